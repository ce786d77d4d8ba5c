"""Coordinated dynamic movement primitives: several manipulators carry one load, verified in continuous time.

>>> import comove
>>> scene = comove.Scene.load("narrow.yaml")             # doctest: +SKIP
>>> solution = comove.solve(scene, seed=0)               # doctest: +SKIP
>>> solution.motion.clearance_min                        # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

from comove._version import __version__

# What the package offers and where it lives; loaded on first use, so that importing comove costs nothing.
_ROOMS = {
    "Comove": "planning",
    "CoordinatedDMP": "coordination",
    "CoordinatedMotion": "coordination",
    "DMP": "dmp",
    "Demonstration": "dmp.demonstrations",
    "Equality": "planning",
    "LeastJerk": "planning",
    "LeastTime": "planning",
    "Library": "dmp",
    "PaperCost": "planning",
    "Primitive": "dmp",
    "ProMP": "dmp",
    "Samples": "planning",
    "Scene": "scenes",
    "Solution": "planning",
    "Trajectory": "trajectory",
    "VerifiedMotion": "verification",
    "as_html": "view.figures.notebooks",
    "best_movement": "planning",
    "combine": "planning",
    "learn": "dmp",
    "show": "view.workbench.recorded",
    "solve": "planning",
    "solve_many": "data",
    "study": "data",
    "verify": "verification",
}

__all__ = ["__version__", *_ROOMS]


def __getattr__(name: str) -> Any:
    if name not in _ROOMS:
        raise AttributeError(f"module 'comove' has no attribute '{name}'")
    return getattr(import_module(f"comove.{_ROOMS[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)

"""Coordinated dynamic movement primitives for manipulators that share a payload.

Motions are verified in continuous time.

>>> import comove
>>> scene = comove.Scene.load("narrow.yaml")             # doctest: +SKIP
>>> solution = comove.solve(scene, seed=0)               # doctest: +SKIP
>>> solution.motion.clearance_min                        # doctest: +SKIP
"""

from __future__ import annotations

from importlib import import_module
from typing import Any
from warnings import warn

from comove._doors import uncollected
from comove._version import __version__

# What the package offers and where it lives; loaded on first use, so that importing comove costs nothing.
_ROOMS = {
    "DMP": "dmp",
    "Demonstration": "dmp.demonstrations",
    "Executor": "solving",
    "LeastJerk": "planning",
    "LeastTime": "planning",
    "Library": "dmp",
    "PaperCost": "planning",
    "Robot": "robots",
    "Scene": "model",
    "Solution": "planning",
    "learn": "dmp",
    "show": "view.workbench.recorded",
    "solve": "solving",
    "solve_many": "data",
    "verify": "stored",
}
_FORMER = {
    **dict.fromkeys(("CoordinatedDMP", "CoordinatedMotion"), "model"),
    **dict.fromkeys(("Comove", "Equality", "Samples", "best_movement"), "planning"),
    **dict.fromkeys(("Primitive", "ProMP"), "dmp"),
    **dict.fromkeys(("Projection", "combine"), "lab.evolution"),
    **{"Trajectory": "trajectory", "VerifiedMotion": "verification", "study": "data"},
}
"""Names that moved to subpackages; they are still found here for one version, with a warning."""
_INTERNAL = {"as_html": "view.figures"}
"""What representations of objects call, whose packages lie above that of figures."""

__all__ = ["__version__", *_ROOMS]


def __getattr__(name: str) -> Any:
    place = _ROOMS.get(name) or _INTERNAL.get(name) or _FORMER.get(name)
    if place is None:
        raise AttributeError(f"module 'comove' has no attribute '{name}'")
    if name in _FORMER:
        warn(f"comove.{name} is now comove.{place}.{name}", DeprecationWarning, stacklevel=2)
    with uncollected():
        return getattr(import_module(f"comove.{place}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)

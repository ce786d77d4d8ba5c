"""Example scenes of the package, and contents of sampled scenes."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

from comove.arrays import Array
from comove.errors import ResultError
from comove.io.files import whole_path
from comove.model.scene import Scene

EXAMPLES = ("wide", "narrow", "complex", "window", "triangle")


def example_path(name: str) -> Path:
    """Return the path of an example's scene file."""
    return Path(str(files("comove") / "examples" / f"{name}.yaml"))


def example(name: str) -> Scene:
    """Load an example scene."""
    return Scene.load(example_path(name))


def copy_examples(folder: Path) -> None:
    """Copy the example scene files to a folder; existing files stay.

    Raises
    ------
    ResultError
        If one cannot be written.
    """
    for source in sorted(example_path("narrow").parent.glob("*.yaml")):
        if not (folder / source.name).exists():
            with whole_path(folder / source.name, ResultError, replace=False) as draft:
                shutil.copyfile(source, draft)


def scene_contents(
    name: str,
    upper: Sequence[float],
    obstacles: list[dict[str, Any]],
    load: dict[str, Any],
    ends: Sequence[Array],
    *,
    names: Sequence[str] = "abcd",
) -> dict[str, Any]:
    """Return the contents of a scene file. The workspace is from 0 to `upper`; the motion lasts ten seconds, at most
    at 1 m/s.

    Parameters
    ----------
    upper : corner of the workspace, n_dims numbers [m]
    ends : end effectors at the start and at the goal, arrays, shape (n_manipulators, n_dims) [m]
    names : names of the manipulators; surplus ones are left out
    """
    start, goal = (end.tolist() for end in ends)
    return {
        "name": name,
        "duration": 10.0,
        "workspace": {"lower": [0.0] * len(upper), "upper": list(upper)},
        "obstacles": obstacles,
        "load": load,
        "manipulators": [
            {"name": n, "start": a, "goal": b} for n, a, b in zip(names, start, goal, strict=False)
        ],
        "limits": {"speed": 1.0},
    }


def wall(
    x: float, thickness: float, low: Array, high: Array, height: float = 1.0, beyond: float = 0.1
) -> list[dict[str, Any]]:
    """Return boxes of a wall across x with an opening. There are two in the plane, four in space.

    Parameters
    ----------
    low, high : arrays, shape (n_dims - 1,), corners of the opening [m]
    height, beyond : height of the workspace, and length of the wall beyond it [m]
    """
    whole = (-beyond, height + beyond)
    sides: list[tuple[tuple[float, float], ...]] = [((-beyond, low[0]),), ((high[0], height + beyond),)]
    if len(low) == 2:
        between = (low[0], high[0])
        sides = [(*side, whole) for side in sides]
        sides += [(between, (-beyond, low[1])), (between, (high[1], height + beyond))]
    return [
        {
            "shape": "box",
            "center": [x, *(float(a + b) / 2 for a, b in side)],
            "size": [float(thickness), *(float(b - a) for a, b in side)],
        }
        for side in sides
    ]

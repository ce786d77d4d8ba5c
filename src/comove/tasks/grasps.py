"""Grasps of movable bodies: all ways in which a gripper may hold one at a place, as grasps of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from comove.arrays import Array, first_least
from comove.dmp.arguments import numbers
from comove.errors import TaskError
from comove.geometry.rotations import matrices
from comove.tasks.world import Body, pose_of

MOST_WAYS = 64  # in which a scene's payload may be held by all arms together


@dataclass(frozen=True, eq=False)
class Grasp:
    """A place on a body, and how grippers may come there.

    Fingers close across a direction, `along`, about which the gripper may be tilted.

    Attributes
    ----------
    body : body to hold
    site : name of the body's site at which it is held; `position` unless given
    position : place in the body's frame [m]; its origin unless given
    along : direction in the body's frame that stays between the fingers; unless given, that of the longest edge of
        the part nearest to the place
    approach : direction of the approach without tilt, in the world at the start; downwards unless given
    tilt_deg : least and largest tilt [deg]
    flip : whether fingers may change sides

    Raises
    ------
    TaskError
        If the body has no such site, or the approach is along `along`.
    """

    body: Body
    site: str | None = None
    position: Sequence[float] | None = None
    along: Sequence[float] | None = None
    approach: Sequence[float] = (0.0, 0.0, -1.0)
    tilt_deg: tuple[float, float] = (0.0, 0.0)
    flip: bool = False

    def __post_init__(self) -> None:
        if self.site is not None:
            self.body.site(self.site)
        if not (self.place.shape == (3,) and np.isfinite(self.place).all()):
            raise TaskError(
                f"the position is {self.position}", key="position", way_out="give three numbers [m]"
            )
        tilt = numbers(self.tilt_deg)
        if tilt.shape != (2,) or not -180.0 <= tilt[0] <= tilt[1] <= 180.0:
            raise TaskError(
                f"the tilt is {self.tilt_deg}",
                key="tilt_deg",
                way_out="give least and largest [deg], -180 to 180",
            )
        self._directions()

    @property
    def place(self) -> Array:
        """Return the place in the body's frame; array, shape (3,) [m]."""
        if self.site is not None:
            return self.body.site(self.site)[:3, 3]
        return np.zeros(3) if self.position is None else numbers(self.position)

    def ways(self, n_most: int) -> list[dict[str, Any]]:
        """Return at most so many grasps of a scene, least tilted first."""
        down, along = self._directions()
        across = np.cross(down, along)
        sides = (1.0, -1.0) if self.flip else (1.0,)
        found = []
        for tilt, side in product(_spread(*self.tilt_deg, n_most // len(sides)), sides):
            turn = _about(along, np.deg2rad(tilt))
            found.append(
                {
                    "position": self.place.tolist(),
                    "approach": (turn @ down).tolist(),
                    "closing": (side * turn @ across).tolist(),
                }
            )
        return found

    def _directions(self) -> tuple[Array, Array]:
        """Return the directions of the approach and between the fingers; unit vectors, (3,)."""
        along = _unit(self._longest() if self.along is None else self.along)
        down = _unit(self.body.pose[:3, :3].T @ _unit(self.approach))
        down = down - (down @ along) * along
        if np.linalg.norm(down) < 1e-3:
            raise TaskError(
                f"the approach to '{self.body.name}' is along what its fingers would hold",
                key="along",
                way_out="give another direction, along or approach",
            )
        return _unit(down), along

    def _longest(self) -> Array:
        """Return the direction of the longest edge of the nearest part; array, shape (3,)."""
        parts = [part for part in self.body.parts if _edges(part) is not None]
        if not parts:
            raise TaskError(
                f"no part of '{self.body.name}' has edges that tell how fingers hold it",
                key="along",
                way_out="give along=[x, y, z], a direction in the body's frame that stays between the fingers",
            )
        off = [np.linalg.norm(_beyond(part, self.place)) for part in parts]
        part = parts[first_least(np.array(off))]
        edges = _edges(part)
        assert edges is not None, "others are left out"
        return pose_of(part)[:3, int(np.argmax(edges))]


def _edges(part: Mapping[str, Any]) -> Array | None:
    """Return the edges of a box around a part [m], (3,).

    It is None for hulls and meshes.
    """
    match part["shape"]:
        case "box":
            return np.array(part["size"], dtype=float)
        case "cylinder":
            return np.array([2 * part["radius"], 2 * part["radius"], part["height"]])
        case "bar":
            return np.array([part["length"], 0.0, 0.0]) + 2 * part["radius"]
    return None


def _beyond(part: Mapping[str, Any], point: Array) -> Array:
    """Return how far a point is outside a part; array, shape (3,) [m]."""
    edges = _edges(part)
    assert edges is not None, "others are left out"
    pose = pose_of(part)
    return np.maximum(np.abs(pose[:3, :3].T @ (point - pose[:3, 3])) - 0.5 * edges, 0.0)


def _spread(least: float, most: float, n_most: int) -> list[float]:
    """Return at most so many angles of a range [deg], smallest first."""
    n = max(1, min(n_most, 1 + int(np.ceil((most - least) / 15.0))))
    middle = 0.0 if least <= 0.0 <= most else 0.5 * (least + most)
    angles = (
        [middle] if n == 1 else np.linspace(least, most, n - (n % 2 == 0 and least < 0.0 < most)).tolist()
    )
    return sorted({round(angle, 9) for angle in angles}, key=abs)


def _about(axis: Array, angle: float) -> Array:
    """Return the rotation about a unit axis, (3,), by an angle [rad]; array, shape (3, 3)."""
    return matrices(np.append(np.cos(0.5 * angle), np.sin(0.5 * angle) * axis))


def _unit(vector: Sequence[float] | Array) -> Array:
    found = numbers(vector)
    length = float(np.linalg.norm(found))
    if found.shape != (3,) or not np.isfinite(length) or length < 1e-12:
        raise TaskError(f"{vector} is no direction", way_out="give three numbers, not all 0")
    return found / length

"""Worlds of tasks: a robot with its joints as they are, obstacles, and bodies that can be moved."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from comove.arrays import Array
from comove.errors import TaskError, near_name
from comove.geometry.rotations import matrices
from comove.robots.model import Robot

if TYPE_CHECKING:
    from comove.tasks.mujoco_world import MujocoWorld


@dataclass(frozen=True, eq=False)
class Body:
    """A body that can be moved.

    Attributes
    ----------
    name : its name
    parts : its shapes in its frame, as `parts` of a scene's payload
    mass : its mass [kg]
    pose : where it is, array, shape (4, 4) [m]
    sites : poses of named places in its frame, arrays, shape (4, 4) [m]
    """

    name: str
    parts: tuple[Mapping[str, Any], ...]
    mass: float
    pose: Array
    sites: Mapping[str, Array] = field(default_factory=dict)

    def at(self, pose: Array) -> Body:
        """Return the body at another pose, array, shape (4, 4) [m]."""
        return replace(self, pose=pose)

    def site(self, name: str) -> Array:
        """Return a site's pose in the body's frame; array, shape (4, 4) [m].

        Raises
        ------
        TaskError
            If the body has none of that name.
        """
        if name in self.sites:
            return self.sites[name]
        way_out = near_name(name, self.sites) if self.sites else "give a position in the body's frame"
        raise TaskError(f"the body '{self.name}' has no site '{name}'", key="site", way_out=way_out)

    @cached_property
    def corners(self) -> Array:
        """Return corners of boxes around its parts, in its frame; array, shape (n, 3) [m]."""
        return np.concatenate([_corners(part) for part in self.parts])

    @property
    def lowest(self) -> float:
        """Return the height of its lowest corner in the world [m]."""
        return float((self.corners @ self.pose[2, :3]).min() + self.pose[2, 3])

    @property
    def radius(self) -> float:
        """Return the largest distance of a corner from its origin [m]."""
        return float(np.linalg.norm(self.corners, axis=1).max())


@dataclass(frozen=True, eq=False)
class World:
    """A robot, obstacles and movable bodies.

    Attributes
    ----------
    robot : the robot, whose home are its joints now
    obstacles : obstacles, as in a scene file, each with a name
    bodies : movable bodies by their names
    clearance : distance that everything keeps from obstacles [m]
    folder : folder of the files that obstacles and bodies name
    """

    robot: Robot
    obstacles: tuple[Mapping[str, Any], ...] = ()
    bodies: Mapping[str, Body] = field(default_factory=dict)
    clearance: float = 0.005
    folder: Path = Path()

    @staticmethod
    def from_mujoco(model: Any, data: Any = None, **options: Any) -> MujocoWorld:
        """Read a MuJoCo model in its present state; see `MujocoWorld.read`."""
        from comove.tasks.mujoco_world import MujocoWorld

        return MujocoWorld.read(model, data, **options)

    def body(self, name: str) -> Body:
        """Return a movable body by its name.

        Raises
        ------
        TaskError
            If there is none of that name.
        """
        if name not in self.bodies:
            raise TaskError(
                f"there is no movable body '{name}'",
                key="body",
                way_out=near_name(name, self.bodies) if self.bodies else "give the world a body",
            )
        return self.bodies[name]

    def top_of(self, obstacle: str) -> float:
        """Return the height of an obstacle's top, a level box [m].

        Raises
        ------
        TaskError
            If there is no such obstacle, or it is no level box.
        """
        by_name = {one["name"]: one for one in self.obstacles}
        if obstacle not in by_name:
            raise TaskError(
                f"there is no obstacle '{obstacle}'", key="set_down", way_out=near_name(obstacle, by_name)
            )
        found = by_name[obstacle]
        turn = matrices(np.array(found.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0)), dtype=float))
        upright = np.abs(turn[2]).max() > 1.0 - 1e-9
        if found["shape"] != "box" or not upright:
            raise TaskError(
                f"'{obstacle}' is no level box",
                key="set_down",
                way_out="carry the body to a pose on it instead",
            )
        return float(found["center"][2] + 0.5 * (np.abs(turn[2]) @ np.array(found["size"], dtype=float)))


def _corners(part: Mapping[str, Any]) -> Array:
    """Return the corners of a part, or of a box around it.

    Array, shape (n, 3), in the body's frame [m].
    """
    match part["shape"]:
        case "box":
            half = 0.5 * np.array(part["size"], dtype=float)
        case "cylinder":
            half = np.array([part["radius"], part["radius"], 0.5 * part["height"]])
        case "bar":
            half = np.array([0.5 * part["length"] + part["radius"], part["radius"], part["radius"]])
        case _:
            points = np.array(part["vertices"], dtype=float)
            return _placed(part, points)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    return _placed(part, signs * half)


def _placed(part: Mapping[str, Any], points: Array) -> Array:
    turn = matrices(np.array(part.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0)), dtype=float))
    return points @ turn.T + np.array(part.get("position", (0.0, 0.0, 0.0)), dtype=float)

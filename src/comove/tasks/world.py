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
from comove.geometry.triangles import read_bytes, triangles_of
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
    folder : folder of the mesh files that parts name
    """

    name: str
    parts: tuple[Mapping[str, Any], ...]
    mass: float
    pose: Array
    sites: Mapping[str, Array] = field(default_factory=dict)
    folder: Path = Path()

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

    @property
    def lowest(self) -> float:
        """Return the height of its lowest point in the world [m]."""
        poses = [self.pose @ pose_of(part) for part in self.parts]
        return min(
            float(pose[2, 3] - _extent(part, -pose[2, :3], self.folder))
            for part, pose in zip(self.parts, poses, strict=True)
        )

    @cached_property
    def radius(self) -> float:
        """Bound the distance of its points from its origin from above [m]."""
        ends = np.vstack([np.eye(3), -np.eye(3)])
        return max(
            float(np.linalg.norm(pose_of(part)[:3, 3]))
            + float(np.sqrt(3.0) * max(_extent(part, axis, self.folder) for axis in ends))
            for part in self.parts
        )


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
        pose = pose_of(found)
        if found["shape"] != "box" or np.abs(pose[2, :3]).max() <= 1.0 - 1e-9:
            raise TaskError(
                f"'{obstacle}' is no level box",
                key="set_down",
                way_out="carry the body to a pose on it instead",
            )
        return float(pose[2, 3] + 0.5 * (np.abs(pose[2, :3]) @ np.array(found["size"], dtype=float)))


def pose_of(part: Mapping[str, Any]) -> Array:
    """Return the pose of a part or an obstacle; array, shape (4, 4) [m]."""
    pose = np.eye(4)
    pose[:3, :3] = matrices(np.array(part.get("quaternion_wxyz", (1.0, 0.0, 0.0, 0.0)), dtype=float))
    pose[:3, 3] = part.get("position", part.get("center", (0.0, 0.0, 0.0)))
    return pose


def _extent(part: Mapping[str, Any], direction: Array, folder: Path) -> float:
    """Return how far a part reaches from its origin [m].

    The direction is a unit vector, (3,), in the part's frame.
    """
    match part["shape"]:
        case "box":
            return float(0.5 * np.array(part["size"]) @ np.abs(direction))
        case "cylinder":
            side = float(np.hypot(direction[0], direction[1]))
            return float(part["radius"] * side + 0.5 * part["height"] * abs(direction[2]))
        case "bar":
            return float(part["radius"] + 0.5 * part["length"] * abs(direction[0]))
        case "mesh":
            file = folder / part["file"]
            vertices = part.get("scale", 1.0) * triangles_of(read_bytes(file), file.suffix)[0]
        case _:
            vertices = np.array(part["vertices"], dtype=float)
    return float((vertices @ direction).max())

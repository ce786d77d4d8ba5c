"""Surroundings of a robot: obstacles as bodies beside its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pinocchio as pin

from comove.arrays import Array
from comove.model.scene import Scene
from comove.robots.model import Robot
from comove.robots.verification.bodies import links_within, obstacle_object

ROOM = 20.0  # m, half the width of a scene that states none


def scene_of(obstacles: Sequence[dict[str, Any]], folder: Path = Path()) -> Scene:
    """Return a scene of obstacles alone; files of meshes are relative to a folder.

    Raises
    ------
    SceneError
        If they are no obstacles as scenes have them.
    """
    nobody = {"name": "nobody", "start": [0.0] * 3, "goal": [0.0] * 3}
    data = {
        "name": "surroundings",
        "duration": 1.0,
        "workspace": {"lower": [-ROOM] * 3, "upper": [ROOM] * 3},
        "manipulators": [nobody],
        "obstacles": list(obstacles),
    }
    return Scene.from_dict(data, folder=folder, check_ends=False)


def names_of(around: Scene) -> list[str]:
    """Return the names of a scene's obstacles."""
    return [around.name_of(i) for i in range(len(around.file.obstacles))]


def among(robot: Robot, around: Scene | None) -> Robot:
    """Return a robot among whose collision bodies are the obstacles of a scene, compared with every link that a joint
    moves; the robot itself where there is no scene.
    """
    if around is None:
        return robot
    geometry = robot.collision.copy()
    links = [k for k, item in enumerate(geometry.geometryObjects) if item.parentJoint > 0]
    for i, name in enumerate(names_of(around)):
        body = obstacle_object(around, i, f"{name}_0")  # numbered, as Pinocchio numbers the bodies of links
        body.parentFrame = 0
        number = geometry.addGeometryObject(body)
        for link in links:
            geometry.addCollisionPair(pin.CollisionPair(link, number))
    return replace(robot, collision=geometry)


def buried(robot: Robot, around: Scene | None, q: Array) -> list[str]:
    """Return which links are inside solids that meshes of a scene close, in words, as no triangle need be near them.

    Parameters
    ----------
    robot : without the scene's obstacles
    q : array, shape (n_joints,) [rad, m]
    """
    return [] if around is None else links_within(robot, around.surfaces, names_of(around), q)

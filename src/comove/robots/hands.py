"""Collisions between the grippers of one payload by their grasps alone.

The links of a gripper are rigid with its grasp frame, so the grasps determine the relative pose of two grippers.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from comove.arrays import Array
from comove.model.candidates import APART
from comove.robots.model import Arm, Robot
from comove.robots.verification.bodies import distance_of, links_of

STEP = 0.005
"""By which grasps are moved apart to find how far apart their hands must be [m]."""
FARTHEST = 1.0
"""Distance of two grasps up to which that is looked for [m]."""


class _Hand(NamedTuple):
    """The links that move rigidly with a grasp frame.

    Attributes
    ----------
    links : their numbers
    shapes, hulls, places : shapes, their convex hulls where they are meshes, and placements in the grasp frame
    centers, radii : arrays, shapes (n_links, 3) and (n_links,), balls that hold them, in the grasp frame [m]
    """

    links: tuple[int, ...]
    shapes: tuple[Any, ...]
    hulls: tuple[Any, ...]
    places: tuple[Any, ...]
    centers: Array
    radii: Array


@lru_cache(maxsize=32)
def _hand_of(robot: Robot, name: str) -> _Hand:
    joint, grasp = robot.grasp_frame(robot.arm(name))
    numbers = [k for k, item in enumerate(robot.collision.geometryObjects) if item.parentJoint == joint]
    links = [links_of(robot).bodies[k] for k in numbers]
    return _Hand(
        tuple(numbers),
        tuple(link.item.geometry for link in links),
        tuple((link.hull or link).item.geometry for link in links),
        tuple(grasp.actInv(link.item.placement) for link in links),
        np.array([grasp.actInv(link.solid.center) for link in links]).reshape(-1, 3),
        np.array([link.solid.radius for link in links]),
    )


@lru_cache(maxsize=8)
def _apart(robot: Robot) -> frozenset[frozenset[int]]:
    return frozenset(map(frozenset, links_of(robot).pairs.tolist()))


def collision_of_hands(
    robot: Robot, arms: tuple[Arm, ...], rotations: Array, points: Array, required: float
) -> tuple[str, str] | None:
    """Return two grippers that collide by their grasps, and a remedy. None if no grippers do.

    Parameters
    ----------
    rotations, points : arrays, shapes (n_arms, 3, 3) and (n_arms, 3), grasp frames at one instant [m]
    required : distance that links keep from each other [m]
    """
    for i, j in combinations(range(len(arms)), 2):
        first, second = _hand_of(robot, arms[i].name), _hand_of(robot, arms[j].name)
        gap = float(np.linalg.norm(points[j] - points[i]))
        frames = [pin.SE3(rotations[k], points[k]) for k in (i, j)]
        if (near := _near(robot, first, second, frames, required)) is None:
            continue
        names, along = f"'{arms[i].name}' and '{arms[j].name}'", pin.SE3.Identity()
        for needed in np.arange(np.ceil(max(gap, APART) / STEP), FARTHEST / STEP) * STEP:
            along.translation = (points[j] - points[i]) * (needed / gap - 1.0)
            if _near(robot, first, second, [frames[0], along * frames[1]], required) is None:
                break
        return (
            f"the grasps of {names} are {gap:.3g} m apart, and there {near} collide whatever joints hold the payload",
            f"move the grasps of {names} apart: along the line between them, hands need at least {needed:.3g} m",
        )
    return None


def _near(robot: Robot, first: _Hand, second: _Hand, frames: list[Any], required: float) -> str | None:
    """Return links of two grippers too near at their grasp frames; None if there are none."""
    one, two = (
        hand.centers @ frame.rotation.T + frame.translation
        for hand, frame in zip((first, second), frames, strict=True)
    )
    away = np.linalg.norm(one[:, None] - two, axis=2) - first.radii[:, None] - second.radii
    for a, b in np.argwhere(away < required).tolist():
        links = first.links[a], second.links[b]
        if frozenset(links) not in _apart(robot):
            continue
        placed = [frames[0] * first.places[a], frames[1] * second.places[b]]
        if (
            distance_of([first.hulls[a], second.hulls[b]], placed) >= required
        ):  # meshes take a hundred times as long
            continue
        if distance_of([first.shapes[a], second.shapes[b]], placed) < required:
            return " and ".join(links_of(robot).bodies[k].name for k in links)
    return None

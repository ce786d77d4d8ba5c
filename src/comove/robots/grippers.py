"""Grippers that a robot's model lacks where its arms hold the payload."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import coal
import numpy as np

from comove.robots.model import Arm, Robot

NEAR = 0.05  # m, from the grasp frame, within which a gripper has a body
BEYOND = 0.01  # m, along the approach, by which a hand in one piece reaches beyond the grasp frame
FLANGE = 0.02  # m, from the grasp frame, within which an arm's own last link holds the payload
POINT = 1e-6  # m, radius of a ball that stands for a point


@lru_cache(maxsize=8)
def without_gripper(robot: Robot) -> tuple[str, ...]:
    """Return the names of the arms whose models have no gripper where they hold the payload.

    An arm has one if a body that moves with its hand is within `NEAR` of its grasp frame, and belongs to a finger or
    to the gripper of the description, reaches beyond the grasp frame along the approach, or is not that of the arm's
    last link, which ends before. So a bare flange is none, nor is a grasp frame in the air.
    """
    return tuple(arm.name for arm in robot.arms if not _has_gripper(robot, arm))


def _has_gripper(robot: Robot, arm: Arm) -> bool:
    joint, grasp = robot.grasp_frame(arm)
    names = {name: link for link, (name, *_) in robot.joints_above.items()}
    last = names[robot.model.names[joint]]
    given, ends_at, rigid = robot.gripper_links(arm), np.inf, False
    for item in robot.collision.geometryObjects:
        if item.parentJoint != joint:
            continue
        link, place = robot.model.frames[item.parentFrame].name, grasp.actInv(item.placement)
        away = _distance(item.geometry, place, coal.Sphere(POINT))
        if link == last:
            ends_at = min(ends_at, away)
        if away > NEAR:
            continue
        if link in given or _is_finger(robot, link, last):
            return True
        beyond = coal.Halfspace(np.array([0.0, 0.0, -1.0]), -BEYOND)
        if _distance(item.geometry, place, beyond) < 0.0:
            return True
        rigid = rigid or link != last
    return rigid and ends_at > FLANGE


def _is_finger(robot: Robot, link: str, last: str) -> bool:
    """Return whether a joint that could move is between a link and the last one of its arm."""
    while link != last:
        _, link, moves = robot.joints_above[link]
        if moves:
            return True
    return False


def _distance(shape: Any, place: Any, other: Any) -> float:
    result = coal.DistanceResult()
    placed = coal.Transform3s(place.rotation, place.translation)
    coal.distance(shape, placed, other, coal.Transform3s(), coal.DistanceRequest(), result)
    return float(result.min_distance)

"""The rules that a home has to keep: those of the search, and of approach and release, which begin and end there."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin

from comove.arrays import Array
from comove.robots.free_space import RoomSettings
from comove.robots.model import Robot
from comove.robots.proposal.bodies import link_of
from comove.robots.search.following import SEARCHING
from comove.robots.verification.bodies import links_apart


def limit_margin(robot: Robot) -> Array:
    """Return the distance that joints keep from their limits; array, shape (n_joints,) [rad, m]."""
    return np.minimum(SEARCHING.keep, 0.5 * (robot.upper - robot.lower))


def clearance_at_home(robot: Robot) -> Array:
    """Return the distance that each pair of links keeps at home; array, shape (n_pairs,) [m]."""
    return links_apart(robot) + RoomSettings().spares[-1]


def near_limits(robot: Robot, rounding: float = 1e-9) -> Iterator[tuple[str, float, float, float]]:
    """Yield each joint that is too near to a limit at home: its name, distance, and the range that keeps it off."""
    keep, q = limit_margin(robot), robot.home
    lower, upper = robot.lower + keep, robot.upper - keep
    for k in np.flatnonzero((q < lower - rounding) | (q > upper + rounding)):
        away = min(q[k] - robot.lower[k], robot.upper[k] - q[k])
        yield robot.joint_names[k], float(away), float(lower[k]), float(upper[k])


def near_links(robot: Robot) -> list[tuple[str, str, float, float]]:
    """Return the pairs of links that are too near at home, the nearest first: their names, distance, and the one that
    they have to keep [m].
    """
    geometry, needed = robot.collision, clearance_at_home(robot)
    data, of_geometry = robot.model.createData(), geometry.createData()
    if not len(needed):
        return []
    pin.computeDistances(robot.model, data, geometry, of_geometry, robot.home)
    apart = np.array([result.min_distance for result in of_geometry.distanceResults])
    links = [link_of(item.name) for item in geometry.geometryObjects]
    found = dict[tuple[str, str], tuple[float, float]]()
    for k in sorted(np.flatnonzero(apart < needed).tolist(), key=lambda k: (apart[k], k)):
        pair = geometry.collisionPairs[k]
        found.setdefault((links[pair.first], links[pair.second]), (float(apart[k]), float(needed[k])))
    return [(a, b, distance, wanted) for (a, b), (distance, wanted) in found.items()]

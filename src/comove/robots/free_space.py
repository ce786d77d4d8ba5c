"""Paths of all joints through free space: straight, one arm after the other, or by RRT-Connect and shortcuts.

Joint space is measured in metres: the length of a joint's motion is the largest change of distance between two bodies
that it can cause. So, on a straight path, no distance changes between two checked configurations by more than half
the length between them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.planning.clock import clock_until
from comove.planning.trees import ARRIVED, BLOCKED, FREE, rrt_connect, shortened
from comove.robots.verification.bodies import Bodies

Array = NDArray[np.float64]

SPARES = (0.02, 0.01, 0.004)  # m, kept beyond what is required; the first that both ends keep
STEP = 0.5  # m, of an extension
MOST_NODES = 2000
SHORTCUTS = 150
NEAR_THE_LINE = 0.5  # share of random configurations near the straight way
SPREAD = 0.5  # rad, of these


@dataclass(frozen=True, eq=False)
class Room:
    """Free space of a robot, in which links keep clear of the scene, the load and each other.

    Attributes
    ----------
    bodies : the bodies and the clearances required of their pairs; a load lies where it was placed
    arms : columns of each arm's joints
    spare : clearance kept beyond the required one [m]
    clock : clock of a search without a deadline
    """

    bodies: Bodies
    arms: tuple[NDArray[np.int64], ...]
    spare: float
    clock: Array = field(default_factory=clock_until)

    @cached_property
    def _placed(self) -> tuple[Any, Any, NDArray[np.int64]]:
        """Return the geometry of the exact pairs alone, its data with the clearance of each, and the pairs'
        numbers.
        """
        bodies, geometry = self.bodies, self.bodies.geometry.copy()
        exact = np.flatnonzero(bodies.exact == np.arange(len(bodies.exact)))
        pairs = [geometry.collisionPairs[int(k)] for k in exact]
        pairs = [(pair.first, pair.second) for pair in pairs]
        geometry.removeAllCollisionPairs()
        for pair in pairs:
            geometry.addCollisionPair(pin.CollisionPair(*pair))
        data = geometry.createData()
        keep = bodies.required[bodies.kind] + bodies.taken + self.spare
        for request, amount in zip(data.collisionRequests, keep[exact].tolist(), strict=True):
            request.security_margin = amount
        return geometry, data, exact

    @cached_property
    def lever(self) -> Array:
        """Return the largest change of a distance per unit of each joint; array, shape (n_joints,) [m/rad]."""
        return self.bodies.reach[:, :-1].max(axis=0)

    @cached_property
    def _data(self) -> Any:
        return self.bodies.robot.model.createData()

    def is_free(self, q: Array) -> bool:
        """Return whether all pairs keep their clearance at joint positions q."""
        geometry, data, _ = self._placed
        return not pin.computeCollisions(self.bodies.robot.model, self._data, geometry, data, q, True)

    def contact(self, q: Array) -> str:
        """Return the names of two bodies that are too near at q; empty where there are none."""
        geometry, data, exact = self._placed
        pin.computeCollisions(self.bodies.robot.model, self._data, geometry, data, q, False)
        for number, result in zip(exact, data.collisionResults, strict=True):
            if result.isCollision():
                return self.bodies.name(int(number))
        return ""

    def length(self, first: Array, second: Array) -> float:
        """Return the largest change of any distance on the straight path between two configurations [m]."""
        return float(np.abs(second - first) @ self.lever)

    def draw(self, nodes: Array, counts: Array, this: int, rng: np.random.Generator, out: Array) -> bool:
        """Write random joints, some of them near the straight way between both ends."""
        robot, start, goal = self.bodies.robot, nodes[0, 0], nodes[1, 0]
        if rng.random() > NEAR_THE_LINE:
            out[:] = robot.lower + rng.random(len(start)) * (robot.upper - robot.lower)
            return True
        q = start + rng.random() * (goal - start) + SPREAD * rng.standard_normal(len(start))
        np.clip(q, robot.lower, robot.upper, out=out)
        return True

    def nearest(self, tree: Array, count: int, q: Array) -> int:
        """Return the number of the nearest node."""
        return int((np.abs(tree[:count] - q) @ self.lever).argmin())

    def extend(self, p: Array, q: Array, steps: float, margin: float, out: Array) -> int:
        """Write the node at most so many steps from p towards q; return whether the edge is free."""
        away = self.length(p, q)
        share = 1.0 if away <= steps * STEP else steps * STEP / away
        out[:] = q if share == 1.0 else p + share * (q - p)
        if away == 0.0 or not (self.is_free(out) and self.is_free_between(p, out)):
            return BLOCKED
        return ARRIVED if share == 1.0 else FREE

    def between(self, p: Array, q: Array, share: float, out: Array) -> bool:
        """Write the node at a share of an edge; return whether it is free."""
        out[:] = p + share * (q - p)
        return self.is_free(out)

    def shortens(self, p: Array, q: Array, way: float) -> bool:
        """Return True: the straight piece between two nodes is never longer."""
        return True

    def is_free_between(self, first: Array, second: Array) -> bool:
        """Return whether all pairs keep their clearance, less the spare, straight between two free configurations."""
        count = int(np.ceil(self.length(first, second) / (2.0 * self.spare)))
        shares = np.arange(1, count) / max(count, 1)
        coarse_first = shares[np.argsort([_bits(k) for k in range(1, count)])] if count > 2 else shares
        return all(self.is_free(first + share * (second - first)) for share in coarse_first)


def way(room: Room, start: Array, goal: Array, rng: np.random.Generator) -> Array | None:
    """Search configurations from start to goal with free straight paths between them; None where none were found.

    Returns
    -------
    array, shape (n_configurations, n_joints)
    """
    for path in _simple(room, start, goal):
        if all(room.is_free(q) for q in path[1:-1]) and _is_free_along(room, path):
            return path
    nothing = np.empty((0, len(start)))
    path = rrt_connect.py_func(room, start, goal, 0.0, rng, MOST_NODES, 20 * MOST_NODES, nothing)
    if len(path) == 0:
        return None
    path = shortened.py_func(room, path, 0.0, rng, SHORTCUTS)
    return path[_corners(path)]


def _simple(room: Room, start: Array, goal: Array) -> Iterator[Array]:
    """Yield the straight path, and the paths that move one arm after the other."""
    yield np.stack([start, goal])
    for columns in room.arms if len(room.arms) > 1 else ():
        between = start.copy()
        between[columns] = goal[columns]
        yield np.stack([start, between, goal])


def _is_free_along(room: Room, path: Array) -> bool:
    return all(room.is_free_between(a, b) for a, b in zip(path[:-1], path[1:], strict=True))


def _corners(path: Array) -> list[int]:
    """Return the indices of both ends and of the configurations at which the path turns."""
    kept = [0]
    for k in range(1, len(path) - 1):
        before, after = path[k] - path[kept[-1]], path[k + 1] - path[k]
        if np.linalg.norm(before) > 1e-9 and np.linalg.norm(after) > 1e-9:
            share = before @ after / (np.linalg.norm(before) * np.linalg.norm(after))
            if share < 1.0 - 1e-12:
                kept.append(k)
    return [*kept, len(path) - 1]


def _bits(number: int) -> float:
    """Return a term of the van der Corput sequence; sorted by it, numbers far from all earlier ones come first."""
    value, share = 0.0, 0.5
    while number:
        value, share, number = value + share * (number & 1), 0.5 * share, number >> 1
    return value

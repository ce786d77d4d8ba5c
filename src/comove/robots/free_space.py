"""Paths of all joints through free space: straight, arm by arm, or RRT-Connect.

Shortcuts shorten the last. Joint space is measured in metres: the length of a joint's motion is the largest change of
distance between two bodies that it can cause. So, on a straight path, no distance changes between two checked
configurations by more than half the length between them.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.model.scene import Scene
from comove.planning.clock import clock_until
from comove.planning.trees import ARRIVED, BLOCKED, FREE, rrt_connect, shortened
from comove.robots.model import Arm
from comove.robots.search.capsules import PROUDEST
from comove.robots.search.links import FATTEST, ROUGH
from comove.robots.search.outline import Outline
from comove.robots.verification.bodies import HULL_OF, SCENE, SELF, Bodies


@dataclass(frozen=True)
class RoomSettings:
    """Settings of paths through free space.

    Attributes
    ----------
    spares : clearances beyond the required one, of which a pair keeps the first that it has at both ends [m]
    step : length of an extension of a tree, at most [m]
    most_nodes : nodes of both trees, at most
    n_shortcuts : attempts to shorten a path
    near_the_line, spread : share of random configurations near the straight path, and their distance from it [rad]
    """

    spares: tuple[float, ...] = (0.02, 0.01, 0.004)
    step: float = 0.5
    most_nodes: int = 2000
    n_shortcuts: int = 150
    near_the_line: float = 0.5
    spread: float = 0.5


SETTINGS = RoomSettings()


@dataclass(frozen=True, eq=False)
class Room:
    """Free space of a robot among the scene, the payload and itself.

    Attributes
    ----------
    bodies : the bodies and the clearances required of their pairs; a payload lies at its place
    arms : the arms that move; those already at their goal are static
    spare : array, shape (n_pairs,), clearance kept beyond the required one [m]
    outline : the arms as capsules, which save most of the exact checks; None to have all
    clock : clock of a search without a deadline
    """

    bodies: Bodies
    arms: tuple[Arm, ...]
    spare: Array
    outline: Outline | None = None
    clock: Array = field(default_factory=clock_until)

    @classmethod
    def for_ends(cls, bodies: Bodies, scene: Scene, ends: Array, nodes: Array | None) -> Room:
        """Return the free space that keeps the spare clearance of both ends.

        Parameters
        ----------
        bodies : a payload lies at its place
        ends : array, shape (2, n_joints)
        nodes : array, shape (n_nodes, 3), keypoints of the payload [m]; None where there is none
        """
        spare, robot = np.full(len(bodies.kind), SETTINGS.spares[0]), bodies.robot
        for lower in SETTINGS.spares[1:]:
            room = cls(bodies, robot.arms, spare)
            spare = spare.copy()
            near = [number for q in ends for number in room._touching(q)]
            spare[np.isin(bodies.exact, near)] = lower
        arms = tuple(arm for arm in robot.arms if (ends[0] != ends[1])[arm.columns].any())
        room, eased = cls(bodies, arms, spare), float(bodies.required[SCENE] - bodies.required[SELF])
        outline = Outline.between(robot, scene, ends, nodes, keep=room._limits[0], eased=eased)
        return replace(room, outline=outline)

    @classmethod
    def widest(cls, bodies: Bodies) -> Room:
        """Return the free space with the least spare clearance.

        Every other one is part of it.
        """
        return cls(bodies, bodies.robot.arms, np.full(len(bodies.kind), SETTINGS.spares[-1]))

    @property
    def rigorous(self) -> Room:
        """Return the same space without approximate checks."""
        return replace(self, outline=None)

    @cached_property
    def _required(self) -> Array:
        """Return the distance that each pair keeps; array, shape (n_pairs,) [m]."""
        bodies = self.bodies
        return np.maximum(bodies.required[bodies.kind], bodies.strayed) + bodies.taken + self.spare

    @cached_property
    def _all(self) -> _Pairs:
        return _Pairs.of(self.bodies, np.arange(len(self.bodies.kind)), self._required)

    @cached_property
    def _first(self) -> _Pairs:
        """Return the pairs of moving bodies that are checked first, as hulls."""
        exact, moves = self.bodies.exact, self.bodies.joint_reach.any(axis=1)
        held = exact[exact != np.arange(len(exact))]
        return _Pairs.of(self.bodies, np.setdiff1d(np.flatnonzero(moves), held), self._required)

    @cached_property
    def _rows_of(self) -> dict[frozenset[str], list[int]]:
        """Return rows of `_first` by link names. Obstacles and payload are not named."""
        items, numbers = self.bodies.geometry.geometryObjects, self._first.numbers
        ends, alone = self.bodies.ends[numbers].tolist(), self.bodies.kind[numbers] != SELF
        rows = defaultdict[frozenset[str], list[int]](list)
        for row, (pair, single) in enumerate(zip(ends, alone, strict=True)):
            bodies = pair[:1] if single else pair
            rows[frozenset(items[k].name.removeprefix(HULL_OF) for k in bodies)].append(row)
        return dict(rows)

    @cached_property
    def _limits(self) -> tuple[float, float]:
        """Return the outline's clearances of free and of blocked space [m]."""
        enough = float(self._required.max(initial=0.0)) + PROUDEST + ROUGH
        spare = float(self.spare.min(initial=SETTINGS.spares[0]))
        return enough, float(self.bodies.required.max()) + spare - FATTEST

    @cached_property
    def _moves(self) -> NDArray[np.bool_]:
        """Return which joints move; array, shape (n_joints,)."""
        moves = np.zeros(len(self.bodies.robot.lower), dtype=bool)
        for arm in self.arms:
            moves[arm.columns] = True
        return moves

    @cached_property
    def lever(self) -> Array:
        """Return the largest change of a distance per unit of each joint; array, shape (n_joints,) [m/rad]."""
        return self.bodies.joint_reach.max(axis=0)

    def is_free(self, q: Array) -> bool:
        """Return whether all pairs keep their clearance at joint positions q."""
        return self.are_free(q[None])

    def are_free(self, q: Array) -> bool:
        """Return whether pairs keep their clearance at configurations; `q` has the shape (n, n_joints)."""
        if (outline := self.outline) is None:
            return not any(self._touching(one) for one in q)
        enough, blocked = self._limits
        apart = outline.clearances(q, enough, blocked)
        if not (apart > blocked).all():
            return False
        for one in q[apart < enough]:
            about, near = outline.near(one, enough)
            names = outline.untold | near | {frozenset((name,)) for name in about}
            if self._touching(one, self._rows(names)):
                return False
        untold = self._rows(outline.untold)
        return not (untold and any(self._touching(one, untold) for one in q[apart >= enough]))

    def _rows(self, names: frozenset[frozenset[str]]) -> list[int]:
        return [row for name in names for row in self._rows_of.get(name, ())]

    def _touching(self, q: Array, some: list[int] | None = None) -> list[int]:
        """Return the pairs that are too near at q. Some of those checked first may be selected."""
        exact, everything = self.bodies.exact, self._all
        near = [(k, int(exact[k])) for k in self._first.near(q, some)]
        if any(k != number for k, number in near):
            everything.put(q)
        return [number for k, number in near if k == number or everything.is_near(number)]

    def contact(self, q: Array) -> str:
        """Return the names of two bodies that are too near at q; empty where there are none."""
        touching = self._touching(q)
        return self.bodies.name(touching[0]) if touching else ""

    def length(self, first: Array, second: Array) -> float:
        """Return the largest distance change on the straight path between configurations [m]."""
        return float(np.abs(second - first) @ self.lever)

    def draw(self, nodes: Array, counts: Array, this: int, rng: np.random.Generator, out: Array) -> bool:
        """Write random joints, some near the straight path between both ends."""
        robot, start, goal = self.bodies.robot, nodes[0, 0], nodes[1, 0]
        if rng.random() > SETTINGS.near_the_line:
            q = robot.lower + rng.random(len(start)) * (robot.upper - robot.lower)
        else:
            q = start + rng.random() * (goal - start) + SETTINGS.spread * rng.standard_normal(len(start))
        out[:] = np.where(self._moves, np.clip(q, robot.lower, robot.upper), start)
        return True

    def nearest(self, tree: Array, count: int, q: Array) -> int:
        """Return the number of the nearest node."""
        return int((np.abs(tree[:count] - q) @ self.lever).argmin())

    def extend(self, p: Array, q: Array, steps: float, margin: float, out: Array) -> int:
        """Write the node some steps from p towards q; return whether it is free."""
        away, most = self.length(p, q), steps * SETTINGS.step
        share = 1.0 if away <= most else most / away
        out[:] = q if share == 1.0 else p + share * (q - p)
        if away == 0.0 or not (self.is_free(out) and self.is_free_between(p, out)):
            return BLOCKED
        return ARRIVED if share == 1.0 else FREE

    def between(self, p: Array, q: Array, share: float, out: Array) -> None:
        """Write the node at a share of an edge."""
        out[:] = p + share * (q - p)

    def exists(self, p: Array, node: Array) -> bool:
        """Return whether a node is free."""
        return self.is_free(node)

    def shortens(self, p: Array, q: Array, way: float, margin: float) -> bool:
        """Return True: the straight piece between two nodes is never longer."""
        return True

    def is_free_between(self, first: Array, second: Array) -> bool:
        """Return whether pairs keep clear, less the spare, straight between free configurations."""
        changes = self.bodies.joint_reach @ np.abs(second - first)
        count = int(np.ceil((changes / (2.0 * self.spare)).max(initial=0.0)))
        width = count.bit_length()
        # By their bits from the last to the first, numbers come that are far from all earlier ones.
        coarse_first = sorted(range(1, count), key=lambda k: int(f"{k:0{width}b}"[::-1], 2))
        shares = np.array(coarse_first)[:, None] / count
        return count < 2 or self.are_free(first + shares * (second - first))


@dataclass(frozen=True, eq=False)
class _Pairs:
    """Some pairs of bodies, each with the distance that it keeps.

    Attributes
    ----------
    model, kinematics : the robot's, which move the bodies
    geometry, data : the bodies and these pairs alone
    numbers : array, shape (n,), the pairs' numbers among all
    required : array, shape (n,), distance that each keeps [m]
    """

    model: Any
    kinematics: Any
    geometry: Any
    data: Any
    numbers: Integers
    required: Array

    @classmethod
    def of(cls, bodies: Bodies, numbers: Integers, required: Array) -> _Pairs:
        """Return some pairs of bodies, which are copied."""
        which, model = np.isin(np.arange(len(bodies.kind)), numbers), bodies.robot.model
        geometry = bodies.some(which).geometry
        data = geometry.createData()
        for request, amount in zip(data.collisionRequests, required[numbers].tolist(), strict=True):
            request.security_margin = amount
        return cls(model, model.createData(), geometry, data, numbers, required[numbers])

    def near(self, q: Array, some: list[int] | None = None) -> list[int]:
        """Return the numbers of pairs too near at q; `some` are the rows to check."""
        rows, data = range(len(self.numbers)) if some is None else some, self.data
        data.deactivateAllCollisionPairs()
        for row in rows:
            data.activateCollisionPair(row)
        if not rows or not pin.computeCollisions(self.model, self.kinematics, self.geometry, data, q, False):
            return []
        results = data.collisionResults
        return [int(self.numbers[row]) for row in rows if results[row].isCollision()]

    def put(self, q: Array) -> None:
        """Move the bodies to joint positions q."""
        pin.updateGeometryPlacements(self.model, self.kinematics, self.geometry, self.data, q)

    def is_near(self, k: int) -> bool:
        """Return whether the k-th pair is too near in its placement."""
        result = pin.computeDistance(self.geometry, self.data, k)  # for meshes faster than a margin
        return bool(result.min_distance < self.required[k])


def way(room: Room, start: Array, goal: Array, rng: np.random.Generator) -> Array | None:
    """Search configurations from start to goal with free straight paths between them. None on failure.

    Returns
    -------
    array, shape (n_configurations, n_joints)
    """
    if not room.are_free(np.stack([start, goal])):
        return None
    for path in _simple(room, start, goal):
        if room.are_free(path[1:-1]) and all(room.is_free_between(a, b) for a, b in pairwise(path)):
            return path
    nothing = np.empty((0, len(start)))
    how = SETTINGS
    path = rrt_connect.py_func(room, start, goal, 0.0, rng, how.most_nodes, 20 * how.most_nodes, nothing)
    if len(path) == 0:
        return None
    path = shortened.py_func(room, path, 0.0, rng, how.n_shortcuts, False)
    return path[_corners(path)]


def _simple(room: Room, start: Array, goal: Array) -> Iterator[Array]:
    """Yield the straight path, and those moving one arm at a time."""
    yield np.stack([start, goal])
    for arm in room.arms if len(room.arms) > 1 else ():
        between = start.copy()
        between[arm.columns] = goal[arm.columns]
        yield np.stack([start, between, goal])


def _corners(path: Array) -> list[int]:
    """Return the indices of both ends and all turns of a path."""
    kept = [0]
    for k in range(1, len(path) - 1):
        before, after = path[k] - path[kept[-1]], path[k + 1] - path[k]
        if np.linalg.norm(before) > 1e-9 and np.linalg.norm(after) > 1e-9:
            share = before @ after / (np.linalg.norm(before) * np.linalg.norm(after))
            if share < 1.0 - 1e-12:
                kept.append(k)
    return [*kept, len(path) - 1]

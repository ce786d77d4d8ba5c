"""Continuous-time certificate of a robot's clearance.

Two bodies that are d apart at an instant are, at all times at most w before or after it, at least

    d - w sum_j max|q_j'| r_j

apart, where r_j is the largest distance of the moved body from the axis of joint j (1 for a joint that slides), and
only the joints between the two count; the payload and moving obstacles add their own largest speeds. The balls about
the bodies are tried first: where they are far enough apart, so are the bodies.

Of convex bodies a second bound is computed along one unit vector n, fixed in the frame that both share: the scene's,
or that of the last joint that moves both. The distance of two points along n is a function of time whose second
derivative is bounded; so between two instants, h apart, it is above its chord less h^2/8 times that bound. At the
instants it is at least the width of the slab that separates the bodies, by their support functions. So

    d >= min slab(t_i, n) - h^2/8 max|p''|

holds for any n. It comes from the interval before, or from GJK (see `slabs`). With r_j as above the second
derivative is at most

    sum r_j |q_j''| + 2 sum |q_j'| sum r_j |q_j'|,

as that of a position by two joints is no longer than the reach r_j of the one nearer to the body. The payload adds
the largest acceleration of its keypoints, and moving obstacles add h/2 times their speed. So an end effector that
glides over a table comes no nearer to it, however fast it is.

Where both bounds are too small, the time interval is divided into four, for those pairs only. Coal computes the
distances of bodies that are not convex, and of those that penetrate each other. Meshes are checked by their convex
hulls first, and themselves only where hulls are too near, as that takes a thousand times as long.

Of meshes no vector n serves all points. But the distance f = |u| of any two points has

    f'' = (|u'|^2 - f'^2) / f + u u'' / f <= s^2 / m + max|p''|,

with s = sum_j max|q_j'| r_j and m the least f, at least min d(t_i) - s h/2. So between two instants that are h apart
no two points, and no two bodies, come nearer than

    d >= min d(t_i) - h^2/8 (s^2 / m + max|p''|),

unless an obstacle moves, whose second derivative has no bound.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from comove.arrays import Array, Integers
from comove.errors import OptionError
from comove.robots.motion import JointCurve, Ranges
from comove.robots.verification.bodies import Bodies, depth_of, distance_of
from comove.robots.verification.carried import LoadMotion
from comove.robots.verification.kinematics import joint_placements
from comove.robots.verification.slabs import (
    MEASURE,
    OPEN,
    BoundTargets,
    Intervals,
    bound_cells,
    changes,
    decided,
    distances_of_balls,
    enough,
    measure_cells,
    note,
)

LARGER = 1e-9  # m, by which a distance is larger than another, whatever rounding does


@dataclass(frozen=True)
class JointCertificateSettings:
    """Settings of the certificate's resolution. Every bound is sound with any of them.

    Attributes
    ----------
    parts : intervals of the motion that are checked first
    deepest : levels, each of which divides the intervals of the level before into four, at most
    tight : how far a bound may stay below the clearance [m]
    loose : likewise where the clearance is too small anyway [m]
    most : cells that balls do not decide, at most; a bound that needs more stays as it is, sound but lower
    few : cells of each kind with the nearest bodies, which are checked first, as they may spare others
    """

    parts: int = 16
    deepest: int = 11
    tight: float = 1e-3
    loose: float = 5e-3
    most: int = 400_000
    few: int = 8

    def __post_init__(self) -> None:
        for name in ("parts", "deepest", "most", "few"):
            if not getattr(self, name) >= 1:
                raise OptionError(f"{name} = {getattr(self, name)}", key=name, way_out="give 1 or more")
        for name in ("tight", "loose"):
            if not getattr(self, name) >= 0.0:
                raise OptionError(f"{name} = {getattr(self, name)}", key=name, way_out="give 0 or more")


class LinkClearance(NamedTuple):
    """Certified bounds of the clearance of one kind of pairs.

    Attributes
    ----------
    lower : certified lower bound of the clearance at every instant [m]; infinite where there is no pair
    upper : least clearance computed at any instant [m]
    pair : number of the pair that has `upper`
    time : time at which it has it [s]
    weakest : number of the pair that has `lower` where that is less than required, else -1
    around : middle of the interval in which it has it [s]
    """

    lower: float
    upper: float
    pair: int
    time: float
    weakest: int
    around: float


@dataclass(frozen=True, eq=False)
class CarryCourse:
    """The joints of a robot, the payload and obstacles by time.

    Attributes
    ----------
    bodies : bodies of robot, obstacles and payload
    load : the payload, in motion or at rest
    curve : joint positions by time [s], cubic between samples
    """

    bodies: Bodies
    load: LoadMotion
    curve: JointCurve

    @cached_property
    def bounds(self) -> Ranges:
        """Return the joints' largest rates, then second derivatives [rad/s, rad/s^2]."""
        return Ranges(self.curve.x, np.hstack([self.curve.fastest[0], self.curve.bends_between]))

    def frames(self, time: Array) -> tuple[Array, Array]:
        """Compute the placements of all frames.

        Returns
        -------
        arrays, shape (n_steps, n_frames, 3, 3) and (n_steps, n_frames, 3) [m]
        """
        return frames(self.bodies, self.curve(time), self.load.nodes(time), time)

    def intervals(self, number: Integers, parts: int) -> tuple[Intervals, Array]:
        """Return intervals by `number`, (n_intervals,), with ends and middles, (n_instants,) [s]."""
        last = float(self.curve.x[-1])
        begins = np.diff(number, prepend=-2) > 1  # the others begin where one ends
        knot = (2 * np.arange(len(number)) + np.cumsum(begins) - 1)[:, None] + np.arange(3)
        time = np.empty(2 * len(number) + int(begins.sum()))
        time[knot] = last * (2 * number[:, None] + np.arange(3)) / (2 * parts)
        begin, end = time[knot[:, 0]], time[knot[:, 2]]
        joints, load = self.bounds.over(begin, end), self.load.bounds.over(begin, end)
        rates, bends = joints[:, : self.curve.c.shape[2]], joints[:, self.curve.c.shape[2] :]
        by_obstacles = self.bodies.moving.speed.over(begin, end)
        return (
            Intervals(
                knot,
                *self.frames(time),
                np.hstack([rates, load[:, :1], by_obstacles]),
                np.hstack([bends, load[:, 1:]]),
                0.5 * last / parts,
            ),
            time,
        )


def frames(bodies: Bodies, q: Array, nodes: Array, time: Array) -> tuple[Array, Array]:
    """Compute the placements of all frames at instants, shape (n_steps,) [s].

    Parameters
    ----------
    q : array, shape (n_steps, n_joints) [rad, m for joints that slide]
    nodes : array, shape (n_steps, n_nodes, 3), keypoints of the payload [m]

    Returns
    -------
    arrays, shape (n_steps, n_frames, 3, 3) and (n_steps, n_frames, 3) [m]
    """
    turns, places = joint_placements(bodies.robot, q)
    turned, placed = bodies.placements(nodes, time)
    if not turned:
        return turns, places
    return (
        np.concatenate([turns, np.stack(turned, axis=1)], axis=1),
        np.concatenate([places, np.stack(placed, axis=1)], axis=1),
    )


class PairCells(NamedTuple):
    """Pairs during time intervals, all of a pair one after the other.

    Attributes
    ----------
    number : array, shape (n_cells,), numbers of the intervals among all of one length
    pair : array, shape (n_cells,), numbers of the pairs
    normal : array, shape (n_cells, 3), directions that parted the pairs last; zeros for none
    """

    number: Integers
    pair: Integers
    normal: Array

    @classmethod
    def first(cls, bodies: Bodies, parts: int) -> PairCells:
        """Return the first intervals' cells of all pairs, rough ones preferred. Immovable pairs have one."""
        rough = bodies.exact != np.arange(len(bodies.exact))
        begun = np.ones(len(rough), dtype=bool)
        begun[bodies.exact[rough]] = False
        count = np.where(begun, np.where(bodies.reach.any(axis=1), parts, 1), 0)
        pair = np.repeat(np.arange(len(begun)), count)
        number = np.arange(len(pair)) - np.repeat(np.cumsum(count) - count, count)
        return cls(number, pair, np.zeros((len(pair), 3)))

    def divided(self, chosen: Integers) -> PairCells:
        """Return the quarters of the chosen cells."""
        number = (4 * self.number[chosen, None] + np.arange(4)).ravel()
        return PairCells(number, np.repeat(self.pair[chosen], 4), np.repeat(self.normal[chosen], 4, axis=0))


def certify(
    bodies: Bodies,
    carried: LoadMotion,
    curve: JointCurve,
    slack: float = 0.0,
    settings: JointCertificateSettings = JointCertificateSettings(),
) -> list[LinkClearance]:
    """Bound the clearance of all pairs over continuous time, by kind: SCENE, LOAD, SELF.

    Where a pair violates its required clearance, the bound of its kind is only as tight as `loose`.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples
    slack : share of the clearance beyond the required one that bounds may lose. With any, the required clearance is
        certified as before, but bounds are loose where it is exceeded, and computation ends once a pair violates it.
        With all of it, no unnecessary clearance is computed: convex hulls suffice where they keep the required one
    """
    need = BoundTargets.none(bodies.required, slack, settings.tight, settings.loose)
    course, cells, parts = (
        CarryCourse(bodies, carried, curve),
        PairCells.first(bodies, settings.parts),
        settings.parts,
    )
    lower, when, computed = np.full(3, np.inf), np.zeros(3), 0
    weakest, around = np.full(3, -1), np.zeros(3)
    known = dict[tuple[int, float], tuple[float, float]]()
    for depth in range(settings.deepest):
        numbers, row = _numbered(cells.number, parts)
        at, time = course.intervals(numbers, parts)
        uppers = need.upper.copy()
        level = Level(bodies, at, cells, row, need, time, known)
        if depth == 0 and slack < 1.0:  # what the clearance is about, before anything is compared with it
            level.begin(settings.few)
        bound, count = level.bounds()
        computed += count
        before, is_last = lower.copy(), depth == settings.deepest - 1 or computed > settings.most
        done = decided(need, bodies.kind, cells.pair, bound, is_last, lower)
        for kind in np.flatnonzero((lower < before) & (lower < bodies.required)):
            own = done & (bodies.kind[cells.pair] == kind)
            least = np.flatnonzero(own & (bound == lower[kind]))[0]
            weakest[kind] = bodies.exact[cells.pair[least]]
            around[kind] = (cells.number[least] + 0.5) / parts * curve.x[-1]
        changed = need.upper < uppers
        when[changed] = time[need.knot[changed]]
        if done.all():
            break
        cells, parts = cells.divided(np.flatnonzero(~done)), 4 * parts
    columns = lower, need.upper, need.pair, when, weakest, around
    return [LinkClearance(*found) for found in zip(*(column.tolist() for column in columns), strict=True)]


def _numbered(number: Integers, parts: int) -> tuple[Integers, Integers]:
    """Return the numbers that occur, and each cell's place among them."""
    if parts > 8 * len(number) + 64:
        return np.unique(number, return_inverse=True)
    occurs = np.zeros(parts, dtype=bool)
    occurs[number] = True
    return np.flatnonzero(occurs), (np.cumsum(occurs) - 1)[number]


def are_clear(bodies: Bodies, q: Array, nodes: Array, time: float) -> bool:
    """Return whether pairs that joints move keep clear at an instant.

    Parameters
    ----------
    q : array, shape (n_joints,) [rad, m for joints that slide]
    nodes : array, shape (n_nodes, 3), keypoints of the payload [m]
    time : the instant, which places moving obstacles [s]
    """
    cells, still = PairCells.first(bodies, 1), np.zeros((1, bodies.reach.shape[1]))
    moved = bodies.joint_reach[cells.pair].any(axis=1)
    cells = PairCells(cells.number[moved], cells.pair[moved], cells.normal[moved])
    at = Intervals(
        np.zeros((1, 3), dtype=np.int64),
        *frames(bodies, q[None], nodes[None], np.array([time])),
        still,
        still[:, : bodies.robot.model.nv + 1],
        0.0,
    )
    need = BoundTargets.none(bodies.required, 1.0, 0.0, 0.0)
    row = np.zeros(len(cells.pair), dtype=np.int64)
    bound, _ = Level(bodies, at, cells, row, need, np.array([time])).bounds()
    return bool((bound >= bodies.required[bodies.kind[cells.pair]]).all())


@dataclass(frozen=True, eq=False)
class Level:
    """The cells of one level.

    Attributes
    ----------
    bodies, at, cells : bodies, intervals and cells
    row : array, shape (n_cells,), number of each cell's interval in `at`
    need : bounds that suffice
    time : array, shape (n_instants,), the instants of `at` [s]
    known : by pair and instant, its distance as coal computed it, and the least that it was not computed beyond [m]
    """

    bodies: Bodies
    at: Intervals
    cells: PairCells
    row: Integers
    need: BoundTargets
    time: Array
    known: dict[tuple[int, float], tuple[float, float]] = field(default_factory=dict)

    def begin(self, few: int) -> None:
        """Compute the distances of each kind's nearest `few` cells. Balls determine which."""
        bodies, pair = self.bodies, self.cells.pair
        apart, kinds = (
            distances_of_balls(bodies.solids, bodies.pairs, self.at, self.row, pair),
            bodies.kind[pair],
        )
        for kind in range(3):
            own = np.flatnonzero(kinds == kind)
            own = own[np.argsort(apart[own], kind="stable")[:few]]
            row, exact = self.row[own], bodies.exact[pair[own]]
            left = measure_cells(bodies.solids, bodies.pairs, self.at, row, exact, self.need)
            for k in np.flatnonzero(left).tolist():
                self.measure(int(self.at.knot[row[k], 1]), int(exact[k]), 0.0)

    def measure(self, knot: int, pair: int, within: float) -> float:
        """Compute a pair's distance at an instant by coal [m]. Possible errors are subtracted.

        One that exceeds the least of its kind by more than `within` [m] may be returned as one that just does. No
        instant is measured twice.
        """
        bodies, kind, key = self.bodies, self.bodies.kind[pair], (pair, float(self.time[knot]))
        distance, most = self.known.get(key, (np.inf, -np.inf))
        wanted = float(self.need.upper[kind]) + within + LARGER
        if distance < most or most >= wanted:
            return distance
        taken = float(bodies.taken[pair])
        placed = _placed(bodies, pair, self.at.turns[knot], self.at.places[knot])
        distance = distance_of(*placed, wanted + taken) - taken
        note(self.need, kind, pair, knot, distance)
        self.known[key] = distance, wanted
        return distance

    def bounds(self) -> tuple[Array, int]:
        """Bound all cells' distances, shape (n_cells,) [m]; count those decided beyond balls.

        Of those left to coal the nearest come first: their results may spare the rest.
        """
        bodies, pair, need = self.bodies, self.cells.pair, self.need
        state, bound = np.empty(len(pair), dtype=np.int64), np.empty(len(pair))
        bound_cells(
            bodies.solids, bodies.pairs, self.at, self.row, pair, self.cells.normal, need, state, bound
        )
        left = np.flatnonzero(state == MEASURE)
        if not len(left):
            return bound, int((state != OPEN).sum())
        left = left[np.argsort(bound[left], kind="stable")]
        row, exact = self.row[left], bodies.exact[pair[left]]
        found = zip(
            left.tolist(),
            self.at.knot[row].tolist(),
            exact.tolist(),
            *(bounds.tolist() for bounds in changes(bodies.pairs, self.at, row, exact)),
            strict=True,
        )
        for cell, knots, own, change, bulge in found:
            least = enough(need, bodies.kind[own])
            if bound[cell] < least:
                bound[cell] = max(bound[cell], self._measured(knots, own, change, bulge, least))
        return bound, int((state != OPEN).sum())

    def _measured(self, knots: list[int], pair: int, change: float, bulge: float, least: float) -> float:
        """Bound a pair's distance during an interval by coal [m].

        The middle is measured where it may suffice.

        Parameters
        ----------
        knots : numbers of its begin, middle and end
        change, bulge : as `changes` returns them [m]
        least : bound that suffices [m]
        """
        begin, end = (self.measure(knot, pair, 2.0 * change) for knot in knots[::2])
        near, bound = min(begin, end), between(begin, end, change, 4.0 * bulge)
        if bound >= least or between(near, near, 0.5 * change, bulge) < least:
            return bound
        middle = self.measure(knots[1], pair, 2.0 * change)
        return max(
            bound, min(between(begin, middle, 0.5 * change, bulge), between(middle, end, 0.5 * change, bulge))
        )


def between(first: float, last: float, change: float, bulge: float) -> float:
    """Bound a distance between two instants at which it is known [m].

    Parameters
    ----------
    change : largest change within half the time between them [m]
    bulge : largest bulge of a directed distance below its chord [m]
    """
    near = min(first, last)
    least = near - change
    bent = near - bulge - 0.5 * change**2 / least if least > 0.0 else -np.inf
    return max(0.5 * (first + last) - change, bent)


def _placed(bodies: Bodies, pair: int, turns: Array, places: Array) -> tuple[list[Any], list[Any]]:
    """Return the coal shapes of a pair and their placements, as SE3."""
    shapes, placed = [], []
    for body in bodies.ends[pair].tolist():
        frame, item = bodies.frame[body], bodies.bodies[body].item
        place = pin.SE3(turns[frame], places[frame])
        if (
            frame < bodies.robot.model.njoints
        ):  # other frames are those of bodies, not of what they are fixed to
            place = place * item.placement
        shapes.append(item.geometry)
        placed.append(place)
    return shapes, placed


def overlap(bodies: Bodies, load: LoadMotion, curve: JointCurve, found: LinkClearance) -> tuple[float, bool]:
    """Compute the penetration depth of a pair at contact. See `depth_of`.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples
    found : the pair and the time
    """
    turns, places = CarryCourse(bodies, load, curve).frames(np.array([found.time]))
    return depth_of(*_placed(bodies, found.pair, turns[0], places[0]))

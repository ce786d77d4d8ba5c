"""Continuous-time certificate of a robot's clearance.

Two bodies whose distance at an instant is d are, at all times at most w before or after it, at least

    d - w sum_j max|q_j'| r_j

apart, where r_j is the largest distance of the moved body from the axis of joint j (1 for a joint that slides), and
only the joints between the two count; the load adds its own largest speed. Where this bound is too small, a
second-order bound is used for convex bodies, and where that is too small as well, the time interval is halved, for
those pairs only. Distances are coal's, placements Pinocchio's. Where the balls about two bodies are already so far
apart, so are the bodies, and nothing more is computed of them. Meshes are looked at by their convex hulls first, and
themselves only where hulls are too near, as that takes a thousand times as long.

The second-order bound looks along the line between the nearest points. Let n be the unit vector along that line at an
instant. Two convex bodies are separated by a slab perpendicular to n,
whose width follows from their support functions, and their distance is at least the distance of their points along n.
At a time w before or after, a point p of a body is where its velocity takes it, to within w^2/2 max|p''|; so the
distance then is at least

    slab - w max |n (v_a - v_b)| - w^2/2 max|p''|,

where the first maximum is over all points a and b of the bodies, here of balls about them. Joints that move both
bodies count for neither. With r_j as above the second derivative is at most

    sum r_j |q_j''| + 2 sum |q_j'| sum r_j |q_j'|,

as the second derivative of a position by two joints is no longer than the reach r_j of the one nearer to the body. So
a hand that glides over a table comes no nearer to first order, however fast it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from comove.geometry.rotations import cross
from comove.robots.model import Robot
from comove.robots.motion import Ranges, fastest
from comove.robots.verification.bodies import Bodies
from comove.robots.verification.carried import LoadMotion, placements
from comove.robots.verification.kinematics import joint_placements, joint_twists, moved_by
from comove.ties import first_least

Array = NDArray[np.float64]

FIRST = 16  # parts of the motion at the beginning
DEEPEST = 22  # halvings of a part
TIGHT, LOOSE = 1e-3, 5e-3  # m, how far a bound may stay below the clearance; where that is too small anyway
MOST = 400_000  # distances: a bound that needs more is given up as it stands, still sound, only lower
WORTH_BALLS = (
    0.9  # share of the cells that balls leave to be computed, from which on they are not looked at any more
)
FEW = 8  # cells of each kind, with the nearest balls, that tell at the beginning what the clearance is about


class LinkClearance(NamedTuple):
    """Bounds of the clearance of one kind of pairs, as the certificate gives them.

    Attributes
    ----------
    lower : certified lower bound of the clearance at every instant [m]; infinite where there is no pair
    upper : least clearance computed at any instant [m]
    pair : number of the pair that has `upper`
    time : time at which it has it [s]
    """

    lower: float
    upper: float
    pair: int
    time: float


UNKNOWN = [LinkClearance(np.inf, np.inf, -1, 0.0)] * 3


@dataclass(frozen=True, eq=False)
class CarryCourse:
    """The joints of a robot and the load by time.

    Attributes
    ----------
    robot : the robot whose joints move
    load : the load, in motion or at rest
    curve : joint positions by time [s], cubic between samples
    """

    robot: Robot
    load: LoadMotion
    curve: PPoly

    @cached_property
    def bounds(self) -> Ranges:
        """Return the largest rates of the joints, then their largest second derivatives, [rad/s] and [rad/s^2]."""
        bend = np.abs(self.curve(self.curve.x, 2))
        return Ranges(self.curve.x, np.hstack([fastest(self.curve)[0], np.maximum(bend[1:], bend[:-1])]))


@dataclass(frozen=True, eq=False)
class Instants:
    """Robot and load in the middle of time intervals; all that is asked of them is computed once.

    Attributes
    ----------
    course : what moves
    time : array, shape (n_steps,), middles of the intervals, in ascending order [s]
    half : half of the intervals' length [s]
    """

    course: CarryCourse
    time: Array
    half: float

    @cached_property
    def positions(self) -> Array:
        """Return the joints' positions; array, shape (n_steps, n_joints) [rad, m]."""
        return self.course.curve(self.time)

    @cached_property
    def placements(self) -> tuple[Array, Array]:
        """Return the joints' placements, as `joint_placements` computes them."""
        return joint_placements(self.course.robot, self.positions)

    @cached_property
    def twists(self) -> Array:
        """Return what the joints give to what they move, as `joint_twists` computes it."""
        return joint_twists(self.course.robot, *self.placements, self.course.curve(self.time, 1))

    @cached_property
    def nodes(self) -> Array:
        """Return the positions of the load's nodes; array, shape (n_steps, n_nodes, 3) [m]."""
        return self.course.load.nodes(self.time)

    @cached_property
    def changes(self) -> tuple[Array, Array]:
        """Return the largest rates of the joints, and at last of the load's nodes, within the intervals, and the
        largest second derivatives of the joints; arrays, shape (n_steps, n_joints + 1) and (n_steps, n_joints).
        """
        begin, end = self.time - self.half, self.time + self.half
        rates, bends = np.split(self.course.bounds.over(begin, end), 2, axis=1)
        load = self.course.load.speed.over(begin, end).max(axis=1, keepdims=True)
        return np.hstack([rates, load]), bends


class PairCells(NamedTuple):
    """Pairs during time intervals of equal length.

    Attributes
    ----------
    at : the middles of the intervals
    row : array, shape (n_cells,), number of each cell's interval in `at`, in ascending order
    pair : array, shape (n_cells,), number of its pair
    """

    at: Instants
    row: NDArray[np.int64]
    pair: NDArray[np.int64]

    def chosen(self, which: NDArray[np.bool_]) -> PairCells:
        """Return some of the cells."""
        return self._replace(row=self.row[which], pair=self.pair[which])

    def halved(self, chosen: NDArray[np.bool_]) -> PairCells:
        """Return both halves of the chosen cells."""
        quarter, (rows, row) = 0.5 * self.at.half, np.unique(self.row[chosen], return_inverse=True)
        time = self.at.time[rows][:, None] + np.array([-quarter, quarter])
        halves = np.concatenate([2 * row, 2 * row + 1])
        order = np.argsort(halves, kind="stable")
        at = Instants(self.at.course, time.ravel(), quarter)
        return PairCells(at, halves[order], np.tile(self.pair[chosen], 2)[order])


def certify(bodies: Bodies, carried: LoadMotion, curve: PPoly, slack: float = 0.0) -> list[LinkClearance]:
    """Bound the clearance of all pairs over continuous time, by kind: SCENE, LOAD, SELF.

    Where a pair violates its required clearance, the bound of its kind is only as tight as `LOOSE`.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples
    slack : share of the clearance beyond the required one that bounds may give away. With any, whether all pairs keep
        what is required is certified as ever, but bounds are loose where there is room, and nothing more is computed
        once a pair is known to violate it. With all of it, no clearance is computed that need not be: convex hulls
        suffice where they keep what is required
    """
    distances, nearing = Distances(bodies), Nearing(bodies)
    cells, computed = _first(bodies, CarryCourse(bodies.robot, carried, curve)), 0
    lower, balls_help = np.full(3, np.inf), True
    met = UNKNOWN if slack >= 1.0 else _few(distances, cells)
    for depth in range(DEEPEST):
        change, bound = distances.changes(cells), np.full(len(cells.pair), -np.inf)
        if balls_help:
            bound = distances.of_balls(cells) - change
        near = bound < _enough(met, bodies, slack)[bodies.kind[cells.pair]]  # for all others balls are enough
        balls_help &= near.sum() < WORTH_BALLS * len(near)
        close, change = cells.chosen(near), change[near]
        distance = distances(close)
        met = _met(met, bodies, close, distance)
        of_meshes, met = _of_meshes(distances, close, distance, met, slack)
        computed += len(distance) + int(np.isfinite(of_meshes).sum())
        enough = _enough(met, bodies, slack)[bodies.kind[close.pair]]
        spare = np.where(distance > 0, distance - enough, 0.0)
        nearer = nearing.improved(change, spare, close)
        bound[near] = np.fmax(distance - nearer, of_meshes)
        done, far = bound[near] >= enough, ~near
        if depth == DEEPEST - 1 or computed > MOST:
            done[:] = True
        far[near] = done
        np.minimum.at(lower, bodies.kind[cells.pair[far]], bound[far])
        if far.all():
            break
        cells = cells.halved(~far)
    return [least._replace(lower=float(bound)) for least, bound in zip(met, lower, strict=True)]


def _of_meshes(
    distances: Distances, cells: PairCells, rough: Array, met: list[LinkClearance], slack: float
) -> tuple[Array, list[LinkClearance]]:
    """Bound the distances of meshes whose hulls are too near, array of shape (n_cells,), NaN for the others [m], and
    return the least clearances so far as well. The nearest come first: what is found there may spare the rest.
    """
    bodies, bound = distances.bodies, np.full(len(rough), np.nan)
    kind, are_hulls = bodies.kind[cells.pair], bodies.exact[cells.pair] != cells.pair
    if not are_hulls.any():
        return bound, met
    nearest = _least(np.where(are_hulls, rough, np.inf), kind)
    for wanted in (are_hulls & nearest, are_hulls & ~nearest):
        chosen = wanted & (rough < _enough(met, bodies, slack)[kind])
        own = cells.chosen(chosen)
        own = own._replace(pair=bodies.exact[own.pair])
        distance = distances(own)
        bound[chosen] = distance - distances.changes(own)
        met = _met(met, bodies, own, distance)
    return bound, met


def _least(distance: Array, kind: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return which are among the `FEW` least of their kind; array, shape (n_cells,)."""
    chosen = np.zeros(len(distance), dtype=bool)
    for k in range(3):
        own = np.flatnonzero(kind == k)
        chosen[own[np.argsort(distance[own], kind="stable")[:FEW]]] = True
    return chosen


def _enough(met: list[LinkClearance], bodies: Bodies, slack: float) -> Array:
    """Return the bounds that suffice, by kind; array, shape (3,) [m]."""
    upper, required = np.array([least.upper for least in met]), bodies.required
    if slack > 0.0 and (upper < required).any():
        return np.full(3, -np.inf)
    if slack >= 1.0:
        return required
    known = np.isfinite(upper)
    spare = np.where(known, upper, 0.0) - required
    enough = np.where(known, np.maximum(required, upper - np.maximum(TIGHT, slack * spare)), np.inf)
    return np.where(upper < required, upper - LOOSE, enough)


def _few(distances: Distances, cells: PairCells) -> list[LinkClearance]:
    """Return the least clearances among the cells whose balls are nearest, by kind."""
    bodies = distances.bodies
    few = cells.chosen(_least(distances.of_balls(cells), bodies.kind[cells.pair]))
    few = few._replace(pair=bodies.exact[few.pair])
    return _met(UNKNOWN, bodies, few, distances(few))


def _met(met: list[LinkClearance], bodies: Bodies, cells: PairCells, distance: Array) -> list[LinkClearance]:
    """Return the least clearances so far, by kind; only exact pairs count."""
    kind = np.where(bodies.exact[cells.pair] == cells.pair, bodies.kind[cells.pair], -1)
    return [_nearer(met[k], cells, distance, np.flatnonzero(kind == k)) for k in range(3)]


def _nearer(best: LinkClearance, cells: PairCells, distance: Array, own: NDArray[np.int64]) -> LinkClearance:
    """Return the least clearance of one kind so far, after the cells `own`."""
    upper = float(distance[own].min(initial=np.inf))
    if upper >= best.upper:
        return best
    k = own[first_least(distance[own])]
    return LinkClearance(-np.inf, upper, int(cells.pair[k]), float(cells.at.time[cells.row[k]]))


def _first(bodies: Bodies, course: CarryCourse) -> PairCells:
    """Return the cells of all pairs in the first intervals, rough pairs where there are such; one cell for pairs that
    never move.
    """
    rough = bodies.exact != np.arange(len(bodies.exact))
    begun = np.ones(len(rough), dtype=bool)
    begun[bodies.exact[rough]] = False
    moves = bodies.reach.any(axis=1)
    still, moving = np.flatnonzero(begun & ~moves), np.flatnonzero(begun & moves)
    row = np.concatenate([np.zeros(len(still), dtype=np.int64), np.repeat(np.arange(FIRST), len(moving))])
    last = float(course.curve.x[-1])
    half = 0.5 * last / FIRST
    at = Instants(course, np.linspace(half, last - half, FIRST), half)
    return PairCells(at, row, np.concatenate([still, np.tile(moving, FIRST)]))


class Distances:
    """Computes distances of pairs at the middle of time intervals, and how much they can change within these."""

    def __init__(self, bodies: Bodies):
        self.bodies = bodies
        self.model, self.data = bodies.robot.model, bodies.robot.model.createData()
        self.placed = bodies.geometry.createData()

    def __call__(self, cells: PairCells) -> Array:
        """Compute distances, less what is taken from them; array, shape (n_cells,) [m]."""
        counts = np.bincount(cells.row)
        compute, geometry, placed = pin.computeDistance, self.bodies.geometry, self.placed
        rods = [(rod, *placements(cells.at.nodes, tuple(spanned))) for rod, *spanned in self.bodies.rods]
        distances, pairs = list[float](), iter(cells.pair.tolist())
        for k in np.flatnonzero(counts).tolist():
            pin.updateGeometryPlacements(self.model, self.data, geometry, placed, cells.at.positions[k])
            for rod, turn, middle in rods:
                placed.oMg[rod] = pin.SE3(turn[k], middle[k])
            distances += [compute(geometry, placed, pair).min_distance for pair in islice(pairs, counts[k])]
        return np.array(distances) - self.bodies.taken[cells.pair]

    def of_balls(self, cells: PairCells) -> Array:
        """Compute lower bounds of the distances, less what is taken, by the balls about the bodies; array, shape
        (n_cells,) [m].
        """
        (centers, (_, radii)), ends = (
            (self._centers(cells.at), self.bodies.balls),
            self.bodies.ends[cells.pair],
        )
        between = centers[cells.row, ends[:, 0]] - centers[cells.row, ends[:, 1]]
        distance = np.sqrt((between**2).sum(axis=1)) - radii[ends].sum(axis=1)
        return distance - self.bodies.taken[cells.pair]

    def changes(self, cells: PairCells) -> Array:
        """Bound how much distances change within half an interval; array, shape (n_cells,) [m]."""
        rates, _ = cells.at.changes
        return cells.at.half * (self.bodies.reach[cells.pair] * rates[cells.row]).sum(axis=1)

    def _centers(self, at: Instants) -> Array:
        """Compute the centres of the balls; array, shape (n_steps, n_bodies, 3) [m]."""
        (turns, places), (own_centers, _) = at.placements, self.bodies.balls
        centers = np.empty((len(at.time), len(own_centers), 3))
        for joint in range(self.model.njoints):
            own = np.flatnonzero(self.bodies.joint == joint)
            centers[:, own] = own_centers[own] @ turns[joint].swapaxes(1, 2) + places[joint][:, None]
        for rod, *spanned in self.bodies.rods:
            centers[:, rod] = placements(at.nodes, tuple(spanned))[1]
        return centers


class Nearing:
    """Computes bounds of how much nearer the bodies of pairs come.

    Attributes
    ----------
    applies : array, shape (n_pairs,), whether the bound applies to a pair: convex bodies on a robot or in the scene
    """

    def __init__(self, bodies: Bodies):
        self.bodies = bodies
        self._state = bodies.robot.model.createData(), bodies.geometry.createData()
        items = list(bodies.geometry.geometryObjects)
        moved = moved_by(bodies.robot)[bodies.joint[bodies.ends]].swapaxes(0, 1)
        self._sides = moved & ~moved[::-1]
        loads = {rod for rod, *_ in bodies.rods}
        plain = [k not in loads and isinstance(item.geometry, CONVEX) for k, item in enumerate(items)]
        first, second = np.array(plain, dtype=bool)[bodies.ends.T]
        self.applies = first & second

    def improved(self, change: Array, spare: Array, cells: PairCells) -> Array:
        """Return smaller bounds of how much a distance changes, where these may help; arrays, shape (n_cells,) [m].

        Parameters
        ----------
        change : known bounds of the change
        spare : change of the distances that is allowed; not positive where bodies touch or no bound can help
        """
        todo = (spare > 0) & (change > spare) & self.applies[cells.pair]
        half, better = cells.at.half, change.copy()
        bulge = 0.5 * half**2 * self.second_order(cells.chosen(todo))
        todo[todo] = helps = bulge < spare[todo]
        if helps.any():
            lost, speed = self.first_order(cells.chosen(todo))
            better[todo] = np.fmin(change[todo], lost + half * speed + bulge[helps])
        return better

    def second_order(self, cells: PairCells) -> Array:
        """Bound |p''| during time intervals; array, shape (n_cells,) [m/s^2]."""
        rates, bends = (bound[cells.row] for bound in cells.at.changes)
        reach = self.bodies.reach[cells.pair, :-1]
        rates, between = rates[:, :-1], self._sides[:, cells.pair].any(axis=0)
        return (bends * reach).sum(axis=1) + 2 * (rates * between).sum(axis=1) * (rates * reach).sum(axis=1)

    def first_order(self, cells: PairCells) -> tuple[Array, Array]:
        """Compute distance minus slab width, and how fast points of both bodies come nearer along n.

        Returns
        -------
        arrays, shape (n_cells,), [m] and [m/s]
        """
        bodies, (centers, radii) = self.bodies, self.bodies.balls
        turns, places = cells.at.placements
        apart, normals = self._nearest(cells)
        lost, speed, turning = apart, np.zeros(len(apart)), np.zeros(len(apart))
        for side, sign in enumerate((1.0, -1.0)):  # normals point from the first body to the second
            body = bodies.ends[cells.pair, side]
            turn, place = turns[bodies.joint[body], cells.row], places[bodies.joint[body], cells.row]
            lost = lost + sign * (normals * place).sum(axis=1)
            lost += self._supports(body, sign * (normals[:, None] @ turn)[:, 0])
            twist = np.einsum("nji,nj->ni", cells.at.twists[cells.row], self._sides[side, cells.pair])
            center = place + (turn @ centers[body, :, None])[..., 0]
            velocity = twist[:, :3] + cross(twist[:, 3:], center)
            speed = speed + sign * (normals * velocity).sum(axis=1)
            turning = turning + np.linalg.norm(cross(normals, twist[:, 3:]), axis=1) * radii[body]
        return lost, np.abs(speed) + turning

    def _nearest(self, cells: PairCells) -> tuple[Array, Array]:
        """Compute distances of pairs and unit vectors along them; arrays, shape (n_cells,) [m] and (n_cells, 3)."""
        model, geometry, placed_for = self.bodies.robot.model, self.bodies.geometry, -1
        data, placed = self._state
        apart, normals = np.empty(len(cells.pair)), np.empty((len(cells.pair), 3))
        for i, (k, pair) in enumerate(zip(cells.row.tolist(), cells.pair.tolist(), strict=True)):
            if k != placed_for:
                pin.updateGeometryPlacements(model, data, geometry, placed, cells.at.positions[k])
                placed_for = k
            found = pin.computeDistance(geometry, placed, pair)
            apart[i], normals[i] = found.min_distance, found.normal
        return apart, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    def _supports(self, body: NDArray[np.int64], along: Array) -> Array:
        """Compute how far bodies reach along unit vectors in the frames of their joints, from these frames' origins.

        Parameters
        ----------
        body : array, shape (n,), numbers of bodies
        along : array, shape (n, 3)

        Returns
        -------
        array, shape (n,) [m]
        """
        reached, items = np.empty(len(body)), self.bodies.geometry.geometryObjects
        for number in np.unique(body).tolist():
            own, item = body == number, items[number]
            support = support_function(item.geometry)
            n = along[own]
            reached[own] = n @ item.placement.translation + support(n @ item.placement.rotation)
        return reached


CONVEX = (coal.Sphere, coal.Box, coal.Capsule, coal.Cylinder, coal.Ellipsoid, coal.ConvexBase)


def support_function(shape: Any) -> Callable[[Array], Array]:
    """Return the function that tells how far a shape of `CONVEX` reaches along unit vectors in its own frame [m];
    arrays, shape (..., 3) -> (...,).
    """
    if isinstance(shape, coal.Sphere):
        return lambda n: np.full(n.shape[:-1], shape.radius)
    if isinstance(shape, coal.Box):
        return lambda n: np.abs(n) @ shape.halfSide
    if isinstance(shape, coal.Capsule):
        return lambda n: shape.radius + shape.halfLength * np.abs(n[..., 2])
    if isinstance(shape, coal.Cylinder):
        return lambda n: shape.radius * np.hypot(n[..., 0], n[..., 1]) + shape.halfLength * np.abs(n[..., 2])
    if isinstance(shape, coal.Ellipsoid):
        return lambda n: np.linalg.norm(n * shape.radii, axis=-1)
    points = np.array(shape.points())
    return lambda n: (n @ points.T).max(axis=-1)

"""Continuous-time certificate of a robot's clearance.

Two bodies whose distance at an instant is d are, at all times at most w before or after it, at least

    d - w sum_j max|q_j'| r_j

apart, where r_j is the largest distance of the moved body from the axis of joint j (1 for a joint that slides), and
only the joints between the two count; the load and obstacles that move add their own largest speeds. Where this
bound is too small, a second-order bound is used for convex bodies other than those, and where that is too small as
well, the time interval is halved, for those pairs only. Distances are coal's, placements Pinocchio's. Where the balls
about two bodies are already so far apart, so are the bodies, and nothing more is computed of them. Meshes are looked
at by their convex hulls first, and themselves only where hulls are too near, as that takes a thousand times as long.

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

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from comove.arrays import Array, Integers, first_least
from comove.errors import OptionError
from comove.geometry.rotations import cross
from comove.robots.model import Robot
from comove.robots.motion import Ranges, fastest
from comove.robots.verification.bodies import Bodies, depth_of
from comove.robots.verification.carried import LoadMotion, placements
from comove.robots.verification.kinematics import joint_placements, joint_twists, moved_by


@dataclass(frozen=True)
class JointCertificateSettings:
    """Settings of how far the certificate goes into time; none of them lets it say more than it knows.

    Attributes
    ----------
    parts : intervals in which the motion is looked at first
    deepest : halvings of an interval, at most
    tight : how far a bound may stay below the clearance [m]
    loose : likewise where the clearance is too small anyway [m]
    most : distances that are computed, at most; a bound that needs more stays as it stands, sound but lower
    few : cells of each kind with the nearest bodies, which are looked at first, as they may spare others
    """

    parts: int = 16
    deepest: int = 22
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


@dataclass(frozen=True, eq=False)
class CarryCourse:
    """The joints of a robot, the load and obstacles by time.

    Attributes
    ----------
    bodies : bodies of robot, obstacles and payload
    load : the load, in motion or at rest
    curve : joint positions by time [s], cubic between samples
    """

    bodies: Bodies
    load: LoadMotion
    curve: PPoly

    @property
    def robot(self) -> Robot:
        """Return the robot."""
        return self.bodies.robot

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
    def moved(self) -> tuple[Array, Array]:
        """Return the placements of obstacles that move, as `MovingObstacles.placements` computes them."""
        return self.course.bodies.moving.placements(self.time)

    @cached_property
    def changes(self) -> tuple[Array, Array]:
        """Return the largest rates of joints, the load's nodes and moving obstacles within the intervals, and the
        largest second derivatives of joints.

        Returns
        -------
        arrays, shape (n_steps, n_joints + 1 + n_moving) and (n_steps, n_joints)
        """
        begin, end = self.time - self.half, self.time + self.half
        rates, bends = np.split(self.course.bounds.over(begin, end), 2, axis=1)
        load = self.course.load.speed.over(begin, end).max(axis=1, keepdims=True)
        return np.hstack([rates, load, self.course.bodies.moving.speed.over(begin, end)]), bends


class PairCells(NamedTuple):
    """Pairs during time intervals of equal length.

    Attributes
    ----------
    at : the middles of the intervals
    row : array, shape (n_cells,), number of each cell's interval in `at`, in ascending order
    pair : array, shape (n_cells,), number of its pair
    """

    at: Instants
    row: Integers
    pair: Integers

    def chosen(self, which: NDArray[np.bool_]) -> PairCells:
        """Return some of the cells."""
        return self._replace(row=self.row[which], pair=self.pair[which])

    def exact(self, bodies: Bodies) -> PairCells:
        """Return the cells of the exact pairs for which theirs are substitutes."""
        return self._replace(pair=bodies.exact[self.pair])

    def halved(self, chosen: NDArray[np.bool_]) -> PairCells:
        """Return both halves of the chosen cells."""
        quarter, (rows, row) = 0.5 * self.at.half, np.unique(self.row[chosen], return_inverse=True)
        time = self.at.time[rows][:, None] + np.array([-quarter, quarter])
        halves = np.concatenate([2 * row, 2 * row + 1])
        order = np.argsort(halves, kind="stable")
        at = Instants(self.at.course, time.ravel(), quarter)
        return PairCells(at, halves[order], np.tile(self.pair[chosen], 2)[order])


def certify(
    bodies: Bodies,
    carried: LoadMotion,
    curve: PPoly,
    slack: float = 0.0,
    settings: JointCertificateSettings = JointCertificateSettings(),
) -> list[LinkClearance]:
    """Bound the clearance of all pairs over continuous time, by kind: SCENE, LOAD, SELF.

    Where a pair violates its required clearance, the bound of its kind is only as tight as `loose`.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples
    slack : share of the clearance beyond the required one that bounds may give away. With any, whether all pairs keep
        what is required is certified as ever, but bounds are loose where there is room, and nothing more is computed
        once a pair is known to violate it. With all of it, no clearance is computed that need not be: convex hulls
        suffice where they keep what is required
    """
    distances = Distances(bodies)
    nearing = Nearing(distances)
    known = _Known(distances, slack, settings)
    cells = _first(bodies, CarryCourse(bodies, carried, curve), settings.parts)
    lower = np.full(3, np.inf)
    if slack < 1.0:  # what the clearance is about, before anything is compared with it
        known.compute(cells.chosen(known.nearest(cells, distances.of_balls(cells))).exact(bodies))
    for depth in range(settings.deepest):
        change = distances.changes(cells)
        bound = distances.of_balls(cells) - change
        near = bound < known.enough(cells)  # for all others balls are enough
        close, change = cells.chosen(near), change[near]
        distance = known.compute(close)
        of_meshes = known.bound_meshes(close, distance)
        enough = known.enough(close)
        spare = np.where(distance > 0, distance - enough, 0.0)
        bound[near] = np.fmax(distance - nearing.improved(change, spare, close), of_meshes)
        done, far = bound[near] >= enough, ~near
        if depth == settings.deepest - 1 or known.computed > settings.most:
            done[:] = True
        far[near] = done
        np.minimum.at(lower, bodies.kind[cells.pair[far]], bound[far])
        if far.all():
            break
        cells = cells.halved(~far)
    return [least._replace(lower=float(bound)) for least, bound in zip(known.least, lower, strict=True)]


def overlap(bodies: Bodies, load: LoadMotion, curve: PPoly, found: LinkClearance) -> tuple[float, bool]:
    """Compute how deep the bodies of a pair are in each other where they are found to meet; see `depth_of`.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples
    found : the pair and the time
    """
    at = Instants(CarryCourse(bodies, load, curve), np.array([found.time]), 0.0)
    distances = Distances(bodies)
    distances(PairCells(at, np.zeros(1, dtype=np.int64), np.array([found.pair])))  # places the bodies
    first, second = bodies.ends[found.pair].tolist()
    shapes = [bodies.geometry.geometryObjects[body].geometry for body in (first, second)]
    places = [distances.placed.oMg[body] for body in (first, second)]
    return depth_of(shapes, places)


class _Known:
    """The least clearances that were computed so far, and the bounds that suffice beside them.

    Attributes
    ----------
    least : least clearances of exact pairs, by kind
    computed : number of distances that were computed
    """

    def __init__(self, distances: Distances, slack: float, settings: JointCertificateSettings):
        self.distances, self.bodies = distances, distances.bodies
        self.slack, self.settings = slack, settings
        self.least, self.computed = [LinkClearance(np.inf, np.inf, -1, 0.0)] * 3, 0

    def compute(self, cells: PairCells) -> Array:
        """Compute distances, less what is taken from them, and keep the least; array, shape (n_cells,) [m]."""
        distance, is_exact = self.distances(cells), self.bodies.exact[cells.pair] == cells.pair
        self.computed += len(distance)
        for kind, best in enumerate(self.least):
            own = np.flatnonzero(is_exact & (self.bodies.kind[cells.pair] == kind))
            upper = float(distance[own].min(initial=np.inf))
            if upper < best.upper:
                k = own[first_least(distance[own])]
                when = float(cells.at.time[cells.row[k]])
                self.least[kind] = LinkClearance(-np.inf, upper, int(cells.pair[k]), when)
        return distance

    def bound_meshes(self, cells: PairCells, rough: Array) -> Array:
        """Bound the distances of meshes whose hulls are too near, NaN for all others; arrays, shape (n_cells,) [m].

        The nearest come first: what is found there may spare the rest.
        """
        bound, are_hulls = np.full(len(rough), np.nan), self.bodies.exact[cells.pair] != cells.pair
        nearest = self.nearest(cells, np.where(are_hulls, rough, np.inf))
        for wanted in (are_hulls & nearest, are_hulls & ~nearest):
            chosen = wanted & (rough < self.enough(cells))
            own = cells.chosen(chosen).exact(self.bodies)
            bound[chosen] = self.compute(own) - self.distances.changes(own)
        return bound

    def nearest(self, cells: PairCells, distance: Array) -> NDArray[np.bool_]:
        """Return which are among the `few` least distances of their kind; arrays, shape (n_cells,)."""
        chosen, kinds = np.zeros(len(distance), dtype=bool), self.bodies.kind[cells.pair]
        for kind in range(3):
            own = np.flatnonzero(kinds == kind)
            chosen[own[np.argsort(distance[own], kind="stable")[: self.settings.few]]] = True
        return chosen

    def enough(self, cells: PairCells) -> Array:
        """Return the bounds that suffice; array, shape (n_cells,) [m]."""
        return self._enough()[self.bodies.kind[cells.pair]]

    def _enough(self) -> Array:
        """Return the bounds that suffice, by kind; array, shape (3,) [m]."""
        upper, required = np.array([least.upper for least in self.least]), self.bodies.required
        if self.slack > 0.0 and (upper < required).any():
            return np.full(3, -np.inf)
        if self.slack >= 1.0:
            return required
        known = np.isfinite(upper)
        spare = np.where(known, upper, 0.0) - required
        away = np.maximum(self.settings.tight, self.slack * spare)
        enough = np.where(known, np.maximum(required, upper - away), np.inf)
        return np.where(upper < required, upper - self.settings.loose, enough)


def _first(bodies: Bodies, course: CarryCourse, parts: int) -> PairCells:
    """Return the cells of all pairs in the first intervals, rough pairs where there are such; one cell for pairs that
    never move.
    """
    rough = bodies.exact != np.arange(len(bodies.exact))
    begun = np.ones(len(rough), dtype=bool)
    begun[bodies.exact[rough]] = False
    moves = bodies.reach.any(axis=1)
    still, moving = np.flatnonzero(begun & ~moves), np.flatnonzero(begun & moves)
    row = np.concatenate([np.zeros(len(still), dtype=np.int64), np.repeat(np.arange(parts), len(moving))])
    last = float(course.curve.x[-1])
    half = 0.5 * last / parts
    at = Instants(course, np.linspace(half, last - half, parts), half)
    return PairCells(at, row, np.concatenate([still, np.tile(moving, parts)]))


class Distances:
    """Computes distances of pairs at the middle of time intervals, and how much they can change within these."""

    def __init__(self, bodies: Bodies):
        self.bodies = bodies
        self.model, self.data = bodies.robot.model, bodies.robot.model.createData()
        self.placed = bodies.geometry.createData()

    def __call__(self, cells: PairCells) -> Array:
        """Compute distances, less what is taken from them; array, shape (n_cells,) [m]."""
        return np.array([found.min_distance for found in self.found(cells)]) - self.bodies.taken[cells.pair]

    def found(self, cells: PairCells) -> Iterator[Any]:
        """Yield coal's results for the pairs, each of which is valid until the next."""
        compute, geometry, placed = pin.computeDistance, self.bodies.geometry, self.placed
        placing = [(rod, *placements(cells.at.nodes, tuple(spanned))) for rod, *spanned in self.bodies.rods]
        turns, places = cells.at.moved
        placing += [
            (body, turns[:, k], places[:, k]) for k, body in enumerate(self.bodies.moving.body.tolist())
        ]
        placed_for = -1
        for k, pair in zip(cells.row.tolist(), cells.pair.tolist(), strict=True):
            if k != placed_for:
                pin.updateGeometryPlacements(self.model, self.data, geometry, placed, cells.at.positions[k])
                for body, turn, place in placing:
                    placed.oMg[body] = pin.SE3(turn[k], place[k])
                placed_for = k
            yield compute(geometry, placed, pair)

    def of_balls(self, cells: PairCells) -> Array:
        """Compute lower bounds of the distances, less what is taken, by the balls about the bodies; array, shape
        (n_cells,) [m].
        """
        centers, (_, radii), ends = self._centers(cells.at), self.bodies.balls, self.bodies.ends[cells.pair]
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
        for k, body in enumerate(self.bodies.moving.body.tolist()):
            turn, place = (values[:, k] for values in at.moved)
            centers[:, body] = turn @ self.bodies.geometry.geometryObjects[body].geometry.aabb_center + place
        return centers


class Nearing:
    """Computes bounds of how much nearer the bodies of pairs come.

    Attributes
    ----------
    applies : array, shape (n_pairs,), whether the bound applies to a pair: convex bodies on a robot or at rest
    """

    def __init__(self, distances: Distances):
        self._distances, self.bodies = distances, distances.bodies
        bodies = self.bodies
        items = list(bodies.geometry.geometryObjects)
        moved = moved_by(bodies.robot)[bodies.joint[bodies.ends]].swapaxes(0, 1)
        self._sides = moved & ~moved[::-1]
        others = {*(rod for rod, *_ in bodies.rods), *bodies.moving.body.tolist()}
        plain = [k not in others and isinstance(item.geometry, CONVEX) for k, item in enumerate(items)]
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
        reach = self.bodies.joint_reach[cells.pair]
        rates, between = rates[:, : reach.shape[1]], self._sides[:, cells.pair].any(axis=0)
        return (bends * reach).sum(axis=1) + 2 * (rates * between).sum(axis=1) * (rates * reach).sum(axis=1)

    def first_order(self, cells: PairCells) -> tuple[Array, Array]:
        """Compute distance minus slab width, and how fast points of both bodies come nearer along n.

        Returns
        -------
        arrays, shape (n_cells,), [m] and [m/s]
        """
        bodies, (centers, radii) = self.bodies, self.bodies.balls
        turns, places = cells.at.placements
        found = [(result.min_distance, *result.normal) for result in self._distances.found(cells)]
        lost, normals = np.hsplit(np.array(found), [1])
        lost, normals = lost[:, 0], normals / np.linalg.norm(normals, axis=1, keepdims=True)
        speed, turning = np.zeros(len(lost)), np.zeros(len(lost))
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

    def _supports(self, body: Integers, along: Array) -> Array:
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

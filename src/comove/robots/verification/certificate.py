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
from typing import Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import PPoly

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


class _Cells(NamedTuple):
    """Pairs during time intervals of equal length, given by the intervals' numbers; arrays, shape (n_cells,)."""

    stretch: NDArray[np.int64]
    pair: NDArray[np.int64]

    def chosen(self, which: NDArray[np.bool_]) -> _Cells:
        """Return some of the cells."""
        return _Cells(self.stretch[which], self.pair[which])

    def halved(self, chosen: NDArray[np.bool_]) -> _Cells:
        """Return both halves of the chosen cells."""
        stretch = np.concatenate([2 * self.stretch[chosen], 2 * self.stretch[chosen] + 1])
        order = np.argsort(stretch, kind="stable")
        return _Cells(stretch[order], np.tile(self.pair[chosen], 2)[order])


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
    distances, nearing = _Distances(bodies, carried, curve), Nearing(bodies, curve)
    cells, width, computed = _first(bodies), float(curve.x[-1]) / FIRST, 0
    lower, balls_help = np.full(3, np.inf), True
    met = UNKNOWN if slack >= 1.0 else _few(distances, cells, width)
    for depth in range(DEEPEST):
        change, bound = distances.changes(cells, width), np.full(len(cells.pair), -np.inf)
        if balls_help:
            bound = distances.of_balls(cells, width) - change
        near = bound < _enough(met, bodies, slack)[bodies.kind[cells.pair]]  # for all others balls are enough
        balls_help &= near.mean() < WORTH_BALLS
        close, change = cells.chosen(near), change[near]
        distance = distances(close, width)
        met = _met(met, bodies, close, width, distance)
        of_meshes, met = _of_meshes(distances, close, width, distance, met, slack)
        computed += len(distance) + int(np.isfinite(of_meshes).sum())
        enough = _enough(met, bodies, slack)[bodies.kind[close.pair]]
        spare = np.where(distance > 0, distance - enough, 0.0)
        middle = (close.stretch.astype(float) + 0.5) * width
        nearer = nearing.improved(change, spare, close.pair, middle, width / 2)
        bound[near] = np.fmax(distance - nearer, of_meshes)
        done, far = bound[near] >= enough, ~near
        if depth == DEEPEST - 1 or computed > MOST:
            done[:] = True
        far[near] = done
        np.minimum.at(lower, bodies.kind[cells.pair[far]], bound[far])
        if far.all():
            break
        cells, width = cells.halved(~far), width / 2
    return [least._replace(lower=float(bound)) for least, bound in zip(met, lower, strict=True)]


def _of_meshes(
    distances: _Distances, cells: _Cells, width: float, rough: Array, met: list[LinkClearance], slack: float
) -> tuple[Array, list[LinkClearance]]:
    """Bound the distances of meshes whose hulls are too near, array of shape (n_cells,), NaN for the others [m], and
    return the least clearances so far as well. The nearest come first: what is found there may spare the rest.
    """
    bodies, bound = distances.bodies, np.full(len(rough), np.nan)
    kind, are_hulls = bodies.kind[cells.pair], bodies.exact[cells.pair] != cells.pair
    nearest = _least(np.where(are_hulls, rough, np.inf), kind)
    for wanted in (are_hulls & nearest, are_hulls & ~nearest):
        chosen = wanted & (rough < _enough(met, bodies, slack)[kind])
        own = cells.chosen(chosen)
        own = own._replace(pair=bodies.exact[own.pair])
        distance = distances(own, width)
        bound[chosen] = distance - distances.changes(own, width)
        met = _met(met, bodies, own, width, distance)
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


def _few(distances: _Distances, cells: _Cells, width: float) -> list[LinkClearance]:
    """Return the least clearances among the cells whose balls are nearest, by kind."""
    bodies = distances.bodies
    few = cells.chosen(_least(distances.of_balls(cells, width), bodies.kind[cells.pair]))
    few = few._replace(pair=bodies.exact[few.pair])
    return _met(UNKNOWN, bodies, few, width, distances(few, width))


def _met(
    met: list[LinkClearance], bodies: Bodies, cells: _Cells, width: float, distance: Array
) -> list[LinkClearance]:
    """Return the least clearances so far, by kind; only exact pairs count."""
    kind, is_exact = bodies.kind[cells.pair], bodies.exact[cells.pair] == cells.pair
    return [
        _nearer(met[k], np.where(is_exact & (kind == k), distance, np.inf), cells, width) for k in range(3)
    ]


def _first(bodies: Bodies) -> _Cells:
    """Return the cells of all pairs in the first intervals, rough pairs where there are such; one cell for pairs that
    never move.
    """
    rough = bodies.exact != np.arange(len(bodies.exact))
    begun = np.ones(len(rough), dtype=bool)
    begun[bodies.exact[rough]] = False
    moves = bodies.reach.any(axis=1)
    still, moving = np.flatnonzero(begun & ~moves), np.flatnonzero(begun & moves)
    stretch = np.concatenate([np.zeros(len(still), dtype=np.int64), np.repeat(np.arange(FIRST), len(moving))])
    return _Cells(stretch, np.concatenate([still, np.tile(moving, FIRST)]))


def _nearer(best: LinkClearance, distance: Array, cells: _Cells, width: float) -> LinkClearance:
    """Return the least clearance so far."""
    k = first_least(distance) if len(distance) else -1
    if k < 0 or distance.min() >= best.upper:
        return best
    return LinkClearance(
        -np.inf, float(distance.min()), int(cells.pair[k]), float((cells.stretch[k] + 0.5) * width)
    )


class _Distances:
    """Computes distances of pairs at the middle of time intervals, and how much they can change within these."""

    def __init__(self, bodies: Bodies, carried: LoadMotion, curve: PPoly):
        self.bodies, self.carried, self.curve = bodies, carried, curve
        self.model, self.data = bodies.robot.model, bodies.robot.model.createData()
        self.placed = bodies.geometry.createData()
        self.rates = Ranges(curve.x, fastest(curve)[0])

    def __call__(self, cells: _Cells, width: float) -> Array:
        """Compute distances, less what is taken from them; array, shape (n_cells,) [m].

        Parameters
        ----------
        width : length of the intervals [s]
        """
        stretches, first, counts = np.unique(cells.stretch, return_index=True, return_counts=True)
        time = (stretches.astype(float) + 0.5) * width
        configurations, nodes = self.curve(time), self.carried.nodes(time)
        rods = [(rod, *placements(nodes, tuple(spanned))) for rod, *spanned in self.bodies.rods]
        compute, geometry, placed = pin.computeDistance, self.bodies.geometry, self.placed
        distances: list[float] = []
        for k, q in enumerate(configurations):
            pin.updateGeometryPlacements(self.model, self.data, geometry, placed, q)
            for rod, turn, middle in rods:
                placed.oMg[rod] = pin.SE3(turn[k], middle[k])
            pairs = cells.pair[first[k] : first[k] + counts[k]].tolist()
            distances += [compute(geometry, placed, pair).min_distance for pair in pairs]
        return np.array(distances) - self.bodies.taken[cells.pair]

    def of_balls(self, cells: _Cells, width: float) -> Array:
        """Compute lower bounds of the distances, less what is taken, by the balls about the bodies; array, shape
        (n_cells,) [m].
        """
        stretches, of_cell = np.unique(cells.stretch, return_inverse=True)
        time = (stretches.astype(float) + 0.5) * width
        centers, (_, radii) = self._centers(time), self.bodies.balls
        ends = self.bodies.ends[cells.pair]
        between = centers[of_cell, ends[:, 0]] - centers[of_cell, ends[:, 1]]
        distance = np.sqrt((between**2).sum(axis=1)) - radii[ends].sum(axis=1)
        return distance - self.bodies.taken[cells.pair]

    def changes(self, cells: _Cells, width: float) -> Array:
        """Bound how much distances change within half an interval; array, shape (n_cells,) [m]."""
        stretches, of_cell = np.unique(cells.stretch, return_inverse=True)
        time = (stretches.astype(float) + 0.5) * width
        rates = self._rates(time - 0.5 * width, time + 0.5 * width)
        return 0.5 * width * (self.bodies.reach[cells.pair] * rates[of_cell]).sum(axis=1)

    def _centers(self, time: Array) -> Array:
        """Compute the centres of the balls; array, shape (n_steps, n_bodies, 3) [m]."""
        turns, places = joint_placements(self.bodies.robot, self.curve(time))
        own_centers, _ = self.bodies.balls
        centers = np.empty((len(time), len(own_centers), 3))
        for joint in range(self.model.njoints):
            own = np.flatnonzero(self.bodies.joint == joint)
            centers[:, own] = own_centers[own] @ turns[joint].swapaxes(1, 2) + places[joint][:, None]
        nodes = self.carried.nodes(time)
        for rod, *spanned in self.bodies.rods:
            centers[:, rod] = placements(nodes, tuple(spanned))[1]
        return centers

    def _rates(self, begin: Array, end: Array) -> Array:
        """Return the largest rates of the joints and the load; array, shape (n_stretches, n_joints + 1)."""
        load = self.carried.speed.over(begin, end).max(axis=1, keepdims=True)
        return np.concatenate([self.rates.over(begin, end), load], axis=1)


class Nearing:
    """Computes bounds of how much nearer the bodies of pairs come.

    Attributes
    ----------
    applies : array, shape (n_pairs,), whether the bound applies to a pair: convex bodies on a robot or in the scene
    """

    def __init__(self, bodies: Bodies, curve: PPoly):
        self.bodies, self.curve = bodies, curve
        self._state = bodies.robot.model.createData(), bodies.geometry.createData()
        items = list(bodies.geometry.geometryObjects)
        moved = moved_by(bodies.robot)[bodies.joint[bodies.ends]].swapaxes(0, 1)
        self._sides = moved & ~moved[::-1]
        loads = {rod for rod, *_ in bodies.rods}
        plain = [k not in loads and isinstance(item.geometry, CONVEX) for k, item in enumerate(items)]
        first, second = np.array(plain, dtype=bool)[bodies.ends.T]
        self.applies = first & second
        bend = np.abs(curve(curve.x, 2))
        self._rates = Ranges(curve.x, np.hstack([fastest(curve)[0], np.maximum(bend[1:], bend[:-1])]))

    def improved(
        self, change: Array, spare: Array, pair: NDArray[np.int64], time: Array, half: float
    ) -> Array:
        """Return smaller bounds of how much a distance changes, where these may help; arrays, shape (n,) [m].

        Parameters
        ----------
        change : known bounds of the change
        spare : change of the distances that is allowed; not positive where bodies touch or no bound can help
        time : middle of the time intervals, in ascending order [s]
        half : half of the intervals' length [s]
        """
        todo = np.flatnonzero((spare > 0) & (change > spare) & self.applies[pair])
        bulge = 0.5 * half**2 * self.second_order(pair[todo], time[todo] - half, time[todo] + half)
        todo, bulge = todo[bulge < spare[todo]], bulge[bulge < spare[todo]]
        better = change.copy()
        if len(todo):
            lost, speed = self.first_order(pair[todo], time[todo])
            better[todo] = np.fmin(change[todo], lost + half * speed + bulge)
        return better

    def second_order(self, pair: NDArray[np.int64], begin: Array, end: Array) -> Array:
        """Bound |p''| during time intervals; all arrays of shape (n,), [s] -> [m/s^2]."""
        rates, bends = np.split(self._rates.over(begin, end), 2, axis=1)
        reach = self.bodies.reach[pair, :-1]
        between = self._sides[:, pair].any(axis=0)
        return (bends * reach).sum(axis=1) + 2 * (rates * between).sum(axis=1) * (rates * reach).sum(axis=1)

    def first_order(self, pair: NDArray[np.int64], time: Array) -> tuple[Array, Array]:
        """Compute distance minus slab width, and how fast points of both bodies come nearer along n.

        Parameters
        ----------
        time : array, shape (n,), in ascending order [s]

        Returns
        -------
        arrays, shape (n,), [m] and [m/s]
        """
        bodies, (centers, radii) = self.bodies, self.bodies.balls
        instants, of_instant = np.unique(time, return_inverse=True)
        turns, places = joint_placements(bodies.robot, self.curve(instants))
        twists = joint_twists(bodies.robot, turns, places, self.curve(instants, 1))
        apart, normals = self._nearest(pair, of_instant, self.curve(instants))
        lost, speed, turning = apart, np.zeros(len(pair)), np.zeros(len(pair))
        for side, sign in enumerate((1.0, -1.0)):  # normals point from the first body to the second
            body = bodies.ends[pair, side]
            turn, place = turns[bodies.joint[body], of_instant], places[bodies.joint[body], of_instant]
            lost = lost + sign * (normals * place).sum(axis=1)
            lost += self._supports(body, sign * (normals[:, None] @ turn)[:, 0])
            twist = np.einsum("nji,nj->ni", twists[of_instant], self._sides[side, pair])
            center = place + (turn @ centers[body, :, None])[..., 0]
            velocity = twist[:, :3] + np.cross(twist[:, 3:], center)
            speed = speed + sign * (normals * velocity).sum(axis=1)
            across = np.linalg.norm(np.cross(normals, twist[:, 3:]), axis=1)
            turning = turning + across * radii[body]
        return lost, np.abs(speed) + turning

    def _nearest(
        self, pair: NDArray[np.int64], of_instant: NDArray[np.int64], positions: Array
    ) -> tuple[Array, Array]:
        """Compute the distances of pairs and unit vectors along them; arrays, shape (n,) [m] and (n, 3).

        Parameters
        ----------
        of_instant : array, shape (n,), in ascending order, rows of `positions`, array of shape (n_steps, n_joints)
        """
        model, geometry, placed_for = self.bodies.robot.model, self.bodies.geometry, -1
        data, placed = self._state
        apart, normals = np.empty(len(pair)), np.empty((len(pair), 3))
        for i, (number, k) in enumerate(zip(pair.tolist(), of_instant.tolist(), strict=True)):
            if k != placed_for:
                pin.updateGeometryPlacements(model, data, geometry, placed, positions[k])
                placed_for = k
            found = pin.computeDistance(geometry, placed, number)
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

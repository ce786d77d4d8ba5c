"""Kernels for interval bounds of convex bodies' distances, by balls and slabs.

A slab between two convex bodies, perpendicular to a unit vector n, is as wide as their support functions determine,
and their distance is at least its width. The bound holds for every direction. Directions come from the interval
before, or from GJK (Gilbert, Johnson & Keerthi, 1988), which also computes the distance.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.geometry.distances import has_last_before, nearest_of_simplex

# Kinds: hulls of points with a radius, then along z, then along all axes, then what is not convex.
POINTS, CYLINDER, ELLIPSOID, OTHER = range(4)
# Cells: far enough by balls, bounded, and those whose bodies coal measures.
OPEN, SEEN, MEASURE = range(3)
# Accuracies of support functions; as literals they would have types of their own.
ROUGH, FINE, CORE = np.arange(3)
MAX_STEPS = 60  # of GJK; gaps are bounds of the distance after any of them
NEAR = 5e-7  # m, by which gap and distance may differ when GJK ends
ROUNDING = 1e-13  # m
TOUCHING = 1e-9  # m, nearer than which cores of bodies are in each other


class Solid(NamedTuple):
    """A body of `Solids`, its points an array of shape (3, n_points)."""

    kind: int
    points: Array
    size: Array
    turn: Array
    place: Array
    center: Array
    radius: float


class Solids(NamedTuple):
    """Bodies for kernels, each in a moving frame. The frame is that of a joint, the payload, or an obstacle.

    Attributes
    ----------
    frame : array, shape (n_bodies,), number of each body's frame
    kind : array, shape (n_bodies,), POINTS, CYLINDER, ELLIPSOID, or OTHER for non-convex ones
    first : array, shape (n_bodies + 1,), number of each body's first point
    points : array, shape (3, n_points), points in the bodies' frames [m]
    size : array, shape (n_bodies, 3), radius about points; radius and half the height; or radii [m]
    turn, place : arrays, shape (n_bodies, 3, 3) and (n_bodies, 3), placements of bodies without points [m]
    center, radius : arrays, shape (n_bodies, 3) and (n_bodies,), balls about the bodies [m]
    lower, upper : arrays, shape (n_bodies, 3), boxes about the points [m]
    """

    frame: Integers
    kind: Integers
    first: Integers
    points: Array
    size: Array
    turn: Array
    place: Array
    center: Array
    radius: Array
    lower: Array
    upper: Array

    @classmethod
    def of(cls, frame: Integers, solids: Sequence[Solid]) -> Solids:
        """Return bodies in frames, array of shape (n_bodies,)."""
        kind, points, size, turn, place, center, radius = list(zip(*solids, strict=True)) or [()] * 7
        return cls(
            frame,
            np.array(kind, dtype=np.int64),
            np.cumsum([0, *(part.shape[1] for part in points)]),
            np.ascontiguousarray(np.hstack([np.empty((3, 0)), *points])),
            np.array(size, dtype=float).reshape(-1, 3),
            np.array(turn, dtype=float).reshape(-1, 3, 3),
            np.array(place, dtype=float).reshape(-1, 3),
            np.array(center, dtype=float).reshape(-1, 3),
            np.array(radius, dtype=float),
            np.array([part.min(axis=1, initial=np.inf) for part in points]).reshape(-1, 3),
            np.array([part.max(axis=1, initial=-np.inf) for part in points]).reshape(-1, 3),
        )

    def with_others(self, others: Solids) -> Solids:
        """Return these bodies and others."""
        axes = [1 if name == "points" else 0 for name in self._fields]
        joined = [np.concatenate(both[:2], axis=both[2]) for both in zip(self, others, axes, strict=True)]
        first = np.append(self.first, self.first[-1] + others.first[1:])
        return Solids(*joined)._replace(first=first)


class Pairs(NamedTuple):
    """Pairs of bodies.

    Attributes
    ----------
    ends : array, shape (n_pairs, 2), numbers of the bodies
    kind : array, shape (n_pairs,)
    common : array, shape (n_pairs,), frame of the last joint that moves both bodies, 0 for none
    is_exact : array, shape (n_pairs,), whether a pair is no rough substitute of another
    taken : array, shape (n_pairs,), by which the true distance may be less than the computed one [m]
    reach : array, shape (n_pairs, n_joints + 1 + n_moving), as in `Bodies`
    between : array, shape (n_pairs, n_joints), whether a joint moves one of the two only
    """

    ends: Integers
    kind: Integers
    common: Integers
    is_exact: NDArray[np.bool_]
    taken: Array
    reach: Array
    between: NDArray[np.bool_]


class Intervals(NamedTuple):
    """Time intervals of equal length, with placements and bounds of rates.

    Attributes
    ----------
    knot : array, shape (n_intervals, 3), numbers of the instants at begin, middle and end
    turns, places : arrays, shape (n_instants, n_frames, 3, 3) and (n_instants, n_frames, 3) [m]
    rates : array, shape (n_intervals, n_joints + 1 + n_moving), largest rates of joints, payload, and obstacles
    bends : array, shape (n_intervals, n_joints + 1), largest second derivatives of joints and payload
    half : half of their length [s]
    """

    knot: Integers
    turns: Array
    places: Array
    rates: Array
    bends: Array
    half: float


class BoundTargets(NamedTuple):
    """Bounds that suffice, and the least distances on which they depend.

    Attributes
    ----------
    required : array, shape (3,), required clearance of each kind [m]
    upper : array, shape (3,), least clearance computed so far, less possible errors [m]; infinite where none was
    pair, knot : arrays, shape (3,), the pair and the instant that have it
    slack, tight, loose : see `certify` and `JointCertificateSettings`
    """

    required: Array
    upper: Array
    pair: Integers
    knot: Integers
    slack: float
    tight: float
    loose: float

    @classmethod
    def none(cls, required: Array, slack: float, tight: float, loose: float) -> BoundTargets:
        """Return the sufficient bounds before any distance is computed."""
        nowhere = np.full(3, -1, dtype=np.int64), np.zeros(3, dtype=np.int64)
        return cls(required, np.full(3, np.inf), *nowhere, slack, tight, loose)


@kernel
def note(need: BoundTargets, kind: int, pair: int, knot: int, distance: float) -> None:
    """Keep a kind's least distance [m]. Possible errors are subtracted."""
    if distance < need.upper[kind]:
        need.upper[kind], need.pair[kind], need.knot[kind] = distance, pair, knot


@kernel
def enough(need: BoundTargets, kind: int) -> float:
    """Return the bound that suffices for pairs of a kind [m]."""
    if need.slack > 0.0:
        for k in range(3):
            if need.upper[k] < need.required[k]:
                return -np.inf
    upper, required = need.upper[kind], need.required[kind]
    if need.slack >= 1.0:
        return required
    if upper < required:
        return upper - need.loose
    if upper == np.inf:
        return np.inf
    return max(required, upper - max(need.tight, need.slack * (upper - required)))


@kernel
def decided(
    need: BoundTargets, kind: Integers, pair: Integers, bound: Array, is_last: bool, lower: Array
) -> NDArray[np.bool_]:
    """Return which cells' bounds suffice, shape (n_cells,), all of the last level; lower their kinds' bounds.

    Parameters
    ----------
    kind : array, shape (n_pairs,)
    pair, bound : arrays, shape (n_cells,)
    lower : array, shape (3,), lower bounds of the kinds, written [m]
    """
    done, enough_for = np.empty(pair.shape[0], dtype=np.bool_), np.empty(3)
    for k in range(3):
        enough_for[k] = enough(need, k)
    for cell in range(pair.shape[0]):
        own = kind[pair[cell]]
        done[cell] = is_last or bound[cell] >= enough_for[own]
        if done[cell] and (bound[cell] < lower[own] or np.isnan(bound[cell])):
            lower[own] = bound[cell]
    return done


@kernel
def ball_centers(solids: Solids, turns: Array, places: Array) -> Array:
    """Compute the centres of the balls about all bodies; array, shape (n_instants, n_bodies, 3) [m]."""
    centers = np.empty((turns.shape[0], solids.frame.shape[0], 3))
    for i in range(turns.shape[0]):
        for body in range(solids.frame.shape[0]):
            turn, place = turns[i, solids.frame[body]], places[i, solids.frame[body]]
            x, y, z = solids.center[body, 0], solids.center[body, 1], solids.center[body, 2]
            for axis in range(3):
                centers[i, body, axis] = (
                    place[axis] + turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2] * z
                )
    return centers


@kernel
def of_balls(centers: Array, solids: Solids, pairs: Pairs, knot: int, pair: int) -> float:
    """Return the distance of two bodies' balls at an instant [m]. Possible errors are subtracted."""
    a, b = pairs.ends[pair, 0], pairs.ends[pair, 1]
    p, q = centers[knot, a], centers[knot, b]
    square = (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2
    return sqrt(square) - solids.radius[a] - solids.radius[b] - pairs.taken[pair]


@kernel
def distances_of_balls(solids: Solids, pairs: Pairs, at: Intervals, row: Integers, pair: Integers) -> Array:
    """Compute the distances of balls in the middle of intervals; array, shape (n_cells,) [m]."""
    centers, result = ball_centers(solids, at.turns, at.places), np.empty(row.shape[0])
    for k in range(row.shape[0]):
        result[k] = of_balls(centers, solids, pairs, at.knot[row[k], 1], pair[k])
    return result


@kernel
def change(pairs: Pairs, at: Intervals, row: int, pair: int) -> float:
    """Bound how much a distance changes within half an interval [m]."""
    total = 0.0
    for j in range(pairs.reach.shape[1]):
        if pairs.reach[pair, j] != 0.0:  # a rate may be infinite that does not count
            total += pairs.reach[pair, j] * at.rates[row, j]
    return at.half * total


@kernel
def _bulge(pairs: Pairs, at: Intervals, row: int, pair: int) -> float:
    """Bound a directed distance's bulge below its chords over half intervals [m]."""
    n_joints = pairs.between.shape[1]
    bend, speed, sweep, by_obstacles = 0.0, 0.0, 0.0, 0.0
    for j in range(n_joints):
        if pairs.between[pair, j]:
            reach = pairs.reach[pair, j]
            bend += at.bends[row, j] * reach
            speed += at.rates[row, j]
            sweep += at.rates[row, j] * reach
    if pairs.reach[pair, n_joints] > 0.0:
        bend += at.bends[row, n_joints]
    for j in range(n_joints + 1, pairs.reach.shape[1]):
        by_obstacles += pairs.reach[pair, j] * at.rates[row, j]
    return 0.125 * at.half**2 * (bend + 2.0 * speed * sweep) + 0.5 * at.half * by_obstacles


@kernel
def changes(pairs: Pairs, at: Intervals, row: Integers, pair: Integers) -> tuple[Array, Array]:
    """Bound how distances change and bulge within half an interval.

    Both are arrays, shape (n_cells,) [m]. The latter are of directed distances, below their chords over half the
    interval, and infinite where an obstacle moves.
    """
    change_, bulge = np.empty(row.shape[0]), np.full(row.shape[0], np.inf)
    for k in range(row.shape[0]):
        change_[k] = change(pairs, at, row[k], pair[k])
        if not (pairs.reach[pair[k], pairs.between.shape[1] + 1 :] > 0.0).any():
            bulge[k] = _bulge(pairs, at, row[k], pair[k])
    return change_, bulge


@kernel
def _most(points: Array, first: int, last: int, x: float, y: float, z: float) -> float:
    """Return the largest extent of points along a vector."""
    most = -1e300
    for i in range(first, last):
        most = max(most, x * points[0, i] + y * points[1, i] + z * points[2, i])
    return most


@kernel
def _reach(
    solids: Solids,
    body: int,
    turns: Array,
    places: Array,
    x: float,
    y: float,
    z: float,
    how: int,
    core: Array,
) -> float:
    """Return a body's support along the unit vector (x, y, z) [m].

    It is measured from the scene's origin. `how` is ROUGH for a bound by the box about its points, FINE, or CORE to
    write the support point, less the radius about points, in `core`.
    """
    frame, kind, size = solids.frame[body], solids.kind[body], solids.size[body]
    turn, place = turns[frame], places[frame]
    from_origin = x * place[0] + y * place[1] + z * place[2]
    u = turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z
    v = turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z
    w = turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z
    if kind == POINTS:
        if how == ROUGH:
            lower, upper = solids.lower[body], solids.upper[body]
            far = max(u * lower[0], u * upper[0])
            far += max(v * lower[1], v * upper[1]) + max(w * lower[2], w * upper[2])
            return far + size[0] + from_origin
        first, last = solids.first[body], solids.first[body + 1]
        far = _most(solids.points, first, last, u, v, w)
        if how == CORE:
            near, best = first, -np.inf
            for i in range(first, last):
                along = u * solids.points[0, i] + v * solids.points[1, i] + w * solids.points[2, i]
                if along > best:
                    near, best = i, along
                    if along >= far - ROUNDING:
                        break
            _placed(turn, place, solids.points[0, near], solids.points[1, near], solids.points[2, near], core)
        return far + size[0] + from_origin
    own, center = solids.turn[body], solids.place[body]
    p = own[0, 0] * u + own[1, 0] * v + own[2, 0] * w
    q = own[0, 1] * u + own[1, 1] * v + own[2, 1] * w
    r = own[0, 2] * u + own[1, 2] * v + own[2, 2] * w
    if kind == CYLINDER:
        level = sqrt(p * p + q * q)
        far = size[0] * level + size[1] * abs(r)
        share = size[0] / level if level > 0.0 else 0.0
        p, q, r = share * p, share * q, size[1] if r > 0.0 else -size[1]
    else:
        far = sqrt((size[0] * p) ** 2 + (size[1] * q) ** 2 + (size[2] * r) ** 2)
        p, q, r = size[0] ** 2 * p / far, size[1] ** 2 * q / far, size[2] ** 2 * r / far
    if how == CORE:
        _placed(own, center, p, q, r, core)
        _placed(turn, place, core[0], core[1], core[2], core)
    return far + u * center[0] + v * center[1] + w * center[2] + from_origin


@kernel
def _placed(turn: Array, place: Array, x: float, y: float, z: float, point: Array) -> None:
    for axis in range(3):
        point[axis] = place[axis] + turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2] * z


@kernel
def apart(solids: Solids, a: int, b: int, turns: Array, places: Array, normal: Array) -> tuple[float, float]:
    """Return the widest slab found between bodies, and their GJK distance [m].

    `normal` is tried first, and becomes that of the slab; the distance is -inf where cores penetrate each other.
    """
    corners, weights, p, q = np.empty((4, 3)), np.empty(4), np.empty(3), np.empty(3)
    radius = 0.0
    for body in (a, b):
        if solids.kind[body] == POINTS:
            radius += solids.size[body, 0]
    x, y, z, n, square, wide = normal[0], normal[1], normal[2], 0, np.inf, -np.inf
    for _ in range(MAX_STEPS):
        most = _reach(solids, a, turns, places, x, y, z, CORE, p)
        gap = -_reach(solids, b, turns, places, -x, -y, -z, CORE, q) - most
        if gap > wide:
            wide = gap
            normal[0], normal[1], normal[2] = x, y, z
        if n > 0 and sqrt(square) - radius - wide <= NEAR:
            break
        corners[n, 0], corners[n, 1], corners[n, 2] = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        if has_last_before(corners, n):
            break
        nearer = nearest_of_simplex(corners, n + 1, weights)
        if not nearer < square:  # rounding: no progress any more
            break
        square, kept = nearer, 0
        x, y, z = 0.0, 0.0, 0.0
        for i in range(n + 1):
            if weights[i] != 0.0:
                x, y, z = (
                    x + weights[i] * corners[i, 0],
                    y + weights[i] * corners[i, 1],
                    z + weights[i] * corners[i, 2],
                )
                for axis in range(3):
                    corners[kept, axis] = corners[i, axis]
                kept += 1
        n, length = kept, sqrt(x * x + y * y + z * z)
        if n == 4 or length < TOUCHING:
            return wide, -np.inf
        x, y, z = x / length, y / length, z / length
    return wide, sqrt(square) - radius


@kernel
def _along(
    solids: Solids, pairs: Pairs, at: Intervals, row: int, pair: int, normal: Array, how: int
) -> float:
    """Return the narrowest slab's width [m] along a vector at three instants; `how` as in `_reach`.

    The vector is in the frame that both bodies share.
    """
    a, b, common, least = pairs.ends[pair, 0], pairs.ends[pair, 1], pairs.common[pair], np.inf
    for k in range(3):
        knot = at.knot[row, k]
        turns, places = at.turns[knot], at.places[knot]
        turn = turns[common]
        x = turn[0, 0] * normal[0] + turn[0, 1] * normal[1] + turn[0, 2] * normal[2]
        y = turn[1, 0] * normal[0] + turn[1, 1] * normal[1] + turn[1, 2] * normal[2]
        z = turn[2, 0] * normal[0] + turn[2, 1] * normal[1] + turn[2, 2] * normal[2]
        most = _reach(solids, a, turns, places, x, y, z, how, normal)
        least = min(least, -most - _reach(solids, b, turns, places, -x, -y, -z, how, normal))
    return least


@kernel
def measured(
    solids: Solids, pairs: Pairs, at: Intervals, row: int, pair: int, normal: Array, need: BoundTargets
) -> tuple[float, float]:
    """Compute `apart` in the middle of an interval, and note the distance. Possible errors are subtracted.

    `normal` is in the frame that both bodies share.
    """
    a, b, knot = pairs.ends[pair, 0], pairs.ends[pair, 1], at.knot[row, 1]
    turns, places, there = at.turns[knot], at.places[knot], np.empty(3)
    turn = turns[pairs.common[pair]]
    for axis in range(3):
        there[axis] = turn[axis, 0] * normal[0] + turn[axis, 1] * normal[1] + turn[axis, 2] * normal[2]
    wide, distance = apart(solids, a, b, turns, places, there)
    for axis in range(3):
        normal[axis] = turn[0, axis] * there[0] + turn[1, axis] * there[1] + turn[2, axis] * there[2]
    if pairs.is_exact[pair] and distance > -np.inf:
        note(need, pairs.kind[pair], pair, knot, distance - pairs.taken[pair])
    return wide, distance


@kernel
def begin_normal(centers: Array, pairs: Pairs, at: Intervals, row: int, pair: int, normal: Array) -> None:
    """Write the direction between the centres of two bodies' balls. It is in the frame that they share."""
    knot = at.knot[row, 1]
    p, q = centers[knot, pairs.ends[pair, 0]], centers[knot, pairs.ends[pair, 1]]
    length = sqrt((q[0] - p[0]) ** 2 + (q[1] - p[1]) ** 2 + (q[2] - p[2]) ** 2)
    if length == 0.0:
        normal[0], normal[1], normal[2] = 1.0, 0.0, 0.0
        return
    turn = at.turns[knot, pairs.common[pair]]
    for axis in range(3):
        normal[axis] = (
            (q[0] - p[0]) * turn[0, axis] + (q[1] - p[1]) * turn[1, axis] + (q[2] - p[2]) * turn[2, axis]
        ) / length


@kernel
def measure_cells(
    solids: Solids, pairs: Pairs, at: Intervals, row: Integers, pair: Integers, need: BoundTargets
) -> NDArray[np.bool_]:
    """Note the distances of convex bodies; return which cells are left to coal, shape (n_cells,)."""
    centers, left, normal = (
        ball_centers(solids, at.turns, at.places),
        np.ones(row.shape[0], dtype=np.bool_),
        np.empty(3),
    )
    for k in range(row.shape[0]):
        ends = pairs.ends[pair[k]]
        if solids.kind[ends[0]] != OTHER and solids.kind[ends[1]] != OTHER:
            begin_normal(centers, pairs, at, row[k], pair[k], normal)
            left[k] = measured(solids, pairs, at, row[k], pair[k], normal, need)[1] == -np.inf
    return left


@kernel
def bound_cells(
    solids: Solids,
    pairs: Pairs,
    at: Intervals,
    row: Integers,
    pair: Integers,
    normals: Array,
    need: BoundTargets,
    state: Integers,
    bound: Array,
) -> None:
    """Bound the distances of pairs during intervals from below.

    Parameters
    ----------
    row, pair : arrays, shape (n_cells,), interval and pair of each cell, all of a pair one after the other
    normals : array, shape (n_cells, 3), directions to be tried, zeros for that of the cell before; those that were
        tried last are written there, in the frames that pairs share
    state : array, shape (n_cells,), the result of each cell, written
    bound : array, shape (n_cells,), written [m]
    """
    centers, before = ball_centers(solids, at.turns, at.places), -1
    for k in range(row.shape[0]):
        i, number = row[k], pair[k]
        change_, kind = change(pairs, at, i, number), pairs.kind[number]
        balls = 0.5 * (
            of_balls(centers, solids, pairs, at.knot[i, 0], number)
            + of_balls(centers, solids, pairs, at.knot[i, 2], number)
        )
        bound[k], state[k] = balls - change_, OPEN
        if bound[k] >= enough(need, kind):
            continue
        normal, taken, ends = normals[k], pairs.taken[number], pairs.ends[number]
        if solids.kind[ends[0]] == OTHER or solids.kind[ends[1]] == OTHER:
            state[k] = MEASURE
            continue
        state[k] = SEEN
        if normal[0] == 0.0 and normal[1] == 0.0 and normal[2] == 0.0:
            if before >= 0 and pair[before] == number:
                for axis in range(3):
                    normal[axis] = normals[before, axis]
            else:
                begin_normal(centers, pairs, at, i, number, normal)
        before, less = k, _bulge(pairs, at, i, number) + taken
        bound[k] = max(bound[k], _along(solids, pairs, at, i, number, normal, ROUGH) - less)
        if bound[k] >= enough(need, kind):
            continue
        parted = _along(solids, pairs, at, i, number, normal, FINE)
        bound[k] = max(bound[k], parted - less)
        if bound[k] >= enough(need, kind) or parted - taken >= enough(need, kind):
            continue  # the latter are decided by parts along the same vector
        wide, distance = measured(solids, pairs, at, i, number, normal, need)
        bound[k] = max(bound[k], wide - change_ - taken)
        if distance == -np.inf:
            state[k] = MEASURE
        elif bound[k] < enough(need, kind):
            bound[k] = max(bound[k], _along(solids, pairs, at, i, number, normal, FINE) - less)
            if bound[k] < enough(need, kind) and not pairs.is_exact[number]:
                state[k] = MEASURE

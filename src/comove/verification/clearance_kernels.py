"""Kernels of the certificate of clearance: bounds for edges, for solids and for meshes; see `certificate`."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel
from comove.geometry.distances import point_distance
from comove.geometry.solids import empty_solid, gap, move_solid, solid_at, solid_distance
from comove.geometry.surfaces import (
    DEPTH,
    Surfaces,
    box_distance,
    box_gap,
    nearest,
    surface_distance,
    triangle_gap,
)

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

MAX_CELLS = 2_000_000  # a bound that needs more is given up as it stands: still sound, only lower
MAX_HALVES = 300_000  # the same for solids and triangles, where each takes a search for a direction
STACK = 256


class Need(NamedTuple):
    """The accuracy that is required of a bound.

    Attributes
    ----------
    clearance : required clearance [m]; the bound is tightened where it is close to it
    loose, tight : allowed difference between bound and true clearance, in general and close to the required one [m]
    rounding : rounding error of distances [m]
    """

    clearance: float
    loose: float
    tight: float
    rounding: float


class CurveArrays(NamedTuple):
    """The nodes of a body at some instants, and how far they stray from their chords in between.

    Attributes
    ----------
    nodes : array, shape (n_knots, n_nodes, 3), [m]
    deviation : array, shape (n_knots - 1, n_nodes), largest distance of the nodes from their chords [m]
    """

    nodes: Array
    deviation: Array


class Paths(NamedTuple):
    """The motions of obstacles by row of their table, as kernels take them; empty where all obstacles stand still.

    Attributes
    ----------
    offset : array, shape (n_knots, n_rows, 3), offsets of the centres from their first positions [m]
    sagitta : array, shape (n_knots - 1, n_rows), largest distance of the centres from their chords between knots [m]
    """

    offset: Array
    sagitta: Array


class Around(NamedTuple):
    """Everything that a body must keep clear of, and how accurately that is to be bounded.

    Attributes
    ----------
    obstacles : array, shape (n_obstacles, N_COLUMNS), table of the obstacles
    paths : motions of the obstacles
    lower, upper : arrays, shape (3,), the workspace [m]
    need : accuracy required of the bound
    """

    obstacles: Array
    paths: Paths
    lower: Array
    upper: Array
    need: Need


@kernel
def certified_clearance(
    curve: CurveArrays, edges: Numbers, radii: Array, around: Around
) -> tuple[float, float, int, int]:
    """Return a certified lower bound of the clearance, the least clearance found, its knot and its obstacle.

    Of several obstacles that are equally near, it is the first.

    Parameters
    ----------
    edges, radii : arrays, shapes (n_edges, 2) and (n_edges,), the body
    """
    (nodes, deviation), (obstacles, paths, lower, upper, need) = curve, around
    n_intervals, n_edges, n_obstacles = deviation.shape[0], edges.shape[0], obstacles.shape[0]
    bound, met, knot, nearest = np.inf, np.inf, 0, -1
    for e in range(n_edges):
        for k in range(n_intervals + 1):
            swell = radii[e]
            worst = 0.0
            for i in range(2):
                n = edges[e, i]
                if k > 0:
                    worst = max(worst, deviation[k - 1, n])
                if k < n_intervals:
                    worst = max(worst, deviation[k, n])
                for axis in range(3):
                    border = min(nodes[k, n, axis] - lower[axis], upper[axis] - nodes[k, n, axis])
                    if border - swell < met:
                        if border - swell < met - need.rounding:
                            knot, nearest = k, -1
                        met = border - swell
                    bound = min(bound, border - swell - worst)
    # A first look at every fourth knot gives a good upper bound, so that few cells need halving.
    for k in range(0, n_intervals + 1, 4):
        for e in range(n_edges):
            p, q = nodes[k, edges[e, 0]], nodes[k, edges[e, 1]]
            for j in range(n_obstacles):
                x, y, z = _offset(paths, k, j)
                for i in range(3):
                    s = 0.5 * i
                    distance = (
                        point_distance(
                            obstacles,
                            j,
                            p[0] + s * (q[0] - p[0]) - x,
                            p[1] + s * (q[1] - p[1]) - y,
                            p[2] + s * (q[2] - p[2]) - z,
                        )
                        - radii[e]
                    )
                    if distance < met:
                        if distance < met - need.rounding:
                            knot, nearest = k, j
                        met = distance
    stack, seen = np.empty((STACK, 4)), np.empty((4, 3))
    cells = 0
    for k in range(n_intervals):
        for e in range(n_edges):
            m, n = edges[e, 0], edges[e, 1]
            a0, b0, a1, b1 = nodes[k, m], nodes[k, n], nodes[k + 1, m], nodes[k + 1, n]
            length = max(_apart(a0, b0), _apart(a1, b1))
            move_a, move_b = _apart(a0, a1), _apart(b0, b1)
            swell = max(deviation[k, m], deviation[k, n]) + need.rounding
            for j in range(n_obstacles):
                if paths.offset.shape[0] > 0:  # as seen from the obstacle
                    _seen_from(paths, k, j, nodes[k, m], seen[0])
                    _seen_from(paths, k, j, nodes[k, n], seen[1])
                    _seen_from(paths, k + 1, j, nodes[k + 1, m], seen[2])
                    _seen_from(paths, k + 1, j, nodes[k + 1, n], seen[3])
                    a0, b0, a1, b1 = seen[0], seen[1], seen[2], seen[3]
                    move_a, move_b = _apart(a0, a1), _apart(b0, b1)
                    swell = max(deviation[k, m], deviation[k, n]) + paths.sagitta[k, j] + need.rounding
                x, y, z = _on_surface(a0, b0, a1, b1, 0.5, 0.5)
                distance = point_distance(obstacles, j, x, y, z) - radii[e]
                if distance - 0.5 * max(move_a, move_b) - 0.5 * length - swell > met:
                    continue  # far away: most cells
                stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0.0, 1.0, 0.0, 1.0
                top = 1
                while top > 0:
                    top -= 1
                    cells += 1
                    t0, t1, s0, s1 = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
                    t, s = 0.5 * (t0 + t1), 0.5 * (s0 + s1)
                    x, y, z = _on_surface(a0, b0, a1, b1, t, s)
                    distance = point_distance(obstacles, j, x, y, z) - radii[e]
                    if distance < met:
                        if distance < met - need.rounding:
                            knot, nearest = k, j
                        met = distance
                    along = distance - 0.5 * (s1 - s0) * length
                    sweep = 0.5 * (t1 - t0) * max(_move(a0, a1, b0, b1, s0), _move(a0, a1, b0, b1, s1))
                    enough = met - _slack(met, need)
                    if along - sweep < enough:
                        x, y, z = _on_surface(a0, b0, a1, b1, t, s0)
                        first = point_distance(obstacles, j, x, y, z) - radii[e]
                        x, y, z = _on_surface(a0, b0, a1, b1, t, s1)
                        last = point_distance(obstacles, j, x, y, z) - radii[e]
                        at_end = min(first, last)
                        if at_end < met:
                            if at_end < met - need.rounding:
                                knot, nearest = k, j
                            met = at_end
                        along = max(along, min(distance, 2 * distance - first, 2 * distance - last))
                    if along - sweep >= enough or top + 2 >= STACK or cells > MAX_CELLS:
                        bound = min(bound, along - sweep - swell)
                        continue
                    stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = t0, t1, s0, s1
                    stack[top + 1, 0], stack[top + 1, 1] = t0, t1
                    stack[top + 1, 2], stack[top + 1, 3] = s0, s1
                    if sweep > distance - along:
                        stack[top, 1], stack[top + 1, 0] = t, t
                    else:
                        stack[top, 3], stack[top + 1, 2] = s, s
                    top += 2
    return bound, met, knot, nearest


@kernel
def certified_solids(
    curve: CurveArrays, solids: Numbers, around: Around, found: tuple[float, float, int, int]
) -> tuple[float, float, int, int]:
    """Return the results of `certified_clearance` for the whole body, solids included.

    Parameters
    ----------
    solids : array of int, shape (n_solids, 8) for boxes or (n_solids, n) for hulls, nodes at their corners
    found : results for the rest of the body
    """
    (nodes, deviation), (obstacles, paths, lower, upper, need) = curve, around
    bound, met, knot, nearest = found
    n_intervals, n_obstacles = deviation.shape[0], obstacles.shape[0]
    begin, end, solid = empty_solid(solids), empty_solid(solids), empty_solid(solids)
    normal, other = np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    stack = np.empty((STACK, 2))
    cells = 0
    for corners in solids:
        for k in range(n_intervals + 1):
            for n in corners:
                worst = max(deviation[max(k - 1, 0), n], deviation[min(k, n_intervals - 1), n])
                for axis in range(3):
                    border = min(nodes[k, n, axis] - lower[axis], upper[axis] - nodes[k, n, axis])
                    if border < met:
                        if border < met - need.rounding:
                            knot, nearest = k, -1
                        met = border
                    bound = min(bound, border - worst)
        for k in range(0, n_intervals + 1, 4):
            for j in range(n_obstacles):
                _solid_seen_from(paths, k, j, nodes[k], corners, solid)
                distance = solid_distance(obstacles, j, solid, met, normal)[1]
                if distance < met:
                    if distance < met - need.rounding:
                        knot, nearest = k, j
                    met = distance
        for j in range(n_obstacles):
            _solid_seen_from(paths, 0, j, nodes[0], corners, end)
            solid_distance(obstacles, j, end, np.inf, normal)
            for k in range(n_intervals):
                begin, end = end, begin
                _solid_seen_from(paths, k + 1, j, nodes[k + 1], corners, end)
                swell = need.rounding
                for n in corners:
                    swell = max(swell, deviation[k, n] + need.rounding)
                if paths.offset.shape[0] > 0:
                    swell += paths.sagitta[k, j]
                stack[0, 0], stack[0, 1] = 0.0, 1.0
                top = 1
                while top > 0:
                    top -= 1
                    t0, t1 = stack[top, 0], stack[top, 1]
                    slack = _slack(met, need)
                    clear = _gap_throughout(obstacles, j, begin, end, t0, t1, solid, normal)
                    if clear < met - slack:
                        cells += 1
                        t = 0.5 * (t0 + t1)
                        _between(begin, end, t, solid)
                        at_middle, distance = solid_distance(obstacles, j, solid, np.inf, other)
                        if distance < met:
                            if distance < met - need.rounding:
                                knot, nearest = k, j
                            met = distance
                            slack = _slack(met, need)
                        anew = _gap_throughout(obstacles, j, begin, end, t0, t1, solid, other)
                        if anew > clear:
                            clear = anew
                            normal[0], normal[1], normal[2] = other[0], other[1], other[2]
                        # Where they touch, or no direction does better at mid-time, halving gains nothing.
                        gains = at_middle > 0.0 and clear < min(met, at_middle) - slack
                        if gains and top + 2 <= STACK and cells <= MAX_HALVES:
                            stack[top, 0], stack[top, 1] = t0, t
                            stack[top + 1, 0], stack[top + 1, 1] = t, t1
                            top += 2
                            continue
                    bound = min(bound, clear - swell)
    return bound, met, knot, nearest


@kernel
def certified_surface(
    curve: CurveArrays,
    hulls: Numbers,
    radii: Array,
    way: tuple[Array, Array],
    surfaces: Surfaces,
    mesh: int,
    need: Need,
    found: tuple[float, float, int],
) -> tuple[float, float, int]:
    """Return the lower bound, the least clearance found and its knot for the whole body and one more mesh.

    Parameters
    ----------
    hulls : array of int, shape (n_hulls, n), nodes of every convex part of the body
    radii : array, shape (n_hulls,), radii by which the parts are thickened [m]
    way : arrays, shapes (n_knots, 3) and (n_knots - 1,), motion of the mesh, as in `Paths` [m]
    surfaces, mesh : the scene's meshes, and the number of the mesh among them
    found : results for the obstacles before
    """
    (nodes, deviation), (offset, sagitta), (bound, met, knot) = curve, way, found
    n_intervals, n_points = deviation.shape[0], hulls.shape[1]
    begin, end, middle = np.empty((n_points, 3)), np.empty((n_points, 3)), np.empty((n_points, 3))
    normal, other, scratch = np.array([1.0, 0.0, 0.0]), np.empty(3), np.empty((3, 4, 3))
    low, high = np.empty(3), np.empty(3)
    boxes, parts, cells = np.empty(DEPTH, dtype=np.int64), np.empty((STACK, 2)), 0
    for h in range(hulls.shape[0]):
        for k in range(0, n_intervals + 1, 4):  # a first look
            _hull_seen_from(nodes[k], hulls[h], offset[k], begin)
            distance = surface_distance(surfaces, mesh, begin, met + radii[h]) - radii[h]
            if distance < met:
                if distance < met - need.rounding:
                    knot = k
                met = distance
        _hull_seen_from(nodes[0], hulls[h], offset[0], end)
        for k in range(n_intervals):
            begin, end = end, begin
            _hull_seen_from(nodes[k + 1], hulls[h], offset[k + 1], end)
            swell = radii[h] + sagitta[k] + surfaces.slack[mesh] + need.rounding
            worst = 0.0
            for node in hulls[h]:
                worst = max(worst, deviation[k, node])
            swell += worst
            for axis in range(3):
                low[axis] = min(begin[:, axis].min(), end[:, axis].min())
                high[axis] = max(begin[:, axis].max(), end[:, axis].max())
            boxes[0], top = surfaces.root[mesh], 1
            while top > 0:
                top -= 1
                box = boxes[top]
                enough = met - _slack(met, need) + radii[h]
                clear = box_distance(surfaces, box, low, high)
                if clear < enough:
                    clear = max(clear, box_gap(surfaces, box, begin, end, normal))
                if clear >= enough:
                    bound = min(bound, clear - swell)
                    continue
                if surfaces.right[box] >= 0:
                    boxes[top], boxes[top + 1] = surfaces.right[box], box + 1
                    top += 2
                    continue
                for i in range(surfaces.first[box], surfaces.first[box] + surfaces.count[box]):
                    triangle = surfaces.triangles[i]
                    parts[0, 0], parts[0, 1], n_parts = 0.0, 1.0, 1
                    while n_parts > 0:
                        n_parts -= 1
                        t0, t1 = parts[n_parts, 0], parts[n_parts, 1]
                        clear = _hull_gap(triangle, begin, end, t0, t1, middle, normal)
                        slack = _slack(met, need)
                        if clear - radii[h] < met - slack:
                            cells += 1
                            t = 0.5 * (t0 + t1)
                            _between(begin, end, t, middle)
                            other[:] = normal
                            at_middle, distance = nearest(triangle, middle, other, scratch)
                            if distance == 0.0:  # they cut each other: about how deep
                                distance = at_middle
                            if distance - radii[h] < met:
                                if distance - radii[h] < met - need.rounding:
                                    knot = k
                                met = distance - radii[h]
                                slack = _slack(met, need)
                            anew = _hull_gap(triangle, begin, end, t0, t1, middle, other)
                            if anew > clear:
                                clear = anew
                                normal[:] = other
                            # Where they touch, or no direction does better at mid-time, halving gains nothing.
                            gains = (
                                at_middle > 0.0 and clear - radii[h] < min(met, at_middle - radii[h]) - slack
                            )
                            if gains and n_parts + 2 <= STACK and cells <= MAX_HALVES:
                                parts[n_parts, 0], parts[n_parts, 1] = t0, t
                                parts[n_parts + 1, 0], parts[n_parts + 1, 1] = t, t1
                                n_parts += 2
                                continue
                        bound = min(bound, clear - swell)
    return min(bound, met), met, knot


@kernel
def _hull_seen_from(nodes: Array, hull: Numbers, offset: Array, out: Array) -> None:
    """Write in `out` the nodes of a hull in the frame of a mesh that has moved by `offset`."""
    for i in range(hull.shape[0]):
        for axis in range(3):
            out[i, axis] = nodes[hull[i], axis] - offset[axis]


@kernel
def _hull_gap(
    triangle: Array, begin: Array, end: Array, t0: float, t1: float, scratch: Array, normal: Array
) -> float:
    """Return the least gap [m] along `normal` while a hull moves from the fraction t0 to t1 of its path.

    `scratch` is an array of the hull's shape.
    """
    _between(begin, end, t0, scratch)
    first = triangle_gap(triangle, scratch, normal)
    _between(begin, end, t1, scratch)
    return min(first, triangle_gap(triangle, scratch, normal))


@kernel
def _offset(paths: Paths, k: int, j: int) -> tuple[float, float, float]:
    """Return the offset of the centre of obstacle j at knot k [m]."""
    if paths.offset.shape[0] == 0:
        return 0.0, 0.0, 0.0
    return paths.offset[k, j, 0], paths.offset[k, j, 1], paths.offset[k, j, 2]


@kernel
def _seen_from(paths: Paths, k: int, j: int, point: Array, out: Array) -> None:
    """Write in `out` a point at knot k in the frame of obstacle j, which has moved."""
    for axis in range(3):
        out[axis] = point[axis] - paths.offset[k, j, axis]


@kernel
def _solid_seen_from(paths: Paths, k: int, j: int, nodes: Array, corners: Numbers, solid: Array) -> None:
    """Write in `solid` the solid at knot k in the frame of obstacle j."""
    solid_at(nodes, corners, solid)
    x, y, z = _offset(paths, k, j)
    move_solid(solid, -x, -y, -z)


@kernel
def _gap_throughout(
    obstacles: Array,
    j: int,
    begin: Array,
    end: Array,
    t0: float,
    t1: float,
    solid: Array,
    normal: Array,
) -> float:
    """Return the least gap [m] along `normal` while a solid moves from the fraction t0 to t1 of its path.

    `solid` is scratch.
    """
    x, y, z = normal[0], normal[1], normal[2]
    _between(begin, end, t0, solid)
    first = gap(obstacles, j, solid, x, y, z)
    _between(begin, end, t1, solid)
    return min(first, gap(obstacles, j, solid, x, y, z))


@kernel
def _between(begin: Array, end: Array, t: float, solid: Array) -> None:
    for row in range(solid.shape[0]):
        for axis in range(3):
            solid[row, axis] = begin[row, axis] + t * (end[row, axis] - begin[row, axis])


@kernel
def _slack(met: float, need: Need) -> float:
    """Return how far [m] the bound may stay below the least clearance found.

    It is little where that is close to the required clearance.
    """
    spare = 0.5 * (met - need.clearance)
    return need.loose if spare < 0.0 else min(need.loose, max(need.tight, spare))


@kernel
def _apart(p: Array, q: Array) -> float:
    return sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@kernel
def _on_surface(a0: Array, b0: Array, a1: Array, b1: Array, t: float, s: float) -> tuple[float, float, float]:
    """Return the point (t, s) of the surface that the edge's chord sweeps."""
    f, g, h, i = (1 - t) * (1 - s), (1 - t) * s, t * (1 - s), t * s
    return (
        f * a0[0] + g * b0[0] + h * a1[0] + i * b1[0],
        f * a0[1] + g * b0[1] + h * a1[1] + i * b1[1],
        f * a0[2] + g * b0[2] + h * a1[2] + i * b1[2],
    )


@kernel
def _move(a0: Array, a1: Array, b0: Array, b1: Array, s: float) -> float:
    """Return the distance that the point s of the edge moves along its chord."""
    x = (1 - s) * (a1[0] - a0[0]) + s * (b1[0] - b0[0])
    y = (1 - s) * (a1[1] - a0[1]) + s * (b1[1] - b0[1])
    z = (1 - s) * (a1[2] - a0[2]) + s * (b1[2] - b0[2])
    return sqrt(x * x + y * y + z * z)

"""Kernels of the certificate of clearance: bounds for edges, solids and meshes. See `certificate`."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import copy_to, kernel
from comove.geometry.distances import point_distance, points_apart
from comove.geometry.solids import empty_solid, gap, solid_at, solid_distance
from comove.geometry.surfaces import (
    DEPTH,
    Surfaces,
    box_distance,
    box_gap,
    nearest,
    surface_distance,
    triangle_gap,
)

STACK = 256


class Need(NamedTuple):
    """The accuracy that is required of a bound.

    Attributes
    ----------
    clearance : required clearance [m]; the bound is tightened where it is close to it
    loose, tight : allowed difference between bound and true clearance, in general and close to the required one [m]
    rounding : rounding error of distances [m]
    most_cells, most_halves : cells of edges, and halves for solids and triangles, beyond which a bound is given up as
        it stands: still sound, only lower
    """

    clearance: float
    loose: float
    tight: float
    rounding: float
    most_cells: int
    most_halves: int


class CurveArrays(NamedTuple):
    """The keypoints of a body at some instants, and their chord deviations. Any frame is possible.

    Attributes
    ----------
    nodes : array, shape (n_knots, n_nodes, 3), [m]
    deviation : array, shape (n_knots - 1, n_nodes), largest distance of the keypoints from their chords [m]
    """

    nodes: Array
    deviation: Array


class ConvexObstacles(NamedTuple):
    """Convex obstacles at rest in the frame of a body's curve.

    Attributes
    ----------
    table : array, shape (n_rows, n_columns), rows of the table of obstacles
    owner : array of int, shape (n_rows,), the obstacles' numbers in the scene's file
    """

    table: Array
    owner: Integers


class ClearanceFound(NamedTuple):
    """The state of a certificate.

    Attributes
    ----------
    bound : lower bound of the clearance so far [m]
    met : least clearance found so far [m]
    knot, nearest : knot at which it was found, and number of the obstacle; -1 for the border
    """

    bound: float
    met: float
    knot: int
    nearest: int


class PartSweep(NamedTuple):
    """A body's convex part between two knots, beside an obstacle.

    Attributes
    ----------
    begin, end : arrays, of the shape of the part, at these knots [m]
    radius, swell : its radius, and how far it strays from the span of its keypoints' chords [m]
    knot, obstacle : number of the first knot, and of the obstacle
    """

    begin: Array
    end: Array
    radius: float
    swell: float
    knot: int
    obstacle: int


class Scratch(NamedTuple):
    """Scratch arrays: a part, directions, GJK simplex, and pending intervals."""

    part: Array
    normal: Array
    other: Array
    simplex: Array
    stack: Array


@kernel
def certified_edges(
    curve: CurveArrays,
    edges: Integers,
    radii: Array,
    rows: ConvexObstacles,
    need: Need,
    found: ClearanceFound,
) -> ClearanceFound:
    """Return the certified clearance of edges among obstacles in their frame.

    Of several obstacles that are equally near, the first is named.

    Parameters
    ----------
    edges, radii : arrays, shapes (n_edges, 2) and (n_edges,), the body
    found : certified state so far
    """
    (nodes, deviation), (obstacles, owner) = curve, rows
    begin, end, stack = np.empty((2, 3)), np.empty((2, 3)), np.empty((STACK, 4))
    cells = 0
    for k in range(deviation.shape[0]):
        for e in range(edges.shape[0]):
            m, n = edges[e, 0], edges[e, 1]
            swell = max(deviation[k, m], deviation[k, n]) + need.rounding
            copy_to(nodes[k, m], begin[0])
            copy_to(nodes[k, n], begin[1])
            copy_to(nodes[k + 1, m], end[0])
            copy_to(nodes[k + 1, n], end[1])
            length = max(points_apart(begin[0], begin[1]), points_apart(end[0], end[1]))
            move = max(points_apart(begin[0], end[0]), points_apart(begin[1], end[1]))
            for j in range(obstacles.shape[0]):
                x, y, z = _on_surface(begin, end, 0.5, 0.5)
                distance = point_distance(obstacles, j, x, y, z) - radii[e]
                if distance - 0.5 * move - 0.5 * length - swell > found.met:
                    continue  # far away: most cells
                sweep = PartSweep(begin, end, radii[e], swell, k, owner[j])
                found, cells = _while_swept(obstacles, j, sweep, length, need, found, stack, cells)
    return found


@kernel
def certified_border(
    curve: CurveArrays, which: Integers, radii: Array, workspace: Array, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return the certified clearance of keypoints from the workspace border.

    Parameters
    ----------
    which, radii : arrays, shape (n,), numbers of the keypoints, and radii about them [m]
    workspace : array, shape (2, 3), its corners [m]
    """
    (nodes, deviation), n_intervals = curve, curve.deviation.shape[0]
    for i in range(which.shape[0]):
        n = which[i]
        for k in range(n_intervals + 1):
            strays = max(deviation[max(k - 1, 0), n], deviation[min(k, n_intervals - 1), n])
            for axis in range(3):
                x = nodes[k, n, axis]
                border = min(x - workspace[0, axis], workspace[1, axis] - x) - radii[i]
                found = _with_distance(found, border, k, -1, need)
                found = _with_bound(found, border - strays)
    return found


@kernel
def _with_distance(
    found: ClearanceFound, distance: float, knot: int, nearest: int, need: Need
) -> ClearanceFound:
    """Add a distance to a state. Among distances equal but for rounding, the first stays."""
    if distance < found.met - need.rounding:
        return ClearanceFound(found.bound, distance, knot, nearest)
    return ClearanceFound(found.bound, min(found.met, distance), found.knot, found.nearest)


@kernel
def _with_bound(found: ClearanceFound, bound: float) -> ClearanceFound:
    """Return a state with the bound of one more part."""
    return ClearanceFound(min(found.bound, bound), found.met, found.knot, found.nearest)


@kernel
def edges_at_knots(
    nodes: Array, edges: Integers, radii: Array, rows: ConvexObstacles, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return the state of edges at every fourth knot. This good upper bound spares the halving of cells."""
    obstacles, owner = rows
    for k in range(0, nodes.shape[0], 4):
        for e in range(edges.shape[0]):
            p, q = nodes[k, edges[e, 0]], nodes[k, edges[e, 1]]
            for j in range(obstacles.shape[0]):
                for i in range(3):
                    s = 0.5 * i
                    distance = point_distance(
                        obstacles,
                        j,
                        p[0] + s * (q[0] - p[0]),
                        p[1] + s * (q[1] - p[1]),
                        p[2] + s * (q[2] - p[2]),
                    )
                    found = _with_distance(found, distance - radii[e], k, owner[j], need)
    return found


@kernel
def _while_swept(
    obstacles: Array,
    j: int,
    sweep: PartSweep,
    length: float,
    need: Need,
    found: ClearanceFound,
    stack: Array,
    cells: int,
) -> tuple[ClearanceFound, int]:
    """Bound an edge's clearance from obstacle j, halving cells where needed.

    The edge has at most this length [m]. `stack` is scratch; the number of `cells` checked so far is returned as
    well.
    """
    begin, end, radius, swell, knot, obstacle = sweep
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0.0, 1.0, 0.0, 1.0
    top = 1
    while top > 0:
        top -= 1
        cells += 1
        t0, t1, s0, s1 = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        t, s = 0.5 * (t0 + t1), 0.5 * (s0 + s1)
        x, y, z = _on_surface(begin, end, t, s)
        distance = point_distance(obstacles, j, x, y, z) - radius
        found = _with_distance(found, distance, knot, obstacle, need)
        along = distance - 0.5 * (s1 - s0) * length
        moved = 0.5 * (t1 - t0) * max(_move(begin, end, s0), _move(begin, end, s1))
        enough = found.met - _slack(found.met, need)
        if along - moved < enough:
            x, y, z = _on_surface(begin, end, t, s0)
            first = point_distance(obstacles, j, x, y, z) - radius
            x, y, z = _on_surface(begin, end, t, s1)
            last = point_distance(obstacles, j, x, y, z) - radius
            found = _with_distance(found, min(first, last), knot, obstacle, need)
            along = max(along, min(distance, 2 * distance - first, 2 * distance - last))
        if along - moved >= enough or top + 2 >= STACK or cells > need.most_cells:
            found = _with_bound(found, along - moved - swell)
            continue
        stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = t0, t1, s0, s1
        stack[top + 1, 0], stack[top + 1, 1] = t0, t1
        stack[top + 1, 2], stack[top + 1, 3] = s0, s1
        if moved > distance - along:
            stack[top, 1], stack[top + 1, 0] = t, t
        else:
            stack[top, 3], stack[top + 1, 2] = s, s
        top += 2
    return found, cells


@kernel
def certified_solids(
    curve: CurveArrays, solids: Integers, rows: ConvexObstacles, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return the certified clearance of solids among obstacles in their frame.

    Parameters
    ----------
    solids : array of int, shape (n_solids, 8) for boxes or (n_solids, n) for hulls, keypoints at their corners
    """
    (nodes, deviation), (obstacles, owner) = curve, rows
    begin, end, none, cells = empty_solid(solids), empty_solid(solids), np.empty((3, 3)), 0
    work = _work(empty_solid(solids))
    for corners in solids:
        for j in range(obstacles.shape[0]):
            solid_at(nodes[0], corners, end)
            solid_distance(obstacles, j, end, np.inf, work.normal)
            first = _gap(obstacles, j, none, end, work.normal)
            for k in range(deviation.shape[0]):
                begin, end = end, begin
                solid_at(nodes[k + 1], corners, end)
                swell = _largest(deviation[k], corners) + need.rounding
                last = _gap(obstacles, j, none, end, work.normal)
                if min(first, last) >= found.met - _slack(found.met, need):
                    found, first = _with_bound(found, min(first, last) - swell), last
                    continue
                sweep = PartSweep(begin, end, 0.0, swell, k, owner[j])
                found, cells = _while_moving(obstacles, j, none, sweep, need, found, work, cells)
                first = _gap(obstacles, j, none, end, work.normal)
    return found


@kernel
def solids_at_knots(
    nodes: Array, solids: Integers, rows: ConvexObstacles, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return the state of solids at every fourth knot."""
    obstacles, owner = rows
    solid, normal = empty_solid(solids), np.array([1.0, 0.0, 0.0])
    for corners in solids:
        for k in range(0, nodes.shape[0], 4):
            solid_at(nodes[k], corners, solid)
            for j in range(obstacles.shape[0]):
                distance = solid_distance(obstacles, j, solid, found.met, normal)[1]
                found = _with_distance(found, distance, k, owner[j], need)
    return found


@kernel
def _work(part: Array) -> Scratch:
    return Scratch(part, np.array([1.0, 0.0, 0.0]), np.empty(3), np.empty((3, 4, 3)), np.empty((STACK, 2)))


@kernel
def _gap(obstacles: Array, j: int, triangle: Array, part: Array, normal: Array) -> float:
    """Return the gap [m] along `normal` to an obstacle or triangle. Negative j is the triangle."""
    if j < 0:
        return triangle_gap(triangle, part, normal)
    return gap(obstacles, j, part, normal[0], normal[1], normal[2])


@kernel
def _while_moving(
    obstacles: Array,
    j: int,
    triangle: Array,
    sweep: PartSweep,
    need: Need,
    found: ClearanceFound,
    work: Scratch,
    cells: int,
) -> tuple[ClearanceFound, int]:
    """Bound a part's clearance from an obstacle or triangle, halving intervals.

    For negative j it is the triangle. The number of `cells`, directions searched so far, is returned as well.
    """
    (begin, end, radius, swell, knot, obstacle), (part, normal, other, simplex, stack) = sweep, work
    stack[0, 0], stack[0, 1] = 0.0, 1.0
    top = 1
    while top > 0:
        top -= 1
        t0, t1 = stack[top, 0], stack[top, 1]
        clear = _gap_throughout(obstacles, j, triangle, sweep, t0, t1, part, normal)
        if clear < found.met - _slack(found.met, need):
            cells += 1
            t = 0.5 * (t0 + t1)
            _between(begin, end, t, part)
            copy_to(normal, other)
            if j < 0:
                at_middle, distance = nearest(triangle, part, other, simplex)
                if not distance > 0.0:
                    distance = at_middle  # about how deep they cut
            else:
                at_middle, distance = solid_distance(obstacles, j, part, np.inf, other)
            found = _with_distance(found, distance - radius, knot, obstacle, need)
            anew = _gap_throughout(obstacles, j, triangle, sweep, t0, t1, part, other)
            if anew > clear:
                clear = anew
                copy_to(other, normal)
            # Where they touch, or no direction does better at mid-time, halving gains nothing.
            gains = at_middle > 0.0 and clear < min(found.met, at_middle - radius) - _slack(found.met, need)
            if gains and top + 2 <= STACK and cells <= need.most_halves:
                stack[top, 0], stack[top, 1] = t0, t
                stack[top + 1, 0], stack[top + 1, 1] = t, t1
                top += 2
                continue
        found = _with_bound(found, clear - swell)
    return found, cells


@kernel
def _gap_throughout(
    obstacles: Array,
    j: int,
    triangle: Array,
    sweep: PartSweep,
    t0: float,
    t1: float,
    part: Array,
    normal: Array,
) -> float:
    """Return the least gap [m] along `normal` during a piece of motion. The part moves from fraction t0 to t1.

    `part` is scratch.
    """
    _between(sweep.begin, sweep.end, t0, part)
    first = _gap(obstacles, j, triangle, part, normal)
    _between(sweep.begin, sweep.end, t1, part)
    return min(first, _gap(obstacles, j, triangle, part, normal)) - sweep.radius


class MeshAround(NamedTuple):
    """A mesh among the obstacles.

    Attributes
    ----------
    surfaces, mesh : the scene's meshes, and the number of the mesh among them
    obstacle : number of the obstacle that it is
    """

    surfaces: Surfaces
    mesh: int
    obstacle: int


@kernel
def certified_surface(
    curve: CurveArrays, hulls: Integers, radii: Array, around: MeshAround, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return the certified clearance of hulls from a mesh in their frame.

    Parameters
    ----------
    hulls : array of int, shape (n_hulls, n), keypoints of every convex part of the body
    radii : array, shape (n_hulls,), radii by which the parts are thickened [m]
    """
    (nodes, _), (surfaces, mesh, obstacle), n_points = curve, around, hulls.shape[1]
    begin, end, none = np.empty((n_points, 3)), np.empty((n_points, 3)), np.empty((0, 0))
    box_of_both, boxes = np.empty((2, 3)), np.empty(DEPTH, dtype=np.int64)
    work, cells = _work(np.empty((n_points, 3))), 0
    for h in range(hulls.shape[0]):
        _hull_at(nodes[0], hulls[h], end)
        for k in range(nodes.shape[0] - 1):
            begin, end = end, begin
            _hull_at(nodes[k + 1], hulls[h], end)
            swell = surfaces.slack[mesh] + _largest(curve.deviation[k], hulls[h]) + need.rounding
            sweep = PartSweep(begin, end, radii[h], swell, k, obstacle)
            _span_box(begin, end, box_of_both)
            boxes[0], top = surfaces.root[mesh], 1
            while top > 0:
                top -= 1
                box = boxes[top]
                enough = found.met - _slack(found.met, need) + radii[h]
                clear = box_distance(surfaces, box, box_of_both[0], box_of_both[1])
                if clear < enough:
                    clear = max(clear, box_gap(surfaces, box, begin, end, work.normal))
                if clear >= enough:
                    found = _with_bound(found, clear - radii[h] - swell)
                elif surfaces.right[box] >= 0:
                    boxes[top], boxes[top + 1] = surfaces.right[box], box + 1
                    top += 2
                else:
                    for i in range(surfaces.first[box], surfaces.first[box] + surfaces.count[box]):
                        triangle = surfaces.triangles[i]
                        clear = triangle_gap(triangle, begin, work.normal)
                        clear = min(clear, triangle_gap(triangle, end, work.normal))
                        if clear >= found.met - _slack(found.met, need) + radii[h]:
                            found = _with_bound(found, clear - radii[h] - swell)
                            continue
                        found, cells = _while_moving(none, -1, triangle, sweep, need, found, work, cells)
    return _with_bound(found, found.met)


@kernel
def hulls_at_knots(
    nodes: Array, hulls: Integers, radii: Array, around: MeshAround, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return the state of hulls at every fourth knot."""
    hull, (surfaces, mesh, obstacle) = np.empty((hulls.shape[1], 3)), around
    for h in range(hulls.shape[0]):
        for k in range(0, nodes.shape[0], 4):
            _hull_at(nodes[k], hulls[h], hull)
            distance = surface_distance(surfaces, mesh, hull, found.met + radii[h]) - radii[h]
            found = _with_distance(found, distance, k, obstacle, need)
    return found


@kernel
def _largest(deviation: Array, hull: Integers) -> float:
    """Return the largest distance of a hull's nodes from their chords [m]."""
    worst = 0.0
    for node in hull:
        worst = max(worst, deviation[node])
    return worst


@kernel
def _span_box(begin: Array, end: Array, out: Array) -> None:
    """Write the corners of two hulls' common box; array, shape (2, 3) [m]."""
    for axis in range(3):
        out[0, axis] = min(begin[:, axis].min(), end[:, axis].min())
        out[1, axis] = max(begin[:, axis].max(), end[:, axis].max())


@kernel
def _hull_at(nodes: Array, hull: Integers, out: Array) -> None:
    for i in range(hull.shape[0]):
        copy_to(nodes[hull[i]], out[i])


@kernel
def _between(begin: Array, end: Array, t: float, solid: Array) -> None:
    for row in range(solid.shape[0]):
        for axis in range(3):
            solid[row, axis] = begin[row, axis] + t * (end[row, axis] - begin[row, axis])


@kernel
def _slack(met: float, need: Need) -> float:
    """Return the admissible gap [m] between bound and least clearance found.

    It is little where that is close to the required clearance.
    """
    spare = 0.5 * (met - need.clearance)
    return need.loose if spare < 0.0 else min(need.loose, max(need.tight, spare))


@kernel
def _on_surface(begin: Array, end: Array, t: float, s: float) -> tuple[float, float, float]:
    """Return the point (t, s) of an edge chord's swept surface."""
    f, g, h, i = (1 - t) * (1 - s), (1 - t) * s, t * (1 - s), t * s
    return (
        f * begin[0, 0] + g * begin[1, 0] + h * end[0, 0] + i * end[1, 0],
        f * begin[0, 1] + g * begin[1, 1] + h * end[0, 1] + i * end[1, 1],
        f * begin[0, 2] + g * begin[1, 2] + h * end[0, 2] + i * end[1, 2],
    )


@kernel
def _move(begin: Array, end: Array, s: float) -> float:
    """Return the displacement of an edge's point s along its chord."""
    x = (1 - s) * (end[0, 0] - begin[0, 0]) + s * (end[1, 0] - begin[1, 0])
    y = (1 - s) * (end[0, 1] - begin[0, 1]) + s * (end[1, 1] - begin[1, 1])
    z = (1 - s) * (end[0, 2] - begin[0, 2]) + s * (end[1, 2] - begin[1, 2])
    return sqrt(x * x + y * y + z * z)

"""Kernels of the certificate of clearance: bounds for edges, for solids and for meshes; see `certificate`."""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel
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

Array = NDArray[np.float64]
Numbers = NDArray[np.int64]

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
    """The nodes of a body at some instants, in any frame, and how far they stray from their chords in between.

    Attributes
    ----------
    nodes : array, shape (n_knots, n_nodes, 3), [m]
    deviation : array, shape (n_knots - 1, n_nodes), largest distance of the nodes from their chords [m]
    """

    nodes: Array
    deviation: Array


class Rows(NamedTuple):
    """Convex obstacles that stand in the frame from which a body is seen.

    Attributes
    ----------
    table : array, shape (n_rows, n_columns), rows of the table of obstacles
    owner : array of int, shape (n_rows,), the obstacles' numbers in the scene's file
    """

    table: Array
    owner: Numbers


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


class EdgeSweep(NamedTuple):
    """An edge from one knot to the next, as seen from an obstacle.

    Attributes
    ----------
    ends : array, shape (4, 3): first and second end at the first knot, then at the next [m]
    length, radius : largest length of the edge, and its radius [m]
    swell : how far it strays from the surface that its chord sweeps, at most [m]
    """

    ends: Array
    length: float
    radius: float
    swell: float


@kernel
def certified_edges(
    curve: CurveArrays, edges: Numbers, radii: Array, rows: Rows, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return what is certified, of edges among obstacles that stand in the curve's frame too.

    Of several obstacles that are equally near, the first is named.

    Parameters
    ----------
    edges, radii : arrays, shapes (n_edges, 2) and (n_edges,), the body
    found : what is certified so far
    """
    (nodes, deviation), (obstacles, _) = curve, rows
    ends, stack = np.empty((4, 3)), np.empty((STACK, 4))
    cells = np.int64(0)  # a literal 0 has a type of its own, for which all below would be compiled once more
    for k in range(deviation.shape[0]):
        for e in range(edges.shape[0]):
            m, n = edges[e, 0], edges[e, 1]
            swell = max(deviation[k, m], deviation[k, n]) + need.rounding
            ends[0], ends[1], ends[2], ends[3] = nodes[k, m], nodes[k, n], nodes[k + 1, m], nodes[k + 1, n]
            length = max(points_apart(ends[0], ends[1]), points_apart(ends[2], ends[3]))
            move = max(points_apart(ends[0], ends[2]), points_apart(ends[1], ends[3]))
            for j in range(obstacles.shape[0]):
                x, y, z = _on_surface(ends, 0.5, 0.5)
                distance = point_distance(obstacles, j, x, y, z) - radii[e]
                if distance - 0.5 * move - 0.5 * length - swell > found.met:
                    continue  # far away: most cells
                sweep = EdgeSweep(ends, length, radii[e], swell)
                found, cells = _while_swept(rows, need, j, k, sweep, found, stack, cells)
    return found


@kernel
def certified_border(
    curve: CurveArrays, which: Numbers, radii: Array, workspace: Array, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return what is certified, of the distance of nodes from the border of the workspace.

    Parameters
    ----------
    which, radii : arrays, shape (n,), numbers of the nodes and the radii of what is about them [m]
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
    """Return what is found with one more distance; of those that are equally near but for rounding, the first."""
    if distance < found.met - need.rounding:
        return ClearanceFound(found.bound, distance, knot, nearest)
    return ClearanceFound(found.bound, min(found.met, distance), found.knot, found.nearest)


@kernel
def _with_bound(found: ClearanceFound, bound: float) -> ClearanceFound:
    """Return what is found where one more part has this bound."""
    return ClearanceFound(min(found.bound, bound), found.met, found.knot, found.nearest)


@kernel
def edges_at_knots(
    nodes: Array, edges: Numbers, radii: Array, rows: Rows, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return what is found at every fourth knot: a good upper bound, so that few cells need halving."""
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
    rows: Rows,
    need: Need,
    j: int,
    k: int,
    sweep: EdgeSweep,
    found: ClearanceFound,
    stack: Array,
    cells: int,
) -> tuple[ClearanceFound, int]:
    """Bound the clearance from obstacle j while an edge sweeps from knot k to the next, halving cells where needed.

    `stack` is scratch, `cells` the number of cells looked at so far, which is returned as well.
    """
    (obstacles, owner), (ends, length, radius, swell) = rows, sweep
    stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = 0.0, 1.0, 0.0, 1.0
    top = 1
    while top > 0:
        top -= 1
        cells += 1
        t0, t1, s0, s1 = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
        t, s = 0.5 * (t0 + t1), 0.5 * (s0 + s1)
        x, y, z = _on_surface(ends, t, s)
        distance = point_distance(obstacles, j, x, y, z) - radius
        found = _with_distance(found, distance, k, owner[j], need)
        along = distance - 0.5 * (s1 - s0) * length
        moved = 0.5 * (t1 - t0) * max(_move(ends, s0), _move(ends, s1))
        enough = found.met - _slack(found.met, need)
        if along - moved < enough:
            x, y, z = _on_surface(ends, t, s0)
            first = point_distance(obstacles, j, x, y, z) - radius
            x, y, z = _on_surface(ends, t, s1)
            last = point_distance(obstacles, j, x, y, z) - radius
            found = _with_distance(found, min(first, last), k, owner[j], need)
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
    curve: CurveArrays, solids: Numbers, rows: Rows, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return what is certified, of solids among obstacles that stand in the curve's frame too.

    Parameters
    ----------
    solids : array of int, shape (n_solids, 8) for boxes or (n_solids, n) for hulls, nodes at their corners
    """
    (nodes, deviation), (obstacles, owner) = curve, rows
    bound, met, knot, nearest = found
    begin, end, solid = empty_solid(solids), empty_solid(solids), empty_solid(solids)
    normal, other = np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])
    stack, cells = np.empty((STACK, 2)), 0
    for corners in solids:
        for j in range(obstacles.shape[0]):
            solid_at(nodes[0], corners, end)
            solid_distance(obstacles, j, end, np.inf, normal)
            for k in range(deviation.shape[0]):
                begin, end = end, begin
                solid_at(nodes[k + 1], corners, end)
                swell = _largest(deviation[k], corners) + need.rounding
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
                                knot, nearest = k, owner[j]
                            met = distance
                            slack = _slack(met, need)
                        anew = _gap_throughout(obstacles, j, begin, end, t0, t1, solid, other)
                        if anew > clear:
                            clear = anew
                            normal[0], normal[1], normal[2] = other[0], other[1], other[2]
                        # Where they touch, or no direction does better at mid-time, halving gains nothing.
                        gains = at_middle > 0.0 and clear < min(met, at_middle) - slack
                        if gains and top + 2 <= STACK and cells <= need.most_halves:
                            stack[top, 0], stack[top, 1] = t0, t
                            stack[top + 1, 0], stack[top + 1, 1] = t, t1
                            top += 2
                            continue
                    bound = min(bound, clear - swell)
    return ClearanceFound(bound, met, knot, nearest)


@kernel
def solids_at_knots(
    nodes: Array, solids: Numbers, rows: Rows, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return what is found of solids at every fourth knot."""
    obstacles, owner = rows
    solid, normal = empty_solid(solids), np.array([1.0, 0.0, 0.0])
    for corners in solids:
        for k in range(0, nodes.shape[0], 4):
            solid_at(nodes[k], corners, solid)
            for j in range(obstacles.shape[0]):
                distance = solid_distance(obstacles, j, solid, found.met, normal)[1]
                found = _with_distance(found, distance, k, owner[j], need)
    return found


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
    curve: CurveArrays, hulls: Numbers, radii: Array, around: MeshAround, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return what is certified, of hulls and a mesh that stands in the curve's frame.

    Parameters
    ----------
    hulls : array of int, shape (n_hulls, n), nodes of every convex part of the body
    radii : array, shape (n_hulls,), radii by which the parts are thickened [m]
    """
    (nodes, _), (surfaces, mesh, obstacle), n_points = curve, around, hulls.shape[1]
    bound, met, knot, who = found
    begin, end, middle = np.empty((n_points, 3)), np.empty((n_points, 3)), np.empty((n_points, 3))
    normal, other, scratch = np.array([1.0, 0.0, 0.0]), np.empty(3), np.empty((3, 4, 3))
    box_of_both, boxes, parts = np.empty((2, 3)), np.empty(DEPTH, dtype=np.int64), np.empty((STACK, 2))
    cells = 0
    for h in range(hulls.shape[0]):
        _hull_at(nodes[0], hulls[h], end)
        for k in range(nodes.shape[0] - 1):
            begin, end = end, begin
            _hull_at(nodes[k + 1], hulls[h], end)
            swell = radii[h] + surfaces.slack[mesh] + need.rounding
            swell += _largest(curve.deviation[k], hulls[h])
            _span_box(begin, end, box_of_both)
            boxes[0], top = surfaces.root[mesh], 1
            while top > 0:
                top -= 1
                box = boxes[top]
                enough = met - _slack(met, need) + radii[h]
                clear = box_distance(surfaces, box, box_of_both[0], box_of_both[1])
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
                            distance = (distance if distance > 0.0 else at_middle) - radii[
                                h
                            ]  # about how deep they cut
                            if distance < met - need.rounding:
                                knot, who = k, obstacle
                            met = min(met, distance)
                            slack = _slack(met, need)
                            anew = _hull_gap(triangle, begin, end, t0, t1, middle, other)
                            if anew > clear:
                                clear = anew
                                normal[:] = other
                            # Where they touch, or no direction does better at mid-time, halving gains nothing.
                            gains = (
                                at_middle > 0.0 and clear - radii[h] < min(met, at_middle - radii[h]) - slack
                            )
                            if gains and n_parts + 2 <= STACK and cells <= need.most_halves:
                                parts[n_parts, 0], parts[n_parts, 1] = t0, t
                                parts[n_parts + 1, 0], parts[n_parts + 1, 1] = t, t1
                                n_parts += 2
                                continue
                        bound = min(bound, clear - swell)
    return ClearanceFound(min(bound, met), met, knot, who)


@kernel
def hulls_at_knots(
    nodes: Array, hulls: Numbers, radii: Array, around: MeshAround, need: Need, found: ClearanceFound
) -> ClearanceFound:
    """Return what is found of hulls at every fourth knot."""
    hull, (surfaces, mesh, obstacle) = np.empty((hulls.shape[1], 3)), around
    for h in range(hulls.shape[0]):
        for k in range(0, nodes.shape[0], 4):
            _hull_at(nodes[k], hulls[h], hull)
            distance = surface_distance(surfaces, mesh, hull, found.met + radii[h]) - radii[h]
            found = _with_distance(found, distance, k, obstacle, need)
    return found


@kernel
def _largest(deviation: Array, hull: Numbers) -> float:
    """Return the largest distance of a hull's nodes from their chords [m]."""
    worst = 0.0
    for node in hull:
        worst = max(worst, deviation[node])
    return worst


@kernel
def _span_box(begin: Array, end: Array, out: Array) -> None:
    """Write the lower and upper corner of the axis-parallel box about two hulls; array, shape (2, 3) [m]."""
    for axis in range(3):
        out[0, axis] = min(begin[:, axis].min(), end[:, axis].min())
        out[1, axis] = max(begin[:, axis].max(), end[:, axis].max())


@kernel
def _hull_at(nodes: Array, hull: Numbers, out: Array) -> None:
    """Write in `out` the nodes of a hull."""
    for i in range(hull.shape[0]):
        out[i] = nodes[hull[i]]


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
def _on_surface(ends: Array, t: float, s: float) -> tuple[float, float, float]:
    """Return the point (t, s) of the surface that the edge's chord sweeps; `ends` as in `EdgeSweep`."""
    f, g, h, i = (1 - t) * (1 - s), (1 - t) * s, t * (1 - s), t * s
    return (
        f * ends[0, 0] + g * ends[1, 0] + h * ends[2, 0] + i * ends[3, 0],
        f * ends[0, 1] + g * ends[1, 1] + h * ends[2, 1] + i * ends[3, 1],
        f * ends[0, 2] + g * ends[1, 2] + h * ends[2, 2] + i * ends[3, 2],
    )


@kernel
def _move(ends: Array, s: float) -> float:
    """Return the distance that the point s of the edge moves along its chord."""
    x = (1 - s) * (ends[2, 0] - ends[0, 0]) + s * (ends[3, 0] - ends[1, 0])
    y = (1 - s) * (ends[2, 1] - ends[0, 1]) + s * (ends[3, 1] - ends[1, 1])
    z = (1 - s) * (ends[2, 2] - ends[0, 2]) + s * (ends[3, 2] - ends[1, 2])
    return sqrt(x * x + y * y + z * z)

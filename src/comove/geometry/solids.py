"""Distances of solids from obstacles.

A box is one array, shape (4, 3): its centre b and three half edges e_k in the world [m]. A hull, the convex hull of
points, is an array of these points [m], of which there are never `BOX_ROWS`. Along a unit vector n a solid and an
obstacle leave a gap

    gap(n) = least n x of the obstacle - largest n x of the solid.

For a box and an obstacle that is symmetric about c it is n (c - b) - sum_k |n e_k| - w(n), with w(n) half the
obstacle's extent along n. No gap is wider than the distance of the two, and the gap along the line between nearest
points is equal to it. Where a box's nearest point is inside a face, this line is the face's normal. Else that point
is on one of the twelve edges, and the line is the gradient of the obstacle's distance there. So the widest gap of
these directions is the distance. For hulls, and for polytopes as obstacles, which have no such symmetry, GJK finds
the nearest points (Gilbert, Johnson & Keerthi, 1988). Where the two overlap, all gaps are negative; the widest of
a few approximates how far the solid would have to be moved out of the obstacle.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from comove.compiled import kernel
from comove.geometry.distances import (
    BALL,
    BOX,
    CAPSULE,
    CYLINDER,
    MAX_STEPS,
    MIDDLE,
    N_PLANES,
    N_VERTICES,
    PLANES,
    POLYTOPE,
    SIZE,
    SPHERE,
    TINY,
    distance_and_gradient,
    has_last_before,
    nearest_of_simplex,
    nearest_on_segment,
    point_distance,
)

N_CORNERS = 8
"""A box's corners are numbered in binary: bit k says on which side of the centre along the half edge k."""
BOX_ROWS = 4
TOLERANCE = 1e-8  # m, of the least distance along an edge; the gap there is about as near to the distance
TOUCHING = 1e-9  # m, nearest points closer than this count as an overlap


@kernel
def empty_solid(solids):
    """Return an uninitialised array for one of `solids`.

    `solids` is an array of int, shape (n_solids, 8) for boxes or (n_solids, n) for hulls.
    """
    return np.empty((BOX_ROWS if solids.shape[1] == N_CORNERS else solids.shape[1], 3))


@kernel
def solid_at(nodes, corners, solid):
    """Write the box or hull with given `corners` in `solid`. Corners are rows of `nodes` (n_nodes, 3) [m]."""
    if solid.shape[0] != BOX_ROWS:
        for i in range(corners.shape[0]):
            for axis in range(3):
                solid[i, axis] = nodes[corners[i], axis]
        return
    p, q = nodes[corners[0]], nodes[corners[7]]
    for axis in range(3):
        solid[0, axis] = 0.5 * (p[axis] + q[axis])
        solid[1, axis] = 0.5 * (nodes[corners[1], axis] - p[axis])
        solid[2, axis] = 0.5 * (nodes[corners[2], axis] - p[axis])
        solid[3, axis] = 0.5 * (nodes[corners[4], axis] - p[axis])


@kernel
def support(table, j, x, y, z):
    """Return obstacle `j`'s farthest point [m] along a unit vector.

    The point is relative to the obstacle's centre.
    """
    kind = int(table[j, 0])
    a, b, c = table[j, 13], table[j, 14], table[j, 15]
    if kind == SPHERE:
        return a * x, a * y, a * z
    u = table[j, 4] * x + table[j, 7] * y + table[j, 10] * z
    v = table[j, 5] * x + table[j, 8] * y + table[j, 11] * z
    w = table[j, 6] * x + table[j, 9] * y + table[j, 12] * z
    if kind == POLYTOPE:
        best = _farthest_vertex(table, j, u, v, w)
        u, v, w = table[j, best] + a * u, table[j, best + 1] + a * v, table[j, best + 2] + a * w
    elif kind == BOX:
        u, v, w = a * np.sign(u), b * np.sign(v), c * np.sign(w)
    elif kind == CAPSULE:
        u, v, w = a * u, a * v, a * w + b * np.sign(w)
    elif kind == CYLINDER:
        radial = a / max(sqrt(u * u + v * v), TINY)
        u, v, w = radial * u, radial * v, b * np.sign(w)
    else:
        length = max(sqrt((a * u) ** 2 + (b * v) ** 2 + (c * w) ** 2), TINY)
        u, v, w = a * a * u / length, b * b * v / length, c * c * w / length
    return (
        table[j, 4] * u + table[j, 5] * v + table[j, 6] * w,
        table[j, 7] * u + table[j, 8] * v + table[j, 9] * w,
        table[j, 10] * u + table[j, 11] * v + table[j, 12] * w,
    )


@kernel
def _farthest_vertex(table, j, u, v, w):
    """Return the column of a polytope's farthest vertex along (u, v, w). The direction is in the obstacle's frame."""
    first = PLANES + 4 * int(table[j, N_PLANES])
    best, farthest = first, -np.inf
    for k in range(int(table[j, N_VERTICES])):
        at = first + 3 * k
        along = table[j, at] * u + table[j, at + 1] * v + table[j, at + 2] * w
        if along > farthest:
            best, farthest = at, along
    return best


@kernel
def solid_support(solid, x, y, z):
    """Return a solid's farthest point along (x, y, z) [m]."""
    if solid.shape[0] == BOX_ROWS:
        u, v, w = solid[0, 0], solid[0, 1], solid[0, 2]
        for k in range(1, 4):
            side = 1.0 if x * solid[k, 0] + y * solid[k, 1] + z * solid[k, 2] >= 0.0 else -1.0
            u, v, w = u + side * solid[k, 0], v + side * solid[k, 1], w + side * solid[k, 2]
        return u, v, w
    best, farthest = 0, -np.inf
    for i in range(solid.shape[0]):
        along = x * solid[i, 0] + y * solid[i, 1] + z * solid[i, 2]
        if along > farthest:
            best, farthest = i, along
    return solid[best, 0], solid[best, 1], solid[best, 2]


@kernel
def gap(table, j, solid, x, y, z):
    """Return the gap [m] between a solid and an obstacle. The unit vector (x, y, z) points away from the solid."""
    if solid.shape[0] != BOX_ROWS or table[j, 0] == POLYTOPE:
        p, q, r = support(table, j, -x, -y, -z)
        u, v, w = solid_support(solid, x, y, z)
        return x * (table[j, 1] + p - u) + y * (table[j, 2] + q - v) + z * (table[j, 3] + r - w)
    u, v, w = support(table, j, x, y, z)
    u, v, w = table[j, 1] - u - solid[0, 0], table[j, 2] - v - solid[0, 1], table[j, 3] - w - solid[0, 2]
    wide = x * u + y * v + z * w
    for k in range(1, 4):
        wide -= abs(x * solid[k, 0] + y * solid[k, 1] + z * solid[k, 2])
    return wide


@kernel
def solid_distance(table, j, solid, cutoff, normal):
    """Return bounds of the distance [m] between a solid and obstacle `j`.

    The first is a lower, the second an upper bound. The unit vector `normal` (3) is the direction tried first; the
    best one is written in it, and the lower bound is the gap along it. The upper bound is the signed distance of a
    point of the solid, negative within the obstacle. Where the two do not overlap, the bounds differ by about
    `TOLERANCE`. Where the distance is certainly above `cutoff`, any values above it may be returned.
    """
    if solid.shape[0] != BOX_ROWS or table[j, 0] == POLYTOPE:
        return hull_distance(table, j, solid, cutoff, normal, np.empty(3))
    u, v, w, reach = _ball(solid)
    far = point_distance(table, j, u, v, w) - reach
    if far > cutoff:
        return far, far
    wide, upper = gap(table, j, solid, normal[0], normal[1], normal[2]), np.inf
    if wide > cutoff:
        return wide, wide
    if table[j, 0] == BOX:  # across whose faces the gap often is widest, and tells soon
        for k in range(3):
            x, y, z = table[j, 4 + k], table[j, 7 + k], table[j, 10 + k]
            side = x * (table[j, 1] - u) + y * (table[j, 2] - v) + z * (table[j, 3] - w)
            side = 1.0 if side >= 0.0 else -1.0
            wide = _widened(table, j, solid, side * x, side * y, side * z, wide, normal)
        if wide > cutoff:
            return wide, wide
    for k in range(1, 4):
        x, y, z = solid[k, 0], solid[k, 1], solid[k, 2]
        half = sqrt(x * x + y * y + z * z)
        u, v, w = table[j, 1] - solid[0, 0], table[j, 2] - solid[0, 1], table[j, 3] - solid[0, 2]
        if x * u + y * v + z * w < 0.0:
            half = -half
        wide = _widened(table, j, solid, x / half, y / half, z / half, wide, normal)
    if wide > cutoff:
        return wide, wide
    for k in range(1, 4):
        u, v, w = point_before_face(table, j, solid, k)
        upper = min(upper, point_distance(table, j, u, v, w))
    # The nearest point on an edge; one that is farther than the points of the faces does not matter.
    nearest, edge, low, high, falls, rises = min(cutoff, upper) + 2 * TOLERANCE, -1, 0.0, 0.0, 0.0, 0.0
    for e in range(12):
        px, py, pz, dx, dy, dz = edge_of(solid, e)
        distance, a, b, f, g = nearest_on_segment(
            table, j, px, py, pz, px + dx, py + dy, pz + dz, nearest, TOLERANCE
        )
        if distance < nearest:
            nearest, edge, low, high, falls, rises = distance, e, a, b, f, g
    if edge < 0:
        return (wide, upper) if upper <= cutoff else (max(wide, cutoff), upper)
    # Gradients at both ends of the bracket, weighed so that the direction is across the edge.
    px, py, pz, dx, dy, dz = edge_of(solid, edge)
    share = 0.5 if high == low else rises / (rises - falls)
    _, ax, ay, az = distance_and_gradient(table, j, px + low * dx, py + low * dy, pz + low * dz)
    _, bx, by, bz = distance_and_gradient(table, j, px + high * dx, py + high * dy, pz + high * dz)
    x, y, z = bx + share * (ax - bx), by + share * (ay - by), bz + share * (az - bz)
    length = sqrt(x * x + y * y + z * z)
    if length > 1e-6:  # else in the midst of the obstacle, where no direction is better than another
        wide = _widened(table, j, solid, -x / length, -y / length, -z / length, wide, normal)
    return wide, min(nearest, upper)


@kernel
def hull_distance(table, j, solid, cutoff, normal, near):
    """Return the bounds of `solid_distance` by GJK. The solid's nearest point is written in `near` (3).

    Where the distance is certainly above `cutoff`, `near` may be the solid's middle.
    """
    u, v, w, reach = _ball(solid)
    near[0], near[1], near[2] = u, v, w
    far = _beyond_ball(table, j, u, v, w) - reach
    if far > cutoff:
        return far, far
    wide = gap(table, j, solid, normal[0], normal[1], normal[2])
    if wide > cutoff:
        return wide, wide
    radius = 0.0  # rounding, which GJK is not given
    if table[j, 0] in (SPHERE, CAPSULE, POLYTOPE):
        radius = table[j, SIZE]
    corners, own, weights = np.empty((4, 3)), np.empty((4, 3)), np.empty(4)
    x, y, z, n, square = -normal[0], -normal[1], -normal[2], 0, np.inf
    for step in range(MAX_STEPS):
        # Along the way that leads from the solid to the obstacle: the nearest of the one, the farthest of the other.
        length = max(sqrt(x * x + y * y + z * z), TINY)
        x, y, z = x / length, y / length, z / length
        u, v, w = solid_support(solid, -x, -y, -z)
        p, q, r = _core_support(table, j, x, y, z)
        p, q, r = table[j, 1] + p, table[j, 2] + q, table[j, 3] + r
        clear = -(x * (p - u) + y * (q - v) + z * (r - w)) - radius
        if clear > wide:
            wide = clear
            normal[0], normal[1], normal[2] = -x, -y, -z
        if wide > cutoff:
            return wide, wide
        if step > 0 and sqrt(square) - radius - clear <= 0.5 * TOLERANCE:
            break
        own[n, 0], own[n, 1], own[n, 2] = u, v, w
        corners[n, 0], corners[n, 1], corners[n, 2] = p - u, q - v, r - w
        if has_last_before(corners, n):
            break
        n += 1
        nearer = nearest_of_simplex(corners, n, weights)
        if not nearer < square and n > 1:  # rounding: no progress any more
            break
        square = nearer
        x, y, z = 0.0, 0.0, 0.0
        near[0], near[1], near[2] = 0.0, 0.0, 0.0
        kept = 0
        for i in range(n):
            share = weights[i]
            if share == 0.0:
                continue
            x, y, z = x - share * corners[i, 0], y - share * corners[i, 1], z - share * corners[i, 2]
            for axis in range(3):
                near[axis] += share * own[i, axis]
                corners[kept, axis], own[kept, axis] = corners[i, axis], own[i, axis]
            kept += 1
        n = kept
        if square < TOUCHING * TOUCHING or n == 4:
            return _deepest(table, j, solid, wide, normal), point_distance(
                table, j, near[0], near[1], near[2]
            )
    return wide, sqrt(square) - radius


@kernel
def _core_support(table, j, x, y, z):
    """Return the farthest point of an obstacle without its rounding [m].

    The direction is (x, y, z). The point is relative to the obstacle's centre.
    """
    kind = table[j, 0]
    if kind == SPHERE:
        return 0.0, 0.0, 0.0
    u, v, w = support(table, j, x, y, z)
    if kind in (CAPSULE, POLYTOPE):
        radius = table[j, SIZE]
        return u - radius * x, v - radius * y, w - radius * z
    return u, v, w


@kernel
def _ball(solid):
    """Return centre and radius [m] of a ball that contains a solid."""
    x, y, z, reach = solid[0, 0], solid[0, 1], solid[0, 2], 0.0
    if solid.shape[0] == BOX_ROWS:
        for k in range(1, 4):
            for axis in range(3):
                reach += solid[k, axis] ** 2
        return x, y, z, sqrt(reach)
    n = solid.shape[0]
    for i in range(1, n):
        x, y, z = x + solid[i, 0], y + solid[i, 1], z + solid[i, 2]
    x, y, z = x / n, y / n, z / n
    for i in range(n):
        reach = max(reach, (solid[i, 0] - x) ** 2 + (solid[i, 1] - y) ** 2 + (solid[i, 2] - z) ** 2)
    return x, y, z, sqrt(reach)


@kernel
def _beyond_ball(table, j, x, y, z):
    """Return a lower bound of a point's distance from obstacle `j` [m].

    For a polytope it is the distance from a ball around it.
    """
    if table[j, 0] != POLYTOPE:
        return point_distance(table, j, x, y, z)
    a, b, c = table[j, MIDDLE], table[j, MIDDLE + 1], table[j, MIDDLE + 2]
    x -= table[j, 1] + table[j, 4] * a + table[j, 5] * b + table[j, 6] * c
    y -= table[j, 2] + table[j, 7] * a + table[j, 8] * b + table[j, 9] * c
    z -= table[j, 3] + table[j, 10] * a + table[j, 11] * b + table[j, 12] * c
    return sqrt(x * x + y * y + z * z) - table[j, BALL] - table[j, SIZE]


@kernel
def _deepest(table, j, solid, wide, normal):
    """Return the widest of the negative gaps of an overlapping solid.

    Its direction is written in `normal`. The directions tried are `normal`, the line between the centres, and the
    normals of a polytope or the obstacle's axes.
    """
    u, v, w, _ = _ball(solid)
    x, y, z = table[j, 1] - u, table[j, 2] - v, table[j, 3] - w
    length = sqrt(x * x + y * y + z * z)
    if length > TINY:
        wide = _widened(table, j, solid, x / length, y / length, z / length, wide, normal)
    polytope = table[j, 0] == POLYTOPE
    for k in range(int(table[j, N_PLANES]) if polytope else 6):
        if polytope:
            at = PLANES + 4 * k
            u, v, w = table[j, at], table[j, at + 1], table[j, at + 2]
        else:
            side = 1.0 if k < 3 else -1.0
            u, v, w = side * (k % 3 == 0), side * (k % 3 == 1), side * (k % 3 == 2)
        x = table[j, 4] * u + table[j, 5] * v + table[j, 6] * w
        y = table[j, 7] * u + table[j, 8] * v + table[j, 9] * w
        z = table[j, 10] * u + table[j, 11] * v + table[j, 12] * w
        wide = _widened(table, j, solid, -x, -y, -z, wide, normal)
    return wide


@kernel
def _widened(table, j, solid, x, y, z, wide, normal):
    """Return the wider of `wide` and the gap along (x, y, z).

    Where it is the latter, (x, y, z) is written in `normal`.
    """
    other = gap(table, j, solid, x, y, z)
    if other > wide:
        wide = other
        normal[0], normal[1], normal[2] = x, y, z
    return wide


@kernel
def edge_of(solid, e):
    """Return one end of a box's edge `e` and its vector. `e` is 0 to 11."""
    k = 1 + e // 4
    left, right = 1 if k > 1 else 2, 3 if k < 3 else 2
    f, g = 2.0 * (e % 2) - 1.0, 2.0 * (e // 2 % 2) - 1.0
    return (
        solid[0, 0] - solid[k, 0] + f * solid[left, 0] + g * solid[right, 0],
        solid[0, 1] - solid[k, 1] + f * solid[left, 1] + g * solid[right, 1],
        solid[0, 2] - solid[k, 2] + f * solid[left, 2] + g * solid[right, 2],
        2 * solid[k, 0],
        2 * solid[k, 1],
        2 * solid[k, 2],
    )


@kernel
def point_before_face(table, j, solid, k):
    """Return a box's point [m] that may be nearest to obstacle `j`.

    The point is on the face across half edge `k`, or inside the box where the obstacle reaches into it.

    An obstacle that overlaps the box and touches none of its edges reaches through the inside of a face, or lies
    inside the box. The line from the obstacle's centre to its point farthest beyond the face then meets the face
    inside its border. Where the two do not overlap and the face holds the nearest point, the end of this line is
    opposite that point.
    """
    x, y, z = table[j, 1] - solid[0, 0], table[j, 2] - solid[0, 1], table[j, 3] - solid[0, 2]
    ex, ey, ez = solid[k, 0], solid[k, 1], solid[k, 2]
    square = ex * ex + ey * ey + ez * ez
    along = (x * ex + y * ey + z * ez) / square
    side = 1.0 if along < 0.0 else -1.0
    length = side / sqrt(square)
    u, v, w = support(table, j, length * ex, length * ey, length * ez)
    reach = abs(u * ex + v * ey + w * ez) / square
    share = min(1.0, max(0.0, abs(along) - 1.0) / max(reach, TINY))
    x, y, z = x + share * u, y + share * v, z + share * w
    px, py, pz = solid[0, 0], solid[0, 1], solid[0, 2]
    for i in range(1, 4):
        ex, ey, ez = solid[i, 0], solid[i, 1], solid[i, 2]
        f = min(1.0, max(-1.0, (x * ex + y * ey + z * ez) / (ex * ex + ey * ey + ez * ez)))
        px, py, pz = px + f * ex, py + f * ey, pz + f * ez
    return px, py, pz


@kernel
def solids_clearance(nodes, solids, table, lower, upper):
    """Return a configuration's clearance [m] and the nearest obstacle.

    Parameters
    ----------
    nodes : array, shape (n_nodes, 3), [m]
    solids : array of int, shape (n_solids, N_CORNERS) for boxes or (n_solids, n) for hulls, nodes at their corners
    table : array, shape (n_obstacles, N_COLUMNS), the obstacles
    lower, upper : arrays, shape (3,), the workspace [m]

    Returns
    -------
    clearance : float, a lower bound that differs from the true clearance by about `TOLERANCE` where nothing overlaps
    nearest : int, row of the nearest obstacle; -1 for the border of the workspace
    """
    clearance, nearest = np.inf, -1
    solid, normal = empty_solid(solids), np.array([1.0, 0.0, 0.0])
    for s in range(solids.shape[0]):
        solid_at(nodes, solids[s], solid)
        border = border_distance(solid, lower, upper)
        if border < clearance:
            clearance, nearest = border, -1
        for j in range(table.shape[0]):
            distance = solid_distance(table, j, solid, clearance, normal)[0]
            if distance < clearance:
                clearance, nearest = distance, j
    return clearance, nearest


@kernel
def border_distance(solid, lower, upper):
    """Return a solid's distance [m] from the workspace border; negative beyond it."""
    distance = np.inf
    if solid.shape[0] != BOX_ROWS:
        for i in range(solid.shape[0]):
            for axis in range(3):
                distance = min(distance, solid[i, axis] - lower[axis], upper[axis] - solid[i, axis])
        return distance
    for axis in range(3):
        reach = abs(solid[1, axis]) + abs(solid[2, axis]) + abs(solid[3, axis])
        distance = min(distance, solid[0, axis] - reach - lower[axis], upper[axis] - solid[0, axis] - reach)
    return distance

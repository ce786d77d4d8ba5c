"""Distances of solid boxes from obstacles, in numba kernels.

A solid is one array, shape (4, 3): its centre b and three half edges e_k in the world [m]. Along a unit vector n it
and an obstacle about c, which is symmetric about c as all obstacles are, leave a gap

    gap(n) = n (c - b) - sum_k |n e_k| - w(n),

w(n) being half the obstacle's extent along n. No gap is wider than the distance of the two, and that along the line
between nearest points is as wide. Where the solid's nearest point is inside a face, this line is the face's normal.
Else that point is on one of the twelve edges, and the line is the gradient of the obstacle's distance there. So
the widest gap of these directions is the distance. Where the two cut each other all gaps are negative; the widest of
these directions tells about how far the solid would have to be moved out of the obstacle.
"""

from __future__ import annotations

from math import sqrt

import numba
import numpy as np

from comove.scenes.distances import (
    BOX,
    CAPSULE,
    CYLINDER,
    SPHERE,
    TINY,
    nearest_on_segment,
    point_distance,
    tangent,
)

N_CORNERS = 8
"""A solid's corners are numbered in binary: bit k says on which side of the centre along the half edge k."""
TOLERANCE = 1e-8  # m, of the least distance along an edge; the gap there is about as near to the distance


@numba.njit(cache=True, error_model="numpy")
def solid_at(nodes, corners, solid):
    """Write in `solid` the box whose `corners` (8) are these of `nodes`, array of shape (n_nodes, 3) [m]."""
    p, q = nodes[corners[0]], nodes[corners[7]]
    for axis in range(3):
        solid[0, axis] = 0.5 * (p[axis] + q[axis])
        solid[1, axis] = 0.5 * (nodes[corners[1], axis] - p[axis])
        solid[2, axis] = 0.5 * (nodes[corners[2], axis] - p[axis])
        solid[3, axis] = 0.5 * (nodes[corners[4], axis] - p[axis])


@numba.njit(cache=True, error_model="numpy")
def support(table, j, x, y, z):
    """The point of obstacle `j` that is farthest along the unit vector (x, y, z), from the obstacle's centre [m]."""
    kind = int(table[j, 0])
    a, b, c = table[j, 13], table[j, 14], table[j, 15]
    if kind == SPHERE:
        return a * x, a * y, a * z
    u = table[j, 4] * x + table[j, 7] * y + table[j, 10] * z
    v = table[j, 5] * x + table[j, 8] * y + table[j, 11] * z
    w = table[j, 6] * x + table[j, 9] * y + table[j, 12] * z
    if kind == BOX:
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


@numba.njit(cache=True, error_model="numpy")
def gap(table, j, solid, x, y, z):
    """Gap [m] between a solid and obstacle `j` along the unit vector (x, y, z), which points from the solid."""
    u, v, w = support(table, j, x, y, z)
    u, v, w = table[j, 1] - u - solid[0, 0], table[j, 2] - v - solid[0, 1], table[j, 3] - w - solid[0, 2]
    wide = x * u + y * v + z * w
    for k in range(1, 4):
        wide -= abs(x * solid[k, 0] + y * solid[k, 1] + z * solid[k, 2])
    return wide


@numba.njit(cache=True, error_model="numpy")
def solid_distance(table, j, solid, cutoff, normal):
    """Distance [m] between a solid and obstacle `j`: a lower bound and an upper one.

    The unit vector `normal` (3) is the direction tried first; the best one comes back in it, and the lower bound is
    the gap along it. The upper bound is the signed distance of a point of the solid, negative within the obstacle.
    Where the two are apart the bounds differ by about `TOLERANCE`. Where the distance is sure to be above `cutoff`,
    any values above it may come back.
    """
    wide, upper = gap(table, j, solid, normal[0], normal[1], normal[2]), np.inf
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
        upper = min(upper, _beyond_face(table, j, solid, k))
    # The nearest point on an edge; one that is farther than the points of the faces does not matter.
    nearest, edge, low, high, falls, rises = min(cutoff, upper) + 2 * TOLERANCE, -1, 0.0, 0.0, 0.0, 0.0
    for e in range(12):
        px, py, pz, dx, dy, dz = _edge(solid, e)
        distance, a, b, f, g = nearest_on_segment(
            table, j, px, py, pz, px + dx, py + dy, pz + dz, nearest, TOLERANCE
        )
        if distance < nearest:
            nearest, edge, low, high, falls, rises = distance, e, a, b, f, g
    if edge < 0:
        return (wide, upper) if upper <= cutoff else (max(wide, cutoff), upper)
    # Gradients at both ends of the bracket, weighed so that the direction is across the edge.
    px, py, pz, dx, dy, dz = _edge(solid, edge)
    share = 0.5 if high == low else rises / (rises - falls)
    ax, ay, az = gradient(table, j, px + low * dx, py + low * dy, pz + low * dz)
    bx, by, bz = gradient(table, j, px + high * dx, py + high * dy, pz + high * dz)
    x, y, z = bx + share * (ax - bx), by + share * (ay - by), bz + share * (az - bz)
    length = sqrt(x * x + y * y + z * z)
    if length > 1e-6:  # else in the midst of the obstacle, where no direction is better than another
        wide = _widened(table, j, solid, -x / length, -y / length, -z / length, wide, normal)
    return wide, min(nearest, upper)


@numba.njit(cache=True, error_model="numpy")
def _widened(table, j, solid, x, y, z, wide, normal):
    """The wider of the gaps `wide` and that along (x, y, z), which is then written in `normal`."""
    other = gap(table, j, solid, x, y, z)
    if other > wide:
        wide = other
        normal[0], normal[1], normal[2] = x, y, z
    return wide


@numba.njit(cache=True, error_model="numpy")
def gradient(table, j, x, y, z):
    """Gradient of the signed distance to obstacle `j` at (x, y, z); a subgradient at a kink."""
    return (
        tangent(table, j, x, y, z, 1.0, 0.0, 0.0)[1],
        tangent(table, j, x, y, z, 0.0, 1.0, 0.0)[1],
        tangent(table, j, x, y, z, 0.0, 0.0, 1.0)[1],
    )


@numba.njit(cache=True, error_model="numpy")
def _edge(solid, e):
    """One end of edge `e` (0 to 11) of a solid and the way to its other end."""
    k = 1 + e // 4
    left, right = 1 + k % 3, 1 + (k + 1) % 3
    f, g = 1.0 - 2.0 * (e % 2), 1.0 - 2.0 * (e // 2 % 2)
    return (
        solid[0, 0] - solid[k, 0] + f * solid[left, 0] + g * solid[right, 0],
        solid[0, 1] - solid[k, 1] + f * solid[left, 1] + g * solid[right, 1],
        solid[0, 2] - solid[k, 2] + f * solid[left, 2] + g * solid[right, 2],
        2 * solid[k, 0],
        2 * solid[k, 1],
        2 * solid[k, 2],
    )


@numba.njit(cache=True, error_model="numpy")
def _beyond_face(table, j, solid, k):
    """Signed distance [m] to obstacle `j` of a point of the solid, on the face along its half edge `k` or within.

    An obstacle that touches no edge of the solid and yet cuts it does so inside a face, or lies within. The way from
    its centre to its point farthest beyond the face then meets the face inside its border; apart, the end of
    this way is right before the face where the face holds the nearest point.
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
    return point_distance(table, j, px, py, pz)


@numba.njit(cache=True, error_model="numpy")
def solids_clearance(nodes, solids, table, lower, upper):
    """Clearance [m] of the solids of one configuration, and what is nearest.

    Parameters
    ----------
    nodes : array, shape (n_nodes, 3), [m]
    solids : array of int, shape (n_solids, N_CORNERS), their corners
    table : array, shape (n_obstacles, N_COLUMNS), the obstacles
    lower, upper : arrays, shape (3,), the workspace [m]

    Returns
    -------
    clearance : float, a lower bound, but for `TOLERANCE` the clearance
    nearest : int, the obstacle; -1 for the border of the workspace
    """
    clearance, nearest = np.inf, -1
    solid, normal = np.empty((4, 3)), np.array([1.0, 0.0, 0.0])
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


@numba.njit(cache=True, error_model="numpy")
def border_distance(solid, lower, upper):
    """Distance [m] of a solid from the border of the workspace, negative where it reaches beyond."""
    distance = np.inf
    for axis in range(3):
        reach = abs(solid[1, axis]) + abs(solid[2, axis]) + abs(solid[3, axis])
        distance = min(distance, solid[0, axis] - reach - lower[axis], upper[axis] - solid[0, axis] - reach)
    return distance

"""Closest points of a rod or a solid to an obstacle, in numba kernels.

A signed distance d to a convex obstacle is convex. So for a point p and the gradient n there, a displacement x of the
point relative to the obstacle leaves a distance of at least ``d(p) + n x``: the first-order estimate is a lower
bound.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from comove.compiled import kernel
from comove.geometry.distances import (
    CENTER,
    KIND,
    POLYTOPE,
    TINY,
    nearest_on_segment,
    point_distance,
    tangent,
)
from comove.geometry.solids import N_CORNERS, hull_distance, support

PLACE_TOLERANCE = 1e-10  # m, of the least distance along an edge
N_PARTS = 15  # of a box: edges and pairs of faces


@kernel
def near_on_edge(table, j, p, q, cutoff):
    """Return the distance [m] of the segment p-q from obstacle `j`, and its place on the segment, from 0 to 1.

    Where the distance is certainly above `cutoff`, any value above `cutoff` may be returned.
    """
    distance, low, high, falls, rises = nearest_on_segment(
        table, j, p[0], p[1], p[2], q[0], q[1], q[2], cutoff, PLACE_TOLERANCE
    )
    if high <= low:
        return distance, low
    # The least distance is known better than its place: of both ends of the bracket and of where the slopes, taken
    # to change evenly, vanish, the nearest point.
    distance, best = np.inf, low
    for k in range(3):
        share = low if k == 0 else high
        if k == 2:
            share = low + (high - low) * min(max(-falls / max(rises - falls, TINY), 0.0), 1.0)
        x, y, z = (
            p[0] + share * (q[0] - p[0]),
            p[1] + share * (q[1] - p[1]),
            p[2] + share * (q[2] - p[2]),
        )
        here = point_distance(table, j, x, y, z)
        if here < distance:
            distance, best = here, share
    return distance, best


@kernel
def near_on_solid(table, j, nodes, corners, cutoff, near):
    """Return the distance [m] of a solid from obstacle `j`, and write the solid's nearest point in `near`.

    `corners` are the indices in `nodes` of the solid's corners. The nearest point is on an edge, or on the face
    opposite the point of the obstacle that is farthest beyond that face (see `comove.geometry.solids`). Where nothing
    is nearer than `cutoff`, `cutoff` is returned and `near` is left unchanged.
    """
    least, point = cutoff, np.empty(3)
    for part in range(N_PARTS):
        distance = near_on_part(table, j, nodes, corners, part, least, point)
        if distance < least:
            least = distance
            near[:] = point
    return least


@kernel
def near_on_part(table, j, nodes, corners, part, cutoff, near):
    """Return the distance [m] of one part of a solid from obstacle `j`, and write its nearest point in `near`.

    The parts of a box are its 12 edges and 3 pairs of faces. A hull is a single part, and so is a solid beside a
    polytope; their other parts give an infinite distance.
    """
    if corners.shape[0] != N_CORNERS or table[j, KIND] == POLYTOPE:
        return near_on_hull(table, j, nodes, corners, cutoff, near) if part == 0 else np.inf
    if part >= N_PARTS - 3:
        return _before_face(table, j, nodes, corners, part - N_PARTS + 3, near)
    k = part // 4
    low, high = (part % 4) & ((1 << k) - 1), (part % 4) >> k
    c = low | high << (k + 1)  # the corners without bit k
    p, q = nodes[corners[c]], nodes[corners[c | 1 << k]]
    distance, share = near_on_edge(table, j, p, q, cutoff)
    for axis in range(3):
        near[axis] = p[axis] + share * (q[axis] - p[axis])
    return distance


@kernel
def near_on_hull(table, j, nodes, corners, cutoff, near):
    """Return the distance [m] of a hull of nodes from obstacle `j`, and write the hull's nearest point in `near`."""
    hull, normal = np.empty((corners.shape[0], 3)), np.array([1.0, 0.0, 0.0])
    for i in range(corners.shape[0]):
        for axis in range(3):
            hull[i, axis] = nodes[corners[i], axis]
    distance = hull_distance(table, j, hull, cutoff, normal, near)[0]
    return distance if distance > 0.0 else point_distance(table, j, near[0], near[1], near[2])


@kernel
def _before_face(table, j, nodes, corners, k, near):
    """Return the distance [m] of one point of a box from obstacle `j`, and write this point in `near`.

    The point is on a face across half edge `k`, or inside the box where the obstacle reaches into it.
    """
    low, high = nodes[corners[0]], nodes[corners[7]]
    far = nodes[corners[1 << k]]
    along, square = 0.0, 0.0
    for axis in range(3):
        half = 0.5 * (far[axis] - low[axis])
        along += (table[j, CENTER + axis] - 0.5 * (low[axis] + high[axis])) * half
        square += half * half
    along /= square
    side = -1.0 if along >= 0.0 else 1.0  # from the obstacle's centre to the solid
    scale = 0.5 * side / sqrt(square)
    u, v, w = support(
        table, j, scale * (far[0] - low[0]), scale * (far[1] - low[1]), scale * (far[2] - low[2])
    )
    beyond = 0.5 * (u * (far[0] - low[0]) + v * (far[1] - low[1]) + w * (far[2] - low[2])) / square
    share = min(1.0, max(0.0, abs(along) - 1.0) / max(abs(beyond), TINY))
    x, y, z = table[j, 1] + share * u, table[j, 2] + share * v, table[j, 3] + share * w
    px, py, pz = 0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])
    mx, my, mz = px, py, pz
    for i in range(3):
        other = nodes[corners[1 << i]]
        ex, ey, ez = 0.5 * (other[0] - low[0]), 0.5 * (other[1] - low[1]), 0.5 * (other[2] - low[2])
        f = ((x - mx) * ex + (y - my) * ey + (z - mz) * ez) / (ex * ex + ey * ey + ez * ez)
        f = min(1.0, max(-1.0, f))
        px, py, pz = px + f * ex, py + f * ey, pz + f * ez
    near[0], near[1], near[2] = px, py, pz
    return point_distance(table, j, px, py, pz)


@kernel
def distance_and_gradient(table, j, x, y, z):
    """Return the signed distance [m] of a point from obstacle `j` and the three components of its gradient."""
    distance, gx = tangent(table, j, x, y, z, 1.0, 0.0, 0.0)
    return (
        distance,
        gx,
        tangent(table, j, x, y, z, 0.0, 1.0, 0.0)[1],
        tangent(table, j, x, y, z, 0.0, 0.0, 1.0)[1],
    )


@kernel
def solid_gradient(table, j, x, y, z):
    """Return the signed distance [m] of a solid's nearest point from obstacle `j` and the components of its gradient.

    Outside a polytope both come from the polytope's nearest point, not from its planes.
    """
    if table[j, KIND] == POLYTOPE:
        point, near, normal = np.empty((1, 3)), np.empty(3), np.array([1.0, 0.0, 0.0])
        point[0, 0], point[0, 1], point[0, 2] = x, y, z
        distance = hull_distance(table, j, point, np.inf, normal, near)[0]
        if distance > 0.0:
            return distance, -normal[0], -normal[1], -normal[2]
    return distance_and_gradient(table, j, x, y, z)

"""Closest points of rods and solids to obstacles.

A signed distance d to a convex obstacle is convex. So for a point p and the gradient n there, a displacement x of the
point relative to the obstacle leaves a distance of at least ``d(p) + n x``: the first-order estimate is a lower
bound.
"""

from __future__ import annotations

import numpy as np

from comove.compiled import copy_to, kernel
from comove.geometry.distances import (
    KIND,
    POLYTOPE,
    TINY,
    distance_and_gradient,
    nearest_on_segment,
    point_distance,
)
from comove.geometry.solids import BOX_ROWS, edge_of, hull_distance, point_before_face

PLACE_TOLERANCE = 1e-10  # m, of the least distance along an edge
N_PARTS = 15  # of a box: edges and pairs of faces


@kernel
def near_on_edge(table, j, p, q, cutoff, tolerance=PLACE_TOLERANCE):
    """Return a segment's distance [m] from obstacle `j`, and the place.

    The place is from 0 at p to 1 at q. Where the distance is above `cutoff`, any value above it may be returned.
    """
    distance, low, high, falls, rises = nearest_on_segment(
        table, j, p[0], p[1], p[2], q[0], q[1], q[2], cutoff, tolerance
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
def near_on_solid(table, j, solid, cutoff, near):
    """Compute a solid's distance [m] from obstacle `j` and its nearest point.

    The nearest point, written in `near`, is on an edge, or on the face opposite the point of the obstacle that is
    farthest beyond that face (see `comove.geometry.solids`). Where nothing is nearer than `cutoff`, `cutoff` is
    returned and `near` is left unchanged.
    """
    least, point = cutoff, np.empty(3)
    for part in range(N_PARTS):
        distance = near_on_part(table, j, solid, part, least, point)
        if distance < least:
            least = distance
            copy_to(point, near)
    return least


@kernel
def near_on_part(table, j, solid, part, cutoff, near):
    """Compute the distance [m] and nearest point of one solid's part.

    The nearest point is written in `near`. The parts of a box are its 12 edges and 3 pairs of faces. A hull is a
    single part, and so is a solid beside a polytope; their other parts give an infinite distance.
    """
    if solid.shape[0] != BOX_ROWS or table[j, KIND] == POLYTOPE:
        return near_on_hull(table, j, solid, cutoff, near) if part == 0 else np.inf
    if part >= N_PARTS - 3:
        near[0], near[1], near[2] = point_before_face(table, j, solid, 1 + part - (N_PARTS - 3))
        return point_distance(table, j, near[0], near[1], near[2])
    x, y, z, dx, dy, dz = edge_of(solid, part)
    distance, share = near_on_edge(table, j, (x, y, z), (x + dx, y + dy, z + dz), cutoff)
    near[0], near[1], near[2] = x + share * dx, y + share * dy, z + share * dz
    return distance


@kernel
def near_on_hull(table, j, solid, cutoff, near):
    """Compute a solid's distance [m] from obstacle `j` by GJK. The nearest point is written in `near`."""
    distance = hull_distance(table, j, solid, cutoff, np.array([1.0, 0.0, 0.0]), near)[0]
    return distance if distance > 0.0 else point_distance(table, j, near[0], near[1], near[2])


@kernel
def solid_gradient(table, j, x, y, z):
    """Return a solid's signed distance [m] from obstacle `j` and its gradient.

    Both are at the solid's nearest point (x, y, z). Outside a polytope both come from the polytope's nearest point,
    not from its planes.
    """
    if table[j, KIND] == POLYTOPE:
        point, near, normal = np.empty((1, 3)), np.empty(3), np.array([1.0, 0.0, 0.0])
        point[0, 0], point[0, 1], point[0, 2] = x, y, z
        distance = hull_distance(table, j, point, np.inf, normal, near)[0]
        if distance > 0.0:
            return distance, -normal[0], -normal[1], -normal[2]
    return distance_and_gradient(table, j, x, y, z)

"""The contact query: distances of parts from things, nearest points and normals.

Bounding balls exclude distant things before exact distances are computed. These are those of `comove.geometry`, of
parts transformed into the obstacle's resting frame.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.contacts.displaced import carried_back
from comove.contacts.surroundings import corner_of, count_corners, count_parts, radius_of, whose
from comove.geometry.closest_points import near_on_edge, near_on_hull, near_on_solid, solid_gradient
from comove.geometry.distances import (
    CENTER,
    REACH,
    distance_and_gradient,
    point_distance,
    segment_distance,
)
from comove.geometry.solids import empty_solid, solid_at, solid_distance
from comove.geometry.surfaces import near_on_surface, signed_distance

TOUCHING = 1e-9  # m, above which a distance does not count as a contact


class Query(NamedTuple):
    """The things of a distance query, its accuracy and its output arrays.

    Attributes
    ----------
    things : array of int, shape (n,), numbers of the things that count
    normals : array, shape (n_solids, n_things, 3), unit vectors that separated a solid from a thing last, tried first
    least : array, shape (n_owners,), least distance found of each obstacle [m], which is lowered; of obstacles other
        than the nearest it is exact where they are touched. Shape (0,) if not needed
    tolerance : of distances of rods [m]
    lowered : amount by which distances of rods are lowered [m]; with the tolerance they are lower bounds
    """

    things: NDArray[np.int64]
    normals: Array
    least: Array
    tolerance: float
    lowered: float


def separating(n_solids: int, n_things: int) -> Array:
    """Return initial separating directions; array, shape (n_solids, n_things, 3)."""
    return np.full((n_solids, n_things, 3), 1.0 / np.sqrt(3.0))


@kernel(counted=False)
def least_distance(around, moved, instant, nodes, query, cap, floor):
    """Return the least distance [m] of parts from things, at most `cap`.

    Parameters
    ----------
    around : Surroundings
    moved, instant : Displacements of the obstacles, and the instant
    nodes : array, shape (n_nodes, 3), positions of the keypoints [m]
    query : Query
    floor : distance [m] at or below which the search ends; the result need not be the least then
    """
    d, n_rods, n_rows = cap, around.edges.shape[0], around.convex.shape[0]
    noted = query.least.shape[0] > 0
    for part in range(count_parts(around)):
        radius = radius_of(around, part)
        x, y, z, reach = ball_of(around, nodes, part)
        reach += radius + query.lowered
        for k in range(query.things.shape[0]):
            thing = query.things[k]
            row, owner = whose(around, thing)
            cutoff = max(d, TOUCHING) if noted else d
            u, v, w = carried_back(moved, row, instant, x, y, z)
            if ball_apart(around, thing, row, u, v, w) - reach > cutoff:
                continue
            if part < n_rods and thing < n_rows:
                i, j = around.edges[part, 0], around.edges[part, 1]
                a, b, c = carried_back(moved, row, instant, nodes[i, 0], nodes[i, 1], nodes[i, 2])
                u, v, w = carried_back(moved, row, instant, nodes[j, 0], nodes[j, 1], nodes[j, 2])
                distance = segment_distance(
                    around.obstacles, row, a, b, c, u, v, w, cutoff + radius, query.tolerance
                )
                distance -= radius + query.lowered
            else:
                distance = _large_distance(around, moved, instant, nodes, query, part, thing, cutoff)
            if noted:
                query.least[owner] = min(query.least[owner], distance)
            d = min(d, distance)
            if d <= floor:
                return d
    return d


@kernel
def _large_distance(around, moved, instant, nodes, query, part, thing, cutoff):
    """Return a part's distance [m] from a thing. One of them is a solid or a mesh."""
    row, radius, points = (
        whose(around, thing)[0],
        radius_of(around, part),
        np.empty((count_corners(around, part), 3)),
    )
    n_rods, n_rows = around.edges.shape[0], around.convex.shape[0]
    for i in range(points.shape[0]):
        k = corner_of(around, part, i)
        points[i, 0], points[i, 1], points[i, 2] = carried_back(
            moved, row, instant, nodes[k, 0], nodes[k, 1], nodes[k, 2]
        )
    if thing >= n_rows:
        return _mesh_distance(around.surfaces, thing - n_rows, points, cutoff + radius) - radius
    normal = query.normals[part - n_rods, thing]
    return _solid_distance(around.solids, around.obstacles, row, points, cutoff, normal)


@kernel(counted=False)
def ball_of(around, nodes, part):
    """Return centre and radius [m] of a part's bounding ball. Its centre is the mean of the corners."""
    n = count_corners(around, part)
    x, y, z, square, share = 0.0, 0.0, 0.0, 0.0, 1.0 / n
    for i in range(n):
        k = corner_of(around, part, i)
        x, y, z = x + share * nodes[k, 0], y + share * nodes[k, 1], z + share * nodes[k, 2]
    for i in range(n):
        k = corner_of(around, part, i)
        square = max(square, (nodes[k, 0] - x) ** 2 + (nodes[k, 1] - y) ** 2 + (nodes[k, 2] - z) ** 2)
    return x, y, z, sqrt(square)


@kernel(counted=False)
def ball_apart(around, thing, row, x, y, z):
    """Return a point's distance [m] from a resting thing's bounding ball. Meshes have a bounding box instead."""
    if thing >= around.convex.shape[0]:
        return _from_box_of_mesh(around.surfaces, thing - around.convex.shape[0], x, y, z)
    x -= around.obstacles[row, CENTER]
    y -= around.obstacles[row, CENTER + 1]
    z -= around.obstacles[row, CENTER + 2]
    return sqrt(x * x + y * y + z * z) - around.obstacles[row, REACH]


@kernel(counted=False)
def point_apart(around, thing, row, x, y, z, enough):
    """Bound a point's distance [m] from a resting thing from below. Bounds above `enough` are not refined."""
    bound = ball_apart(around, thing, row, x, y, z)
    if bound >= enough or thing >= around.convex.shape[0]:
        return bound
    return point_distance(around.obstacles, row, x, y, z)


@kernel(counted=False)
def part_apart(around, moved, instant, nodes, part, thing, row, enough):
    """Bound a part's distance [m] from a thing from below. Bounds above `enough` are not refined."""
    x, y, z, reach = ball_of(around, nodes, part)
    reach += radius_of(around, part)
    u, v, w = carried_back(moved, row, instant, x, y, z)
    return point_apart(around, thing, row, u, v, w, enough + reach) - reach


@kernel(counted=False)
def ball_about(nodes):
    """Return centre and radius [m] of a ball around keypoints; array, shape (n_nodes, 3)."""
    x, y, z, square, share = 0.0, 0.0, 0.0, 0.0, 1.0 / nodes.shape[0]
    for i in range(nodes.shape[0]):
        x, y, z = x + share * nodes[i, 0], y + share * nodes[i, 1], z + share * nodes[i, 2]
    for i in range(nodes.shape[0]):
        square = max(square, (nodes[i, 0] - x) ** 2 + (nodes[i, 1] - y) ** 2 + (nodes[i, 2] - z) ** 2)
    return x, y, z, sqrt(square)


@kernel(counted=False)
def near_things(around, moved, instant, nodes, cutoff, near):
    """Write the things possibly within `cutoff` [m] of keypoints; return their number."""
    (x, y, z, reach), count = ball_about(nodes), 0
    for thing in range(near.shape[0]):
        row, _ = whose(around, thing)
        u, v, w = carried_back(moved, row, instant, x, y, z)
        if point_apart(around, thing, row, u, v, w, reach + cutoff) < reach + cutoff:
            near[count] = thing
            count += 1
    return count


@kernel(counted=False)
def nearest_point(around, part, thing, row, points, cutoff, tolerance, near, normal):
    """Return a part's distance [m] from a resting thing; write its nearest point. The distance is at most `cutoff`.

    Parameters
    ----------
    points : array, shape (n_corners, 3), corners of the part as seen from the thing [m]
    near : array, shape (3,), point on the axis of a rod or on a solid, written [m]
    normal : array, shape (3,), unit vector from a mesh to the point, written; for other things `normal_at` gives it
    """
    n_rods, n_rows, radius = around.edges.shape[0], around.convex.shape[0], radius_of(around, part)
    if thing >= n_rows:
        distance = _near_mesh(around.surfaces, thing - n_rows, points, cutoff + radius, near, normal)
    elif part < n_rods:
        p, q = points[0], points[1]
        distance, share = near_on_edge(around.obstacles, row, p, q, cutoff + radius, tolerance)
        for axis in range(3):
            near[axis] = p[axis] + share * (q[axis] - p[axis])
    else:
        distance = _near_solid(around.solids, around.obstacles, row, points, cutoff, near)
    return min(distance - radius, cutoff)


@kernel(counted=False)
def normal_at(around, part, thing, row, near, normal):
    """Write the unit vector from a resting thing to the nearest point. Does nothing for a mesh."""
    if thing >= around.convex.shape[0]:
        return
    if part < around.edges.shape[0]:
        _, normal[0], normal[1], normal[2] = distance_and_gradient(
            around.obstacles, row, near[0], near[1], near[2]
        )
    else:
        _away_from_solid(around.solids, around.obstacles, row, near, normal)


@kernel
def _solid_distance(solids, table, row, points, cutoff, normal):
    solid = empty_solid(solids)
    solid_at(points, np.arange(points.shape[0]), solid)
    return solid_distance(table, row, solid, cutoff, normal)[0]


@kernel
def _mesh_distance(surfaces, mesh, points, cutoff):
    return signed_distance(surfaces, mesh, points, cutoff)


@kernel(counted=False)
def _from_box_of_mesh(surfaces, mesh, x, y, z):
    root = surfaces.root[mesh]
    low, high = surfaces.lower[root], surfaces.upper[root]
    x = max(low[0] - x, x - high[0], 0.0)
    y = max(low[1] - y, y - high[1], 0.0)
    z = max(low[2] - z, z - high[2], 0.0)
    return sqrt(x * x + y * y + z * z)


@kernel
def _near_mesh(surfaces, mesh, points, cutoff, near, normal):
    return near_on_surface(surfaces, mesh, points, cutoff, -np.inf, near, normal)


@kernel
def _near_solid(solids, table, row, points, cutoff, near):
    solid = empty_solid(solids)
    solid_at(points, np.arange(solids.shape[1]), solid)
    distance = near_on_hull(table, row, solid, cutoff, near)
    if distance <= 0.0:  # boxes that penetrate each other: their edges give the depth
        distance = near_on_solid(table, row, solid, cutoff, near)
    return distance


@kernel
def _away_from_solid(solids, table, row, near, normal):
    _, normal[0], normal[1], normal[2] = solid_gradient(table, row, near[0], near[1], near[2])

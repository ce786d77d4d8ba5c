"""Points of loads and hands, and where they are nearest to obstacles.

A signed distance d to a convex obstacle is convex. So for a point p and the gradient n there, a displacement x of the
point relative to the obstacle leaves at least ``d(p) + n x``: a bound to first order is a bound. Sampled points see
most of what matters and those that are nearest now see more; which will be nearest after a step, the step tells.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from comove.reaction.twists import exponential_at, group_nodes, turn_into
from comove.scenes.distances import (
    CENTER,
    KIND,
    POLYTOPE,
    ROTATION,
    TINY,
    nearest_on_segment,
    point_distance,
    tangent,
)
from comove.scenes.polytopes import hull_of
from comove.scenes.scene import Scene
from comove.scenes.solids import N_CORNERS, hull_distance, support

Array = NDArray[np.float64]

PLACE_TOLERANCE = 1e-10  # m, of the least distance along an edge
N_PARTS = 15  # of a box: edges and pairs of faces
FEW_CORNERS = 16  # of a hull that is looked at between its corners as well


class LoadPoints(NamedTuple):
    """What must not touch anything, in the frames of the rigid groups.

    Attributes
    ----------
    group, point, radius : arrays, shapes (n_points,), (n_points, 3), (n_points,): points along the edges of the load,
        its corners and the hands that are no end of an edge; lengths in metres
    node_group, node_point, node_radius : the same of the nodes, hands first
    edges, edge_radius : arrays, shapes (n_edges, 2), (n_edges,), between nodes; an edge with equal ends is a point
    solids : array of int, shape (n_solids, 8) for boxes or (n_solids, n) for hulls
    reach : array, shape (n_groups,), from a group's centre to the farthest of its points, radius included [m]
    """

    group: NDArray[np.int64]
    point: Array
    radius: Array
    node_group: NDArray[np.int64]
    node_point: Array
    node_radius: Array
    edges: NDArray[np.int64]
    edge_radius: Array
    solids: NDArray[np.int64]
    reach: Array


def load_points(scene: Scene, n_points: int) -> LoadPoints:
    """Points along every edge, `n_points` on the longest of a body and as close on the others, ends included.

    Solids have a grid on their faces, twice as wide. Between points the velocity of a face that an obstacle's corner
    is about to touch is read off from the neighbours.
    """
    node_group, node_point = group_nodes(scene)
    edges, radii = scene.body.edges, scene.body.radii
    node_radius = np.zeros(len(node_group))
    for edge, thick in zip(edges, radii, strict=True):
        node_radius[edge] = np.maximum(node_radius[edge], thick)
    ends = node_point[edges]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    group, point, radius = [], [], []
    for g in range(len(scene.groups)):
        own = np.flatnonzero(node_group[edges[:, 0]] == g)
        spacing = max(lengths[own].max(initial=0.0), TINY) / (n_points - 1)
        inner = [(*node_point[edges[e]], radii[e], lengths[e]) for e in own]
        found = [(node_point[i], node_radius[i]) for i in np.unique(edges[own])]
        for p, q, thick, length in inner:
            for share in np.linspace(0.0, 1.0, int(np.ceil(length / spacing - 1e-9)) + 1)[1:-1]:
                found.append((p + share * (q - p), thick))
        for corners in scene.body.solids:
            if node_group[corners[0]] == g:
                on = _on_faces if len(corners) == N_CORNERS else _on_hull
                found += [(p, 0.0) for p in on(node_point[corners], n_points)]
        group += [g] * len(found)
        point += [p for p, _ in found]
        radius += [r for _, r in found]
    reach = np.zeros(len(scene.groups))
    np.maximum.at(reach, node_group, np.linalg.norm(node_point, axis=1) + node_radius)
    return LoadPoints(
        np.array(group, dtype=np.int64),
        np.array(point).reshape(-1, 3),
        np.array(radius),
        node_group,
        node_point,
        node_radius,
        edges,
        radii,
        scene.body.solids,
        reach,
    )


def _on_faces(corners: Array, n_points: int) -> Array:
    """A grid (n, 3) on the faces of a box, corners included, given by its corners, array of shape (8, 3) [m]."""
    halves = 0.5 * (corners[[1, 2, 4]] - corners[0])
    lengths = np.linalg.norm(halves, axis=1)
    spacing = lengths.max() / max(1, (n_points - 1) // 4)
    axes = [np.linspace(-1.0, 1.0, int(np.ceil(2 * length / spacing - 1e-9)) + 1) for length in lengths]
    shares = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outer = shares[np.abs(shares).max(axis=1) == 1.0]
    return 0.5 * (corners[0] + corners[7]) + outer @ halves


def _on_hull(corners: Array, n_points: int) -> Array:
    """Corners (n, 3) of a hull and, where they are few, points between them on its faces [m]."""
    hull = hull_of(np.unique(corners, axis=0))
    if len(hull.vertices) > FEW_CORNERS:
        return hull.vertices
    spacing = hull.size / max(1, (n_points - 1) // 4)
    touching = np.abs(hull.vertices @ hull.planes[:, :3].T - hull.planes[:, 3]) < 1e-7 * hull.size
    points = [hull.vertices]
    for face in touching.T:
        own = hull.vertices[face]
        for i in range(1, len(own)):
            for j in range(i):
                count = int(np.ceil(np.linalg.norm(own[i] - own[j]) / spacing - 1e-9))
                points.append(own[i] + np.linspace(0.0, 1.0, count + 1)[1:-1, None] * (own[j] - own[i]))
    return np.unique(np.round(np.concatenate(points), 9), axis=0)


@numba.njit(cache=True, error_model="numpy")
def near_on_edge(table, j, p, q, cutoff):
    """Distance [m] of the segment p-q from obstacle `j` and the share of the segment where it is that.

    Where it is sure to be above `cutoff`, any above it may come back.
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


@numba.njit(cache=True, error_model="numpy")
def near_on_solid(table, j, nodes, corners, cutoff, near):
    """Distance [m] from obstacle `j` of a solid, whose `corners` are these of `nodes`; its nearest point in `near`.

    The nearest point is on an edge, or before the point of the obstacle that is farthest beyond a face (see
    `comove.scenes.solids`). Where nothing is nearer than `cutoff`, this comes back and `near` is as it was.
    """
    least, point = cutoff, np.empty(3)
    for part in range(N_PARTS):
        distance = near_on_part(table, j, nodes, corners, part, least, point)
        if distance < least:
            least = distance
            near[:] = point
    return least


@numba.njit(cache=True, error_model="numpy")
def near_on_part(table, j, nodes, corners, part, cutoff, near):
    """The same of one part of a box: 12 edges and 3 pairs of faces; a hull, or before a polytope, is one part."""
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


@numba.njit(cache=True, error_model="numpy")
def near_on_hull(table, j, nodes, corners, cutoff, near):
    """The same of the hull of these corners."""
    hull, normal = np.empty((corners.shape[0], 3)), np.array([1.0, 0.0, 0.0])
    for i in range(corners.shape[0]):
        for axis in range(3):
            hull[i, axis] = nodes[corners[i], axis]
    distance = hull_distance(table, j, hull, cutoff, normal, near)[0]
    return distance if distance > 0.0 else point_distance(table, j, near[0], near[1], near[2])


@numba.njit(cache=True, error_model="numpy")
def _before_face(table, j, nodes, corners, k, near):
    """Distance [m] of a point on the faces across edge `k`, or within, where the obstacle is; the point in `near`."""
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


@numba.njit(cache=True, error_model="numpy")
def distance_and_gradient(table, j, x, y, z):
    """Signed distance [m] of a point from obstacle `j` and its gradient."""
    distance, gx = tangent(table, j, x, y, z, 1.0, 0.0, 0.0)
    return (
        distance,
        gx,
        tangent(table, j, x, y, z, 0.0, 1.0, 0.0)[1],
        tangent(table, j, x, y, z, 0.0, 0.0, 1.0)[1],
    )


@numba.njit(cache=True, error_model="numpy")
def solid_gradient(table, j, x, y, z):
    """The same of a solid's nearest point: of a polytope not its planes but the way to its nearest point tells."""
    if table[j, KIND] == POLYTOPE:
        point, near, normal = np.empty((1, 3)), np.empty(3), np.array([1.0, 0.0, 0.0])
        point[0, 0], point[0, 1], point[0, 2] = x, y, z
        distance = hull_distance(table, j, point, np.inf, normal, near)[0]
        if distance > 0.0:
            return distance, -normal[0], -normal[1], -normal[2]
    return distance_and_gradient(table, j, x, y, z)


@numba.njit(cache=True, error_model="numpy")
def moved_obstacles(table, velocity, spin, dt, moved):
    """Write in `moved` the table after `dt` [s] of constant velocities (n, 3) [m/s] and spins (n, 3) [rad/s]."""
    turn = np.empty((3, 3))
    for j in range(table.shape[0]):
        for column in range(table.shape[1]):
            moved[j, column] = table[j, column]
        for axis in range(3):
            moved[j, CENTER + axis] += dt * velocity[j, axis]
        if spin[j, 0] == 0.0 and spin[j, 1] == 0.0 and spin[j, 2] == 0.0:
            continue
        w, x, y, z = exponential_at(dt * spin[j, 0], dt * spin[j, 1], dt * spin[j, 2])
        turn_into(w, x, y, z, turn)
        for row in range(3):
            for column in range(3):
                moved[j, ROTATION + 3 * row + column] = (
                    turn[row, 0] * table[j, ROTATION + column]
                    + turn[row, 1] * table[j, ROTATION + 3 + column]
                    + turn[row, 2] * table[j, ROTATION + 6 + column]
                )

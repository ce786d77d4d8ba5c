"""Points of payloads and end effectors that must not touch obstacles.

Sampled points detect most contacts, and those that are nearest now (`comove.geometry.closest_points`) detect more;
the points that are nearest after a step are found from the step itself.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.control.safety.twists import exponential_at, group_nodes, turn_into
from comove.geometry.distances import CENTER, ROTATION, TINY
from comove.geometry.polytopes import solid_hull_of
from comove.geometry.solids import N_CORNERS
from comove.model.scene import Scene


class LoadPoints(NamedTuple):
    """The geometry to keep clear of obstacles, in the rigid groups' frames.

    Attributes
    ----------
    group, point, radius : arrays, shapes (n_points,), (n_points, 3), (n_points,): points along the edges of the
        payload, its corners and the end effectors that are not the end of an edge, with the radius around each;
        lengths in metres
    node_group, node_point, node_radius : arrays, group, position and radius of each keypoint, end effectors first
    edges, edge_radius : arrays, shapes (n_edges, 2), (n_edges,), keypoints of the edges, whose ends are equal for a
        point, and radii
    solids : array of int, shape (n_solids, 8) for boxes or (n_solids, n) for hulls, keypoints of the solids
    reach : array, shape (n_groups,), distance of a group's centre from the farthest of its points, radius included
        [m]
    """

    group: Integers
    point: Array
    radius: Array
    node_group: Integers
    node_point: Array
    node_radius: Array
    edges: Integers
    edge_radius: Array
    solids: Integers
    reach: Array


def load_points(scene: Scene, n_points: int) -> LoadPoints:
    """Sample points along every edge, its ends included.

    There are `n_points` on the longest edge of a body and equally dense ones on the others.

    Solids have a grid on their faces, coarser than the points on edges. The velocity of a point between them, which
    an obstacle's corner is about to touch, is approximated by those of its neighbours.
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
    """Return a grid (n, 3) on a box's faces, corners included [m].

    The box is given by its corners, array of shape (8, 3) [m].
    """
    halves = 0.5 * (corners[[1, 2, 4]] - corners[0])
    lengths = np.linalg.norm(halves, axis=1)
    spacing = lengths.max() / max(1, (n_points - 1) // 4)
    axes = [np.linspace(-1.0, 1.0, int(np.ceil(2 * length / spacing - 1e-9)) + 1) for length in lengths]
    shares = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    outer = shares[np.abs(shares).max(axis=1) == 1.0]
    return 0.5 * (corners[0] + corners[7]) + outer @ halves


def _on_hull(corners: Array, n_points: int, few: int = 16) -> Array:
    """Return a hull's corners and, if few, points between them [m]; array, shape (n, 3)."""
    hull = solid_hull_of(np.unique(corners, axis=0))
    if len(hull.vertices) > few:
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


@kernel
def moved_obstacles(table: Array, velocity: Array, spin: Array, dt: float, moved: Array) -> None:
    """Write the table after `dt` [s] of constant velocities and spins; arrays, shape (n, 3) [m/s], [rad/s]."""
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

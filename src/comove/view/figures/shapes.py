"""Outlines and faces of convex bodies, and bars of payloads."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from comove.arrays import Array
from comove.geometry import distances as sd
from comove.geometry.polytopes import vertices_in
from comove.model.scene import Scene


def support_points(row: Array, directions: Array) -> Array:
    """Return the extreme points of a convex obstacle in given directions. Arrays, shape (n, 3) [m].

    Parameters
    ----------
    row : row of the obstacle in `Scene.obstacles`
    directions : unit vectors
    """
    rotation = row[sd.ROTATION : sd.ROTATION + 9].reshape(3, 3)
    size = np.minimum(row[sd.SIZE : sd.SIZE + 3], 1e3)  # a planar scene's boxes are endless along z
    local, kind = directions @ rotation, int(row[sd.KIND])
    if kind == sd.BOX:
        points = np.sign(local) * size
    elif kind == sd.POLYTOPE:
        corners = vertices_in(row)
        points = corners[np.argmax(local @ corners.T, axis=1)]
    elif kind in (sd.SPHERE, sd.CAPSULE):
        points = local * size[0]
        if kind == sd.CAPSULE:
            points[:, 2] += np.sign(local[:, 2]) * size[1]
    elif kind == sd.CYLINDER:
        radial = np.maximum(np.linalg.norm(local[:, :2], axis=1, keepdims=True), 1e-12)
        points = np.concatenate([local[:, :2] / radial * size[0], np.sign(local[:, 2:]) * size[1]], axis=1)
    else:
        points = local * size**2 / np.linalg.norm(local * size, axis=1, keepdims=True)
    return row[sd.CENTER : sd.CENTER + 3] + points @ rotation.T


def outline(row: Array, view: tuple[int, int]) -> Array:
    """Compute the border of an obstacle's projection onto two axes. Array, shape (n, 2) [m]."""
    angles = np.linspace(0.0, 2 * np.pi, 181)
    directions = np.zeros((len(angles), 3))
    directions[:, view[0]], directions[:, view[1]] = np.cos(angles), np.sin(angles)
    return support_points(row, directions)[:, list(view)]


def hull_outline(corners: Array) -> Array:
    """Return the corners of a convex hull in order, shape (n, 2)."""
    angles = np.linspace(0.0, 2 * np.pi, 721)
    farthest = np.argmax(corners @ np.stack([np.cos(angles), np.sin(angles)]), axis=0)
    return corners[list(dict.fromkeys(farthest.tolist()))]


@lru_cache(maxsize=4)
def all_around(around: int, along: int) -> Array:
    """Return unit vectors in all directions; array, shape (n, 3). `around` and `along` are their numbers about the
    vertical and along it."""
    u, v = np.meshgrid(
        0.01 + np.linspace(0.0, 2 * np.pi, around, endpoint=False), np.linspace(-1.0, 1.0, along)
    )
    ring, height = np.cos(0.5 * np.pi * v), np.sin(0.5 * np.pi * v)
    return np.stack([ring * np.cos(u), ring * np.sin(u), height], axis=-1).reshape(-1, 3)


def obstacle_faces(row: Array) -> Array:
    """Return outward surface triangles of a convex obstacle. Array, shape (n_faces, 3, 3) [m]."""
    return hull_faces(support_points(row, all_around(20, 10)))


def hull_faces(points: Array) -> Array:
    """Return outward triangles of the convex hull of points. Array, shape (n_faces, 3, 3), empty if the points lie
    in a plane."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        return np.zeros((0, 3, 3))
    faces = points[hull.simplices]
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    inward = (normal * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def load_pairs(scene: Scene) -> list[tuple[int, int]]:
    """Return the pairs of nodes that are drawn as bars. They are the payload's edges, or end effectors kept at a
    distance without a payload."""
    edges = [(int(a), int(b)) for a, b in scene.body.edges if a != b]
    return edges if edges or len(scene.body.solids) else [(c.first, c.second) for c in scene.distances]

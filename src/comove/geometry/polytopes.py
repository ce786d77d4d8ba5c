"""Convex polytopes: hulls of points, coarser hulls, and their table rows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.geometry import distances as sd
from comove.geometry.rotations import evenly_spread
from comove.geometry.surfaces import nearest

ROUNDING = 1e-9  # of a size, below which lengths do not count; also between normals of one facet
FAR = 1e6  # of a polytope's size, beyond which no vertex of a coarser one is


@dataclass(frozen=True)
class Polytope:
    """A convex polytope, which planes bound.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3) [m]
    planes : array, shape (n_planes, 4): outward unit normals n and offsets d, n x <= d [m]
    """

    vertices: Array
    planes: Array

    @property
    def size(self) -> float:
        """Return the longest side of the box around the polytope [m]."""
        return float(np.ptp(self.vertices, axis=0).max())


def hull_of(points: Array) -> Polytope | None:
    """Return the convex hull of points (n, 3) [m], or None. It is None where they all lie in one plane."""
    from scipy.spatial import ConvexHull, QhullError  # slow to import, and only polytopes need it

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # all in one plane, fewer than four, or as good as
        return None
    vertices = points[hull.vertices]
    return Polytope(vertices, _planes(vertices, hull.equations[:, :3]))


def solid_hull_of(points: Array) -> Polytope:
    """Return the convex hull of points (n, 3) [m].

    Raises
    ------
    ValueError
        If they all lie in one plane.
    """
    hull = hull_of(points)
    if hull is None:
        raise ValueError(f"{len(points)} points lie in one plane")
    return hull


def hull_triangles(points: Array, thickness: float = 1e-4) -> tuple[Array, Integers]:
    """Return the convex hull of points (n, 3) [m] as outward triangles.

    The results are vertices and faces. Points in one plane are thickened [m].
    """
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # as in `hull_of`
        points = thickened(points, thickness)
        hull = ConvexHull(points)
    a, b, c = points[hull.simplices].swapaxes(0, 1)
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
    triangles = np.where(inwards[:, None], hull.simplices[:, ::-1], hull.simplices)
    used = np.unique(triangles)
    return points[used], np.searchsorted(used, triangles)


def thickened(points: Array, thickness: float) -> Array:
    """Return six neighbours of every point along the axes; shape (6 n, 3) [m]. They are half the thickness away."""
    steps = 0.5 * thickness * np.concatenate([np.eye(3), -np.eye(3)])
    return (points[:, None] + steps).reshape(-1, 3)


def _planes(vertices: Array, normals: Array) -> Array:
    """Return the planes that touch the vertices, one for each different normal; array, shape (n, 4)."""
    kept = np.unique(np.round(normals / ROUNDING).astype(np.int64), axis=0, return_index=True)[1]
    normals = normals[np.sort(kept)]
    return np.column_stack([normals, (vertices @ normals.T).max(axis=0)])


def coarser(
    hull: Polytope, tolerance: float, *, many: tuple[int, int] = (48, 40), most_planes: int = 96
) -> tuple[Polytope, float]:
    """Return a hull with fewer planes, and its over-approximation error [m].

    It begins as a box. The vertex that is farthest from the hull is cut off by the plane that touches the hull at the
    point nearest to the vertex, until no vertex is farther than `tolerance` [m], or `most_planes` are reached.

    Parameters
    ----------
    many : numbers of vertices and planes; a hull that has no more of either is returned as it is
    """
    if len(hull.vertices) <= many[0] and len(hull.planes) <= many[1]:
        return hull, 0.0
    from scipy.spatial import HalfspaceIntersection

    middle = hull.vertices.mean(axis=0)
    axes = np.linalg.svd(hull.vertices - middle, full_matrices=False)[2]
    normals, out = np.concatenate([axes, -axes]), ROUNDING * hull.size
    while True:
        offsets = (hull.vertices @ normals.T).max(axis=0) + out
        planes = np.column_stack([normals, offsets])
        vertices = HalfspaceIntersection(np.column_stack([normals, -offsets]), middle).intersections
        vertices = vertices[
            np.abs(vertices - middle).max(axis=1) < FAR * hull.size
        ]  # planes that hardly meet
        feet = nearest_in_hull(hull.vertices, vertices)
        apart = np.linalg.norm(vertices - feet, axis=1)
        worst = int(apart.argmax())
        beyond = float(apart[worst])
        if beyond <= tolerance or len(normals) >= most_planes:
            break
        normals = np.concatenate([normals, [(vertices[worst] - feet[worst]) / beyond]])
    found = solid_hull_of(vertices)
    if len(found.vertices) >= len(hull.vertices):
        return hull, 0.0
    return Polytope(found.vertices, planes), beyond


@kernel
def nearest_in_hull(vertices, points):
    """Return the nearest points of a convex hull; array, shape (m, 3).

    The hull is that of `vertices` (n, 3), and `points` (m, 3) are the given points [m].
    """
    feet, normal, scratch = points.copy(), np.array([1.0, 0.0, 0.0]), np.empty((3, 4, 3))
    triangle = np.empty((3, 3))
    for k in range(points.shape[0]):
        for corner in range(3):
            triangle[corner] = points[k]
        if nearest(triangle, vertices, normal, scratch)[1] > 0.0:  # else it is inside
            feet[k] = scratch[2, 0]
    return feet


def bevelled(polytope: Polytope) -> Array:
    """Return a polytope's planes with planes at edges and corners; shape (n, 4).

    The further planes cut nothing off. Outside, the largest distance from a plane that touches the polytope at the
    nearest point is the distance times the cosine of the angle between their directions: with normals `BETWEEN` apart
    along every edge, and directions all around for the corners, it is at most an eighth less than the distance.
    """
    vertices, normals = polytope.vertices, polytope.planes[:, :3]
    touching = np.abs(vertices @ normals.T - polytope.planes[:, 3]) < 1e-7 * polytope.size
    shared = touching.T.astype(int) @ touching.astype(int)  # how many vertices two planes share
    added = [normals]
    for i, j in zip(*np.nonzero(np.triu(shared >= 2, k=1)), strict=True):
        angle = np.arccos(np.clip(normals[i] @ normals[j], -1.0, 1.0))
        share = np.linspace(0.0, 1.0, int(np.ceil(angle / BETWEEN - 1e-6)) + 1)[1:-1, None]
        if len(share) and angle < np.pi - 1e-4:  # else as flat as nothing is
            turn = np.sin((1 - share) * angle) * normals[i] + np.sin(share * angle) * normals[j]
            added.append(turn / np.sin(angle))
    found = np.concatenate(added)
    new = (ALL_AROUND @ found.T).max(axis=1) < SAME_DIRECTION
    return _planes(vertices, np.concatenate([found, ALL_AROUND[new]]))


BETWEEN = np.radians(50.0)
ALL_AROUND = evenly_spread(40)  # no direction is farther than 25 deg from one of them
SAME_DIRECTION = np.cos(np.radians(12.0))


def rows_of(polytopes: list[Polytope], center: Array, rotation: Array) -> Array:
    """Return the rows of polytopes for the table of obstacles (`comove.geometry.distances`).

    Parameters
    ----------
    polytopes : in the frame of one obstacle
    center, rotation : arrays, shapes (3,) and (3, 3), pose of this frame [m]
    """
    planes = [bevelled(p) for p in polytopes]
    widths = [
        sd.PLANES + own.size + polytope.vertices.size for own, polytope in zip(planes, polytopes, strict=True)
    ]
    table = np.zeros((len(polytopes), max(widths)))
    table[:, sd.KIND] = sd.POLYTOPE
    table[:, sd.CENTER : sd.CENTER + 3], table[:, sd.ROTATION : sd.ROTATION + 9] = center, rotation.ravel()
    for row, own, polytope in zip(table, planes, polytopes, strict=True):
        row[sd.REACH] = np.linalg.norm(polytope.vertices, axis=1).max()
        row[sd.N_PLANES], row[sd.N_VERTICES] = len(own), len(polytope.vertices)
        middle = 0.5 * (polytope.vertices.min(axis=0) + polytope.vertices.max(axis=0))
        row[sd.MIDDLE : sd.MIDDLE + 3] = middle
        row[sd.BALL] = np.linalg.norm(polytope.vertices - middle, axis=1).max()
        behind = sd.PLANES + own.size
        row[sd.PLANES : behind] = own.ravel()
        row[behind : behind + polytope.vertices.size] = polytope.vertices.ravel()
    return table


def vertices_in(row: Array) -> Array:
    """Return a polytope row's vertices in the obstacle's frame; shape (n_vertices, 3) [m]."""
    first = sd.PLANES + 4 * int(row[sd.N_PLANES])
    return row[first : first + 3 * int(row[sd.N_VERTICES])].reshape(-1, 3)

"""Surfaces of mesh obstacles, and distances of convex bodies from them.

A mesh obstacle is represented by its triangles. A body that starts outside cannot enter without crossing a triangle,
whether the triangles are closed or not, turned alike or not, repeated, or crossing each other. So a proof needs an
inside only once, at the start, and a search needs none; where triangles close (`comove.geometry.topology`), a ray
decides whether a point is inside.

A body is convex: the hull of points, thickened by a radius. Along a unit vector n that points from the body to a
triangle the two leave a gap, ``min n x of the triangle - max n x of the body``. No gap is wider than their distance,
and the gap along the line between nearest points is equal to it; GJK finds it (Gilbert, Johnson & Keerthi, 1988).
Triangles are stored in trees of boxes, one for each mesh, so that far ones are skipped together.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.compiled import copy_to, kernel, sort_by
from comove.geometry.distances import has_last_before, nearest_of_simplex

LEAF = 4  # triangles
DEPTH = 64  # of a stack of boxes: halves of 2^32 triangles need no more
MAX_STEPS = 40  # of GJK; the gap is a bound after any of them
NEAR = 1e-9  # of a distance, by which gap and distance may differ when GJK ends
GRAZING = 1e-9  # of where a box is, by which a ray may miss it
RAY = np.array([0.3710, 0.2437, 0.8960])  # no edge of a drawing is parallel to it


def _axes() -> Array:
    z = RAY / np.linalg.norm(RAY)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


AXES = _axes()  # two across the ray and one along it, as rows


class Surfaces(NamedTuple):
    """The meshes among a scene's obstacles, each in a tree of boxes. The left child of a box is the next box.

    Attributes
    ----------
    triangles : array, shape (n_triangles, 3, 3), positions at 0 s [m]
    side : array, shape (n_triangles,), 1 for a triangle of a closed solid, which is turned outwards; else 0
    lower, upper : arrays, shape (n_boxes, 3), corners of the boxes [m]
    right : array of int, shape (n_boxes,), the right child, -1 for a leaf
    first, count : arrays of int, shape (n_boxes,), first triangle in a box and number of triangles in it
    root : array of int, shape (n_meshes,), the box that contains all of a mesh
    closed : array of bool, shape (n_meshes,), whether any triangles of a mesh close a solid
    owner, row : arrays of int, shape (n_meshes,), number of the obstacle, and its first row in the table of obstacles
    center : array, shape (n_meshes, 3), centre of the obstacle at 0 s [m]
    slack : array, shape (n_meshes,), largest distance of a triangle's corner from its position in the file [m]
    """

    triangles: Array
    side: Array
    lower: Array
    upper: Array
    right: Integers
    first: Integers
    count: Integers  # type: ignore[assignment]  # hides the method of tuples
    root: Integers
    closed: NDArray[np.bool_]
    owner: Integers
    row: Integers
    center: Array
    slack: Array

    def of(self, mesh: int) -> Array:
        """Return the triangles of one mesh; array, shape (n_triangles, 3, 3) [m]."""
        first = self.first[self.root[mesh]]
        return self.triangles[first : first + self.count[self.root[mesh]]]

    def among(self, kept: Integers, rows: NDArray[np.bool_]) -> Surfaces:
        """Return the meshes of some obstacles, renumbered.

        Parameters
        ----------
        kept : numbers of the obstacles, in order
        rows : array, shape (n_rows,), whether a row of the table is one of theirs
        """
        which = np.isin(self.owner, kept)
        return self._replace(
            root=self.root[which],
            closed=self.closed[which],
            owner=np.searchsorted(kept, self.owner[which]),
            row=(np.cumsum(rows) - 1)[self.row[which]],
            center=self.center[which],
            slack=self.slack[which],
        )


@dataclass(frozen=True, eq=False)
class Parts:
    """The triangles of a mesh, sorted into solids and sheets.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3) [m], no two at one place
    solids : closed triangles, turned outwards, the cavities of a solid included; arrays, shape (n_faces, 3)
    sheets : connected triangles that close nothing, degenerate triangles included; arrays, shape (n_faces, 3)
    slack : largest distance of a vertex from its position in the file [m]
    """

    vertices: Array
    solids: tuple[Integers, ...]
    sheets: tuple[Integers, ...]
    slack: float


class Placed(NamedTuple):
    """A mesh among the obstacles: its parts and pose.

    Attributes
    ----------
    parts : solids and sheets of the mesh, in its own frame
    center, rotation : arrays, shapes (3,) and (3, 3), pose of this frame at 0 s [m]
    owner, row : number of the obstacle, and its first row in the table of obstacles
    """

    parts: Parts
    center: Array
    rotation: Array
    owner: int
    row: int


def surfaces_of(meshes: list[Placed]) -> Surfaces:
    """Return the triangles of meshes, sorted into trees of boxes."""
    if not meshes:
        none, numbers, corners = np.zeros(0), np.zeros(0, dtype=np.int64), np.zeros((0, 3))
        boxes = corners, corners, *3 * (numbers,)
        return Surfaces(np.zeros((0, 3, 3)), none, *boxes, numbers, none > 0, numbers, numbers, corners, none)
    own, n_boxes, n_triangles = [], 0, 0
    for mesh in meshes:
        vertices = np.ascontiguousarray(mesh.parts.vertices @ mesh.rotation.T + mesh.center)
        n_closed = sum(map(len, mesh.parts.solids))
        tree = surface_of(vertices[np.concatenate([*mesh.parts.solids, *mesh.parts.sheets])], n_closed)
        own.append(
            tree._replace(
                right=np.where(tree.right >= 0, tree.right + n_boxes, tree.right),
                first=tree.first + n_triangles,
                root=tree.root + n_boxes,
                owner=np.array([mesh.owner], dtype=np.int64),
                row=np.array([mesh.row], dtype=np.int64),
                center=np.array([mesh.center], dtype=float),
                slack=np.array([mesh.parts.slack], dtype=float),
            )
        )
        n_boxes, n_triangles = n_boxes + len(tree.lower), n_triangles + len(tree.triangles)
    return Surfaces(*map(np.concatenate, zip(*own, strict=True)))


def surface_of(triangles: Array, n_closed: int) -> Surfaces:
    """Return one mesh, at the origin.

    Parameters
    ----------
    triangles : array, shape (n_triangles, 3, 3) [m]
    n_closed : number of the first triangles that close solids, which are turned outwards
    """
    side = np.repeat([1.0, 0.0], [n_closed, len(triangles) - n_closed])
    order, *boxes = _built(np.ascontiguousarray(triangles))
    zero = np.zeros(1, dtype=np.int64)
    closed = np.array([n_closed > 0])
    own = zero, closed, zero, zero, np.zeros((1, 3)), np.zeros(1)
    return Surfaces(triangles[order], side[order], *boxes, *own)  # type: ignore[call-arg]


@kernel
def count_meshes(surfaces):
    """Return the number of meshes, 0 for None."""
    if surfaces is None:
        return 0
    return surfaces.root.shape[0]


@kernel
def _built(triangles):
    """Build the tree of one mesh.

    Returns
    -------
    order : array of int, shape (n,), triangles by box
    lower, upper, right, first, count : the boxes, as in `Surfaces`
    """
    n = triangles.shape[0]
    order, spare = np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    middle = np.empty((3, n))
    for i in range(n):
        order[i] = i
        for axis in range(3):
            middle[axis, i] = triangles[i, 0, axis] + triangles[i, 1, axis] + triangles[i, 2, axis]
    most = 2 * n
    lower, upper = np.empty((most, 3)), np.empty((most, 3))
    right, first = np.empty(most, dtype=np.int64), np.empty(most, dtype=np.int64)
    count = np.empty(most, dtype=np.int64)
    stack = np.empty((DEPTH, 3), dtype=np.int64)  # begin, end, whose right child
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, n, -1
    top, boxes = 1, 0
    while top > 0:
        top -= 1
        begin, end, parent = stack[top]
        box = boxes
        boxes += 1
        if parent >= 0:
            right[parent] = box
        right[box], first[box], count[box] = -1, begin, end - begin
        for axis in range(3):
            low, high = np.inf, -np.inf
            for k in range(begin, end):
                i = order[k]
                for corner in range(3):
                    low, high = min(low, triangles[i, corner, axis]), max(high, triangles[i, corner, axis])
            lower[box, axis], upper[box, axis] = low, high
        if end - begin <= LEAF:
            continue
        widest, axis = -1.0, 0
        for k in range(3):
            low, high = np.inf, -np.inf
            for i in range(begin, end):
                low, high = min(low, middle[k, order[i]]), max(high, middle[k, order[i]])
            if high - low > widest:
                widest, axis = high - low, k
        # Ties keep their order, so that the tree is the same on every machine.
        sort_by(middle[axis], order, begin, end, spare)
        half = (begin + end) // 2
        stack[top, 0], stack[top, 1], stack[top, 2] = half, end, box
        stack[top + 1, 0], stack[top + 1, 1], stack[top + 1, 2] = begin, half, -1
        top += 2
    return order, lower[:boxes], upper[:boxes], right[:boxes], first[:boxes], count[:boxes]


@kernel
def signed_distance(surfaces, mesh, points, cutoff):
    """Return a hull's signed distance [m] from a mesh at 0 s.

    The hull is that of points (n, 3); the distance is `cutoff` at most. It is negative where the hull cuts the
    triangles or lies inside a solid that they close: minus the depth of the deepest of the points.
    """
    distance = surface_distance(surfaces, mesh, points, max(cutoff, 0.0))
    if not surfaces.closed[mesh]:
        return distance
    corner = np.empty((1, 3))
    for i in range(points.shape[0] if distance == 0.0 else 1):
        if holds(surfaces, mesh, points[i, 0], points[i, 1], points[i, 2]):
            copy_to(points[i], corner[0])
            distance = min(distance, -surface_distance(surfaces, mesh, corner, np.inf))
    return distance


@kernel
def point_distances(surfaces, mesh, points, cutoff, depths):
    """Return points' (n, 3) distances [m] from a mesh at 0 s.

    They are `cutoff` at most. Inside a solid they are 0, or with `depths` negative.
    """
    found, point = np.zeros(points.shape[0]), np.empty((1, 3))
    for i in range(points.shape[0]):
        copy_to(points[i], point[0])
        inside = surfaces.closed[mesh] and holds(surfaces, mesh, points[i, 0], points[i, 1], points[i, 2])
        if depths or not inside:
            distance = surface_distance(surfaces, mesh, point, cutoff)
            found[i] = -distance if inside else distance
    return found


@kernel
def holds(surfaces, mesh, x, y, z):
    """Return whether a point is inside a solid of a mesh. For a point on the surface the result is undefined.

    A ray counts the triangles that it crosses, +1 or -1 by their side.
    """
    u = AXES[0, 0] * x + AXES[0, 1] * y + AXES[0, 2] * z
    v = AXES[1, 0] * x + AXES[1, 1] * y + AXES[1, 2] * z
    w = AXES[2, 0] * x + AXES[2, 1] * y + AXES[2, 2] * z
    point, seen = np.array([x, y, z]), np.empty((3, 3))
    stack = np.empty(DEPTH, dtype=np.int64)
    stack[0], top, turns = surfaces.root[mesh], 1, 0
    while top > 0:
        top -= 1
        box = stack[top]
        enters, leaves = 0.0, np.inf
        for axis in range(3):
            low, high = surfaces.lower[box, axis], surfaces.upper[box, axis]
            wide = GRAZING * (abs(low) + abs(high) + abs(point[axis]))
            enters = max(enters, (low - wide - point[axis]) / RAY[axis])
            leaves = min(leaves, (high + wide - point[axis]) / RAY[axis])
        if leaves < enters:
            continue
        if surfaces.right[box] >= 0:
            stack[top], stack[top + 1] = surfaces.right[box], box + 1
            top += 2
            continue
        for i in range(surfaces.first[box], surfaces.first[box] + surfaces.count[box]):
            if surfaces.side[i] == 0.0:
                continue
            for k in range(3):
                p = surfaces.triangles[i, k]
                for row in range(3):
                    seen[k, row] = AXES[row, 0] * p[0] + AXES[row, 1] * p[1] + AXES[row, 2] * p[2]
            e, f, g = (
                side_of(seen[0], seen[1], u, v),
                side_of(seen[1], seen[2], u, v),
                side_of(seen[2], seen[0], u, v),
            )
            if (e > 0.0) == (f > 0.0) and (f > 0.0) == (g > 0.0):
                total = e + f + g
                if total != 0.0 and (f * seen[0, 2] + g * seen[1, 2] + e * seen[2, 2]) / total > w:
                    turns += 1 if total > 0.0 else -1
    return turns != 0


@kernel
def side_of(p, q, u, v):
    """Return the side of edge p-q on which a ray passes, signed.

    Both triangles that share the edge get the same number, to the last digit.
    """
    if p[0] < q[0] or (p[0] == q[0] and p[1] < q[1]):
        return (q[0] - p[0]) * (v - p[1]) - (q[1] - p[1]) * (u - p[0])
    return -((p[0] - q[0]) * (v - q[1]) - (p[1] - q[1]) * (u - q[0]))


@kernel
def surface_distance(surfaces, mesh, points, cutoff):
    """Return a hull's distance [m] from a mesh's triangles at 0 s.

    The hull is that of points (n, 3); the distance is `cutoff` at most.
    """
    return max(near_on_surface(surfaces, mesh, points, cutoff, 0.0, np.empty(3), np.empty(3)), 0.0)


@kernel
def near_on_surface(surfaces, mesh, points, cutoff, enough, near, way):
    """Compute a hull's distance [m] from a mesh's triangles at 0 s.

    The hull is that of points (n, 3), and the distance is `cutoff` at most. The nearest point of the hull is written
    in `near` and the unit vector from the mesh to it in `way`; both are left unchanged where nothing is nearer than
    `cutoff`. Where the hull cuts a triangle the distance is negative: about how far the hull would have to be moved.
    The search ends where the distance is `enough` or less.
    """
    low, high = np.empty(3), np.empty(3)
    for axis in range(3):
        low[axis], high[axis] = np.inf, -np.inf
        for i in range(points.shape[0]):
            low[axis], high[axis] = min(low[axis], points[i, axis]), max(high[axis], points[i, axis])
    normal, scratch = np.array([1.0, 0.0, 0.0]), np.empty((3, 4, 3))
    stack = np.empty(DEPTH, dtype=np.int64)
    stack[0], top, least = surfaces.root[mesh], 1, cutoff
    while top > 0:
        top -= 1
        box = stack[top]
        far = max(box_distance(surfaces, box, low, high), box_gap(surfaces, box, points, points, normal), 0.0)
        if least <= enough or far >= max(least, 1e-300):
            continue
        if surfaces.right[box] >= 0:  # the nearer half first
            left, right = box + 1, surfaces.right[box]
            if box_distance(surfaces, left, low, high) > box_distance(surfaces, right, low, high):
                left, right = right, left
            stack[top], stack[top + 1] = right, left
            top += 2
            continue
        for i in range(surfaces.first[box], surfaces.first[box] + surfaces.count[box]):
            if triangle_gap(surfaces.triangles[i], points, normal) < least:
                gap, distance = nearest(surfaces.triangles[i], points, normal, scratch)
                if distance == 0.0:
                    distance = gap
                if distance < least:
                    least = distance
                    for axis in range(3):
                        near[axis], way[axis] = scratch[2, 0, axis], -normal[axis]
    return least


@kernel
def box_distance(surfaces, box, low, high):
    """Return a tree box's distance [m] from the box `low` to `high`."""
    square = 0.0
    for axis in range(3):
        beyond = max(surfaces.lower[box, axis] - high[axis], low[axis] - surfaces.upper[box, axis])
        if beyond > 0.0:
            square += beyond * beyond
    return sqrt(square)


@kernel
def box_gap(surfaces, box, points, others, normal):
    """Return the gap [m] along `normal` between points and a tree box. Both sets of points, (n, 3), count."""
    least, most = 0.0, -np.inf
    for axis in range(3):
        least += min(normal[axis] * surfaces.lower[box, axis], normal[axis] * surfaces.upper[box, axis])
    for i in range(points.shape[0]):
        most = max(most, normal[0] * points[i, 0] + normal[1] * points[i, 1] + normal[2] * points[i, 2])
        most = max(most, normal[0] * others[i, 0] + normal[1] * others[i, 1] + normal[2] * others[i, 2])
    return least - most


@kernel
def triangle_gap(triangle, points, normal):
    """Return the gap [m] along `normal` between a hull and a triangle.

    The hull is that of points (n, 3). The unit vector points from the hull to the triangle.
    """
    least, most = np.inf, -np.inf
    for i in range(3):
        along = normal[0] * triangle[i, 0] + normal[1] * triangle[i, 1] + normal[2] * triangle[i, 2]
        least = min(least, along)
    for i in range(points.shape[0]):
        along = normal[0] * points[i, 0] + normal[1] * points[i, 1] + normal[2] * points[i, 2]
        most = max(most, along)
    return least - most


@kernel
def nearest(triangle, points, normal, scratch):
    """Return widest gap and distance [m] of a hull and a triangle.

    The hull is that of points (n, 3). `normal` holds the direction that is tried first; the direction of the widest
    gap is written in it. The nearest point of the hull, or its deepest corner, is written in the first row of
    ``scratch[2]``. Where the two overlap the distance is 0 and the gap negative: about how far the body would have to
    be moved.

    Parameters
    ----------
    scratch : array, shape (3, 4, 3)
    """
    corners, near = scratch[0], scratch[2]
    weights, shares = scratch[1].reshape(12)[:4], scratch[1].reshape(12)[4:8]
    wide = triangle_gap(triangle, points, normal)
    x, y, z, n, square = normal[0], normal[1], normal[2], 0, np.inf
    for _ in range(MAX_STEPS):
        # The point of the body that is farthest along the way to the triangle, and the triangle's that is nearest.
        own, most, other, least = 0, -np.inf, 0, np.inf
        for i in range(points.shape[0]):
            along = x * points[i, 0] + y * points[i, 1] + z * points[i, 2]
            if along > most:
                own, most = i, along
        for i in range(3):
            along = x * triangle[i, 0] + y * triangle[i, 1] + z * triangle[i, 2]
            if along < least:
                other, least = i, along
        if least - most > wide:
            wide = least - most
            normal[0], normal[1], normal[2] = x, y, z
        if n > 0 and sqrt(square) - wide <= NEAR * sqrt(square):
            break
        for axis in range(3):
            corners[n, axis] = triangle[other, axis] - points[own, axis]
            near[n, axis] = points[own, axis]
        if has_last_before(corners, n):
            break
        nearer = nearest_of_simplex(corners, n + 1, weights)
        if not nearer < square:  # rounding: no progress any more
            break
        square, kept = nearer, 0
        x, y, z = 0.0, 0.0, 0.0
        for i in range(n + 1):
            if weights[i] > 0.0:
                x, y, z = (
                    x + weights[i] * corners[i, 0],
                    y + weights[i] * corners[i, 1],
                    z + weights[i] * corners[i, 2],
                )
                for axis in range(3):
                    corners[kept, axis], near[kept, axis] = corners[i, axis], near[i, axis]
                shares[kept] = weights[i]
                kept += 1
        n, length = kept, sqrt(x * x + y * y + z * z)
        if n == 4 or length == 0.0:
            wide, deepest = _deepest(triangle, points, wide, normal), 0
            for i in range(1, points.shape[0]):
                if np.dot(normal, points[i]) > np.dot(normal, points[deepest]):
                    deepest = i
            copy_to(points[deepest], near[0])
            return wide, 0.0
        x, y, z = x / length, y / length, z / length
    for axis in range(3):
        near[0, axis] *= shares[0]
        for i in range(1, n):
            near[0, axis] += shares[i] * near[i, axis]
    return wide, sqrt(square)


@kernel
def _deepest(triangle, points, wide, normal):
    """Return the widest of the gaps of an overlapping body and triangle.

    It is 0 or less; its direction is written in `normal`. The directions tried are `normal` and both normals of the
    triangle.
    """
    a, b, c = triangle[0], triangle[1], triangle[2]
    x = (b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1])
    y = (b[2] - a[2]) * (c[0] - a[0]) - (b[0] - a[0]) * (c[2] - a[2])
    z = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
    length = sqrt(x * x + y * y + z * z)
    if length == 0.0:
        return min(wide, 0.0)
    across = np.array([x / length, y / length, z / length])
    for _ in range(2):
        for axis in range(3):
            across[axis] *= -1.0
        gap = triangle_gap(triangle, points, across)
        if gap > wide:
            wide = gap
            copy_to(across, normal)
    return min(wide, 0.0)

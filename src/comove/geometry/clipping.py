"""Polygons cut by planes, in numba kernels: what lies in a half space, and what of triangles no polytope contains."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel
from comove.geometry.polytopes import Polytope

Array = NDArray[np.float64]

MAX_CORNERS, MAX_OPEN = 64, 192  # corners of a remaining polygon; pending polygons


def left_out(triangles: Array, polytopes: list[Polytope], tolerance: float) -> list[Array]:
    """Return the parts of triangles that are outside all polytopes, as polygons, arrays of shape (n, 3) [m].

    Parameters
    ----------
    triangles : array, shape (n_triangles, 3, 3) [m]
    tolerance : distance by which a contained point may be outside a polytope [m]
    """
    first = np.cumsum([0, *(len(p.planes) for p in polytopes)])
    planes = np.concatenate([p.planes for p in polytopes]) if polytopes else np.zeros((0, 4))
    corners, counts = _left_out(triangles, planes, first, tolerance)
    return [own[:n] for own, n in zip(corners, counts, strict=True)]


@kernel
def clipped(polygon, n, plane, side, out):
    """Write in `out` the part of a polygon behind a plane (`side` 1) or beyond it (-1); return its number of corners.

    Parameters
    ----------
    polygon : array whose first `n` rows are its corners [m]
    plane : array, shape (4,), normal and offset d; what is behind has ``normal x <= d`` [m]
    """
    count = 0
    for i in range(n):
        p, q = polygon[i], polygon[(i + 1) % n]
        here = side * (plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3])
        there = side * (plane[0] * q[0] + plane[1] * q[1] + plane[2] * q[2] - plane[3])
        if here <= 0.0:
            for axis in range(3):
                out[count, axis] = p[axis]
            count += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            for axis in range(3):
                out[count, axis] = p[axis] + share * (q[axis] - p[axis])
            count += 1
    return count


@kernel
def _left_out(triangles, planes, first, tolerance):
    """Return the polygons that remain of triangles when everything inside one polytope after the other is cut off.

    Parameters
    ----------
    planes : array, shape (n_planes, 4), of all polytopes [m]
    first : array of int, shape (n_polytopes + 1,), index of each polytope's first plane

    Returns
    -------
    corners : array, shape (n_polygons, MAX_CORNERS, 3) [m]
    counts : array of int, shape (n_polygons,), number of corners of each polygon
    """
    found, counts, n_found = np.empty((16, MAX_CORNERS, 3)), np.empty(16, dtype=np.int64), 0
    stack = np.empty((256, MAX_CORNERS, 3))
    sizes, after = np.empty(256, dtype=np.int64), np.empty(256, dtype=np.int64)
    inner, outer = np.empty((MAX_CORNERS, 3)), np.empty((MAX_CORNERS, 3))
    for triangle in triangles:
        stack[0, :3], sizes[0], after[0] = triangle, 3, 0
        top = 1
        while top > 0:
            top -= 1
            n, polytope = sizes[top], after[top]
            polygon = stack[top, :n].copy()
            # What lies beyond one of its planes as a whole is not touched by a polytope.
            while polytope < first.shape[0] - 1 and _is_apart(
                polygon, planes[first[polytope] : first[polytope + 1]], tolerance
            ):
                polytope += 1
            # In no polytope, or in so many pieces already that it is left as it is.
            whole = polytope == first.shape[0] - 1 or top > MAX_OPEN
            for k in range(0 if whole else first[polytope], 0 if whole else first[polytope + 1]):
                if _beyond(polygon, planes[k])[1] <= tolerance:
                    continue
                n_outer = clipped(polygon, n, planes[k], -1.0, outer)
                if n_outer > 2:
                    if top == stack.shape[0]:
                        stack = np.concatenate((stack, np.empty_like(stack)))
                        sizes = np.concatenate((sizes, np.empty_like(sizes)))
                        after = np.concatenate((after, np.empty_like(after)))
                    stack[top], sizes[top], after[top] = outer, n_outer, polytope + 1
                    top += 1
                    n = clipped(polygon, n, planes[k], 1.0, inner)
                    polygon = inner[:n].copy()
                    whole = n + 2 > MAX_CORNERS
                    if n < 3 or whole:
                        break
            if whole:
                if n_found == found.shape[0]:
                    found = np.concatenate((found, np.empty_like(found)))
                    counts = np.concatenate((counts, np.empty_like(counts)))
                found[n_found, :n], counts[n_found] = polygon, n
                n_found += 1
    return found[:n_found], counts[:n_found]


@kernel
def _is_apart(polygon, planes, tolerance):
    """Return whether all corners of a polygon (n, 3) are `tolerance` [m] or more beyond one of the planes (m, 4)."""
    for plane in planes:
        if _beyond(polygon, plane)[0] >= tolerance:
            return True
    return False


@kernel
def _beyond(polygon, plane):
    """Return how far the corners of a polygon (n, 3) are beyond a plane, at least and at most [m]."""
    least, most = np.inf, -np.inf
    for p in polygon:
        beyond = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3]
        least, most = min(least, beyond), max(most, beyond)
    return least, most

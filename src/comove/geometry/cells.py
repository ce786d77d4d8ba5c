"""Solids bounded by triangles, cut into small convex pieces.

Boxes are halved until the part of the solid in each of them is nearly convex. A piece is described by its extreme
points: the vertices of the triangles' parts inside the box, and the corners of the box that are inside the solid. So
a convex set that contains these points contains the piece, and a set that contains all pieces contains the solid.
"""

from __future__ import annotations

import numpy as np

from comove.compiled import copy_to, kernel
from comove.geometry.surfaces import holds

INWARD = 1e-6  # of a box, by which its corners are moved into it before they are asked for
FLAT = 1e-9  # of the solid's size, below which a piece has no inside
MAX_POLYGON = 16  # corners: a triangle cut by six planes has nine


@kernel
def pieces(surfaces, planes, first_plane, low, high, bend, smallest, most):
    """Cut a solid, or an open sheet, into nearly convex pieces.

    Parameters
    ----------
    surfaces : one mesh, in the frame of the planes
    planes : array, positions of the planes at which it is cut in any case: along x, then y, then z, each in order [m]
    first_plane : array of int, shape (4,), index of each axis's first plane in `planes`
    low, high : arrays, shape (3,), corners of a box around the solid [m]
    bend : largest deviation of a piece from convexity [m], unless its box is smaller than `smallest` [m]
    most : number of pieces beyond which the cutting stops

    Returns
    -------
    points : array, shape (n, 3), extreme points of the pieces [m]
    first : array of int, shape (n_pieces + 1,), index of each piece's first point in `points`
    """
    n_triangles = surfaces.triangles.shape[0]
    flat = FLAT * (high - low).max()
    pool = np.empty(8 * n_triangles + 1024, dtype=np.int64)
    for k in range(n_triangles):
        pool[k] = k
    boxes, spans = np.empty((1024, 2, 3)), np.empty((1024, 2), dtype=np.int64)
    boxes[0, 0], boxes[0, 1] = low, high
    spans[0, 0], spans[0, 1] = 0, n_triangles
    points, first = np.empty((4096, 3)), np.empty(1024, dtype=np.int64)
    n_points, n_pieces, top = 0, 0, 1
    first[0] = 0
    polygon, other = np.empty((MAX_POLYGON, 3)), np.empty((MAX_POLYGON, 3))
    own = np.empty((4096, 3))
    while top > 0 and n_pieces <= most:
        top -= 1
        a, b = boxes[top, 0].copy(), boxes[top, 1].copy()
        begin, end = spans[top]
        axis, at = _cut(planes, first_plane, a, b)
        if axis < 0 or begin == end:
            x, y, z = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]), 0.5 * (a[2] + b[2])
            if begin == end and not holds(surfaces, 0, x, y, z):
                continue
            if axis < 0:
                n_own, off, own = _piece(surfaces, pool[begin:end], a, b, polygon, other, own, flat)
                if n_own == 0:
                    continue
                longest = int(np.argmax(b - a))
                if off <= bend or b[longest] - a[longest] < 2.0 * smallest:
                    if n_points + n_own > points.shape[0]:
                        points = np.concatenate((points, np.empty((points.shape[0] + n_own, 3))))
                    if n_pieces + 2 > first.shape[0]:
                        first = np.concatenate((first, np.empty(first.shape[0], dtype=np.int64)))
                    points[n_points : n_points + n_own] = own[:n_own]
                    n_points, n_pieces = n_points + n_own, n_pieces + 1
                    first[n_pieces] = n_points
                    continue
                axis, at = longest, 0.5 * (a[longest] + b[longest])
        pool, n_low, n_high = _halved(surfaces, pool, begin, end, axis, at)
        if top + 2 > boxes.shape[0]:
            boxes = np.concatenate((boxes, np.empty_like(boxes)))
            spans = np.concatenate((spans, np.empty_like(spans)))
        boxes[top, 0], boxes[top, 1] = a, b
        boxes[top, 1, axis] = at
        spans[top, 0], spans[top, 1] = begin, begin + n_low
        boxes[top + 1, 0], boxes[top + 1, 1] = a, b
        boxes[top + 1, 0, axis] = at
        spans[top + 1, 0], spans[top + 1, 1] = begin + n_low, begin + n_low + n_high
        top += 2
    return points[:n_points].copy(), first[: n_pieces + 1].copy()


@kernel
def _halved(surfaces, pool, begin, end, axis, at):
    """Divide a box's triangles by a plane into those below and above.

    Returns
    -------
    pool : array of int, which holds from `begin` on first those that reach below, then those above
    n_low, n_high : their numbers; a triangle may be among both
    """
    count = end - begin
    if begin + 3 * count > pool.shape[0]:
        pool = np.concatenate((pool, np.empty(pool.shape[0] + 3 * count, dtype=np.int64)))
    kept = begin + count
    n_low = 0
    for m in range(begin, end):
        corners = surfaces.triangles[pool[m]]
        if min(corners[0, axis], corners[1, axis], corners[2, axis]) <= at:
            pool[kept + n_low] = pool[m]
            n_low += 1
    n_high = 0
    for m in range(begin, end):
        corners = surfaces.triangles[pool[m]]
        if max(corners[0, axis], corners[1, axis], corners[2, axis]) >= at:
            pool[kept + n_low + n_high] = pool[m]
            n_high += 1
    for m in range(n_low + n_high):
        pool[begin + m] = pool[kept + m]
    return pool, n_low, n_high


@kernel
def _cut(planes, first_plane, a, b):
    """Return axis and position of the plane that halves a box.

    It is the middle plane across the longest side that any plane cuts; the axis is -1 where none does.
    """
    best, at, longest = -1, 0.0, 0.0
    for axis in range(3):
        low, high = first_plane[axis], first_plane[axis + 1]
        own = planes[low:high]
        i, j = np.searchsorted(own, a[axis], side="right"), np.searchsorted(own, b[axis], side="left")
        if j > i and b[axis] - a[axis] > longest:
            best, at, longest = axis, own[(i + j) // 2], b[axis] - a[axis]
    return best, at


@kernel
def _piece(surfaces, members, a, b, polygon, other, own, flat):
    """Collect the extreme points of a solid's part within a box.

    Returns
    -------
    n_own : number of extreme points
    off : deviation of the piece from convexity [m]
    own : array whose first `n_own` rows are the extreme points [m]
    """
    n_own, n_faces = 0, 0
    sheet = not surfaces.closed[0]
    faces, sides = np.empty((members.shape[0], 4)), np.zeros((6, 4))
    for axis in range(3):
        sides[axis, axis], sides[axis, 3] = 1.0, b[axis]
        sides[3 + axis, axis], sides[3 + axis, 3] = -1.0, -a[axis]
    for m in range(members.shape[0]):
        corners = surfaces.triangles[members[m]]
        n = 3
        for i in range(3):
            polygon[i] = corners[i]
        for k in range(0, 6, 2):
            n = half(polygon[:n], sides[k], 0.0, -1.0, other)
            n = half(other[:n], sides[k + 1], 0.0, -1.0, polygon)
        if n < 3:
            continue
        p, q, r = corners[0], corners[1], corners[2]
        nx = (q[1] - p[1]) * (r[2] - p[2]) - (q[2] - p[2]) * (r[1] - p[1])
        ny = (q[2] - p[2]) * (r[0] - p[0]) - (q[0] - p[0]) * (r[2] - p[2])
        nz = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])
        length = np.sqrt(nx * nx + ny * ny + nz * nz)
        if length == 0.0:
            continue
        nx, ny, nz = nx / length, ny / length, nz / length
        if not sheet and _is_neighbours(polygon, n, a, b, nx, ny, nz, flat):
            continue
        faces[n_faces, 0], faces[n_faces, 1], faces[n_faces, 2] = nx, ny, nz
        faces[n_faces, 3] = nx * p[0] + ny * p[1] + nz * p[2]
        n_faces += 1
        if n_own + n + 8 > own.shape[0]:
            own = np.concatenate((own, np.empty_like(own)))
        for i in range(n):
            own[n_own + i] = polygon[i]
        n_own += n
    for corner in range(8):
        if members.shape[0] > 0:  # else the whole box is inside
            x = _inward(a, b, corner, 0)
            if not holds(surfaces, 0, x, _inward(a, b, corner, 1), _inward(a, b, corner, 2)):
                continue
        for axis in range(3):
            own[n_own, axis] = b[axis] if corner >> axis & 1 else a[axis]
        n_own += 1
    for axis in range(3):
        low, high = np.inf, -np.inf
        for i in range(n_own):
            low, high = min(low, own[i, axis]), max(high, own[i, axis])
        if high - low <= flat and not sheet:
            return 0, 0.0, own
    off = 0.0
    for f in range(n_faces):
        for i in range(n_own):
            beyond = faces[f, 0] * own[i, 0] + faces[f, 1] * own[i, 1] + faces[f, 2] * own[i, 2] - faces[f, 3]
            off = max(off, abs(beyond) if sheet else beyond)
    return n_own, off, own


@kernel
def _inward(a, b, corner, axis):
    share = 1.0 - INWARD if corner >> axis & 1 else INWARD
    return a[axis] + share * (b[axis] - a[axis])


@kernel
def _is_neighbours(polygon, n, a, b, nx, ny, nz, flat):
    """Return whether a polygon bounds the solid beyond a box side."""
    for axis in range(3):
        normal = nx if axis == 0 else (ny if axis == 1 else nz)
        at_low, at_high = True, True
        for i in range(n):
            at_low &= polygon[i, axis] <= a[axis] + flat
            at_high &= polygon[i, axis] >= b[axis] - flat
        # Outwards along the axis: the solid is on the box's own side. A line only on the side: others tell more.
        if at_low and normal > -0.5:
            return True
        if at_high and normal < 0.5:
            return True
    return False


@kernel
def half(polygon, plane, tolerance, side, out):
    """Write one side of a cut polygon in `out`; return its number of corners.

    `side` 1 is the part beyond the plane, -1 the part behind it. If no corner is beyond the plane by more than
    `tolerance` [m], the part beyond it counts as empty.
    """
    n, count, most = polygon.shape[0], 0, -np.inf
    for p in polygon:
        most = max(most, plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3])
    if side > 0.0 and most <= tolerance:
        return 0
    for i in range(n):
        p, q = polygon[i], polygon[(i + 1) % n]
        here = side * (plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3])
        there = side * (plane[0] * q[0] + plane[1] * q[1] + plane[2] * q[2] - plane[3])
        if here >= 0.0:
            copy_to(p, out[count])
            count += 1
        if (here > 0.0 and there < 0.0) or (here < 0.0 and there > 0.0):
            share = here / (here - there)
            for axis in range(3):
                out[count, axis] = p[axis] + share * (q[axis] - p[axis])
            count += 1
    return count

"""Signed distances from points and segments to obstacles, in numba kernels.

Everything is spatial: a planar scene is the slice z = 0 of a spatial one whose boxes and ellipses reach far
along z. One set of kernels then serves both, and the distances within the slice are exact.

Every obstacle is convex, so its signed distance (negative inside) is a convex function with Lipschitz
constant 1; along a segment it is convex too, which `segment_distance` uses.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

BOX, SPHERE, CAPSULE, CYLINDER, ELLIPSOID = range(5)
GOLDEN = 0.3819660112501051  # 2 - golden ratio


class Obstacles(NamedTuple):
    """Obstacles as arrays, the form that kernels take.

    Attributes
    ----------
    kind : array of int, shape (n_obstacles,): BOX, SPHERE, CAPSULE, CYLINDER or ELLIPSOID
    center : array, shape (n_obstacles, 3), [m]
    rotation : array, shape (n_obstacles, 3, 3), its columns are the obstacle's axes in the world
    size : array, shape (n_obstacles, 3), [m]: half edges; radius; radius and half length along the
        obstacle's z; likewise; radii
    reach : array, shape (n_obstacles,), [m], radius of a sphere about the centre that holds the obstacle
    """

    kind: NDArray[np.int64]
    center: Array
    rotation: Array
    size: Array
    reach: Array


@numba.njit(cache=True, fastmath=False, inline="never")
def point_distance(obstacles, j, x, y, z):
    """Signed distance [m] from the point (x, y, z) to obstacle `j`; negative inside."""
    kind = obstacles.kind[j]
    x -= obstacles.center[j, 0]
    y -= obstacles.center[j, 1]
    z -= obstacles.center[j, 2]
    a, b, c = obstacles.size[j, 0], obstacles.size[j, 1], obstacles.size[j, 2]
    if kind == SPHERE:
        return sqrt(x * x + y * y + z * z) - a
    r = obstacles.rotation
    u = abs(r[j, 0, 0] * x + r[j, 1, 0] * y + r[j, 2, 0] * z)
    v = abs(r[j, 0, 1] * x + r[j, 1, 1] * y + r[j, 2, 1] * z)
    w = abs(r[j, 0, 2] * x + r[j, 1, 2] * y + r[j, 2, 2] * z)
    if kind == BOX:
        u -= a
        v -= b
        w -= c
        inside = max(u, v, w)
        if inside <= 0.0:
            return inside
        u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
        return sqrt(u * u + v * v + w * w)
    if kind == CAPSULE:
        w = max(w - b, 0.0)
        return sqrt(u * u + v * v + w * w) - a
    if kind == CYLINDER:
        radial, axial = sqrt(u * u + v * v) - a, w - b
        inside = max(radial, axial)
        if inside <= 0.0:
            return inside
        radial, axial = max(radial, 0.0), max(axial, 0.0)
        return sqrt(radial * radial + axial * axial)
    return _ellipsoid_distance(a, b, c, u, v, w)


@numba.njit(cache=True)
def _ellipsoid_distance(a, b, c, u, v, w):
    """Signed distance to an axis-aligned ellipsoid from a point of the first octant.

    The nearest surface point is r_i^2 p_i / (t + r_i^2) where t solves sum (r_i p_i / (t + r_i^2))^2 = 1;
    that sum is convex and decreasing, so Newton's method from the left is monotone (Eberly, 2013).
    """
    tiny = 1e-12
    u, v, w = max(u, tiny * a), max(v, tiny * b), max(w, tiny * c)
    t = max(a * u - a * a, b * v - b * b, c * w - c * c)
    for _ in range(60):
        pa, pb, pc = 1.0 / (t + a * a), 1.0 / (t + b * b), 1.0 / (t + c * c)
        ga, gb, gc = (a * u * pa) ** 2, (b * v * pb) ** 2, (c * w * pc) ** 2
        value = ga + gb + gc - 1.0
        step = 0.5 * value / (ga * pa + gb * pb + gc * pc)
        t += step
        if not step > 1e-15 * (abs(t) + a * a):
            break
    du = u * t / (t + a * a)
    dv = v * t / (t + b * b)
    dw = w * t / (t + c * c)
    distance = sqrt(du * du + dv * dv + dw * dw)
    return distance if t > 0.0 else -distance


@numba.njit(cache=True)
def segment_distance(obstacles, j, p, q, cutoff, tolerance):
    """Least signed distance [m] from the segment p-q to obstacle `j`, to within `tolerance`.

    The distance is convex along the segment: golden sections close in on its minimum. The result is an
    upper bound of it, at most `tolerance` above; where the distance is sure to be above `cutoff`, any value
    above `cutoff` may come back.
    """
    px, py, pz = p[0], p[1], p[2]
    dx, dy, dz = q[0] - px, q[1] - py, q[2] - pz
    length = sqrt(dx * dx + dy * dy + dz * dz)
    middle = point_distance(obstacles, j, px + 0.5 * dx, py + 0.5 * dy, pz + 0.5 * dz)
    if length == 0.0 or middle - 0.5 * length > cutoff:
        return middle
    low, high = 0.0, 1.0
    s1, s2 = GOLDEN, 1.0 - GOLDEN
    f1 = point_distance(obstacles, j, px + s1 * dx, py + s1 * dy, pz + s1 * dz)
    f2 = point_distance(obstacles, j, px + s2 * dx, py + s2 * dy, pz + s2 * dz)
    while (high - low) * length > tolerance:
        if f1 < f2:
            high, s2, f2 = s2, s1, f1
            s1 = low + GOLDEN * (high - low)
            f1 = point_distance(obstacles, j, px + s1 * dx, py + s1 * dy, pz + s1 * dz)
        else:
            low, s1, f1 = s1, s2, f2
            s2 = high - GOLDEN * (high - low)
            f2 = point_distance(obstacles, j, px + s2 * dx, py + s2 * dy, pz + s2 * dz)
        if min(f1, f2) - (high - low) * length > cutoff:
            break
    return min(f1, f2, middle)


@numba.njit(cache=True)
def configuration_distance(nodes, edges, radii, obstacles, lower, upper):
    """Clearance [m] of one configuration, and what is nearest.

    Parameters
    ----------
    nodes : array, shape (n_nodes, 3), [m]
    edges : array of int, shape (n_edges, 2); an edge with equal ends is a point
    radii : array, shape (n_edges,), [m]
    obstacles : Obstacles
    lower, upper : arrays, shape (3,), the workspace [m]

    Returns
    -------
    clearance : float
    nearest : int, the obstacle; -1 for the border of the workspace
    """
    clearance, nearest = np.inf, -1
    for e in range(edges.shape[0]):
        p, q = nodes[edges[e, 0]], nodes[edges[e, 1]]
        for axis in range(3):
            border = min(p[axis], q[axis]) - lower[axis], upper[axis] - max(p[axis], q[axis])
            if min(border) - radii[e] < clearance:
                clearance, nearest = min(border) - radii[e], -1
        for j in range(obstacles.kind.shape[0]):
            distance = segment_distance(obstacles, j, p, q, clearance + radii[e], 1e-7) - radii[e]
            if distance < clearance:
                clearance, nearest = distance, j
    return clearance, nearest

"""Signed distances from points and segments to obstacles.

Obstacles are rows of one table, which kernels take at no cost. The columns of a row are `KIND`, `CENTER` (3),
`ROTATION` (9, a row-major matrix whose columns are the obstacle's axes in the world), `SIZE` (3) and `REACH` (radius
of a ball about the centre that contains the obstacle), in metres. `SIZE` holds, by kind: half edges of a box; radius
of a sphere; radius and half length along the obstacle's z of a capsule or a cylinder; semi-axes of an ellipsoid; the
radius by which a polytope is rounded. The row of a polytope continues with `N_PLANES`, `N_VERTICES`, `MIDDLE` (3) and
`BALL` (the radius about `MIDDLE` that contains the vertices), then `PLANES`, the planes n x <= d as (n, d), and the
vertices, in the obstacle's frame; all rows are as long as the longest.

Everything is spatial: a planar scene is the slice z = 0 of a spatial one whose boxes and ellipses reach far along z.
One set of kernels then serves both, and the distances within the slice are exact.

Every obstacle is convex, so its signed distance (negative inside) is a convex function with Lipschitz constant 1;
along a segment it is convex too, which `segment_distance` uses. For a polytope, the largest distance from one of its
planes replaces the signed distance: it is convex with the same constant, 0 on the surface as well, and never above
the signed distance. Additional planes that touch the polytope at its edges and corners keep the difference within an
eighth of the distance (`comove.geometry.polytopes`).

The inner step of GJK is here as well: the point of a simplex that is nearest to the origin. The nearest point lies
inside one of the simplex's faces, where it is the foot of the perpendicular on the face's plane. So among all faces
whose foot has no negative weight, the nearest foot is the nearest point (Gilbert, Johnson & Keerthi, 1988).
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from comove.arrays import Array
from comove.compiled import kernel

KIND, CENTER, ROTATION, SIZE, REACH, N_COLUMNS = 0, 1, 4, 13, 16, 17
N_PLANES, N_VERTICES, MIDDLE, BALL, PLANES = 17, 18, 19, 22, 23
BOX, SPHERE, CAPSULE, CYLINDER, ELLIPSOID = range(5)
POLYTOPE = 6  # 5 is the superquadric of `comove.lab.modulation.levels`
TINY = 1e-12


def inflated(table: Array, margin: Array) -> Array:
    """Return obstacles that contain every point within `margin` (n_obstacles,) [m]."""
    table, kind = table.copy(), table[:, KIND].astype(int)
    sizes = table[:, SIZE : SIZE + 3]
    # How many sizes grow: the radius of a capsule carries its ends along, and so does a polytope's rounding.
    counts = np.array([3, 1, 1, 2, 3, 0, 1])[kind]
    ellipsoid = kind == ELLIPSOID  # the sum with a ball is none, but within one of the same proportions
    grown = sizes + margin[:, None] * (np.arange(3) < counts[:, None])
    grown[ellipsoid] = sizes[ellipsoid] * (1 + margin[ellipsoid] / sizes[ellipsoid].min(axis=1))[:, None]
    table[ellipsoid, REACH] *= grown[ellipsoid, 0] / sizes[ellipsoid, 0]
    table[:, REACH] += np.where(ellipsoid, 0.0, np.where(kind == BOX, np.sqrt(3.0), np.sqrt(2.0)) * margin)
    table[:, SIZE : SIZE + 3] = grown
    return table


@kernel
def points_apart(p, q):
    """Return the distance [m] of two points."""
    return sqrt((p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2)


@kernel(counted=False)
def point_distance(table, j, x, y, z):
    """Return a point's signed distance [m] from obstacle `j`; negative inside."""
    kind = int(table[j, 0])
    x, y, z = x - table[j, 1], y - table[j, 2], z - table[j, 3]
    a, b, c = table[j, 13], table[j, 14], table[j, 15]
    if kind == SPHERE:
        return sqrt(x * x + y * y + z * z) - a
    if kind == POLYTOPE:
        return _farthest_plane(table, j, x, y, z)[0]
    u = abs(table[j, 4] * x + table[j, 7] * y + table[j, 10] * z)
    v = abs(table[j, 5] * x + table[j, 8] * y + table[j, 11] * z)
    w = abs(table[j, 6] * x + table[j, 9] * y + table[j, 12] * z)
    if kind == BOX:
        u, v, w = u - a, v - b, w - c
        outside = sqrt(max(u, 0.0) ** 2 + max(v, 0.0) ** 2 + max(w, 0.0) ** 2)
        return outside + min(max(u, v, w), 0.0)
    if kind == CAPSULE:
        w = max(w - b, 0.0)
        return sqrt(u * u + v * v + w * w) - a
    if kind == CYLINDER:
        radial, axial = sqrt(u * u + v * v) - a, w - b
        return sqrt(max(radial, 0.0) ** 2 + max(axial, 0.0) ** 2) + min(max(radial, axial), 0.0)
    t, _, _, _, length = _ellipsoid_normal(a, b, c, u, v, w)
    return t * length


@kernel(counted=False)
def _farthest_plane(table, j, x, y, z):
    """Return a point's distance [m] from the farthest plane, and its column.

    The plane is one of a polytope's. The point is given relative to the polytope's centre, along the axes of the
    world.
    """
    u = table[j, 4] * x + table[j, 7] * y + table[j, 10] * z
    v = table[j, 5] * x + table[j, 8] * y + table[j, 11] * z
    w = table[j, 6] * x + table[j, 9] * y + table[j, 12] * z
    farthest, which = -np.inf, PLANES
    for k in range(int(table[j, N_PLANES])):
        at = PLANES + 4 * k
        distance = table[j, at] * u + table[j, at + 1] * v + table[j, at + 2] * w - table[j, at + 3]
        if distance > farthest:
            farthest, which = distance, at
    return farthest - table[j, SIZE], which


@kernel
def _ellipsoid_normal(a, b, c, u, v, w):
    """Find the point of an ellipsoid nearest to a point.

    The ellipsoid is axis-aligned, the point in the first octant.

    The nearest point is r_i^2 p_i / (t + r_i^2), where t solves sum (r_i p_i / (t + r_i^2))^2 = 1; that sum is convex
    and decreasing, so Newton's method from the left is monotone (Eberly, 2013). Returns t, the outward normal p_i /
    (t + r_i^2), and its length; the signed distance is t times the length.
    """
    u, v, w = max(u, TINY * a), max(v, TINY * b), max(w, TINY * c)
    least = min(a, b, c) ** 2
    da, db, dc = a * a - least, b * b - least, c * c - least
    t = max(a * u - da, b * v - db, c * w - dc)  # plus least, so that nothing cancels deep inside
    for _ in range(100):
        pa, pb, pc = 1.0 / (t + da), 1.0 / (t + db), 1.0 / (t + dc)
        ga, gb, gc = (a * u * pa) ** 2, (b * v * pb) ** 2, (c * w * pc) ** 2
        step = 0.5 * (ga + gb + gc - 1.0) / (ga * pa + gb * pb + gc * pc)
        t += step
        if not step > 1e-15 * t:
            break
    nu, nv, nw = u / (t + da), v / (t + db), w / (t + dc)
    return t - least, nu, nv, nw, sqrt(nu * nu + nv * nv + nw * nw)


@kernel(counted=False)
def tangent(table, j, x, y, z, dx, dy, dz):
    """Return a point's signed distance [m] from obstacle `j`, and its slope.

    The slope is along (dx, dy, dz). Where the distance has a kink, the slope is that of a subgradient.
    """
    kind = int(table[j, 0])
    x, y, z = x - table[j, 1], y - table[j, 2], z - table[j, 3]
    a, b, c = table[j, 13], table[j, 14], table[j, 15]
    if kind == SPHERE:
        length = sqrt(x * x + y * y + z * z)
        return length - a, (x * dx + y * dy + z * dz) / max(length, TINY)
    if kind == POLYTOPE:
        distance, at = _farthest_plane(table, j, x, y, z)
        du = table[j, 4] * dx + table[j, 7] * dy + table[j, 10] * dz
        dv = table[j, 5] * dx + table[j, 8] * dy + table[j, 11] * dz
        dw = table[j, 6] * dx + table[j, 9] * dy + table[j, 12] * dz
        return distance, table[j, at] * du + table[j, at + 1] * dv + table[j, at + 2] * dw
    u = table[j, 4] * x + table[j, 7] * y + table[j, 10] * z
    v = table[j, 5] * x + table[j, 8] * y + table[j, 11] * z
    w = table[j, 6] * x + table[j, 9] * y + table[j, 12] * z
    du = table[j, 4] * dx + table[j, 7] * dy + table[j, 10] * dz
    dv = table[j, 5] * dx + table[j, 8] * dy + table[j, 11] * dz
    dw = table[j, 6] * dx + table[j, 9] * dy + table[j, 12] * dz
    # By symmetry in the first octant, the direction mirrored along.
    if u < 0.0:
        u, du = -u, -du
    if v < 0.0:
        v, dv = -v, -dv
    if w < 0.0:
        w, dw = -w, -dw
    if kind == BOX:
        u, v, w = u - a, v - b, w - c
        if u <= 0.0 and v <= 0.0 and w <= 0.0:
            if u >= v and u >= w:
                return u, du
            return (v, dv) if v >= w else (w, dw)
        u, v, w = max(u, 0.0), max(v, 0.0), max(w, 0.0)
        length = sqrt(u * u + v * v + w * w)
        return length, (u * du + v * dv + w * dw) / length
    if kind == CAPSULE:
        w = max(w - b, 0.0)
        length = sqrt(u * u + v * v + w * w)
        return length - a, (u * du + v * dv + w * dw) / max(length, TINY)
    if kind == CYLINDER:
        length = sqrt(u * u + v * v)
        radial, outward, axial = length - a, (u * du + v * dv) / max(length, TINY), w - b
        if radial <= 0.0 and axial <= 0.0:
            return (radial, outward) if radial >= axial else (axial, dw)
        radial, axial = max(radial, 0.0), max(axial, 0.0)
        length = sqrt(radial * radial + axial * axial)
        return length, (radial * outward + axial * dw) / length
    t, nu, nv, nw, length = _ellipsoid_normal(a, b, c, u, v, w)
    return t * length, (nu * du + nv * dv + nw * dw) / length


@kernel(counted=False)
def distance_and_gradient(table, j, x, y, z):
    """Return a point's signed distance [m] from obstacle `j` and its gradient. At a kink it is a subgradient."""
    distance, gx = tangent(table, j, x, y, z, 1.0, 0.0, 0.0)
    return (
        distance,
        gx,
        tangent(table, j, x, y, z, 0.0, 1.0, 0.0)[1],
        tangent(table, j, x, y, z, 0.0, 0.0, 1.0)[1],
    )


@kernel(counted=False)
def segment_distance(table, j, px, py, pz, qx, qy, qz, cutoff, tolerance):
    """Return the least signed distance [m] of a segment from obstacle `j`.

    The result is an upper bound, at most `tolerance` above the least distance; where the least distance is certainly
    above `cutoff`, any value above `cutoff` may be returned.
    """
    return nearest_on_segment(table, j, px, py, pz, qx, qy, qz, cutoff, tolerance)[0]


@kernel(inline="always")  # unused results cost nothing
def nearest_on_segment(table, j, px, py, pz, qx, qy, qz, cutoff, tolerance):
    """Find the point of a segment nearest to obstacle `j`.

    It is as accurate as `segment_distance`. The distance is convex along the segment, so tangents bound it from
    below: the next point to evaluate is where the tangents at both ends of a bracket meet. Returns the distance [m],
    the ends of the last bracket as fractions of the segment (equal where the nearest point is known exactly), and the
    slopes there.
    """
    dx, dy, dz = qx - px, qy - py, qz - pz
    middle, rise = tangent(table, j, px + 0.5 * dx, py + 0.5 * dy, pz + 0.5 * dz, dx, dy, dz)
    if middle - 0.5 * abs(rise) > cutoff or dx * dx + dy * dy + dz * dz == 0.0:
        return middle, 0.5, 0.5, rise, rise
    # The least distance lies on the falling side of the middle.
    if rise > 0.0:
        high, f_high, g_high = 0.5, middle, rise
        low = 0.0
        f_low, g_low = tangent(table, j, px, py, pz, dx, dy, dz)
        if g_low >= 0.0:
            return f_low, low, low, g_low, g_low
    else:
        low, f_low, g_low = 0.5, middle, rise
        high = 1.0
        f_high, g_high = tangent(table, j, qx, qy, qz, dx, dy, dz)
        if g_high <= 0.0:
            return f_high, high, high, g_high, g_high
    best = min(f_low, f_high)
    for _ in range(40):
        s = (f_high - f_low + g_low * low - g_high * high) / (g_low - g_high)
        bound = f_low + g_low * (s - low)
        if best - bound <= tolerance or bound > cutoff or not low < s < high:
            break
        f, g = tangent(table, j, px + s * dx, py + s * dy, pz + s * dz, dx, dy, dz)
        best = min(best, f)
        if g > 0.0:
            high, f_high, g_high = s, f, g
        elif g < 0.0:
            low, f_low, g_low = s, f, g
        else:
            return best, s, s, g, g
    return best, low, high, g_low, g_high


@kernel
def configuration_distance(nodes, edges, radii, table, lower, upper):
    """Return the clearance [m] of one configuration, and the nearest obstacle.

    Parameters
    ----------
    nodes : array, shape (n_nodes, 3), [m]
    edges : array of int, shape (n_edges, 2); an edge with equal ends is a point
    radii : array, shape (n_edges,), [m]
    table : array, shape (n_obstacles, N_COLUMNS), the obstacles
    lower, upper : arrays, shape (3,), the workspace [m]

    Returns
    -------
    clearance : float
    nearest : int, row of the nearest obstacle; -1 for the border of the workspace
    """
    clearance, nearest = np.inf, -1
    for e in range(edges.shape[0]):
        p, q = nodes[edges[e, 0]], nodes[edges[e, 1]]
        for axis in range(3):
            border = min(min(p[axis], q[axis]) - lower[axis], upper[axis] - max(p[axis], q[axis]))
            if border - radii[e] < clearance:
                clearance, nearest = border - radii[e], -1
        for j in range(table.shape[0]):
            distance = (
                segment_distance(table, j, p[0], p[1], p[2], q[0], q[1], q[2], clearance + radii[e], 1e-7)
                - radii[e]
            )
            if distance < clearance:
                clearance, nearest = distance, j
    return clearance, nearest


FACES = np.array(  # which corners, -1 for none
    [[i, -1, -1] for i in range(4)]
    + [[i, j, -1] for i in range(4) for j in range(i)]
    + [[i, j, k] for i in range(4) for j in range(i) for k in range(j)]
)
MAX_STEPS = 60  # of GJK; gaps are bounds of the distance after any of them
DEGENERATE = 1e-14  # of the product of squared edges: faces that flat have sides that tell more


@kernel
def has_last_before(corners, n):
    """Return whether corner n repeats an earlier one, so that GJK ends."""
    for i in range(n):
        if (
            corners[i, 0] == corners[n, 0]
            and corners[i, 1] == corners[n, 1]
            and corners[i, 2] == corners[n, 2]
        ):
            return True
    return False


@kernel
def nearest_of_simplex(corners, n, weights):
    """Compute the weights of a simplex's point nearest to the origin.

    They are written in `weights` (4), and the squared distance is returned. The first n rows of `corners`, array of
    shape (4, 3), are the simplex.
    """
    best = np.inf
    for face in range(FACES.shape[0]):
        i, j, k = FACES[face, 0], FACES[face, 1], FACES[face, 2]
        if i >= n:
            continue
        p = corners[i]
        f, g = 0.0, 0.0
        if j >= 0:
            ax, ay, az = corners[j, 0] - p[0], corners[j, 1] - p[1], corners[j, 2] - p[2]
            aa, ap = ax * ax + ay * ay + az * az, -(ax * p[0] + ay * p[1] + az * p[2])
            if k < 0:
                if aa == 0.0:
                    continue
                f = ap / aa
            else:
                bx, by, bz = corners[k, 0] - p[0], corners[k, 1] - p[1], corners[k, 2] - p[2]
                bb, bp = bx * bx + by * by + bz * bz, -(bx * p[0] + by * p[1] + bz * p[2])
                ab = ax * bx + ay * by + az * bz
                area = aa * bb - ab * ab
                if area <= DEGENERATE * aa * bb:
                    continue
                f, g = (bb * ap - ab * bp) / area, (aa * bp - ab * ap) / area
        if f < 0.0 or g < 0.0 or f + g > 1.0:
            continue
        square = 0.0
        for axis in range(3):
            x = p[axis]
            if j >= 0:
                x += f * (corners[j, axis] - p[axis])
            if k >= 0:
                x += g * (corners[k, axis] - p[axis])
            square += x * x
        if square < best:
            best = square
            weights[0] = weights[1] = weights[2] = weights[3] = 0.0
            weights[i] = 1.0 - f - g
            if j >= 0:
                weights[j] = f
            if k >= 0:
                weights[k] = g
    if n == 4 and _around_origin(corners, weights):
        return 0.0
    return best


@kernel
def _around_origin(corners, weights):
    """Return whether the tetrahedron holds the origin; write its `weights`."""
    a, b, c, d = (
        _volume(corners[1], corners[3], corners[2]),
        _volume(corners[0], corners[2], corners[3]),
        _volume(corners[0], corners[3], corners[1]),
        _volume(corners[0], corners[1], corners[2]),
    )
    total = a + b + c + d
    size = abs(a) + abs(b) + abs(c) + abs(d)
    if size == 0.0 or abs(total) < size * (1.0 - 1e-12):
        return False
    weights[0], weights[1], weights[2], weights[3] = a / total, b / total, c / total, d / total
    return True


@kernel
def _volume(p, q, r):
    return (
        p[0] * (q[1] * r[2] - q[2] * r[1])
        + p[1] * (q[2] * r[0] - q[0] * r[2])
        + p[2] * (q[0] * r[1] - q[1] * r[0])
    )

"""The point of a simplex that is nearest to the origin, in numba kernels: the inner step of GJK.

The nearest point lies inside one of the simplex's faces, where it is the foot of the perpendicular on the face's
plane. So among all faces whose foot has no negative weight, the nearest foot is the nearest point (Gilbert, Johnson
& Keerthi, 1988).
"""

from __future__ import annotations

import numpy as np

from comove.compiled import kernel

FACES = np.array(  # which corners, -1 for none
    [[i, -1, -1] for i in range(4)]
    + [[i, j, -1] for i in range(4) for j in range(i)]
    + [[i, j, k] for i in range(4) for j in range(i) for k in range(j)]
)
MAX_STEPS = 60  # of GJK; gaps are bounds of the distance after any of them
DEGENERATE = 1e-14  # of the product of squared edges: faces that flat have sides that tell more


@kernel
def has_last_before(corners, n):
    """Return whether corner n is among those before, so that GJK gets no nearer by it."""
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
    """Write in `weights` (4) the weights of a simplex's point nearest to the origin, and return its squared distance.

    The simplex has the first n rows of `corners`, array of shape (4, 3), as corners.
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
    """Return whether the origin is inside the tetrahedron; if so, write the origin's weights in `weights`."""
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

"""Distances of rods, such as link capsules, from obstacles and each other.

A rod is given by the ends of its axis, arrays of shape (3,) [m]. Distances are those of the axis: the caller
subtracts the radius. Bounding balls exclude distant pairs before exact distances are computed.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from comove.compiled import kernel
from comove.contacts.displaced import carried_back, shifted_back
from comove.geometry.distances import CAPSULE, CENTER, KIND, REACH, ROTATION, SIZE, SPHERE, segment_distance

AXIS = ROTATION + 2  # of a capsule: every third column is a coordinate


@kernel(counted=False)
def rod_distance(table, moved, row, instant, p, q, cutoff, tolerance):
    """Return a rod's distance [m] from an obstacle at an instant. It is as accurate as `segment_distance`.

    Certainly above `cutoff`, any value above it may be returned; infinity where even the bounding balls are.
    """
    x, y, z = 0.5 * (p[0] + q[0]), 0.5 * (p[1] + q[1]), 0.5 * (p[2] + q[2])
    x, y, z = shifted_back(moved, row, instant, x, y, z)
    x, y, z = x - table[row, CENTER], y - table[row, CENTER + 1], z - table[row, CENTER + 2]
    u, v, w = 0.5 * (q[0] - p[0]), 0.5 * (q[1] - p[1]), 0.5 * (q[2] - p[2])
    reach = cutoff + table[row, REACH] + sqrt(u * u + v * v + w * w)
    if reach < 0.0 or x * x + y * y + z * z > reach * reach:
        return np.inf
    a, b, c = carried_back(moved, row, instant, p[0], p[1], p[2])
    u, v, w = carried_back(moved, row, instant, q[0], q[1], q[2])
    if table[row, KIND] == SPHERE or table[row, KIND] == CAPSULE:  # which are rods
        half = table[row, SIZE + 1] if table[row, KIND] == CAPSULE else 0.0
        x, y, z = table[row, CENTER], table[row, CENTER + 1], table[row, CENTER + 2]
        k, l, m = half * table[row, AXIS], half * table[row, AXIS + 3], half * table[row, AXIS + 6]
        ends = (x - k, y - l, z - m), (x + k, y + l, z + m)
        return nearest_shares((a, b, c), (u, v, w), *ends)[2] - table[row, SIZE]
    return segment_distance(table, row, a, b, c, u, v, w, cutoff, tolerance)


@kernel(counted=False)
def rods_distance(a, b, c, d, cutoff):
    """Return the distance [m] of the rods a-b and c-d. It is infinite if certainly above `cutoff`."""
    return nearest_shares(a, b, c, d)[2] if near_enough(a, b, c, d, cutoff) else np.inf


@kernel(counted=False)
def near_enough(a, b, c, d, far):
    """Return whether two rods' bounding balls are within `far` [m]. The rods are a-b and c-d."""
    square, one, two = 0.0, 0.0, 0.0
    for x in range(3):
        square += (0.5 * (a[x] + b[x] - c[x] - d[x])) ** 2
        one += (b[x] - a[x]) ** 2
        two += (d[x] - c[x]) ** 2
    reach = far + 0.5 * (sqrt(one) + sqrt(two))
    return reach > 0.0 and square < reach * reach


@kernel(counted=False)
def nearest_shares(a, b, c, d):
    """Return two rods' nearest shares and their distance [m]. The rods are a-b and c-d (Ericson, 2005, 5.1.9)."""
    uu, vv, uv, uw, vw = 0.0, 0.0, 0.0, 0.0, 0.0
    for x in range(3):
        u, v, w = b[x] - a[x], d[x] - c[x], a[x] - c[x]
        uu += u * u
        vv += v * v
        uv += u * v
        uw += u * w
        vw += v * w
    s, t = 0.0, 0.0
    if uu > 1e-18:
        det = uu * vv - uv * uv
        if det > 1e-12 * uu * vv:
            s = min(1.0, max(0.0, (uv * vw - vv * uw) / det))
        if vv > 1e-18:
            t = (uv * s + vw) / vv
            if t < 0.0:
                t, s = 0.0, min(1.0, max(0.0, -uw / uu))
            elif t > 1.0:
                t, s = 1.0, min(1.0, max(0.0, (uv - uw) / uu))
        else:
            s = min(1.0, max(0.0, -uw / uu))
    elif vv > 1e-18:
        t = min(1.0, max(0.0, vw / vv))
    square = 0.0
    for x in range(3):
        square += (a[x] + s * (b[x] - a[x]) - c[x] - t * (d[x] - c[x])) ** 2
    return s, t, sqrt(square)

"""Vectors of three numbers as tuples, which kernels hold in registers."""

from __future__ import annotations

from math import cos, sin, sqrt

from comove.arrays import Array
from comove.compiled import kernel

Triple = tuple[float, float, float]


@kernel
def cross(a: Triple, b: Triple) -> Triple:
    """Return the cross product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@kernel
def dot(a: Triple, b: Triple) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel
def plus(a: Triple, b: Triple, factor: float = 1.0) -> Triple:
    """Return a + factor b."""
    return a[0] + factor * b[0], a[1] + factor * b[1], a[2] + factor * b[2]


@kernel
def length(a: Triple) -> float:
    """Return the length of a vector."""
    return sqrt(dot(a, a))


@kernel
def rotated(r: Array, v: Triple | Array) -> Triple:
    """Return R v."""
    return (
        r[0, 0] * v[0] + r[0, 1] * v[1] + r[0, 2] * v[2],
        r[1, 0] * v[0] + r[1, 1] * v[1] + r[1, 2] * v[2],
        r[2, 0] * v[0] + r[2, 1] * v[1] + r[2, 2] * v[2],
    )


@kernel
def rotated_back(r: Array, v: Triple | Array) -> Triple:
    """Return R^T v."""
    return (
        r[0, 0] * v[0] + r[1, 0] * v[1] + r[2, 0] * v[2],
        r[0, 1] * v[0] + r[1, 1] * v[1] + r[2, 1] * v[2],
        r[0, 2] * v[0] + r[1, 2] * v[1] + r[2, 2] * v[2],
    )


@kernel
def about(k: Triple, angle: float, v: Triple) -> Triple:
    """Rotate v about the unit vector k by an angle [rad]. See Rodrigues (1840)."""
    c, s = cos(angle), sin(angle)
    return plus(plus((c * v[0], c * v[1], c * v[2]), cross(k, v), s), k, (1.0 - c) * dot(k, v))


@kernel
def about_axis(k: Triple, at: Triple, angle: float, p: Triple) -> Triple:
    """Rotate p by an angle [rad] about direction k through `at`."""
    return plus(at, about(k, angle, plus(p, at, -1.0)))

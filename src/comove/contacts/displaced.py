"""Parts in the frames of obstacles that translate and rotate.

A displaced obstacle is as far from a part as the resting one is from the part transformed by the inverse
displacement. An *instant* is a tuple of two samples of the displacements and a share of the time between them.
"""

from __future__ import annotations

from math import cos, sin, sqrt

from comove.compiled import kernel
from comove.geometry.distances import REACH

Instant = tuple[int, int, float]

RESTING = (0, 0, 0.0)
"""The instant of obstacles that do not move."""


@kernel(counted=False)
def instant_at(moved, t):
    """Return the instant of a normalised time. It is 0 at the first sample, 1 at the last."""
    n = moved.offsets.shape[0]
    if n < 2:
        return 0, 0, 0.0
    at = min(max(t, 0.0), 1.0) * (n - 1)
    first = min(int(at), n - 2)
    return first, first + 1, at - first


@kernel(counted=False)
def carried_back(moved, row, instant, x, y, z):
    """Transform a point [m] into an obstacle's resting frame at an instant."""
    x, y, z = shifted_back(moved, row, instant, x, y, z)
    angle = angle_at(moved, row, instant) if moved.offsets.shape[0] > 0 else 0.0
    if angle == 0.0:
        return x, y, z
    a, b, c = moved.centers[row, 0], moved.centers[row, 1], moved.centers[row, 2]
    u, v, w = turned(moved.axes[row], cos(angle), -sin(angle), x - a, y - b, z - c)
    return a + u, b + v, c + w


@kernel(counted=False)
def shifted_back(moved, row, instant, x, y, z):
    """Undo an obstacle's translation of a point [m]. This suffices for distances from its centre."""
    if moved.offsets.shape[0] == 0:
        return x, y, z
    return (
        x - offset_at(moved, row, instant, 0),
        y - offset_at(moved, row, instant, 1),
        z - offset_at(moved, row, instant, 2),
    )


@kernel(counted=False)
def carried_forward(moved, row, instant, point):
    """Transform a point from an obstacle's resting frame, in place; array, shape (3,) [m]."""
    if moved.offsets.shape[0] == 0:
        return
    center = moved.centers[row]
    for k in range(3):
        point[k] -= center[k]
    turned_forward(moved, row, instant, point)
    for k in range(3):
        point[k] += center[k]
        point[k] += offset_at(moved, row, instant, k)


@kernel(counted=False)
def turned_forward(moved, row, instant, direction):
    """Rotate a direction from an obstacle's resting frame, in place; array, shape (3,)."""
    angle = angle_at(moved, row, instant) if moved.offsets.shape[0] > 0 else 0.0
    if angle != 0.0:
        x, y, z = turned(moved.axes[row], cos(angle), sin(angle), direction[0], direction[1], direction[2])
        direction[0], direction[1], direction[2] = x, y, z


@kernel(counted=False)
def moves(moved, row):
    """Return whether an obstacle ever moves or turns."""
    for s in range(moved.offsets.shape[0]):
        if moved.angles[s, row] != 0.0:
            return True
        for k in range(3):
            if moved.offsets[s, row, k] != 0.0:
                return True
    return False


@kernel(counted=False)
def farthest_moved(moved, obstacles, first, last):
    """Bound any obstacle point's displacement [m] between two samples from above."""
    farthest = 0.0
    for row in range(obstacles.shape[0] if moved.offsets.shape[0] > 0 else 0):
        square = 0.0
        for k in range(3):
            square += (moved.offsets[last, row, k] - moved.offsets[first, row, k]) ** 2
        angle = abs(moved.angles[last, row] - moved.angles[first, row])
        farthest = max(farthest, sqrt(square) + angle * obstacles[row, REACH])
    return farthest


@kernel(counted=False)
def offset_at(moved, row, instant, axis):
    """Return an obstacle's displacement [m] along a world axis, 0 to 2."""
    first, last, share = instant
    return (1.0 - share) * moved.offsets[first, row, axis] + share * moved.offsets[last, row, axis]


@kernel(counted=False)
def angle_at(moved, row, instant):
    """Return the angle [rad] of an obstacle at an instant."""
    first, last, share = instant
    return (1.0 - share) * moved.angles[first, row] + share * moved.angles[last, row]


@kernel(counted=False)
def turned(axis, cosine, sine, x, y, z):
    """Rotate a vector about a unit vector by Rodrigues' formula (1840)."""
    a, b, c = axis[0], axis[1], axis[2]
    along = (1.0 - cosine) * (a * x + b * y + c * z)
    return (
        cosine * x + sine * (b * z - c * y) + along * a,
        cosine * y + sine * (c * x - a * z) + along * b,
        cosine * z + sine * (a * y - b * x) + along * c,
    )

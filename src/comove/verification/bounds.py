"""Upper bounds of speeds, accelerations and third derivatives over continuous time.

On an interval between two knots the second derivative of q is ``(P + Q t) exp(-omega t)``, fixed by its values at
both ends: a line times a decay. Its norm is therefore at most ``exp(omega h)`` times the larger end value, and its
derivative is bounded likewise. Through the coordinates this bounds the derivatives of every node. Then, between two
knots, a node stays within ``h^2/8 max|y''|`` of its chord, its velocity within ``h^2/8 max|y'''|`` of its chord, and
its acceleration changes by at most ``h/2 max|y'''|`` from the nearer knot. No finite differences are used.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.constraints.constraint import nearest_on_chords
from comove.coordination.coordinates import ANGLE, POINT, QUATERNION
from comove.coordination.motion import CoordinatedMotion
from comove.primitives.flow import OMEGA
from comove.primitives.forcing import INTERVAL, N_INTERVALS

Array = NDArray[np.float64]

SUBDIVISIONS = (1, 8, 64)  # of an interval, tried in turn where a bound alone breaks the limit


class NodeBounds(NamedTuple):
    """Upper bounds of the nodes' derivatives on every interval, in unit duration.

    Attributes
    ----------
    acceleration, jerk : arrays, shape (n_intervals, n_nodes), bounds of the second and third derivative
    """

    acceleration: Array
    jerk: Array


def node_bounds(motion: CoordinatedMotion) -> NodeBounds:
    """Return bounds of every node's derivatives; infinite where an orientation is not defined."""
    coordinates, knots = motion.coordinates, motion.knots
    shape = (N_INTERVALS, len(coordinates.blocks.node))
    acceleration, jerk = np.zeros(shape), np.zeros(shape)
    for part in coordinates.parts:
        center, turn = np.split(knots[:, :, part.columns], [coordinates.n_dims], axis=2)
        _, second, third = column_bounds(center)
        swing, twist = np.zeros(N_INTERVALS), np.zeros(N_INTERVALS)
        if part.kind != POINT:
            swing, twist = _turning_bounds(part.kind, turn)
        points = part.points[:, :2] if part.kind == ANGLE else part.points
        reach = lengths(points)
        with np.errstate(invalid="ignore"):
            acceleration[:, part.nodes] = second[:, None] + swing[:, None] * reach
            jerk[:, part.nodes] = third[:, None] + twist[:, None] * reach
    return NodeBounds(acceleration, jerk)


def largest_speed(motion: CoordinatedMotion, velocity: Array, jerk: Array) -> float:
    """Return an upper bound of the speed of every hand at every instant [m/s].

    Parameters
    ----------
    velocity : array, shape (n_knots, n_manipulators, 3), derivative by normalised time, at the knots
    jerk : `jerk` of the motion's `node_bounds`
    """
    speed = lengths(velocity)
    bound = np.maximum(speed[1:], speed[:-1]) + INTERVAL**2 / 8 * jerk[:, : speed.shape[1]]
    return float(bound.max()) / motion.scene.duration


def largest_acceleration(motion: CoordinatedMotion, acceleration: Array, jerk: Array, limit: float) -> float:
    """Return an upper bound of the acceleration of every hand at every instant [m/s^2].

    It is tightened until it keeps `limit` or a sample breaks `limit`.

    Parameters
    ----------
    acceleration : array, shape (n_knots, n_manipulators, 3), second derivative by normalised time, at the knots
    jerk : `jerk` of the motion's `node_bounds`
    limit : [m/s^2]
    """
    scale, n_hands = motion.scene.duration**2, acceleration.shape[1]
    jerk, last, bound = jerk[:, :n_hands], acceleration[-1], np.inf
    for parts in SUBDIVISIONS:
        if parts > 1:
            s = np.linspace(0.0, 1.0, N_INTERVALS * parts + 1)[:-1]
            acceleration = motion.coordinates.motion(motion.at(s))[2, :, :n_hands]
            # The end is that of the knots: by `at`, the forcing is cut off there.
            acceleration = np.concatenate([acceleration, last[None]])
        size = lengths(acceleration)
        change = np.repeat(jerk, parts, axis=0) * (0.5 * INTERVAL / parts)
        bound = float((np.maximum(size[1:], size[:-1]) + change).max()) / scale
        if bound <= limit or size.max() / scale > limit:
            break
    return bound


def least_length(columns: Array, second: Array) -> Array:
    """Return a lower bound of |x| on every interval; array, shape (n_intervals,).

    Parameters
    ----------
    columns : array, shape (3, n_knots, width), x and its first two derivatives
    second : array, shape (n_intervals,), upper bound of |x''|
    """
    return nearest_on_chords(columns[0]) - INTERVAL**2 / 8 * second


def lengths(vectors: Array) -> Array:
    """Return Euclidean lengths; (..., width) -> (...).

    Twice as fast as numpy's norm, which matters as the checks need very many of them.
    """
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def column_bounds(columns: Array) -> tuple[Array, Array, Array]:
    """Return upper bounds of the norms of the first three derivatives of a vector x on every interval.

    Parameters
    ----------
    columns : array, shape (3, n_knots, width), x and its first two derivatives

    Returns
    -------
    first, second, third : arrays, shape (n_intervals,)
    """
    ends = lengths(columns[2])
    second = np.exp(OMEGA * INTERVAL) * np.maximum(ends[1:], ends[:-1])
    speeds = lengths(columns[1])
    first = np.maximum(speeds[1:], speeds[:-1]) + 0.5 * INTERVAL * second
    p = columns[2, :-1]
    q = (columns[2, 1:] * np.exp(OMEGA * INTERVAL) - p) / INTERVAL
    begin, end = q - OMEGA * p, q - OMEGA * p - OMEGA * INTERVAL * q
    third = np.maximum(lengths(begin), lengths(end))
    return first, second, third


def _turning_bounds(kind: int, turn: Array) -> tuple[Array, Array]:
    """Return bounds of the second and third derivative of a turning point at unit distance from the centre.

    With a1, a2, a3 the bounds of the derivatives of v divided by the least |v|, a unit vector u = v/|v| has

        |u'| <= a1,   |u''| <= sqrt((a2 + a1^2)^2 + a1^4),   |u'''| <= a3 + 2 sqrt(3) a1 a2 + 3 a1^3:

    across u, u'' is the part of v'' there less 2 |v|' u', along u it is -|u'|^2; and the derivatives of
    v -> v/|v| have the norms 1/|v|, (2/sqrt 3)/|v|^2 and 3/|v|^3. A quaternion p turns a point r to p r conj(p).

    Parameters
    ----------
    turn : array, shape (3, n_knots, width), the orientation's columns of q and their first two derivatives

    Returns
    -------
    second, third : arrays, shape (n_intervals,)
    """
    first, second, third = column_bounds(turn)
    if kind == ANGLE:
        return np.hypot(second, first**2), third + 3 * first * second + first**3
    least = least_length(turn, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        a1, a2, a3 = (np.where(least > 0, x / least, np.inf) for x in (first, second, third))
    across = a2 + a1**2
    bend, swing = np.hypot(across, a1**2), a3 + 2 * np.sqrt(3.0) * a1 * a2 + 3 * a1**3
    if kind == QUATERNION:
        return np.hypot(2 * across, 4 * a1**2), 2 * swing + 6 * a1 * bend
    return bend, swing

"""Upper bounds of hand speeds and accelerations over continuous time.

Both are known exactly at the knots. Between two knots the velocity stays within ``h^2/8 max|y'''|`` of its chord
and the acceleration changes by at most ``h/2 max|y'''|``; the third derivative is bounded from the transformed
system, whose second derivative on an interval is ``(P + Q t) exp(-omega t)``, fixed by its values at both ends.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import ANGLE, POINT, QUATERNION, turning_bounds
from comove.coordination.motion import CoordinatedMotion
from comove.primitives.basis import INTERVAL, N_INTERVALS, OMEGA

Array = NDArray[np.float64]

SUBDIVISIONS = (1, 8, 64)  # of an interval, tried in turn where a bound alone breaks the limit


def largest_speed(motion: CoordinatedMotion, velocity: Array, jerk: Array) -> float:
    """Upper bound of the speed of every hand at every instant [m/s].

    Parameters
    ----------
    velocity : array, shape (n_knots, n_manipulators, 3), by normalised time, at the knots
    jerk : as `jerk_bound` gives it
    """
    speed = np.linalg.norm(velocity, axis=2)
    bound = np.maximum(speed[1:], speed[:-1]) + INTERVAL**2 / 8 * jerk[:, : speed.shape[1]]
    return float(bound.max()) / motion.scene.duration


def largest_acceleration(motion: CoordinatedMotion, acceleration: Array, jerk: Array, limit: float) -> float:
    """Upper bound of the acceleration of every hand at every instant [m/s^2], as tight as `limit` asks.

    Parameters
    ----------
    acceleration : array, shape (n_knots, n_manipulators, 3), by normalised time, at the knots
    jerk : as `jerk_bound` gives it
    limit : [m/s^2]
    """
    scale, n_hands = motion.scene.duration**2, acceleration.shape[1]
    jerk = jerk[:, :n_hands]
    bound = np.inf
    for parts in SUBDIVISIONS:
        if parts > 1:
            s = np.linspace(0.0, 1.0, N_INTERVALS * parts + 1)
            s[-1] = 1.0
            acceleration = motion.coordinates.motion(motion.at(s))[2, :, :n_hands]
            acceleration[-1] = motion.coordinates.motion(motion.knots[:, -1:])[2, 0, :n_hands]
        size = np.linalg.norm(acceleration, axis=2)
        ends = np.maximum(size[1:], size[:-1])
        change = np.repeat(jerk, parts, axis=0) * (0.5 * INTERVAL / parts)
        bound = float((ends + change).max()) / scale
        if bound <= limit or size.max() / scale > limit:
            break
    return bound


def jerk_bound(motion: CoordinatedMotion) -> Array:
    """Upper bound of every node's third derivative on every interval; array, shape (n_intervals, n_nodes).

    With a1, a2, a3 the derivatives of v over the least |v|, a unit vector u = v/|v| has
    ``|u'''| <= a3 + 3 (2/sqrt 3) a1 a2 + 3 a1^3``: the norms of the derivatives of v -> v/|v| are 1/|v|,
    (2/sqrt 3)/|v|^2 and 3/|v|^3.
    """
    knots, coordinates = motion.knots, motion.coordinates
    bound = np.zeros((N_INTERVALS, len(coordinates.blocks.node)))
    for b, (kind, columns, entries) in enumerate(coordinates._parts()):
        part = knots[:, :, columns]
        n_dims = coordinates.n_dims
        change = _third(part[2, :, :n_dims])[:, None]
        if kind != POINT:
            turn = part[:, :, n_dims:]
            spin, twist = turning_bounds(kind, turn)
            third = _third(turn[2])
            reach = np.linalg.norm(coordinates.blocks.point[entries], axis=1)
            if kind == ANGLE:
                swing = third + 3 * spin * twist + spin**3
            else:
                factor = 2.0 if kind == QUATERNION else 1.0
                a1 = spin / factor
                a2 = twist / factor  # bounds |v''|/|v| from above
                with np.errstate(invalid="ignore", divide="ignore"):
                    least = _least_length(turn, a1)
                    swing = third / least + 2 * np.sqrt(3.0) * a1 * a2 + 3 * a1**3
                if kind == QUATERNION:  # x = p r conj(p)
                    swing = 2 * swing + 6 * a1 * np.hypot(a2, a1**2)
            change = change + reach * swing[:, None]
        bound[:, coordinates.blocks.node[coordinates._entries(b)]] = change
    return bound


def _third(second: Array) -> Array:
    """Bound of |x'''| on every interval from x'' at the knots, (n_knots, width) -> (n_intervals,)."""
    p = second[:-1]
    q = (second[1:] * np.exp(OMEGA * INTERVAL) - p) / INTERVAL
    begin, end = q - OMEGA * p, q - OMEGA * p - OMEGA * INTERVAL * q
    return np.maximum(np.linalg.norm(begin, axis=1), np.linalg.norm(end, axis=1))


def _least_length(turn: Array, spin: Array) -> Array:
    """Least |v| on every interval, such that |v'|/|v| <= spin was derived from it."""
    ends = np.linalg.norm(turn[2], axis=1)
    acceleration = np.exp(OMEGA * INTERVAL) * np.maximum(ends[1:], ends[:-1])
    speeds = np.linalg.norm(turn[1], axis=1)
    speed = np.maximum(speeds[1:], speeds[:-1]) + 0.5 * INTERVAL * acceleration
    return np.where(spin > 0, speed / np.where(spin > 0, spin, 1.0), 1.0)

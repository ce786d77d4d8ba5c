"""An upper bound of the hands' jerk over continuous time, by truncated power series.

Between two knots the second derivative of q is ``(P + Q t) exp(-omega t)`` (see `bounds`), so q has derivatives of
every order there, known at both ends. Carried through the coordinates as power series they give the jerk of every
hand at both ends exactly; in between it is at most the larger of the two plus ``h^2/8`` times a bound of its second
derivative. That bound is a majorant: a series with coefficients that no coefficient of the true one exceeds.
"""

from __future__ import annotations

from math import factorial

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import ANGLE, DIRECTION, POINT, QUATERNION
from comove.coordination.motion import CoordinatedMotion
from comove.primitives.flow import OMEGA
from comove.primitives.forcing import INTERVAL
from comove.verification.bounds import (
    largest_acceleration,
    largest_speed,
    least_length,
    lengths,
    node_bounds,
)

Array = NDArray[np.float64]

FIFTH = 5  # derivative, the second of the jerk


def largest_jerk(motion: CoordinatedMotion, jerk: Array) -> float:
    """Return an upper bound of the jerk of every hand at every instant [m/s^3].

    Infinite where an orientation is not defined.

    Parameters
    ----------
    jerk : `jerk` of the motion's `node_bounds`: a looser bound, which is used where this one fails
    """
    coordinates, knots, worst = motion.coordinates, motion.knots, 0.0
    for part in coordinates.parts:
        hands = part.nodes < len(motion.scene.manipulators)
        columns, points = knots[:, :, part.columns], part.points[hands]
        center = slice(0, coordinates.n_dims)
        turn = slice(coordinates.n_dims, None)
        ends = [
            6.0
            * (
                _turned(part.kind, series[:, :, turn], points, coordinates.n_dims)[3]
                + series[3, :, None, center]
            )
            for series in _series_at_ends(columns)
        ]
        reach = lengths(points[:, :2] if part.kind == ANGLE else points)
        bend = _norms(columns[:, :, center])[FIFTH, :, None] + (
            _turning(part.kind, columns[:, :, turn])[:, None] * reach if part.kind != POINT else 0.0
        )
        bound = np.maximum(*map(lengths, ends)) + INTERVAL**2 / 8 * bend
        bound = np.fmin(bound, jerk[:, part.nodes[hands]])  # which is never no number
        worst = max(worst, float(bound.max(initial=0.0)))
    return worst / motion.scene.duration**3


def largest_rates(motion: CoordinatedMotion) -> tuple[float, float, float]:
    """Return upper bounds of the hands' speed, acceleration and jerk at every instant, as tight as possible.

    Returns
    -------
    speed, acceleration, jerk : [m/s, m/s^2, m/s^3]
    """
    _, velocity, acceleration = motion.coordinates.motion(motion.knots)[
        :, :, : len(motion.scene.manipulators)
    ]
    jerk = node_bounds(motion).jerk
    tightest = float(lengths(acceleration).max()) / motion.scene.duration**2
    return (
        largest_speed(motion, velocity, jerk),
        largest_acceleration(motion, acceleration, jerk, tightest),
        largest_jerk(motion, jerk),
    )


def _series_at_ends(columns: Array) -> tuple[Array, Array]:
    """Return the power series of q at the start and at the end of every interval.

    Arrays, shape (4, n_intervals, width).
    """
    p, q, decay = columns[2, :-1], _slopes(columns), np.exp(-OMEGA * INTERVAL)
    third = q - OMEGA * p, decay * (q - OMEGA * p - OMEGA * INTERVAL * q)
    begin = np.stack([*columns[:, :-1], third[0]])
    end = np.stack([*columns[:, 1:], third[1]])
    scale = np.array([1.0, 1.0, 0.5, 1.0 / 6.0])[:, None, None]
    return scale * begin, scale * end


def _slopes(columns: Array) -> Array:
    """Return Q of every interval, array of shape (n_intervals, width)."""
    return (columns[2, 1:] * np.exp(OMEGA * INTERVAL) - columns[2, :-1]) / INTERVAL


def _norms(columns: Array) -> Array:
    """Return bounds of the norms of the derivatives of x, up to the fifth, on every interval.

    Array, shape (6, n_intervals).

    The decay is at most 1, and its factor is a line, whose norm is largest at an end. The norm of x itself is not
    bounded (row 0 is 0).
    """
    p, q = columns[2, :-1], _slopes(columns)
    bounds = np.zeros((FIFTH + 1, len(p)))
    for order in range(2, FIFTH + 1):
        m = order - 2
        line = [
            (-OMEGA) ** m * (p + q * t) + (m * (-OMEGA) ** (m - 1) * q if m else 0.0) for t in (0.0, INTERVAL)
        ]
        bounds[order] = np.maximum(*map(lengths, line))
    speed = lengths(columns[1])
    bounds[1] = np.maximum(speed[1:], speed[:-1]) + 0.5 * INTERVAL * bounds[2]
    return bounds


def _turned(kind: int, turn: Array, points: Array, n_dims: int) -> Array:
    """Return the power series of turned points; array, shape (4, n_intervals, n_points, n_dims).

    Parameters
    ----------
    turn : array, shape (4, n_intervals, width), power series of the orientation's columns
    points : array, shape (n_points, 3), in the group's frame [m]
    """
    if kind == POINT:
        return np.zeros((len(turn), 1, 1, 1))
    if kind == ANGLE or (kind == DIRECTION and turn.shape[2] == 2):
        if kind == ANGLE:
            unit = _exponential(1j * turn[:, :, 0])
        else:
            v = turn[:, :, 0] + 1j * turn[:, :, 1]
            unit = _product(v, _power(_product(v, v.conj()).real, -0.5))
        moved = unit[:, :, None] * (points[:, 0] + 1j * points[:, 1])
        flat = np.stack([moved.real, moved.imag], axis=-1)
        return flat if n_dims == 2 else np.concatenate([flat, np.zeros((*flat.shape[:-1], 1))], axis=-1)
    if kind == DIRECTION:
        unit = _product(turn, _power(_dot(turn, turn), -0.5)[:, :, None])
        return unit[:, :, None, :] * points[:, :1]
    w, axis, n = turn[:, :, :1], turn[:, :, 1:], len(points)
    doubled = _dot(axis, axis)
    real = _product(w[:, :, 0], w[:, :, 0])
    share = _power(real + doubled, -1.0)[:, :, None, None]
    along = np.einsum("kiw,nw->kin", axis, points)
    crossed = np.cross(axis[:, :, None, :], points)
    rotated = (
        (real - doubled)[:, :, None, None] * points
        + 2 * _product(along[..., None], np.repeat(axis[:, :, None, :], n, axis=2))
        + 2 * _product(w[:, :, None, :], crossed)
    )
    return _product(rotated, share)


def _turning(kind: int, turn: Array) -> Array:
    """Return a bound of the fifth derivative of a turning point at unit distance.

    Array, shape (n_intervals,).

    A unit vector (v + e)/|v + e| is majorised by (1 + x) (1 - 2x - x^2)^(-1/2) with x = |e|/|v|, a point that a
    quaternion turns by (1 + x)^2 (1 - 2x - x^2)^(-1), and a point turned by an angle by exp(x).
    """
    norms = _norms(turn)
    x = norms / np.array([factorial(k) for k in range(FIFTH + 1)])[:, None]
    x[0] = 0.0
    one = np.zeros_like(x)
    one[0] = 1.0
    if kind == ANGLE:
        majorant = _exponential(x)
    else:
        least = least_length(turn, norms[2])
        with np.errstate(divide="ignore", invalid="ignore"):
            x[1:] = np.where(least > 0, x[1:] / least, np.inf)
            near = one - 2 * x - _product(x, x)
            grown = one + x
            majorant = _product(grown, _power(near, -0.5))
            if kind == QUATERNION:
                majorant = _product(majorant, majorant)
    return factorial(FIFTH) * majorant[FIFTH]


def _product(a: Array, b: Array) -> Array:
    """Return the product of two power series; the first axis is the order."""
    return np.stack([sum(a[i] * b[k - i] for i in range(k + 1)) for k in range(len(a))])


def _dot(a: Array, b: Array) -> Array:
    """Return the power series of the inner product of two vectors, whose components are along the last axis."""
    return np.stack([sum((a[i] * b[k - i]).sum(axis=-1) for i in range(k + 1)) for k in range(len(a))])


def _power(s: Array, exponent: float) -> Array:
    """Return the power series of s to a power, s[0] > 0 (the recurrence of J. C. P. Miller)."""
    result = np.zeros_like(s)
    result[0] = s[0] ** exponent
    for k in range(1, len(s)):
        terms = ((exponent * i - (k - i)) * s[i] * result[k - i] for i in range(1, k + 1))
        result[k] = sum(terms) / (k * s[0])
    return result


def _exponential(s: Array) -> Array:
    """Return the power series of exp(s)."""
    result = np.zeros_like(s)
    result[0] = np.exp(s[0])
    for k in range(1, len(s)):
        result[k] = sum(i * s[i] * result[k - i] for i in range(1, k + 1)) / k
    return result

"""Upper bounds of speeds, accelerations and jerks over continuous time.

On an interval between two knots the second derivative of q is ``(P + Q t) exp(-omega t)``, fixed by its values at
both ends: a line times a decay. Its norm is therefore at most the larger norm of the line at an end, and its
derivatives are bounded likewise. Through the coordinates this bounds the derivatives of every keypoint. Then, between
two knots, a keypoint stays within ``h^2/8 max|y''|`` of its chord, its velocity within ``h^2/8 max|y'''|`` of its
chord, and its acceleration changes by at most ``h/2 max|y'''|`` from the nearer knot. No finite differences are used.

The jerk of a limited motion is bounded more tightly. q has derivatives of every order, known at both ends of an
interval; propagated through the coordinates as truncated power series they give the jerk of every end effector at
both ends exactly. In between it is at most the larger of the two plus ``h^2/8`` times a bound of its second
derivative. That bound is a majorant: a series with coefficients that no coefficient of the true one exceeds.
"""

from __future__ import annotations

from functools import lru_cache
from math import exp, factorial, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, inner
from comove.compiled import kernel
from comove.dmp.system import INTERVAL, N_INTERVALS, OMEGA
from comove.model.blocks import contiguous
from comove.model.constraints.constraint import nearest_on_chords
from comove.model.coordinates import ANGLE, DIRECTION, POINT, QUATERNION
from comove.model.motion import CoordinatedMotion

FIFTH = 5  # derivative, the second of the jerk
SUBDIVISIONS = (1, 8, 64)  # of an interval, tried in turn where a bound alone breaks the limit


class NodeBounds(NamedTuple):
    """Upper bounds of the keypoints' derivatives on every interval, in unit duration.

    Attributes
    ----------
    acceleration, jerk : arrays, shape (n_intervals, n_nodes), bounds of the second and third derivative
    """

    acceleration: Array
    jerk: Array


@lru_cache(maxsize=4)  # a motion's payload is verified, then its joints
def node_bounds(motion: CoordinatedMotion) -> NodeBounds:
    """Return bounds of keypoints' derivatives. They are infinite where an orientation is not defined."""
    coordinates, knots = motion.coordinates, motion.knots
    shape = (N_INTERVALS, len(coordinates.blocks.node))
    acceleration, jerk = np.zeros(shape), np.zeros(shape)
    for part in coordinates.parts:
        center, turn = np.split(knots[:, :, part.columns], [coordinates.n_dims], axis=2)
        _, _, second, third = derivative_bounds(center)
        swing, twist = np.zeros(N_INTERVALS), np.zeros(N_INTERVALS)
        if part.kind != POINT:
            swing, twist = turning_bounds(part.kind, turn)
        points = part.points[:, :2] if part.kind == ANGLE else part.points
        reach = lengths(points)
        with np.errstate(invalid="ignore"):
            acceleration[:, contiguous(part.nodes)] = second[:, None] + swing[:, None] * reach
            jerk[:, contiguous(part.nodes)] = third[:, None] + twist[:, None] * reach
    for bound in (acceleration, jerk):
        bound.setflags(write=False)
    return NodeBounds(acceleration, jerk)


def turn_jerk(motion: CoordinatedMotion, node: int) -> Array:
    """Bound the second derivative of a body's angular velocity; array, shape (n_intervals,).

    In unit duration. A body with the unit quaternion u has the angular velocity w = 2 u' conj(u), so that |w"| is at
    most 2 |u'''| + 6 |u'| |u"|, as the third derivative of a point at unit distance is.

    Parameters
    ----------
    node : number of a keypoint of the body
    """
    part = next(part for part in motion.coordinates.parts if node in part.nodes)
    if part.kind == POINT:
        return np.zeros(N_INTERVALS)
    return turning_bounds(part.kind, motion.knots[:, :, part.columns][:, :, motion.coordinates.n_dims :])[1]


def largest_speed(motion: CoordinatedMotion, velocity: Array, jerk: Array) -> float:
    """Bound the speed of all end effectors from above [m/s].

    Parameters
    ----------
    velocity : array, shape (n_knots, n_manipulators, 3), derivative by normalised time, at the knots
    jerk : `jerk` of the motion's `node_bounds`
    """
    speed = lengths(velocity)
    bound = np.maximum(speed[1:], speed[:-1]) + INTERVAL**2 / 8 * jerk[:, : speed.shape[1]]
    return float(bound.max()) / motion.scene.duration


def largest_acceleration(motion: CoordinatedMotion, acceleration: Array, jerk: Array, limit: float) -> float:
    """Bound the acceleration of all end effectors from above [m/s^2].

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


def largest_jerk(motion: CoordinatedMotion, jerk: Array) -> float:
    """Bound the jerk of all end effectors from above [m/s^3].

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
        bend = derivative_bounds(columns[:, :, center], FIFTH)[FIFTH, :, None] + (
            _turning(part.kind, columns[:, :, turn])[:, None] * reach if part.kind != POINT else 0.0
        )
        bound = np.maximum(*map(lengths, ends)) + INTERVAL**2 / 8 * bend
        bound = np.fmin(bound, jerk[:, part.nodes[hands]])  # which is never no number
        worst = max(worst, float(bound.max(initial=0.0)))
    return worst / motion.scene.duration**3


def largest_rates(motion: CoordinatedMotion) -> tuple[float, float, float]:
    """Bound the end effectors' speed, acceleration and jerk as tightly as possible.

    Returns
    -------
    speed, acceleration, jerk : [m/s, m/s^2, m/s^3]
    """
    _, velocity, acceleration = motion.nodes_at_knots[:, :, : len(motion.scene.manipulators)]
    jerk = node_bounds(motion).jerk
    tightest = float(lengths(acceleration).max()) / motion.scene.duration**2
    return (
        largest_speed(motion, velocity, jerk),
        largest_acceleration(motion, acceleration, jerk, tightest),
        largest_jerk(motion, jerk),
    )


def least_length(columns: Array, second: Array) -> Array:
    """Return a lower bound of |x| on every interval; array, shape (n_intervals,).

    Parameters
    ----------
    columns : array, shape (3, n_knots, width), x and its first two derivatives
    second : array, shape (n_intervals,), upper bound of |x''|
    """
    return nearest_on_chords(columns[0]) - INTERVAL**2 / 8 * second


def lengths(vectors: Array) -> Array:
    """Return Euclidean lengths; (..., width) -> (...)."""
    return np.sqrt(inner(vectors, vectors))


def derivative_bounds(columns: Array, highest: int = 3) -> Array:
    """Bound the norms of a vector's derivatives on every interval, by order.

    The decay of the second derivative and its derivatives is at most 1, and its factor is a line, whose norm is
    largest at an end. The norm of x itself is not bounded (row 0 is 0).

    Parameters
    ----------
    columns : array, shape (3, n_knots, width), x and its first two derivatives

    Returns
    -------
    array, shape (highest + 1, n_intervals)
    """
    return _derivative_bounds(np.array(columns, order="C"), highest)


@kernel
def _derivative_bounds(columns: Array, highest: int) -> Array:
    n_intervals, width = columns.shape[1] - 1, columns.shape[2]
    bounds, growth = np.zeros((highest + 1, n_intervals)), exp(OMEGA * INTERVAL)
    for i in range(n_intervals):
        factor, change = 1.0, 0.0  # of the line's value, and of its slope
        for order in range(2, highest + 1):
            begin, end = 0.0, 0.0
            for c in range(width):
                p = columns[2, i, c]
                q = (columns[2, i + 1, c] * growth - p) / INTERVAL
                begin += (factor * p + change * q) ** 2
                end += (factor * (p + q * INTERVAL) + change * q) ** 2
            bounds[order, i] = sqrt(_larger(begin, end))
            factor, change = -OMEGA * factor, factor - OMEGA * change
        before, after = 0.0, 0.0
        for c in range(width):
            before += columns[1, i, c] ** 2
            after += columns[1, i + 1, c] ** 2
        bounds[1, i] = sqrt(_larger(before, after)) + 0.5 * INTERVAL * bounds[2, i]
    return bounds


@kernel
def _larger(a: float, b: float) -> float:
    """Return the larger of two numbers, or NaN if either is."""
    return b if b >= a or b != b else a


def _slopes(columns: Array) -> Array:
    """Return Q of every interval; array, shape (n_intervals, width)."""
    return (columns[2, 1:] * np.exp(OMEGA * INTERVAL) - columns[2, :-1]) / INTERVAL


def turning_bounds(kind: int, turn: Array) -> tuple[Array, Array]:
    """Bound a turning point's second and third derivative at unit distance.

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
    _, first, second, third = derivative_bounds(turn)
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


def _series_at_ends(columns: Array) -> tuple[Array, Array]:
    """Return q's power series at both ends of every interval.

    Arrays, shape (4, n_intervals, width).
    """
    p, q, decay = columns[2, :-1], _slopes(columns), np.exp(-OMEGA * INTERVAL)
    third = q - OMEGA * p, decay * (q - OMEGA * p - OMEGA * INTERVAL * q)
    begin = np.stack([*columns[:, :-1], third[0]])
    end = np.stack([*columns[:, 1:], third[1]])
    scale = np.array([1.0, 1.0, 0.5, 1.0 / 6.0])[:, None, None]
    return scale * begin, scale * end


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
    """Bound the fifth derivative of a turning point at unit distance; array, shape (n_intervals,).

    A unit vector (v + e)/|v + e| is majorised by (1 + x) (1 - 2x - x^2)^(-1/2) with x = |e|/|v|, a point that a
    quaternion turns by (1 + x)^2 (1 - 2x - x^2)^(-1), and a point turned by an angle by exp(x).
    """
    norms = derivative_bounds(turn, FIFTH)
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
    """Return the power series of the inner product along the last axis."""
    return np.stack([sum((a[i] * b[k - i]).sum(axis=-1) for i in range(k + 1)) for k in range(len(a))])


def _power(s: Array, exponent: float) -> Array:
    """Return a power of a power series, s[0] > 0 (Miller's recurrence)."""
    result = np.zeros_like(s)
    result[0] = s[0] ** exponent
    for k in range(1, len(s)):
        terms = ((exponent * i - (k - i)) * s[i] * result[k - i] for i in range(1, k + 1))
        result[k] = sum(terms) / (k * s[0])
    return result


def _exponential(s: NDArray[Any]) -> NDArray[Any]:
    """Return the power series of exp(s)."""
    result = np.zeros_like(s)
    result[0] = np.exp(s[0])
    for k in range(1, len(s)):
        result[k] = sum(i * s[i] * result[k - i] for i in range(1, k + 1)) / k
    return result

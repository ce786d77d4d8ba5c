"""Limits of the end effectors in the safety filter.

They bound the length of velocities, accelerations and rotations. Each is a ball |M x - c| <= radius in the variables
x, approximated by tangent planes where a solution leaves it.
"""

from __future__ import annotations

from math import sqrt

import numpy as np

from comove.arrays import Array
from comove.compiled import kernel
from comove.control.safety.qp_workspace import LIMIT, QP

INSIDE, INSIDE_BENDS = 1e-3, 2e-2  # of a speed, and of an acceleration or a turn: how far inside tangents lie
ROUND, FAR_OUT = 1e-9, 1.5  # of a limit: rounding error, and factor for far outside


@kernel
def limit_rows(qp: QP, m: int, before: Array, wanted: Array, near: bool) -> int:
    """Set up the balls of limits and write tangents; return the number of rows.

    Tangents are written where the desired velocity is outside. An end effector that moves on an arc needs a
    centripetal acceleration w^2 r, which is then not available for braking, so rotations are bounded: where an
    obstacle is `near`, such that half of the acceleration is left; otherwise such that the rotation can be sustained
    at all.
    """
    freedom, rates, work = qp.freedom, qp.rates, qp.work
    n_hands, balls = before.shape[0], work.balls
    reach = rates.acceleration * rates.period
    for i in range(n_hands):
        for axis in range(3):
            balls[i, axis] = 0.0
            balls[n_hands + i, axis] = before[i, axis]
        # Who is too fast brakes as hard as he may.
        balls[i, 3] = max(rates.speed, length_of(before[i]) - 0.9 * reach) if reach < np.inf else rates.speed
        balls[n_hands + i, 3] = reach
    for g in range(freedom.spread.shape[0]):
        balls[2 * n_hands + g, 0] = balls[2 * n_hands + g, 1] = balls[2 * n_hands + g, 2] = 0.0
        balls[2 * n_hands + g, 3] = np.inf
    if reach < np.inf:
        n = freedom.basis.shape[2]
        right = np.zeros(n)
        for i in range(n_hands):
            for axis in range(3):
                for c in range(n):
                    right[c] += work.hands[i, axis, c] * before[i, axis]
        x = np.linalg.solve(np.ascontiguousarray(work.quadratic[:n, :n]), right)
        for g in range(freedom.spread.shape[0]):
            spread = freedom.spread[g]
            if spread == 0.0:
                continue
            turn = 0.0
            for axis in range(3):
                w = 0.0
                for c in range(n):
                    w += freedom.basis[g, 3 + axis, c] * x[c]
                turn += w * w
            turn = sqrt(turn) * spread
            free = sqrt(max((rates.acceleration - turn * turn / spread) * rates.acceleration, 0.0))
            most = sqrt((0.5 if near else 1.0) * rates.acceleration * spread)
            balls[2 * n_hands + g, 3] = max(most, turn - 0.5 * free * rates.period)
    for b in range(2 * n_hands):
        m = _tangent(qp, m, b, wanted[b % n_hands], np.zeros(3))
    return m


@kernel
def broken_limits(qp: QP, m: int, x: Array) -> tuple[int, bool]:
    """Write tangents to balls that x leaves. Return the number of rows, and whether x is far outside."""
    work = qp.work
    n, n_hands, n_balls = x.shape[0], work.hands.shape[0], work.balls.shape[0]
    y, far_out = np.empty(3), False
    for b in range(n_balls):
        if work.balls[b, 3] == np.inf:
            continue
        for axis in range(3):
            y[axis] = 0.0
            for c in range(n):
                y[axis] += _bound(qp, b, n_hands, axis, c) * x[c]
        m = _tangent(qp, m, b, y, np.zeros(3))
        away = (
            (y[0] - work.balls[b, 0]) ** 2 + (y[1] - work.balls[b, 1]) ** 2 + (y[2] - work.balls[b, 2]) ** 2
        )
        far_out = far_out or away > (FAR_OUT * work.balls[b, 3]) ** 2
    return m, far_out


@kernel
def bent_limits(qp: QP, m: int, x: Array, dt: float) -> int:
    """Write tangents to balls left by average velocities; return the number of rows.

    The average velocity of an end effector is its displacement to `work.after.nodes`, divided by `dt`. An end
    effector turns within a step, so this differs from its first velocity to second order, by an amount that is
    treated as constant until the next round.
    """
    work = qp.work
    n, n_hands = x.shape[0], work.hands.shape[0]
    way, bend = np.empty(3), np.empty(3)
    for b in range(2 * n_hands):
        i = b % n_hands
        for axis in range(3):
            way[axis] = (work.after.nodes[i, axis] - work.nodes[i, axis]) / dt
            bend[axis] = way[axis]
            for c in range(n):
                bend[axis] -= work.hands[i, axis, c] * x[c]
        m = _tangent(qp, m, b, way, bend)
    return m


@kernel
def _bound(qp: QP, b: int, n_hands: int, axis: int, c: int) -> float:
    """Return a variable's coefficient in the vector that ball `b` bounds.

    It is that of variable c, along an axis. The vector is the velocity of an end effector, or the rotation of a group
    times its `spread` [m/s].
    """
    freedom, work = qp.freedom, qp.work
    if b < 2 * n_hands:
        return work.hands[b % n_hands, axis, c]
    return freedom.spread[b - 2 * n_hands] * freedom.basis[b - 2 * n_hands, 3 + axis, c]


@kernel
def _tangent(qp: QP, m: int, b: int, y: Array, bend: Array) -> int:
    """Write a ball's tangent towards y [m/s] outside it; return the number of rows.

    `bend` is the part of y that is not linear in the variables.
    """
    points, work = qp.points, qp.work
    ball, n_hands = work.balls[b], work.hands.shape[0]
    x, y, z = y[0] - ball[0], y[1] - ball[1], y[2] - ball[2]
    length = sqrt(x * x + y * y + z * z)
    if not length > ball[3] * (1.0 + ROUND):
        return m
    x, y, z = out = x / length, y / length, z / length
    work.rows[m, :] = 0.0
    for c in range(work.hands.shape[2]):
        for axis in range(3):
            work.rows[m, c] -= out[axis] * _bound(qp, b, n_hands, axis, c)
    inside = INSIDE if b < n_hands else INSIDE_BENDS
    off = x * (ball[0] - bend[0]) + y * (ball[1] - bend[1]) + z * (ball[2] - bend[2])
    work.low[m] = -(1.0 - inside) * ball[3] - off
    work.owner[m] = LIMIT
    work.body[m] = points.node_group[b % n_hands] if b < 2 * n_hands else b - 2 * n_hands
    return m + 1


@kernel
def length_of(v: Array) -> float:
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])

"""The solution of the transformed system in closed form, used by every rollout and every step.

With ``omega = alpha_y / 2``, ``e = y - g`` and a forcing ``f0 + f1 t``,

    e(t)  = ((1 + omega t) e0 + t v0) exp(-omega t) + f0 c0(t) + f1 c1(t),

where c0 and c1 are the responses to a unit step and a unit ramp. Times are in durations.
"""

from __future__ import annotations

from math import exp
from typing import Any

import numpy as np

from comove.compiled import kernel
from comove.primitives.forcing import INTERVAL, N_INTERVALS, Array

ALPHA_Y = 25.0
OMEGA = ALPHA_Y / 2.0
LONG_AFTER = 1e6  # durations, after which nothing is left of any deviation


@kernel
def responses(t: float) -> tuple[float, float, float]:
    """Compute exp(-omega t), c0(t) and c1(t), by series where the closed forms lose digits by cancellation."""
    x = OMEGA * t
    decay = exp(-x)
    if x >= 1.0:
        return decay, (1.0 - (1.0 + x) * decay) / OMEGA**2, (x - 2.0 + (x + 2.0) * decay) / OMEGA**3
    term, c0, c1 = x * x / 2.0, 0.0, 0.0
    for k in range(2, 22):  # term = x^k / k! with alternating sign
        c0 += (k - 1) * term
        term = -term * x / (k + 1)
        c1 -= (k - 1) * term
    return decay, c0 / OMEGA**2, c1 / OMEGA**3


@kernel
def flow(
    t: float, response: tuple[float, float, float], error: Any, velocity: Any, force: Any, slope: Any
) -> tuple[Any, Any]:
    """Compute error and velocity after the time `t`, with its `responses`, under the forcing ``force + slope t``.

    Error, velocity, force and slope are numbers or arrays of one shape.
    """
    decay, c0, c1 = response
    rate = velocity + OMEGA * error
    return (
        (error + t * rate) * decay + force * c0 + slope * c1,
        (velocity - OMEGA * t * rate) * decay + force * t * decay + slope * c0,
    )


@kernel
def from_rest(psi: Array) -> Array:
    """Compute the motions that start at rest at the goal 0, one for every forcing function.

    Parameters
    ----------
    psi : array, shape (n_knots, n_functions)

    Returns
    -------
    array, shape (3, n_knots, n_functions): position, velocity and acceleration at the knots
    """
    n_knots, n_functions = psi.shape
    knots = np.zeros((3, n_knots, n_functions))
    response = responses(INTERVAL)
    for k in range(n_knots):
        for j in range(n_functions):
            position, velocity = knots[0, k, j], knots[1, k, j]
            knots[2, k, j] = -(OMEGA**2) * position - 2 * OMEGA * velocity + psi[k, j]
            if k + 1 < n_knots:
                slope = (psi[k + 1, j] - psi[k, j]) / INTERVAL
                position, velocity = flow(INTERVAL, response, position, velocity, psi[k, j], slope)
                knots[0, k + 1, j], knots[1, k + 1, j] = position, velocity
    return knots


@kernel
def values_at(knots: Array, force: Array, goal: Array, s: Array) -> Array:
    """Compute position, velocity and acceleration at any time on motions that are known at the knots.

    Parameters
    ----------
    knots : array, shape (3, n_knots, n_columns)
    force : array, shape (n_knots, n_columns), linear between the knots, zero after the last one
    goal : array, shape (n_columns,)
    s : array, shape (n_steps,), times from 0 on

    Returns
    -------
    array, shape (3, n_steps, n_columns)
    """
    n_columns = knots.shape[2]
    values = np.empty((3, s.shape[0], n_columns))
    for i in range(s.shape[0]):
        inside = min(s[i], LONG_AFTER)  # a whole number of knots must remain one
        k = min(int(inside * N_INTERVALS), N_INTERVALS)
        t = max(inside - k * INTERVAL, 0.0)
        response = responses(t)
        for j in range(n_columns):
            f0, slope = 0.0, 0.0
            if k < N_INTERVALS:
                f0, slope = force[k, j], (force[k + 1, j] - force[k, j]) / INTERVAL
            error, velocity = flow(t, response, knots[0, k, j] - goal[j], knots[1, k, j], f0, slope)
            values[0, i, j], values[1, i, j] = error + goal[j], velocity
            values[2, i, j] = -(OMEGA**2) * error - 2 * OMEGA * velocity + f0 + slope * t
    return values

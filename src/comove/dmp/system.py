"""The dynamical system of a primitive: phase, forcing functions, and flow.

The phase replaces time and gates the forcing term, equation (1b); ``s = t / duration`` is the normalised time. (The
paper's (1b) lost a sign: the phase must decay.) The forcing functions are the psi of equation (2), evaluated at the
knots. The transformed system is solved in closed form, for every rollout and every step: with ``omega = alpha_y /
2``, ``e = y - g`` and a forcing ``f0 + f1 t``,

    e(t)  = ((1 + omega t) e0 + t v0) exp(-omega t) + f0 c0(t) + f1 c1(t),

where c0 and c1 are the responses to a unit step and a unit ramp. Times are in durations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.errors import OptionError

FASTEST = 20.0  # decay rate: the phase falls to 2e-9


@dataclass(frozen=True)
class LinearPhase:
    """The linear canonical system, ``duration * dx/dt = -1``. The phase reaches 0 exactly when the movement ends.

    The forcing term fades out with the phase, so the acceleration vanishes at the end too: robots stop smoothly.
    """

    def __call__(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the phase x at the normalised times `s` (any shape)."""
        return 1.0 - np.asarray(s, dtype=float)


@dataclass(frozen=True)
class ExponentialPhase:
    """The classic canonical system, ``duration * dx/dt = -alpha * x``. See Ijspeert et al. (2013).

    The forcing term is cut off at the end, where recorded human movements still brake.

    Attributes
    ----------
    alpha : decay rate per duration

    Raises
    ------
    OptionError
        If alpha is not positive, or exceeds `FASTEST`, so that the phase vanishes before the end.
    """

    alpha: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.alpha, (int, float)) or not 0 < self.alpha <= FASTEST:
            raise OptionError(
                f"alpha = {self.alpha!r}", way_out=f"give a number above 0, at most {FASTEST:g}"
            )

    def __call__(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the phase x at the normalised times `s` (any shape)."""
        return np.exp(-self.alpha * np.asarray(s, dtype=float))


Phase = LinearPhase | ExponentialPhase


N_INTERVALS = 800
INTERVAL = 1.0 / N_INTERVALS
WIDTH = 0.55  # of a bell, in distances between centres: narrow enough to stay well conditioned

Kernels = Callable[[int, Phase], Array]


def gaussians(n_functions: int, phase: Phase) -> Array:
    """Compute normalised Gaussians of the phase times the phase, equation (2). See Ijspeert et al. (2013).

    Centres lie evenly in time, from a little before the start to a little after the end.

    Returns
    -------
    array, shape (n_knots, n_functions)
    """
    x, away, spacing = _from_centres(n_functions, phase)
    log_psi = -0.5 * (away / (WIDTH * spacing)) ** 2
    psi = np.exp(log_psi - log_psi.max(axis=1, keepdims=True))
    return psi / psi.sum(axis=1, keepdims=True) * x[:, None]


def mollifiers(n_functions: int, phase: Phase) -> Array:
    """Compute normalised mollifiers of the phase times the phase.

    They are ``exp(-1 / (1 - r^2))`` (Ginesi et al., 2021).

    They are smooth, and zero farther than 1.5 distances between centres from their own, so two or three of them share
    every instant, and a weight changes only its own part of the movement.

    Returns
    -------
    array, shape (n_knots, n_functions)
    """
    x, away, spacing = _from_centres(n_functions, phase)
    inside = np.maximum(1.0 - (away / (1.5 * spacing)) ** 2, 1e-9)
    log_psi = -1.0 / inside
    psi = np.exp(log_psi - log_psi.max(axis=1, keepdims=True))
    return psi / psi.sum(axis=1, keepdims=True) * x[:, None]


def von_mises(n_functions: int) -> Array:
    """Compute normalised periodic bell functions (Ijspeert et al., 2013). They are ``exp(h (cos(2 pi s - c) - 1))``.

    Returns
    -------
    array, shape (n_knots, n_functions); the last knot is the first one, a period later
    """
    angle = 2 * np.pi * np.linspace(0.0, 1.0, N_INTERVALS + 1)[:, None]
    centres = 2 * np.pi * np.arange(n_functions) / n_functions
    width = 2 * np.pi * WIDTH / n_functions
    psi = np.exp((np.cos(angle - centres) - 1.0) / width**2)
    return psi / psi.sum(axis=1, keepdims=True)


def _from_centres(n_functions: int, phase: Phase) -> tuple[Array, Array, Array]:
    """Return phases at knots, distances from centres, and centres' spacing.

    The centres reach a twenty-fifth of the duration beyond both ends, a spacing at most: recorded shapes fit best so.
    """
    x = phase(np.linspace(0.0, 1.0, N_INTERVALS + 1))
    overhang = min(0.04, 1.0 / n_functions)
    centres = phase(np.linspace(-overhang, 1.0 + overhang, n_functions))
    return x, x[:, None] - centres, np.gradient(centres)


ALPHA_Y = 25.0
OMEGA = ALPHA_Y / 2.0
LONG_AFTER = 1e6  # durations, after which nothing is left of any deviation


@kernel
def responses(t: float) -> tuple[float, float, float]:
    """Compute exp(-omega t), c0(t) and c1(t). Series are used where the closed forms lose digits by cancellation."""
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
    """Compute error and velocity after `t` under a linear forcing.

    The forcing is ``force + slope t``, `response` that of `t`. All four are numbers or arrays of one shape.
    """
    decay, c0, c1 = response
    rate = velocity + OMEGA * error
    return (
        (error + t * rate) * decay + force * c0 + slope * c1,
        (velocity - OMEGA * t * rate) * decay + force * t * decay + slope * c0,
    )


@kernel
def from_rest(psi: Array) -> Array:
    """Compute every forcing function's motion from rest at goal 0.

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
    """Compute position, velocity and acceleration between knots.

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

"""Rollouts of the transformed system as matrices.

The transformed system of the paper, equation (1a), in unit duration,

    y'' = alpha_y (beta_y (g - y) - y') + f(s),   f(s) = psi(s) w,   beta_y = alpha_y / 4,

is critically damped and its phase does not depend on y, so a rollout is *linear* in the boundary values
and in the weights. The forcing basis psi of equation (2) is held first order (linearly) between
`N_INTERVALS` + 1 knots; on such an interval the solution is known in closed form, so every matrix here is
exact and so is every value between the knots.

With ``omega = alpha_y / 2``, ``e = y - g`` and a forcing ``f0 + f1 t`` on an interval,

    e(t)  = ((1 + omega t) e0 + t v0) exp(-omega t) + f0 c0(t) + f1 c1(t).

Both ends are met by every weight vector: the weights are ``w = W_b b + Z z`` where ``b`` holds the
boundary values (start, start velocity, goal, goal velocity), Z spans the null space of the two end
conditions and W_b is the least-acceleration solution of them. Hence ``y = B(s) b + Phi(s) z``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.primitives.phase import LinearPhase, Phase

ALPHA_Y = 25.0
OMEGA = ALPHA_Y / 2.0
N_INTERVALS = 800
INTERVAL = 1.0 / N_INTERVALS
N_END_CONDITIONS = 2  # position and velocity
OVERHANG = 0.04  # centres reach this far beyond both ends (a spacing at most): recorded shapes fit best so
WIDTH = 0.55  # of a Gaussian, in distances between centres: narrow enough to stay well conditioned

Metric = Literal["velocity", "acceleration"]
Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class MotionBasis:
    """Matrices that turn boundary values and shape weights into a motion of unit duration.

    Attributes
    ----------
    boundary : array, shape (3, n_knots, 4): position, velocity and acceleration caused by a unit
        start, start velocity, goal and goal velocity
    shape : array, shape (3, n_knots, n_basis): likewise by a unit shape weight
    forcing : array, shape (n_knots, n_basis + n_ends), the forcing functions psi of equation (2);
        n_ends = 2 of them hold the ends
    forcing_of_boundary : array, shape (n_basis + n_ends, 4), W_b
    forcing_of_shape : array, shape (n_basis + n_ends, n_basis), Z whitened
    metric, phase : what `motion_basis` was asked for
    """

    boundary: Array
    shape: Array
    forcing: Array
    forcing_of_boundary: Array
    forcing_of_shape: Array
    metric: Metric
    phase: Phase

    @property
    def n_basis(self) -> int:
        """Number of free shape weights a dimension."""
        return self.shape.shape[2]

    def sampled(self, n_steps: int) -> Array:
        """Positions at even samples caused by unit shape weights and then by unit boundary values.

        Returns
        -------
        array, shape (n_basis + 4, n_steps)
        """
        return _sampled(self, n_steps)

    def at(self, s: ArrayLike) -> tuple[Array, Array]:
        """Boundary and shape matrices at normalised times, exact between the knots as well.

        Parameters
        ----------
        s : array, shape (n_steps,), time over duration; before 0 is held at 0, after 1 the system is
            left to itself with the forcing silent

        Returns
        -------
        boundary : array, shape (3, n_steps, 4)
        shape : array, shape (3, n_steps, n_basis)
        """
        s = np.maximum(np.asarray(s, dtype=float), 0.0)
        knots = np.linspace(0.0, 1.0, N_INTERVALS + 1)
        k = np.clip(np.searchsorted(knots, s, side="right") - 1, 0, N_INTERVALS)
        goal = np.zeros(4)
        goal[2] = 1.0
        force = self.forcing @ self.forcing_of_boundary, self.forcing @ self.forcing_of_shape
        return (
            _between_knots(s - knots[k], k, self.boundary, force[0], goal),
            _between_knots(s - knots[k], k, self.shape, force[1], np.zeros(self.n_basis)),
        )


@lru_cache(maxsize=32)
def motion_basis(n_basis: int, metric: Metric = "velocity", phase: Phase | None = None) -> MotionBasis:
    """Build (once) the basis with `n_basis` free shape weights a dimension.

    Parameters
    ----------
    n_basis
        Free shape weights; two more functions hold the ends.
    metric
        In which the shape weights are orthonormal: a unit step in weight space then changes the
        velocity (good for polishing) or the acceleration (good for a search from nothing) equally much
        in every direction. Without this the weight space has a condition number of 1e6 to 1e9.
    phase
        Canonical system; linear unless given.

    Raises
    ------
    ValueError
        If `n_basis` is not between 1 and 200.
    """
    if not 1 <= n_basis <= 200:
        raise ValueError(f"n_basis = {n_basis}: give 1 to 200 shape weights")
    phase = phase or LinearPhase()
    psi = forcing_functions(n_basis + N_END_CONDITIONS, phase)
    inputs, weights = _propagate(psi, *map(float, _hold(INTERVAL)))
    _accelerations(inputs, weights, psi)

    end = weights[:2, -1]  # E: position and velocity at the end caused by the weights
    wanted = np.array([[0.0, 0, 1, 0], [0, 0, 0, 1]]) - inputs[:2, -1]
    null_space = np.linalg.svd(end)[2][N_END_CONDITIONS:].T
    particular = np.linalg.pinv(end) @ wanted
    coast = inputs[2] + weights[2] @ particular
    of_boundary = particular - null_space @ np.linalg.lstsq(weights[2] @ null_space, coast, rcond=None)[0]

    order = 1 if metric == "velocity" else 2
    _, singular, right = np.linalg.svd(weights[order] @ null_space, full_matrices=False)
    of_shape = null_space @ (right.T / singular)
    of_shape /= np.linalg.norm(weights[0, N_INTERVALS // 2] @ of_shape)  # unit z: the middle moves by 1
    arrays = inputs + weights @ of_boundary, weights @ of_shape, psi, of_boundary, of_shape
    for array in arrays:
        array.setflags(write=False)
    return MotionBasis(*arrays, metric, phase)


@lru_cache(maxsize=32)
def _sampled(basis: MotionBasis, n_steps: int) -> Array:
    boundary, shape = basis.at(np.linspace(0.0, 1.0, n_steps))
    return np.ascontiguousarray(np.concatenate([shape[0], boundary[0]], axis=1).T)


def forcing_functions(n_functions: int, phase: Phase) -> Array:
    """Normalised Gaussians of the phase times the phase, equation (2), at the knots.

    Centres lie evenly in time, from a little before the start to a little after the end.

    Returns
    -------
    array, shape (n_knots, n_functions)
    """
    x = phase(np.linspace(0.0, 1.0, N_INTERVALS + 1))
    overhang = min(OVERHANG, 1.0 / n_functions)
    centres = phase(np.linspace(-overhang, 1.0 + overhang, n_functions))
    log_psi = -0.5 * ((x[:, None] - centres) / (WIDTH * np.gradient(centres))) ** 2
    psi = np.exp(log_psi - log_psi.max(axis=1, keepdims=True))
    return psi / psi.sum(axis=1, keepdims=True) * x[:, None]


def hold_step(
    dt: float, error: Array, velocity: Array, force: Array, next_force: Array
) -> tuple[Array, Array]:
    """Advance the transformed system exactly by `dt` (in durations) with the forcing held first order.

    Parameters
    ----------
    error, velocity, force, next_force : arrays of one shape: y - g, y' and the forcing now and then
    """
    decay, c0, c1 = _hold(dt)
    x, slope = OMEGA * dt, (next_force - force) / dt
    rate = velocity + OMEGA * error
    return (
        (error + dt * rate) * decay + force * c0 + slope * c1,
        (velocity - x * rate) * decay + force * (dt * decay) + slope * c0,
    )


def _hold(t: ArrayLike) -> tuple[Array, Array, Array]:
    """exp(-omega t) and the responses c0, c1 to a unit step and a unit ramp (series where they cancel)."""
    x = OMEGA * np.asarray(t, dtype=float)
    decay = np.exp(-x)
    small = np.minimum(x, 1.0)
    term, c0, c1 = small * small / 2.0, 0.0, 0.0
    for k in range(2, 22):  # term = x^k / k! with alternating sign
        c0 = c0 + (k - 1) * term
        term = -term * small / (k + 1)
        c1 = c1 - (k - 1) * term
    c0 = np.where(x < 1.0, c0, 1.0 - (1.0 + x) * decay)
    c1 = np.where(x < 1.0, c1, x - 2.0 + (x + 2.0) * decay)
    return decay, c0 / OMEGA**2, c1 / OMEGA**3


@numba.njit(cache=True)
def _propagate(psi, decay, c0, c1):
    """Positions and velocities at the knots caused by (start, start velocity, goal, -) and by the weights.

    Row 2 of either result is left for the accelerations.
    """
    h, n = INTERVAL, psi.shape[1]
    inputs = np.zeros((3, psi.shape[0], 4))
    weights = np.zeros((3, psi.shape[0], n))
    inputs[0, 0, 0], inputs[1, 0, 1] = 1.0, 1.0
    for k in range(psi.shape[0] - 1):
        for j in range(4):
            goal = 1.0 if j == 2 else 0.0
            error, velocity = inputs[0, k, j] - goal, inputs[1, k, j]
            rate = velocity + OMEGA * error
            inputs[0, k + 1, j] = goal + (error + h * rate) * decay
            inputs[1, k + 1, j] = (velocity - OMEGA * h * rate) * decay
        for j in range(n):
            error, velocity = weights[0, k, j], weights[1, k, j]
            rate = velocity + OMEGA * error
            slope = (psi[k + 1, j] - psi[k, j]) / h
            weights[0, k + 1, j] = (error + h * rate) * decay + psi[k, j] * c0 + slope * c1
            weights[1, k + 1, j] = (velocity - OMEGA * h * rate) * decay + psi[k, j] * h * decay + slope * c0
    return inputs, weights


def _accelerations(inputs: Array, weights: Array, psi: Array) -> None:
    """Fill row 2 of both by the transformed system itself."""
    goal = np.array([0.0, 0, 1, 0])
    inputs[2] = OMEGA**2 * (goal - inputs[0]) - 2 * OMEGA * inputs[1]
    weights[2] = -(OMEGA**2) * weights[0] - 2 * OMEGA * weights[1] + psi


def _between_knots(t: Array, k: Array, knots: Array, force: Array, goal: Array) -> Array:
    """Values at `t` after knot `k`, from the values and the forcing at the knots."""
    following = np.minimum(k + 1, N_INTERVALS)
    f0, slope = force[k], (force[following] - force[k]) / INTERVAL
    f0 = np.where((k == N_INTERVALS)[:, None], 0.0, f0)
    decay, c0, c1 = (value[:, None] for value in _hold(t))
    t = t[:, None]
    error, velocity = knots[0, k] - goal, knots[1, k]
    rate = velocity + OMEGA * error
    position = (error + t * rate) * decay + f0 * c0 + slope * c1
    speed = (velocity - OMEGA * t * rate) * decay + f0 * t * decay + slope * c0
    acceleration = -(OMEGA**2) * position - 2 * OMEGA * speed + f0 + slope * t
    return np.stack([position + goal, speed, acceleration])

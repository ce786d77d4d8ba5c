"""Rollouts of the transformed system as matrices.

The transformed system of the paper, equation (1a), in unit duration,

    y'' = alpha_y (beta_y (g - y) - y') + f(s),   f(s) = psi(s) w,   beta_y = alpha_y / 4,

is critically damped and its phase does not depend on y, so a rollout is *linear* in the boundary values
and in the weights. The forcing basis psi of equation (2) is held first order (linearly) between
`N_INTERVALS` + 1 knots; on such an interval the solution is known in closed form (`flow`), so every matrix
here is exact and so is every value between the knots.

Every weight vector meets both ends: the weights are ``w = W_b b + Z z`` where ``b`` holds the boundary values
(start, start velocity, goal, goal velocity), Z spans the null space of the end conditions and W_b solves them with
the least acceleration (with a fading goal, with the least forcing). Hence ``y = B(s) b + Phi(s) z``. In the metric
of jerk the forcing functions are splines, motions have no acceleration at either end, W_b is the solution of least
jerk, and the squared jerk of ``z`` is proportional to ``|z|^2``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal, Protocol

import numpy as np
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.system import (
    INTERVAL,
    N_INTERVALS,
    OMEGA,
    Kernels,
    LinearPhase,
    Phase,
    from_rest,
    gaussians,
    values_at,
)

N_END_CONDITIONS = 2  # position and velocity
MAX_BASIS = 200  # shape weights per dimension

Metric = Literal["velocity", "acceleration", "jerk"]


@dataclass(frozen=True, eq=False)
class MotionBasis:
    """Matrices from boundary values and shape weights to unit-duration motions.

    Attributes
    ----------
    boundary : array, shape (3, n_knots, 4): position, velocity and acceleration caused by a unit
        start, start velocity, goal and goal velocity
    shape : array, shape (3, n_knots, n_basis): position, velocity and acceleration caused by a unit shape weight
    boundary_force : array, shape (n_knots, 4), the forcing term f caused by a unit boundary value, psi W_b
    shape_force : array, shape (n_knots, n_basis), the forcing term caused by a unit shape weight, psi Z whitened
    metric, phase : the arguments of `motion_basis`
    """

    boundary: Array
    shape: Array
    boundary_force: Array
    shape_force: Array
    metric: Metric
    phase: Phase

    @property
    def n_basis(self) -> int:
        """Return the number of free shape weights per dimension."""
        return self.shape.shape[2]

    def __reduce__(self) -> tuple[Callable[..., MotionBasis], tuple[Any, ...]]:
        """Pickle the arguments of `motion_basis` where they rebuild the arrays."""
        same = motion_basis(self.n_basis, self.metric, self.phase)
        arrays = tuple(getattr(self, name) for name in ("boundary", "shape", "boundary_force", "shape_force"))
        theirs = (same.boundary, same.shape, same.boundary_force, same.shape_force)
        if all(map(np.array_equal, arrays, theirs)):
            return motion_basis, (self.n_basis, self.metric, self.phase)
        return MotionBasis, (*arrays, self.metric, self.phase)

    def sampled(self, n_steps: int) -> Array:
        """Return positions at even samples, by unit weights and boundary values.

        Returns
        -------
        array, shape (n_basis + 4, n_steps)
        """
        return _sampled(self, n_steps)

    def at(self, s: ArrayLike) -> tuple[Array, Array]:
        """Return the boundary and shape matrices at normalised times. They are exact between the knots as well.

        Parameters
        ----------
        s : array, shape (n_steps,), time over duration; times before 0 count as 0, and after 1 the system moves
            without forcing

        Returns
        -------
        boundary : array, shape (3, n_steps, 4)
        shape : array, shape (3, n_steps, n_basis)
        """
        times = np.maximum(np.asarray(s, dtype=float), 0.0)
        return (
            values_at(self.boundary, self.boundary_force, np.array([0.0, 0, 1, 0]), times),
            values_at(self.shape, self.shape_force, np.zeros(self.n_basis), times),
        )


def motion_basis(
    n_basis: int,
    metric: Metric = "velocity",
    phase: Phase | None = None,
    kernels: Kernels = gaussians,
    fading_goal: bool = False,
) -> MotionBasis:
    """Build the basis with `n_basis` free shape weights per dimension; results are cached.

    Parameters
    ----------
    n_basis
        Number of free shape weights; two further forcing functions serve the end conditions.
    metric
        Metric in which the shape weights are orthonormal: a unit step in weight space then changes the velocity
        (good for refining a solution), the acceleration (good for a search from scratch) or the jerk (smooth
        motions) by the same amount in every direction. Otherwise the weight space has a condition number of 1e6
        to 1e9.
    phase
        Canonical system; linear by default, and always linear in the metric of jerk.
    kernels
        The forcing functions; in the metric of jerk they are splines and cannot be chosen.
    fading_goal
        Add ``-alpha_y beta_y (g - y0) x`` to the system: the attraction of the goal then starts at zero and grows
        as the phase decays (Hoffmann et al., 2009).

    Raises
    ------
    ValueError
        If `n_basis` is not between 1 and 200, or the metric of jerk is combined with another phase, other kernels
        or a fading goal.
    """
    return _motion_basis(n_basis, metric, phase or LinearPhase(), kernels, fading_goal)


@lru_cache(maxsize=32)
def _motion_basis(
    n_basis: int, metric: Metric, phase: Phase, kernels: Kernels, fading_goal: bool
) -> MotionBasis:
    if not 1 <= n_basis <= MAX_BASIS:
        raise ValueError(f"n_basis = {n_basis}: give 1 to {MAX_BASIS} shape weights")
    smooth = metric == "jerk"
    if smooth and (phase != LinearPhase() or kernels is not gaussians or fading_goal):
        raise ValueError("the metric of jerk has a linear phase, splines for its forcing, and no fading goal")
    psi = _splines(n_basis) if smooth else kernels(n_basis + N_END_CONDITIONS, phase)
    knots = np.linspace(0.0, 1.0, N_INTERVALS + 1)
    weights, inputs = from_rest(psi), np.zeros((3, N_INTERVALS + 1, 4))
    inputs[:, :, :2] = released(knots)
    inputs[:, :, 2] = -inputs[:, :, 0]  # what the goal does is what is left of the start
    inputs[0, :, 2] += 1.0
    coasting = np.zeros((N_INTERVALS + 1, 4))  # what the boundary values force by themselves
    if fading_goal:
        fading, displacement = -(OMEGA**2) * phase(knots)[:, None], np.array([[-1.0, 0, 1, 0]])
        inputs, coasting = inputs + from_rest(fading) @ displacement, fading @ displacement

    end = weights[:2, -1]  # E: position and velocity at the end caused by the weights
    wanted = np.array([[0.0, 0, 1, 0], [0, 0, 0, 1]]) - inputs[:2, -1]
    if smooth:
        # No acceleration at the end; and of the quintics of the start those that turn what is left to itself there
        # into a spline.
        start = np.zeros((3, psi.shape[1]))
        start[:, n_basis : n_basis + 3] = np.eye(3)
        end = np.concatenate([end, weights[2, -1:], start])
        of_start = np.array([[1.0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 0]])
        wanted = np.concatenate([wanted, -inputs[2, -1:], of_start])
    null_space = np.linalg.svd(end)[2][len(end) :].T
    particular = np.linalg.pinv(end) @ wanted
    if fading_goal:  # the least forcing, so that the fading goal stays what moves
        effort, coast = psi, psi @ particular
    elif smooth:
        effort = _jerk(weights, psi)
        coast = _jerk(inputs, coasting) + effort @ particular
    else:  # the least acceleration
        effort, coast = weights[2], inputs[2] + weights[2] @ particular
    of_boundary = particular - null_space @ np.linalg.lstsq(effort @ null_space, coast, rcond=None)[0]

    whole = effort if smooth else weights[1 if metric == "velocity" else 2]
    _, singular, right = np.linalg.svd(whole @ null_space, full_matrices=False)
    of_shape = null_space @ (right.T / singular)
    if smooth:  # in the order of what a unit of jerk moves
        of_shape = of_shape @ np.linalg.svd(weights[0] @ of_shape, full_matrices=False)[2].T
    of_shape /= np.linalg.norm(weights[0, N_INTERVALS // 2] @ of_shape)  # unit z: the middle moves by 1
    # The decomposition leaves the signs open: they are made alike on every machine.
    of_shape *= np.where(np.exp(-3.0 * knots) @ weights[0] @ of_shape < 0.0, -1.0, 1.0)
    motions = inputs + weights @ of_boundary, weights @ of_shape
    arrays = *motions, coasting + psi @ of_boundary, psi @ of_shape
    for array in arrays:
        array.setflags(write=False)
    return MotionBasis(*arrays, metric, phase)


class Sampled(Protocol):
    """A basis sampled evenly as an array (n_basis + 4, n_steps)."""

    def sampled(self, n_steps: int) -> Array: ...


def rollouts(basis: Sampled, boundary: Array, weights: Array, n_steps: int = 201) -> Array:
    """Compute the positions of many rollouts as one matrix product.

    Parameters
    ----------
    boundary : array, shape (4, n_columns)
    weights : array, shape (n_rollouts, n_columns, n_basis)

    Returns
    -------
    array, shape (n_rollouts, n_columns, n_steps)
    """
    n_rollouts, n_columns, n_basis = weights.shape
    inputs = np.empty((n_rollouts, n_columns, n_basis + 4))
    inputs[:, :, :n_basis] = weights
    inputs[:, :, n_basis:] = boundary.T
    product = inputs.reshape(-1, n_basis + 4) @ basis.sampled(n_steps)
    return product.reshape(n_rollouts, n_columns, n_steps)


def _splines(n_inner: int) -> Array:
    """Return the forcing of quintic B-splines and six boundary quintics.

    The B-splines rest at both ends. A motion b(s) of the transformed system is caused by the forcing ``b'' + 2 omega
    b' + omega^2 b``. Each of the six quintics has a unit position, velocity or acceleration at one end (first those
    of the start) and zero for the others.

    Parameters
    ----------
    n_inner : number of B-splines

    Returns
    -------
    array, shape (n_knots, n_inner + 6)
    """
    degree, s = 5, np.linspace(0.0, 1.0, N_INTERVALS + 1)
    breaks = np.linspace(0.0, 1.0, n_inner + 2)
    places = np.concatenate([np.zeros(degree), breaks, np.ones(degree)])
    orders = np.arange(6)
    at_start, at_end = np.diag([1.0, 1, 2, 0, 0, 0])[:3], np.stack([orders**0, orders, orders * (orders - 1)])
    ends = np.linalg.inv(np.concatenate([at_start, at_end]))
    motions = [
        np.concatenate(
            [_b_splines(places, degree, s, order)[:, 3:-3], polyval(s, polyder(ends, order)).T], axis=1
        )
        for order in range(3)
    ]
    return motions[2] + 2 * OMEGA * motions[1] + OMEGA**2 * motions[0]


def _b_splines(knots: Array, degree: int, s: Array, order: int = 0) -> Array:
    """Compute derivatives of B-splines (de Boor, 1978, chapter X).

    Parameters
    ----------
    knots : array, shape (n_functions + degree + 1,), repeated at both ends
    s : array, shape (n_points,), between the first and the last knot
    order : of the derivative

    Returns
    -------
    array, shape (n_points, n_functions)
    """
    if degree == 0:
        cell = np.clip(np.searchsorted(knots, s, "right") - 1, 0, np.flatnonzero(np.diff(knots))[-1])
        return (cell[:, None] == np.arange(len(knots) - 1)).astype(float)
    width = knots[degree:] - knots[:-degree]
    share = np.divide(1.0, width, out=np.zeros_like(width), where=width > 0.0)
    lower = _b_splines(knots, degree - 1, s, max(order - 1, 0)) * share
    if order > 0:
        return degree * (lower[:, :-1] - lower[:, 1:])
    at, n = s[:, None], -degree - 1
    return (at - knots[:n]) * lower[:, :-1] + (knots[degree + 1 :] - at) * lower[:, 1:]


@lru_cache(maxsize=32)
def _sampled(basis: MotionBasis, n_steps: int) -> Array:
    boundary, shape = positions_at_even_times(basis, n_steps)
    return np.ascontiguousarray(np.concatenate([shape, boundary], axis=1).T)


@lru_cache(maxsize=32)
def positions_at_even_times(basis: MotionBasis, n_steps: int) -> tuple[Array, Array]:
    """Return `MotionBasis.at` of positions at even times, not to be changed.

    Returns
    -------
    boundary, shape : arrays, shape (n_steps, 4) and (n_steps, n_basis)
    """
    boundary, shape = basis.at(np.linspace(0.0, 1.0, n_steps))
    return boundary[0].copy(), shape[0].copy()


def _jerk(knots: Array, force: Array) -> Array:
    """Compute the third derivatives in the middle of every interval. They are ``f' - 2 omega y'' - omega^2 y'``.

    Parameters
    ----------
    knots : array, shape (3, n_knots, n_functions)
    force : array, shape (n_knots, n_functions)

    Returns
    -------
    array, shape (n_knots - 1, n_functions)
    """
    middle = 0.5 * (knots[:, 1:] + knots[:, :-1])
    return np.diff(force, axis=0) / INTERVAL - 2 * OMEGA * middle[2] - OMEGA**2 * middle[1]


def released(s: Array) -> Array:
    """Return the unforced motions from unit start and start velocity. The goal is 0.

    Returns
    -------
    array, shape (3, n_steps, 2): position, velocity and acceleration
    """
    x = OMEGA * s
    decay = np.exp(-x)
    start = np.stack([(1 + x) * decay, -OMEGA * x * decay, OMEGA**2 * (x - 1) * decay])
    velocity = np.stack([s * decay, (1 - x) * decay, OMEGA * (x - 2) * decay])
    return np.stack([start, velocity], axis=2)

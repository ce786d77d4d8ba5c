"""Filters of what moves: steadily, with a turn that lasts, until it suddenly does something else.

Two extended Kalman filters of position, velocity and angular velocity of the direction (the coordinated turn;
Bar-Shalom, Li and Kirubarajan, 2001, 11.7) take in the same measurements. The steady one expects velocities to
change by turning alone, and knows a motion that goes on for long very well; the quick one takes any other
acceleration for white noise. Where the quick one has told the measurements of late better, by a likelihood ratio that
forgets, something has happened, and the steady one begins anew from what the quick one believes.
"""

from __future__ import annotations

from math import cos, log, sin, sqrt
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CALM = 0.006  # of the acceleration's density, what the steady filter leaves of it
SLOW, REST = 0.2, 0.02  # of `fastest`, below which the density falls; what is left of it for what stands
DRIFT = 0.1  # of an angular velocity that is to be expected, by how much it changes within a second
FORGETS = 0.9  # of the ratio, what a measurement leaves
RATIO = 4.0  # natural logarithm, from which on something has happened
POSITION, VELOCITY, TURN = slice(0, 3), slice(3, 6), slice(6, 9)


class Belief(NamedTuple):
    """What two filters, first the steady one, believe of things that move.

    Attributes
    ----------
    state : array, shape (2, n, 9), positions [m], velocities [m/s] and their turning [rad/s]
    covariance : array, shape (2, n, 9, 9)
    ratio : array, shape (n,), logarithm of how much better the steady one has told measurements of late, at most 0
    """

    state: Array
    covariance: Array
    ratio: Array

    def at(self, which: NDArray[np.int64]) -> Belief:
        """Of some things."""
        return Belief(self.state[:, which], self.covariance[:, which], self.ratio[which])

    def put(self, which: NDArray[np.int64], of: Belief) -> None:
        """Write in place what is believed of some things."""
        self.state[:, which], self.covariance[:, which], self.ratio[which] = of

    @property
    def position(self) -> Array:
        """Array, shape (n, 3) [m]."""
        return self.state[0, :, POSITION]

    @property
    def velocity(self) -> Array:
        """Array, shape (n, 3) [m/s]."""
        return self.state[0, :, VELOCITY]

    @property
    def spin(self) -> Array:
        """Angular velocity of the velocity's direction, across it; array, shape (n, 3) [rad/s]."""
        velocity, turn = self.velocity, self.state[0, :, TURN]
        square = np.maximum((velocity**2).sum(axis=1, keepdims=True), np.finfo(float).tiny)
        return turn - velocity * ((turn * velocity).sum(axis=1, keepdims=True) / square)

    @property
    def deviation(self) -> Array:
        """Standard deviation of the position in the direction of which least is known; array, shape (n,) [m]."""
        return np.sqrt(np.linalg.eigvalsh(self.covariance[:, :, POSITION, POSITION])[..., -1].max(axis=0))


def unknown(position: Array, variances: Array) -> Belief:
    """Nothing but where things may be, (n, 3) [m], and variances, (n, 9), zeros for what cannot be."""
    n = len(position)
    state, covariance = np.zeros((2, n, 9)), np.zeros((2, n, 9, 9))
    state[:, :, POSITION] = position
    covariance[:, :, range(9), range(9)] = variances
    return Belief(state, covariance, np.zeros(n))


def later(belief: Belief, dt: Array, agility: float, fastest: float, sharpest: float) -> Belief:
    """The same after a while.

    Parameters
    ----------
    dt : array, shape (n,), [s]
    agility : spectral density of accelerations that are no turn, of what does not stand [m^2/s^3]
    fastest, sharpest : standard deviations of velocities and angular velocities [m/s], [rad/s]
    """
    state, covariance = belief.state.copy(), belief.covariance.copy()
    # What has been standing cannot turn, only start.
    square = (state[0, :, VELOCITY] ** 2).sum(axis=1) + covariance[0, :, range(3, 6), range(3, 6)].max(axis=0)
    density = agility * np.clip(square / (SLOW * fastest) ** 2, REST, 1.0)
    for kind, left in enumerate((CALM, 1.0)):
        _predict(state[kind], covariance[kind], dt, left * density, (DRIFT * sharpest) ** 2)
    return Belief(state, covariance, belief.ratio)


def informed(belief: Belief, position: Array, variance: float) -> Belief:
    """The same, knowing measured positions, (n, 3) [m], of a variance [m^2] a coordinate."""
    state, covariance = belief.state.copy(), belief.covariance.copy()
    steady, quick = (_correct(*each, position, variance) for each in zip(state, covariance, strict=True))
    ratio = np.minimum(FORGETS * belief.ratio + steady - quick, 0.0)
    happened = ratio < -RATIO
    state[0, happened], covariance[0, happened] = state[1, happened], covariance[1, happened]
    return Belief(state, covariance, np.where(happened, 0.0, ratio))


@numba.njit(cache=True, error_model="numpy")
def _predict(state, covariance, dt, density, drift):
    """States (n, 9) and covariances (n, 9, 9) after times (n,), in place."""
    for i in range(len(dt)):
        h, forward = dt[i], np.eye(9)
        velocity, turn = state[i, VELOCITY].copy(), state[i, TURN]
        bent, moving = _crossing(turn), -_crossing(velocity)
        forward[POSITION, VELOCITY] = h * np.eye(3) + 0.5 * h * h * bent
        forward[POSITION, TURN] = 0.5 * h * h * moving
        forward[VELOCITY, VELOCITY] += h * bent + 0.5 * h * h * (bent @ bent)
        forward[VELOCITY, TURN] = h * moving
        # The state moves along a helix, exactly.
        square = (turn**2).sum()
        angle = sqrt(square) * h
        if angle > 1e-3:
            along, across = h * sin(angle) / angle, (1.0 - cos(angle)) / square
            rest = (h - along) / square
        else:
            along, across, rest = h - h**3 * square / 6.0, 0.5 * h * h, h**3 / 6.0
        bend = bent @ velocity
        twice = bent @ bend
        state[i, POSITION] += h * velocity + across * bend + rest * twice
        state[i, VELOCITY] += along * bend + across * twice
        noise = np.zeros(9)
        for k in range(3, 9):  # what cannot be, as heights in the plane, has no variance and gets none
            if covariance[i, k, k] > 0.0:
                noise[k] = density[i] if k < 6 else drift
        covariance[i] = forward @ np.ascontiguousarray(covariance[i]) @ forward.T
        for k in range(3):
            covariance[i, k, k] += noise[k + 3] * h**3 / 3.0
            covariance[i, k, k + 3] += noise[k + 3] * h * h / 2.0
            covariance[i, k + 3, k] += noise[k + 3] * h * h / 2.0
        for k in range(3, 9):
            covariance[i, k, k] += noise[k] * h


@numba.njit(cache=True, error_model="numpy")
def _correct(state, covariance, position, variance):
    """Let states and covariances know measured positions, in place; log-likelihoods of these, shape (n,)."""
    told = np.empty(len(position))
    for i in range(len(position)):
        known = np.ascontiguousarray(covariance[i, POSITION])
        expected = np.ascontiguousarray(known[:, POSITION]) + variance * np.eye(3)
        missed = position[i] - state[i, POSITION]
        gain = np.linalg.solve(expected, known).T
        told[i] = -0.5 * ((missed * np.linalg.solve(expected, missed)).sum() + log(np.linalg.det(expected)))
        state[i] += gain @ missed
        covariance[i] -= gain @ known
        covariance[i] = 0.5 * (covariance[i] + covariance[i].T)
    return told


@numba.njit(cache=True, error_model="numpy")
def _crossing(a):
    """The matrix of the cross product with a vector."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])

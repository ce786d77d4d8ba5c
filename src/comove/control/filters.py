"""Tracking filters for steadily moving, possibly turning obstacles with sudden changes.

Two extended Kalman filters of position, velocity and angular velocity of the direction (the coordinated turn;
Bar-Shalom, Li and Kirubarajan, 2001, 11.7) use the same measurements. The steady one expects velocities to
change by turning alone, and estimates a lasting motion very accurately; the quick one treats any other
acceleration as white noise. Where the quick one has predicted recent measurements better, by a likelihood ratio with
forgetting, the motion has changed, and the steady one is restarted from the estimate of the quick one.
"""

from __future__ import annotations

from math import cos, log, sin, sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel

POSITION, VELOCITY, TURN = slice(0, 3), slice(3, 6), slice(6, 9)


class Expectations(NamedTuple):
    """The motions that filters expect of obstacles.

    Attributes
    ----------
    agility : spectral density of the accelerations that are not turns, of moving obstacles [m^2/s^3]
    fastest, sharpest : standard deviations of velocities and angular velocities [m/s], [rad/s]
    calm : factor on the density in the steady filter
    slow, rest : share of `fastest` below which the density falls, and its factor at rest
    drift : share of an angular velocity that is to be expected by which it changes within a second
    forgets : factor on the logarithm of the likelihood ratio per measurement
    ratio : natural logarithm of the likelihood ratio from which on the motion has changed
    """

    agility: float
    fastest: float
    sharpest: float
    calm: float = 0.006
    slow: float = 0.2
    rest: float = 0.02
    drift: float = 0.1
    forgets: float = 0.9
    ratio: float = 4.0


class Belief(NamedTuple):
    """The estimates of the steady and the quick filter of several obstacles.

    Attributes
    ----------
    state : array, shape (2, n, 9), of the steady, then the quick filter: positions [m], velocities [m/s] and angular
        velocities of their direction [rad/s]
    covariance : array, shape (2, n, 9, 9)
    ratio : array, shape (n,), logarithm of the likelihood ratio of the steady to the quick filter for recent
        measurements, at most 0
    """

    state: Array
    covariance: Array
    ratio: Array

    def at(self, which: Integers) -> Belief:
        """Return the estimates for some of the obstacles, by index."""
        return Belief(self.state[:, which], self.covariance[:, which], self.ratio[which])

    def put(self, which: Integers, of: Belief) -> None:
        """Write the estimates for some of the obstacles, in place."""
        self.state[:, which], self.covariance[:, which], self.ratio[which] = of

    @property
    def position(self) -> Array:
        """Return the positions of the steady filter; array, shape (n, 3) [m]."""
        return self.state[0, :, POSITION]

    @property
    def velocity(self) -> Array:
        """Return the velocities of the steady filter; array, shape (n, 3) [m/s]."""
        return self.state[0, :, VELOCITY]

    @property
    def spin(self) -> Array:
        """Return the angular velocity of the velocity's direction, across the velocity; array, shape (n, 3)
        [rad/s].
        """
        velocity, turn = self.velocity, self.state[0, :, TURN]
        square = np.maximum((velocity**2).sum(axis=1, keepdims=True), np.finfo(float).tiny)
        return turn - velocity * ((turn * velocity).sum(axis=1, keepdims=True) / square)

    @property
    def deviation(self) -> Array:
        """Return the largest standard deviation of position, over directions and filters; array, shape (n,) [m]."""
        return np.sqrt(np.linalg.eigvalsh(self.covariance[:, :, POSITION, POSITION])[..., -1].max(axis=0))


def unknown(position: Array, variances: Array) -> Belief:
    """Return initial estimates from positions, (n, 3) [m], and variances, (n, 9).

    A component that cannot change has the variance 0.
    """
    n = len(position)
    state, covariance = np.zeros((2, n, 9)), np.zeros((2, n, 9, 9))
    state[:, :, POSITION] = position
    covariance[:, :, range(9), range(9)] = variances
    return Belief(state, covariance, np.zeros(n))


def later(belief: Belief, dt: Array, expected: Expectations) -> Belief:
    """Return the estimates after a time without measurements.

    Parameters
    ----------
    dt : array, shape (n,), [s]
    """
    state, covariance = belief.state.copy(), belief.covariance.copy()
    # What has been standing cannot turn, only start.
    square = (state[0, :, VELOCITY] ** 2).sum(axis=1) + covariance[0, :, range(3, 6), range(3, 6)].max(axis=0)
    density = expected.agility * np.clip(square / (expected.slow * expected.fastest) ** 2, expected.rest, 1.0)
    for kind, left in enumerate((expected.calm, 1.0)):
        _predict(state[kind], covariance[kind], dt, left * density, (expected.drift * expected.sharpest) ** 2)
    return Belief(state, covariance, belief.ratio)


def informed(belief: Belief, position: Array, variance: float, expected: Expectations) -> Belief:
    """Update estimates by measured positions, (n, 3) [m], with a variance [m^2]. It is that of each coordinate."""
    state, covariance = belief.state.copy(), belief.covariance.copy()
    steady, quick = (_correct(*each, position, variance) for each in zip(state, covariance, strict=True))
    ratio = np.minimum(expected.forgets * belief.ratio + steady - quick, 0.0)
    happened = ratio < -expected.ratio
    state[0, happened], covariance[0, happened] = state[1, happened], covariance[1, happened]
    return Belief(state, covariance, np.where(happened, 0.0, ratio))


@kernel
def _predict(state: Array, covariance: Array, dt: Array, density: Array, drift: float) -> None:
    """Advance states (n, 9) and covariances (n, 9, 9) in place. The times have the shape (n,)."""
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
        for k in range(3, 9):  # fixed components, as heights in the plane, keep variance 0
            if covariance[i, k, k] > 0.0:
                noise[k] = density[i] if k < 6 else drift
        covariance[i] = forward @ np.ascontiguousarray(covariance[i]) @ forward.T
        for k in range(3):
            covariance[i, k, k] += noise[k + 3] * h**3 / 3.0
            covariance[i, k, k + 3] += noise[k + 3] * h * h / 2.0
            covariance[i, k + 3, k] += noise[k + 3] * h * h / 2.0
        for k in range(3, 9):
            covariance[i, k, k] += noise[k] * h


@kernel
def _correct(state: Array, covariance: Array, position: Array, variance: float) -> Array:
    """Update states and covariances in place; return log-likelihoods of the positions, shape (n,)."""
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


@kernel
def _crossing(a: Array) -> Array:
    """Return the matrix of the cross product with a vector."""
    return np.array([[0.0, -a[2], a[1]], [a[2], 0.0, -a[0]], [-a[1], a[0], 0.0]])

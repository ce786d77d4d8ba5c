"""The movement of a robot's joints: one C2 curve through exact samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline, PPoly

Array = NDArray[np.float64]

SAMPLE_RATE = 100.0  # Hz


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joint positions at samples and, between them, the clamped cubic spline through these.

    The spline is also the cubic Hermite curve through `position` and `velocity`, so whoever interpolates so (as
    trajectory controllers do) executes the curve that was verified. Its acceleration is linear between samples.

    Attributes
    ----------
    time : array, shape (n_steps,), from 0 [s]
    joint_names : of the robot's moving joints, in its order
    position : array, shape (n_steps, n_joints) [rad, m for prismatic joints]
    """

    time: Array
    joint_names: tuple[str, ...]
    position: Array

    @cached_property
    def curve(self) -> CubicSpline:
        """Position by time [s]; at rest at both ends."""
        return CubicSpline(self.time, self.position, bc_type="clamped")

    @cached_property
    def velocity(self) -> Array:
        """At the samples; array, shape (n_steps, n_joints) [rad/s]."""
        return self.curve(self.time, 1)

    @cached_property
    def acceleration(self) -> Array:
        """At the samples; array, shape (n_steps, n_joints) [rad/s^2]; linear between them."""
        return self.curve(self.time, 2)

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Position, velocity and acceleration at given times; arrays, shape (..., n_joints)."""
        return self.curve(time), self.curve(time, 1), self.curve(time, 2)

    def stretched(self, duration: float) -> JointMotion:
        """The same path at a pace changed throughout, for another duration [s]."""
        return JointMotion(self.time * (duration / self.duration), self.joint_names, self.position)

    def largest(self) -> tuple[Array, Array]:
        """Largest velocity and acceleration of each joint at any instant; arrays, shape (n_joints,)."""
        velocity = self.curve.derivative()
        return _largest(velocity), np.abs(self.acceleration).max(axis=0)

    def extremes(self) -> tuple[Array, Array]:
        """Least and largest position of each joint at any instant; arrays, shape (n_joints,)."""
        low, high = _extremes(self.curve)
        return low, high


def _largest(curve: PPoly) -> Array:
    low, high = _extremes(curve)
    return np.maximum(np.abs(low), np.abs(high))


def _extremes(curve: PPoly) -> tuple[Array, Array]:
    """Exact extremes of a piecewise polynomial of degree 2 or 3; arrays, shape (n_joints,)."""
    ends = curve(curve.x)
    low, high = ends.min(axis=0), ends.max(axis=0)
    width = np.diff(curve.x)[:, None]
    slope = curve.derivative().c  # of degree 1 or 2
    if len(slope) == 2:
        roots = [-slope[1] / _nonzero(slope[0])]
    else:
        a, b, c = slope
        discriminant = b * b - 4 * a * c
        q = -0.5 * (b + np.copysign(np.sqrt(np.maximum(discriminant, 0.0)), b))
        roots = [np.where(discriminant >= 0, root, np.nan) for root in (q / _nonzero(a), c / _nonzero(q))]
    for root in roots:
        inside = np.clip(np.nan_to_num(root), 0.0, width)
        value = np.zeros_like(inside)
        for coefficient in curve.c:
            value = value * inside + coefficient
        low, high = np.minimum(low, value.min(axis=0)), np.maximum(high, value.max(axis=0))
    return low, high


def _nonzero(array: Array) -> Array:
    return np.where(array == 0.0, np.finfo(float).tiny, array)

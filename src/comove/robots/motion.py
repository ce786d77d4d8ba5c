"""Motion of a robot's joints: one C2 curve through exact samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicSpline

from comove.robots.extremes import fastest, places

Array = NDArray[np.float64]

SAMPLE_RATE = 100.0  # Hz


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joint positions at samples, and the clamped cubic spline through them.

    The spline is also the cubic Hermite curve through `position` and `velocity`, so a trajectory controller that
    interpolates in this way executes the curve that was verified. Its acceleration is linear between samples.

    Attributes
    ----------
    time : array, shape (n_steps,), times of the samples, from 0 [s]
    joint_names : names of the robot's moving joints, in its order
    position : array, shape (n_steps, n_joints), joint positions [rad, m for prismatic joints]
    """

    time: Array
    joint_names: tuple[str, ...]
    position: Array

    @cached_property
    def curve(self) -> CubicSpline:
        """Return the spline of position by time [s], at rest at both ends."""
        return CubicSpline(self.time, self.position, bc_type="clamped")

    @cached_property
    def velocity(self) -> Array:
        """Return the velocity at the samples; array, shape (n_steps, n_joints) [rad/s]."""
        return self.curve(self.time, 1)

    @cached_property
    def acceleration(self) -> Array:
        """Return the acceleration at the samples; array, shape (n_steps, n_joints) [rad/s^2]; linear between them."""
        return self.curve(self.time, 2)

    @property
    def duration(self) -> float:
        """Return the duration [s]."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Evaluate position, velocity and acceleration at given times; arrays, shape (..., n_joints)."""
        return self.curve(time), self.curve(time, 1), self.curve(time, 2)

    def stretched(self, duration: float) -> JointMotion:
        """Return the same path at a pace scaled by one factor, to another duration [s]."""
        return JointMotion(self.time * (duration / self.duration), self.joint_names, self.position)

    def largest(self) -> tuple[Array, Array]:
        """Compute the largest speed and acceleration of each joint at any instant; arrays, shape (n_joints,)."""
        return fastest(self.curve)[0].max(axis=0), np.abs(self.acceleration).max(axis=0)

    def extremes(self) -> tuple[Array, Array]:
        """Compute the least and largest position of each joint at any instant; arrays, shape (n_joints,)."""
        _, position = places(self.curve)
        return position.min(axis=0), position.max(axis=0)

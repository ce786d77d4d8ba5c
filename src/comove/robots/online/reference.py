"""Reference of an online run: payload configurations and joints over time."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from comove.arrays import Array, Integers
from comove.robots.online.roadmap import Way
from comove.robots.verification.verify import VerifiedJointMotion
from comove.trajectory import interpolated


@dataclass(frozen=True)
class ReferenceSettings:
    """Settings of references.

    Attributes
    ----------
    sample : time between samples of a curve [s]
    width : width of the filter that rounds the corners of a trajectory [s]
    fading : time after which a spliced trajectory is filtered wholly [s]
    tail : time after the end of a trajectory in which the filter settles, in its widths
    """

    sample: float = 0.02
    width: float = 0.15
    fading: float = 0.3
    tail: float = 4.0

    @property
    def settling(self) -> float:
        """Return the time after a trajectory in which the filter settles [s]."""
        return self.tail * self.width


@dataclass(frozen=True)
class Stop:
    """The stop of a reference: followed during replanning, and then braked."""

    thinks: float  # s
    brakes: float  # s

    @property
    def after(self) -> float:
        """Return the time from now until rest [s]."""
        return self.thinks + self.brakes


@dataclass(frozen=True, eq=False)
class MotionReference:
    """A curve to follow, at rest at its end.

    Attributes
    ----------
    time : array, shape (n_samples,), from 0 [s]
    way : its samples
    left : slots from its end to the goal
    settings : see `ReferenceSettings`
    """

    time: Array
    way: Way
    left: float = 0.0
    settings: ReferenceSettings = ReferenceSettings()

    @classmethod
    def of_plan(
        cls,
        plan: VerifiedJointMotion,
        columns: Integers,
        settings: ReferenceSettings = ReferenceSettings(),
    ) -> MotionReference:
        """Return a verified transfer motion as a reference; `columns` are those of the arms' joints."""
        duration, motion = plan.joints.duration, plan.motion.motion
        time = np.linspace(0.0, duration, 1 + int(np.ceil(duration / settings.sample)))
        joints = plan.joints.at(time)[0][:, columns]
        way = Way(np.ascontiguousarray(motion.at(time / duration)[0]), joints)
        return cls(time, way, settings=settings)

    @classmethod
    def standing(cls, here: Way, settings: ReferenceSettings = ReferenceSettings()) -> MotionReference:
        """Return a reference at rest at a sample."""
        way = Way(*(np.repeat(values[:1], 2, axis=0) for values in here))
        return cls(np.array([0.0, settings.sample]), way, settings=settings)

    def spliced(self, now: float, stop: Stop, course: Way, slot: float, left: float) -> MotionReference:
        """Return this reference from now on, braked, and then a trajectory. Its corners are rounded.

        Parameters
        ----------
        now : present time on this reference [s]
        course : samples, one a slot [s]
        left : slots from the trajectory's end to the goal
        """
        how, after = self.settings, stop.after + slot * np.arange(len(course.joints), dtype=np.float64)
        end = after[-1] + how.settling
        time = np.linspace(0.0, end, 1 + int(np.ceil(end / how.sample)))
        own = self.at(self.braked(now, stop, time))[:2]
        x = np.minimum(time / how.fading, 1.0)[:, None]
        blend = x * x * (3.0 - 2.0 * x)
        curves = []
        for mine, other in zip(own, course, strict=True):
            on = interpolated(time, after, other)
            raw = np.where((time < stop.after)[:, None], mine, on)
            rounded = gaussian_filter1d(raw, how.width * (len(time) - 1) / end, axis=0, mode="nearest")
            curve = raw + blend * (rounded - raw)
            curve[-1] = other[-1]
            curves.append(curve)
        return MotionReference(time, Way(*curves), left, how)

    def braked(self, now: float, stop: Stop, time: ArrayLike) -> Array:
        """Return the time on this reference if it brakes evenly to rest."""
        t = np.minimum(np.asarray(time, dtype=float), stop.after)
        late = np.maximum(t - stop.thinks, 0.0)
        return np.minimum(now + t - 0.5 * late**2 / max(stop.brakes, 1e-9), self.duration)

    @property
    def duration(self) -> float:
        """Return the duration [s]."""
        return float(self.time[-1])

    def at(self, time: ArrayLike) -> tuple[Array, Array, Array]:
        """Return configurations, joints and rates of the joints at given times; arrays, shape (..., n)."""
        t = np.minimum(np.asarray(time, dtype=float), self.duration)
        return self._curves[0](t), self._curves[1](t), self._curves[1](t, 1)

    @cached_property
    def _curves(self) -> tuple[CubicSpline, CubicSpline]:
        return tuple(CubicSpline(self.time, values) for values in self.way)

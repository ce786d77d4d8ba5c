"""Joint motions: C2 curves through samples, their extremes, bounds and commands.

Between two samples a joint follows a cubic: its position is extreme at a sample or at a root of a quadratic, its
velocity at a sample or at the vertex of a parabola, and its acceleration at a sample.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import ROUNDING, Array, Integers
from comove.brief import brief
from comove.compiled import kernel
from comove.dmp.arguments import is_number
from comove.errors import OptionError

SLOWEST, FASTEST = 20.0, 1e4  # Hz, of commands: below, hands would leave their distance between them


@dataclass(frozen=True, eq=False)
class JointCurve:
    """Cubics of joint positions by time [s] between samples.

    A call evaluates the derivative of an order at given times.

    Attributes
    ----------
    x : array, shape (n_steps,), times of the samples [s]
    c : array, shape (4, n_steps - 1, n_joints), coefficients of (t - x)^3 to (t - x)^0, as SciPy's `PPoly` has them
    """

    x: Array
    c: Array

    @classmethod
    def through(cls, time: Array, position: Array) -> JointCurve:
        """Return the C2 curve through samples, at rest at both ends.

        Parameters
        ----------
        time : array, shape (n_steps,) [s]
        position : array, shape (n_steps, n_joints) [rad, m for prismatic joints]
        """
        x = np.array(time, dtype=float)
        return cls(x, _clamped(x, np.array(position, dtype=float, order="C")))

    def __call__(self, time: ArrayLike, order: int = 0) -> Array:
        """Evaluate the derivative of an order at given times; array, shape (..., n_joints)."""
        return self.orders(time, order)[order]

    def orders(self, time: ArrayLike, last: int) -> Array:
        """Evaluate position and derivatives up to an order, 3 at most; array, shape (last + 1, ..., n_joints)."""
        if not 0 <= last <= 3:
            raise OptionError(f"order = {last}", key="order", way_out="give 0 to 3")
        at = np.array(time, dtype=float)
        return _evaluated(self.x, self.c, at.ravel(), last).reshape(last + 1, *at.shape, self.c.shape[2])

    @cached_property
    def fastest(self) -> tuple[Array, Array]:
        """Return the largest speeds between samples, and their times; arrays, shape (n_intervals, n_joints)."""
        return _fastest(self.c, self.x)

    @cached_property
    def bends(self) -> Array:
        """Return the sizes of the second derivatives at the samples; array, shape (n_steps, n_joints)."""
        return np.abs(self(self.x, 2))

    @property
    def bends_between(self) -> Array:
        """Return the largest sizes of the second derivatives between samples; (n_intervals, n_joints)."""
        return np.maximum(self.bends[1:], self.bends[:-1])


@kernel
def _clamped(x: Array, y: Array) -> Array:
    """Return the coefficients of `JointCurve.through`.

    Slopes s of C2 cubics obey h_i s_(i-1) + 2 (h_(i-1) + h_i) s_i + h_(i-1) s_(i+1) = 3 (h_i d_(i-1) + h_(i-1) d_i),
    with widths h and slopes d of the chords: a diagonally dominant tridiagonal system (de Boor 1978, ch. IV).
    """
    n, m = x.shape[0] - 1, y.shape[1]
    c, share, slope = np.empty((4, n, m)), np.zeros(n + 1), np.zeros((n + 1, m))
    for i in range(1, n):
        before, after = x[i] - x[i - 1], x[i + 1] - x[i]
        pivot = 2.0 * (before + after) - after * share[i - 1]
        share[i] = before / pivot
        for k in range(m):
            right = 3.0 * (
                after / before * (y[i, k] - y[i - 1, k]) + before / after * (y[i + 1, k] - y[i, k])
            )
            slope[i, k] = (right - after * slope[i - 1, k]) / pivot
    for i in range(n - 1, -1, -1):
        width = x[i + 1] - x[i]
        for k in range(m):
            slope[i, k] -= share[i] * slope[i + 1, k]
            chord = (y[i + 1, k] - y[i, k]) / width
            c[0, i, k] = (slope[i, k] + slope[i + 1, k] - 2.0 * chord) / width**2
            c[1, i, k] = (3.0 * chord - 2.0 * slope[i, k] - slope[i + 1, k]) / width
            c[2, i, k], c[3, i, k] = slope[i, k], y[i, k]
    return c


@kernel
def _evaluated(x: Array, c: Array, time: Array, last: int) -> Array:
    """Return `JointCurve.orders` at times, array of shape (n,); beyond the ends the outer cubics go on."""
    n, m, i = time.shape[0], c.shape[2], 0
    result = np.empty((last + 1, n, m))
    for t in range(n):
        if not (x[i] <= time[t] < x[i + 1]):
            i = min(max(np.searchsorted(x, time[t], side="right") - 1, 0), c.shape[1] - 1)
        s = time[t] - x[i]
        for k in range(m):
            cubic, square, slope = c[0, i, k], c[1, i, k], c[2, i, k]
            result[0, t, k] = ((cubic * s + square) * s + slope) * s + c[3, i, k]
            if last > 0:
                result[1, t, k] = (3.0 * cubic * s + 2.0 * square) * s + slope
            if last > 1:
                result[2, t, k] = 6.0 * cubic * s + 2.0 * square
            if last > 2:
                result[3, t, k] = 6.0 * cubic
    return result


@dataclass(frozen=True, eq=False)
class JointMotion:
    """Joint positions at samples, and the clamped cubic spline through them.

    The spline is also the cubic Hermite curve through `position` and `velocity`, so a trajectory controller that
    interpolates in this way executes the verified curve. Its acceleration is linear between samples.

    Attributes
    ----------
    time : array, shape (n_steps,), times of the samples, from 0 [s]
    joint_names : names of the robot's moving joints, in its order
    position : array, shape (n_steps, n_joints), joint positions [rad, m for prismatic joints]
    """

    __repr__ = brief

    time: Array
    joint_names: tuple[str, ...]
    position: Array

    @cached_property
    def curve(self) -> JointCurve:
        """Return the spline of position by time [s], clamped at rest."""
        return JointCurve.through(self.time, self.position)

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
        position, velocity, acceleration = self.curve.orders(time, 2)
        return position, velocity, acceleration

    def stretched(self, duration: float) -> JointMotion:
        """Return the same path with time scaled to another duration [s]."""
        return JointMotion(self.time * (duration / self.duration), self.joint_names, self.position)

    def largest(self) -> tuple[Array, Array]:
        """Compute the largest speed and acceleration of each joint at any instant; arrays, shape (n_joints,)."""
        return self.curve.fastest[0].max(axis=0), self.curve.bends.max(axis=0)


class JointCommand(NamedTuple):
    """The command of the joints at an instant.

    Attributes
    ----------
    time : since the beginning of the motion [s]
    position, velocity, acceleration : arrays, shape (n_joints,) [rad, rad/s, rad/s^2; m for joints that slide]
    """

    time: float
    position: Array
    velocity: Array
    acceleration: Array


class Extreme(NamedTuple):
    """An extreme value, the column of its joint, and its time [s]."""

    value: float
    joint: int
    time: float

    @classmethod
    def largest(cls, values: Array, time: Array) -> Extreme:
        """Return the largest of `values`, shape (n_places, n_joints); `time` is of that shape, or (n_places,)."""
        largest, first = _largest_of(values.ravel())
        row, column = divmod(first, values.shape[1])
        when = time[row] if time.ndim == 1 else time[row, column]
        return cls(largest, column, float(when))


@kernel
def _largest_of(values: Array) -> tuple[float, int]:
    """Return the largest of some values, shape (n,), and what `first_largest` does."""
    best = 0
    for k in range(values.shape[0]):
        if np.isnan(values[k]):
            return values[k], k
        if values[k] > values[best]:
            best = k
    largest, size = values[best], 0.0
    if not np.isfinite(largest):
        return largest, best
    for value in values:
        if np.isfinite(value):
            size = max(size, abs(value))
    for k in range(best):
        if values[k] >= largest - ROUNDING * size:
            return largest, k
    return largest, best


@kernel
def _beyond(position: Array, lower: Array, upper: Array) -> Array:
    """Return how far positions, shape (n, n_joints), are beyond limits. It is negative within."""
    out = np.empty(position.shape)
    for i in range(position.shape[0]):
        for j in range(position.shape[1]):
            margin = min(position[i, j] - lower[j], upper[j] - position[i, j])
            out[i, j] = margin if np.isnan(margin) else -margin
    return out


def least_margin(curve: JointCurve, lower: Array, upper: Array) -> Extreme:
    """Compute the joints' least margin to limits [rad, m for prismatic joints]. It is negative beyond them.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples
    lower, upper : arrays, shape (n_joints,), position limits
    """
    time, position = places(curve)
    worst = Extreme.largest(_beyond(position, lower, upper), time)
    return worst._replace(value=-worst.value)


def largest_velocity(curve: JointCurve, limit: Array) -> Extreme:
    """Compute the largest share of a joint's velocity limit, shape (n_joints,)."""
    speed, time = curve.fastest
    return Extreme.largest(speed / limit, time)


def largest_acceleration(curve: JointCurve, limit: Array) -> Extreme:
    """Compute the largest share of a joint's acceleration limit, shape (n_joints,)."""
    return Extreme.largest(curve.bends / limit, curve.x)


def largest_approach(curve: JointCurve, approach: Array, lower: Array, upper: Array) -> Extreme:
    """Compute the largest share of the joints' approach velocities at position limits.

    A joint at q, with the time constant T and the limit b before it, may move at (b - q)/T. The largest share, at any
    instant, is found as Dinkelbach's method finds the largest quotient: the exact extreme of T q' - share (b - q)
    gives the next share.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples, within the limits
    approach : array, shape (n_joints,), time constants [s], 0 for joints that may move at any velocity
    lower, upper : arrays, shape (n_joints,), position limits

    Returns
    -------
    Extreme : inf for a joint that moves at its limit, or comes to rest there
    """
    return Extreme(*_fastest_approach(curve.c, curve.x, approach, lower, upper))


@kernel
def _fastest_approach(
    c: Array, x: Array, approach: Array, lower: Array, upper: Array
) -> tuple[float, int, float]:
    """Compute `largest_approach` in a kernel."""
    worst, joint, when, s = 0.0, 0, x[0], np.empty(4)
    for _ in range(100):
        found, at, time = 0.0, 0, x[0]
        for i in range(c.shape[1]):
            width = x[i + 1] - x[i]
            for k in range(c.shape[2]):
                if approach[k] == 0.0:
                    continue
                cubic, square, slope, start = c[0, i, k], c[1, i, k], c[2, i, k], c[3, i, k]
                s[0], s[1] = width, _within(-square, 3.0 * cubic, width)
                speed = abs(slope)
                for r in range(2):
                    speed = max(speed, abs((3.0 * cubic * s[r] + 2.0 * square) * s[r] + slope))
                room = min(upper[k] - start, start - lower[k]) - width * speed
                if room > 0.0 and approach[k] * speed <= max(worst, found) * room:
                    continue
                s[2] = s[3] = 0.0
                if worst > 0.0:  # where q + T/share q' is extreme
                    ahead = approach[k] / worst
                    s[2], s[3] = _roots(
                        3.0 * cubic, square + 3.0 * ahead * cubic, slope + 2.0 * ahead * square, width
                    )
                for r in range(4):
                    velocity = (3.0 * cubic * s[r] + 2.0 * square) * s[r] + slope
                    position = ((cubic * s[r] + square) * s[r] + slope) * s[r] + start
                    room = upper[k] - position if velocity > 0.0 else position - lower[k]
                    if velocity != 0.0:
                        share = approach[k] * abs(velocity) / max(room, 0.0)
                        if share > found:
                            found, at, time = share, k, x[i] + s[r]
        if not worst * (1.0 + 1e-12) < found < np.inf:
            break
        worst, joint, when = found, at, time
    else:  # not converged: `worst` may be too small
        return np.inf, joint, when
    return (found, at, time) if found > worst else (worst, joint, when)


@kernel
def _roots(a: float, b: float, c: float, width: float) -> tuple[float, float]:
    """Return a quadratic's roots in [0, width]; any numbers without roots. It is a s^2 + 2 b s + c."""
    q = -(b + np.copysign(sqrt(max(b * b - a * c, 0.0)), b))
    return _within(q, a, width), _within(c, q, width)


@kernel
def _within(numerator: float, denominator: float, width: float) -> float:
    """Return a quotient, clipped to 0 and `width`. It is 0 where it is not finite."""
    quotient = numerator / denominator
    return min(max(quotient, 0.0), width) if np.isfinite(quotient) else 0.0


def approach_shares(position: Array, velocity: Array, approach: Array, lower: Array, upper: Array) -> Array:
    """Compute shares of the joints' approach velocities at limits; arrays, shape (..., n_joints).

    Parameters
    ----------
    position, velocity : of the joints [rad, rad/s]
    approach, lower, upper : as in `largest_approach`
    """
    room = np.where(velocity > 0.0, upper - position, position - lower)
    wanted = approach * np.abs(velocity)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = wanted / np.maximum(room, 0.0)
    return np.where(wanted > 0.0, share, 0.0)


def largest_jerk(curve: JointCurve, limit: Array) -> Extreme:
    """Compute the largest share of a joint's jerk limit, shape (n_joints,).

    Between samples jerk is constant. At both ends the robot is at rest: an acceleration there counts as one that is
    reached within the time between two samples.
    """
    width = np.diff(curve.x)
    ends = curve.bends[[0, -1]] / width[[0, -1], None]
    jerk = np.concatenate([ends[:1], 6.0 * np.abs(curve.c[0]), ends[1:]])
    return Extreme.largest(jerk / limit, np.concatenate([curve.x[:1], curve.x[:-1], curve.x[-1:]]))


@kernel
def _fastest(c: Array, x: Array) -> tuple[Array, Array]:
    """Return what `JointCurve.fastest` does."""
    speed, when = np.empty((c.shape[1], c.shape[2])), np.empty((c.shape[1], c.shape[2]))
    for i in range(c.shape[1]):
        width = x[i + 1] - x[i]
        for k in range(c.shape[2]):
            cubic, square, slope = c[0, i, k], c[1, i, k], c[2, i, k]
            speed[i, k], when[i, k] = abs(slope), x[i]
            for s in (_within(-square, 3.0 * cubic, width), width):
                other = abs((3.0 * cubic * s + 2.0 * square) * s + slope)
                if other > speed[i, k]:
                    speed[i, k], when[i, k] = other, x[i] + s
    return speed, when


def places(curve: JointCurve) -> tuple[Array, Array]:
    """Compute times and positions of samples and of stops; arrays, shape (n_places, n_joints)."""
    return _places(curve.c, curve.x)


@kernel
def _places(c: Array, x: Array) -> tuple[Array, Array]:
    """Compute `places` in a kernel."""
    n = c.shape[1]
    time, position = np.empty((3 * n + 1, c.shape[2])), np.empty((3 * n + 1, c.shape[2]))
    for k in range(c.shape[2]):
        time[0, k], position[0, k] = x[0], c[3, 0, k]
        for i in range(n):
            cubic, square, slope, start = c[0, i, k], c[1, i, k], c[2, i, k], c[3, i, k]
            width = x[i + 1] - x[i]
            first, second = _roots(3.0 * cubic, square, slope, width)
            row = 3 * i + 1
            for s in (first, second, width):
                time[row, k] = x[i] + s
                position[row, k] = ((cubic * s + square) * s + slope) * s + start
                row += 1
    return time, position


def subdivided(samples: Array, parts: Integers) -> tuple[Array, Integers]:
    """Divide the sample intervals evenly into `parts`, shape (n_intervals,).

    Returns
    -------
    time : array, shape (n_steps,), instants, the samples included [s]
    interval : array, shape (n_steps - 1,), index of the sample interval in which each piece lies
    """
    interval = np.repeat(np.arange(len(parts)), parts)
    within = np.arange(len(interval)) - np.repeat(np.cumsum(parts) - parts, parts)
    time = samples[interval] + np.diff(samples)[interval] * within / parts[interval]
    return np.append(time, samples[-1]), interval


class Ranges(NamedTuple):
    """Bounds by time, with their largest value over any time interval.

    Attributes
    ----------
    time : array, shape (n + 1,), increasing [s]
    bounds : array, shape (n, width), bounds that hold between two neighbouring instants
    """

    time: Array
    bounds: Array

    def over(self, begin: Array, end: Array) -> Array:
        """Return the largest values between times, arrays of shape (k,) [s]; array, shape (k, width)."""
        return _largest(np.array(self.time), np.ascontiguousarray(self.bounds), begin, end)


@kernel
def _largest(time: Array, bounds: Array, begin: Array, end: Array) -> Array:
    """Compute `Ranges.over` in a kernel."""
    result = np.empty((begin.shape[0], bounds.shape[1]))
    for k in range(begin.shape[0]):
        low, high = 0, bounds.shape[0] - 1
        while low < high:  # the last row that begins at `begin` or before
            middle = (low + high + 1) // 2
            if time[middle] <= begin[k]:
                low = middle
            else:
                high = middle - 1
        for column in range(bounds.shape[1]):
            result[k, column] = bounds[low, column]
        row = low + 1
        while row < bounds.shape[0] and time[row] < end[k]:
            for column in range(bounds.shape[1]):
                result[k, column] = max(result[k, column], bounds[row, column])
            row += 1
    return result


def commands(joints: JointMotion, rate: float, columns: Integers) -> Iterator[JointCommand]:
    """Return an iterator over commands of joints at a rate [Hz]. It is from rest to rest.

    The last command is at the end of the motion, also where the cycles do not divide it.

    Raises
    ------
    OptionError
        If no robot is driven at that rate.
    """
    if not is_number(rate) or not SLOWEST <= rate <= FASTEST:
        raise OptionError(
            f"commands at {rate} Hz",
            key="rate",
            way_out=f"give {SLOWEST:g} to {FASTEST:g}, such as 1000 for libfranka or 500 for a UR",
        )
    return _commands(joints, float(rate), columns)


def _commands(joints: JointMotion, rate: float, columns: Integers) -> Iterator[JointCommand]:
    block = 1000  # commands computed at once
    count = int(np.ceil(joints.duration * rate - 1e-9))
    for first in range(0, count + 1, block):
        cycles = np.arange(first, min(first + block, count + 1)).astype(np.float64)
        time = np.minimum(cycles / rate, joints.duration)
        values = (samples[:, columns] for samples in joints.at(time))
        for instant, *command in zip(time.tolist(), *values, strict=True):
            yield JointCommand(instant, *command)

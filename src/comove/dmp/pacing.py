r"""Least time along a movement's path, within velocity and acceleration limits.

A movement y(s) keeps its path for any progress s(t). With ``x = (ds/dt)^2`` and ``u = d^2 s / dt^2`` the limits
of every coordinate are linear,

    |y'| sqrt(x) <= v,        |y' u + y'' x| <= a,        dx/ds = 2 u,

and the fastest progress has the largest x everywhere (Bobrow, Dubowsky and Gibson, 1985). It is found in two passes
(reachability analysis; Pham and Pham, 2018): backwards the largest x from which the end can still be reached at every
knot, then forwards the largest u that stays below. u is constant between two knots, and the limits are imposed at
both knots and in the middle of them. Where the parabola through these exceeds a limit in between, the limit is
lowered and both passes are made again; the remaining violation is removed by slowing the whole motion slightly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.compiled import kernel
from comove.dmp.arguments import instants, require_numbers, require_positive, require_steps
from comove.dmp.dmp import DMP
from comove.dmp.limits import ending_basis, limits_of
from comove.dmp.system import INTERVAL, N_INTERVALS, values_at
from comove.errors import OptionError
from comove.trajectory import Trajectory

FASTEST = 1e4  # pace: what stands still is passed in no time
STANDING = 1e-9  # share of the largest velocity below which an end is one at rest


@dataclass(frozen=True)
class PacingSettings:
    """Settings of the search for the least time along a path.

    Attributes
    ----------
    n_rounds : largest number of times that both passes are made, each with lower limits where they were exceeded
    margin : share of a limit left free for the error of the parabola between knots
    """

    n_rounds: int = 5
    margin: float = 1e-5

    def __post_init__(self) -> None:
        require_numbers(self)


@dataclass(frozen=True, eq=False)
class PacedDMP:
    """A movement on its own path with another time scaling.

    Attributes
    ----------
    dmp : the movement
    time : array, shape (n_knots,), times of the knots [s]
    speed : array, shape (n_knots,), speed of the progress at the knots [1/s]; it changes evenly in time between them
    """

    dmp: DMP
    time: Array
    speed: Array

    @property
    def duration(self) -> float:
        """Return the duration [s]."""
        return float(self.time[-1])

    def progress_at(self, time: ArrayLike) -> Array:
        """Return the progress, 0 to 1, at times [s]; shape (n_steps,)."""
        return self._course(instants(time))[0]

    def pace_at(self, time: ArrayLike) -> Array:
        """Return the pace relative to the movement's own at times [s]; shape (n_steps,)."""
        return self._course(instants(time))[1] * self.dmp.duration

    def rate(self, time: float, dt: float) -> float:
        """Return the mean pace from `time` to ``time + dt`` [s]. It is the `rate` of that step of `DMP.step`."""
        require_positive("dt", dt, of="seconds")
        before, after = self.progress_at([time, time + dt])
        return float((after - before) * self.dmp.duration / dt)

    def at(self, time: ArrayLike) -> Trajectory:
        """Return positions and velocities at times [s], shape (n_steps,)."""
        time = instants(time)
        progress, speed = self._course(time)
        played = self.dmp.at(progress * self.dmp.duration)
        velocity = played.velocity * (speed * self.dmp.duration)[:, None]
        return Trajectory(time, played.position, velocity)

    def rollout(self, *, n_steps: int = 201) -> Trajectory:
        """Play the movement at even times."""
        require_steps(n_steps)
        return self.at(np.linspace(0.0, self.duration, n_steps))

    def _course(self, time: Array) -> tuple[Array, Array]:
        """Return progress and its speed, constant before start and after end."""
        k = np.clip(np.searchsorted(self.time, time, side="right") - 1, 0, N_INTERVALS - 1)
        passed, length = time - self.time[k], self.time[k + 1] - self.time[k]
        first, last = self.speed[k], self.speed[k + 1]
        share = np.clip(passed / length, 0.0, 1.0)
        inside = share * length
        progress = k * INTERVAL + inside * (first + 0.5 * share * (last - first))
        progress = np.where(share >= 1.0, (k + 1) * INTERVAL, progress)
        speed = first + share * (last - first)
        return progress + (passed - inside) * speed, speed


def slowed(
    dmp: DMP,
    *,
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    pace: float = 1.0,
    settings: PacingSettings = PacingSettings(),
) -> PacedDMP:
    """Return the movement on its path in least time within limits.

    The movement slows down only where limits require it, and nowhere exceeds the given pace. Where it does not begin
    and end at rest, it begins and ends at its own pace at most.

    Parameters
    ----------
    velocity, acceleration : limits per coordinate; a number or an array of shape (n_dims,), [m/s] and [m/s^2]
    pace : largest pace: 1 for nowhere faster than the movement itself, infinity for as fast as the limits allow
    settings : settings of the search

    Raises
    ------
    OptionError
        If an argument is out of range, the movement is rhythmic, or nothing limits it.
    """
    ending_basis(dmp)
    fastest, hardest = limits_of("velocity", velocity, dmp), limits_of("acceleration", acceleration, dmp)
    if not isinstance(pace, (int, float, np.number)) or isinstance(pace, bool) or not pace > 0:
        raise OptionError(
            f"pace = {pace!r}", way_out="give a positive number, infinity for as fast as can be"
        )
    if not (pace < np.inf or np.isfinite(fastest).any() or np.isfinite(hardest).any()):
        raise OptionError("nothing limits the pace", key="pace", way_out="give a limit, or a largest pace")
    slope, bend = _derivatives(dmp)
    if pace == np.inf and not np.abs(slope).max() > STANDING * np.abs(dmp.curve.knots[0]).max():
        raise OptionError(
            "the movement stands still, and nothing limits its pace", key="pace", way_out="give one"
        )
    cap = _largest(slope, fastest, min(float(pace), FASTEST) / dmp.duration)
    rows, bends = _rows(slope, bend, hardest)
    _limit_ends(cap, slope, bends, dmp.duration)
    for _ in range(settings.n_rounds):
        x = _forwards(rows, bends, cap, _backwards(rows, bends, cap))
        share = _shares(x, slope, bend, fastest, hardest)
        if share.max() <= 1.0 + settings.margin:
            break
        rows, bends = rows * np.maximum(share, 1.0)[:, None], bends * np.maximum(share, 1.0)[:, None]
    x /= max(1.0, float(share.max()) + settings.margin)
    speed: Array = np.sqrt(x)
    steps = 2 * INTERVAL / (speed[1:] + speed[:-1])
    return PacedDMP(dmp, np.concatenate([[0.0], np.cumsum(steps)]), speed)


def _derivatives(dmp: DMP) -> tuple[Array, Array]:
    """Return y' and y'' at and between knots; shape (2 N + 1, n_dims). They are with respect to the progress."""
    curve = dmp.curve
    middles: Array = np.linspace(0.5 * INTERVAL, 1.0 - 0.5 * INTERVAL, N_INTERVALS)
    between = values_at(curve.knots, curve.force, curve.goal, middles)
    whole = np.empty((2, 2 * N_INTERVALS + 1, dmp.n_dims))
    whole[:, ::2], whole[:, 1::2] = curve.knots[1:], between[1:]
    return whole[0], whole[1]


def _largest(slope: Array, fastest: Array, speed: float) -> Array:
    """Return the largest x within velocity and pace limits; shape (2 N + 1,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        allowed = np.where(slope != 0.0, fastest / np.abs(slope), np.inf)
    return np.asarray(np.minimum(allowed.min(axis=1), speed) ** 2, dtype=np.float64)


def _rows(slope: Array, bend: Array, hardest: Array) -> tuple[Array, Array]:
    """Return the factors of |U u + X x| <= 1; arrays, (N, 3 n_dims). These are the limits of acceleration."""
    cells = [slice(0, -1, 2), slice(1, None, 2), slice(2, None, 2)]
    bends = np.stack([bend[cell] / hardest for cell in cells], axis=1)
    slopes = np.stack([slope[cell] / hardest for cell in cells], axis=1)
    rows = slopes + np.array([0.0, INTERVAL, 2 * INTERVAL])[:, None] * bends
    return rows.reshape(N_INTERVALS, -1), bends.reshape(N_INTERVALS, -1)


def _limit_ends(cap: Array, slope: Array, bends: Array, duration: float) -> None:
    """Limit the pace at both ends to the movement's own, or less."""
    least = STANDING * np.abs(slope).max(initial=0.0)
    for end in (0, -1):
        steady = np.abs(bends[end]).max(initial=0.0)
        most = 1.0 / steady if steady > 0 else np.inf
        cap[end] = min(cap[end], duration**-2 if np.abs(slope[end]).max() > least else most)


@kernel
def _range(rows: Array, bends: Array, x: float, cap: tuple[float, float]) -> tuple[float, float]:
    """Return the least and largest u in an interval. `x` is its first value, `cap` its largest in middle and end."""
    low, high = -x / (2 * INTERVAL), min((cap[0] - x) / INTERVAL, (cap[1] - x) / (2 * INTERVAL))
    for j in range(len(rows)):
        away = bends[j] * x
        if rows[j] == 0.0:
            if abs(away) > 1.0:
                return 1.0, -1.0
            continue
        one, other = (-1.0 - away) / rows[j], (1.0 - away) / rows[j]
        low, high = max(low, min(one, other)), min(high, max(one, other))
    return low, high


@kernel
def _backwards(rows: Array, bends: Array, cap: Array) -> Array:
    """Return the largest x from which the end is reachable; shape (N + 1,)."""
    reach = np.empty(len(rows) + 1)
    reach[-1] = cap[-1]
    for i in range(len(rows) - 1, -1, -1):
        after = (cap[2 * i + 1], reach[i + 1])
        best, high, tried = 0.0, cap[2 * i], cap[2 * i]
        for _ in range(100):
            if high - best <= 1e-15 * high:  # rounding
                break
            low, most = _range(rows[i], bends[i], tried, after)
            if low <= most:
                best = tried
            else:
                high = tried
            tried = 0.5 * (best + high)
        reach[i] = best
    return reach


@kernel
def _forwards(rows: Array, bends: Array, cap: Array, reach: Array) -> Array:
    """Return the largest x reachable from the start; shape (N + 1,)."""
    x = reach.copy()
    for i in range(len(rows)):
        low, high = _range(rows[i], bends[i], x[i], (cap[2 * i + 1], reach[i + 1]))
        x[i + 1] = min(x[i] + 2 * INTERVAL * max(low, high), reach[i + 1])
    return x


def _shares(x: Array, slope: Array, bend: Array, fastest: Array, hardest: Array) -> Array:
    """Return the largest used share of acceleration and squared-velocity limits by interval.

    Returns
    -------
    array, shape (N,)
    """
    squares = np.empty(2 * N_INTERVALS + 1)
    squares[::2], squares[1::2] = x, 0.5 * (x[1:] + x[:-1])
    push = np.diff(x)[:, None] / (2 * INTERVAL)
    most = np.zeros(N_INTERVALS)
    velocity = slope**2 * squares[:, None] / fastest**2
    cells = [slice(0, -1, 2), slice(1, None, 2), slice(2, None, 2)]
    acceleration = [(slope[cell] * push + bend[cell] * squares[cell, None]) / hardest for cell in cells]
    for first, middle, last in ([velocity[cell] for cell in cells], acceleration):
        curved, sloping = 2 * (first + last - 2 * middle), 4 * middle - 3 * first - last
        with np.errstate(divide="ignore", invalid="ignore"):
            at = -sloping / (2 * curved)
            vertex = np.where((at > 0) & (at < 1), first - sloping**2 / (4 * curved), 0.0)
        for part in (first, middle, last, vertex):
            most = np.maximum(most, np.abs(part).max(axis=1))
    return most

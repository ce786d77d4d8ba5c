"""Segmentation of a long recording into its movements.

A movement ends where the end effector rests, and, optionally, at corners, where it is slow and the path turns, as the
two-thirds power law describes it for human strokes. Pure functions; the returned samples are neither moved nor
filtered.

The speed is computed after a zero-phase low-pass filter. It counts as still below a share of the largest speed, and
always where it does not exceed the effect of the recording's noise on the speed. The noise is estimated from fourth
differences, in which movements vanish but noise does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.arrays import first_largest, first_least
from comove.dmp.demonstrations import resampling
from comove.errors import OptionError


@dataclass(frozen=True)
class Segmentation:
    """Criteria of a movement. The first five are the options of `segment`.

    Attributes
    ----------
    speed_share : share of the recording's largest speed that a movement must exceed, between 0 and 1
    min_pause, min_duration : shortest duration of a pause and of a movement [s]
    cutoff_hz : frequency above which the recording counts as noise [Hz]
    corner : smallest angle between path directions [rad] at which minima of the speed are cut; None: none is
    still_share : share of the threshold of moving below which a movement has ended; between the two the state stays
    rest_share : share of its own largest speed at which a movement begins and ends
    noise_moving, noise_still : multiples of the noise in the speed that a movement exceeds, and that standing still
        may reach
    cutoff_share : largest cutoff of the low-pass, as a share of the sampling rate
    smallest_turn : an orientation that differs less than this from the first sample's is not turning [rad]
    corner_depth : a corner is slower than this share of the largest speeds on either side of it

    Raises
    ------
    OptionError
        If an option is out of its range; names it.
    """

    speed_share: float = 0.05
    min_pause: float = 0.2
    min_duration: float = 0.2
    cutoff_hz: float = 6.0
    corner: float | None = None
    still_share: float = 0.6
    rest_share: float = 0.02
    noise_moving: float = 5.0
    noise_still: float = 2.5
    cutoff_share: float = 0.2
    smallest_turn: float = 0.1
    corner_depth: float = 0.75

    def __post_init__(self) -> None:
        for key, fits, way_out in [
            ("speed_share", lambda x: 0.0 < x < 1.0, "give a share between 0 and 1"),
            ("min_pause", lambda x: 0.0 <= x < np.inf, "give seconds, 0 or more"),
            ("min_duration", lambda x: 0.0 <= x < np.inf, "give seconds, 0 or more"),
            ("cutoff_hz", lambda x: 0.0 < x < np.inf, "give a positive frequency"),
            ("corner", lambda x: 0.0 < x <= np.pi, "give radians up to pi, or None"),
        ]:
            value = getattr(self, key)
            if key == "corner" and value is None:
                continue
            if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not fits(value):
                raise OptionError(f"{value!r} does not fit", key=key, way_out=way_out)


def movements(
    time: NDArray[np.float64],
    position: NDArray[np.float64],
    orientation: NDArray[np.float64] | None,
    options: Segmentation,
) -> NDArray[np.int64]:
    """Find the movements of a recording.

    Parameters
    ----------
    time : array, shape (n_steps,), [s], increasing, from 0
    position : array, shape (n_steps, n_dims), [m]
    orientation : array, shape (n_steps, 4), unit quaternions, neighbours in one hemisphere, or None

    Returns
    -------
    bounds : array, shape (n_movements, 2), first sample and the one after the last; each has at least two samples
    """
    track = _Track.of(time, position, options)
    moving = _moving(track, options)
    if orientation is not None:
        turn = 2.0 * np.arccos(np.abs(orientation @ orientation[0]).min().clip(-1, 1))
        if turn > options.smallest_turn:
            moving |= _moving(_Track.of(time, orientation, options), options)
    bounds = _to_rest(track, _runs(_without_short_gaps(moving, track.step, options.min_pause)), options)
    if options.corner is not None:
        bounds = _cut_at_corners(track, bounds, options.corner, options)
    shortest = options.min_duration - 0.5 * track.step
    bounds = bounds[(bounds[:, 1] - 1 - bounds[:, 0]) * track.step >= shortest]
    if track.even is not time:
        # Samples of the recording that lie within; the even ones only served to find where.
        start, goal = track.even[bounds[:, 0]], track.even[bounds[:, 1] - 1]
        bounds = np.column_stack((np.searchsorted(time, start), np.searchsorted(time, goal, side="right")))
    return bounds[bounds[:, 1] - bounds[:, 0] >= 2]


@dataclass(frozen=True)
class _Track:
    """A filtered recording at even time steps.

    Attributes
    ----------
    even : array, shape (n_steps,), [s]
    path : array, shape (n_steps, n_dims), [m]
    speed : array, shape (n_steps,), [m/s]
    noise : standard deviation of the velocity caused by noise in the recording, all dimensions together [m/s]
    """

    even: NDArray[np.float64]
    path: NDArray[np.float64]
    speed: NDArray[np.float64]
    noise: float

    @property
    def step(self) -> float:
        """Return the time between samples [s]."""
        return float(self.even[-1]) / (len(self.even) - 1)

    @classmethod
    def of(cls, time: NDArray[np.float64], position: NDArray[np.float64], options: Segmentation) -> _Track:
        n_steps = len(time)
        even = time
        if not resampling.is_even(time):
            even = np.linspace(0.0, time[-1], n_steps)
            position = resampling.resample(time, position, even)
        rate = (n_steps - 1) / time[-1]
        cutoff = min(options.cutoff_hz, options.cutoff_share * rate)
        path = resampling.smooth(even, position, cutoff)
        speed = np.sqrt(np.square(np.gradient(path, 1.0 / rate, axis=0)).sum(axis=1))
        return cls(even, path, speed, _speed_noise(position, rate, cutoff))


def _speed_noise(position: NDArray[np.float64], rate: float, cutoff: float) -> float:
    """Return the standard deviation of filtered velocity due to white noise [m/s].

    White noise of deviation s has the power 2 s^2 / rate at each frequency up to the Nyquist frequency;
    differentiation weights it by (2 pi f)^2, and the filter ends the integral near its cutoff.

    Parameters
    ----------
    position : array, shape (n_steps, n_dims), [m]
    rate, cutoff : [Hz]
    """
    time = np.arange(len(position)) / rate
    return resampling.noise(time, position) * 2.0 * np.pi * float(np.sqrt(2.0 / rate * cutoff**3 / 3.0))


def _moving(track: _Track, options: Segmentation) -> NDArray[np.bool_]:
    """Return which samples belong to a movement, with hysteresis.

    A run above the lower threshold is a movement if it exceeds the upper one at some sample.
    """
    speed, share = track.speed, options.speed_share * float(track.speed.max())
    upper = max(share, options.noise_moving * track.noise)
    lower = min(upper, max(options.still_share * share, options.noise_still * track.noise))
    runs = _runs(speed > lower)
    moving = np.zeros(len(speed), dtype=bool)
    if len(runs):
        peaks = np.maximum.reduceat(speed, runs[:, 0])  # up to the next run: what lies between is slow
        moving = _filled(runs[peaks > upper], len(speed))
    return moving


def _without_short_gaps(moving: NDArray[np.bool_], step: float, min_pause: float) -> NDArray[np.bool_]:
    """Fill gaps shorter than `min_pause` [s], also at the ends."""
    if not moving.any():
        return moving
    gaps = _runs(~moving)
    return ~_filled(gaps[(gaps[:, 1] - gaps[:, 0]) * step >= min_pause], len(moving))


def _to_rest(track: _Track, bounds: NDArray[np.int64], options: Segmentation) -> NDArray[np.int64]:
    """Extend runs to where the speed is small, or noise.

    Small is relative to their own largest speed. A common threshold would cut the slow beginning off a slow movement
    beside a fast one. If the gap between two movements never gets so slow, its slowest sample separates them.
    """
    if not len(bounds):
        return bounds
    speed, rest = track.speed, options.noise_still * track.noise
    lowest = [max(rest, options.rest_share * speed[first:stop].max()) for first, stop in bounds.tolist()]
    gaps = np.column_stack((np.r_[0, bounds[:, 1]], np.r_[bounds[:, 0], len(speed)]))
    starts, stops = bounds[:, 0].copy(), bounds[:, 1].copy()
    for index, (low, high) in enumerate(gaps.tolist()):
        if low == high:
            continue
        gap = speed[low:high]
        slowest = first_least(gap)
        if index > 0:
            still = np.flatnonzero(gap <= lowest[index - 1])
            stops[index - 1] = low + 1 + (int(still[0]) if len(still) else slowest)
        if index < len(bounds):
            still = np.flatnonzero(gap <= lowest[index])
            starts[index] = low + (int(still[-1]) if len(still) else slowest)
    starts[1:] = np.maximum(starts[1:], stops[:-1])
    return np.column_stack((starts, stops))


def _runs(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return first and stop of each run of True, shape (n_runs, 2)."""
    edges = np.diff(mask.astype(np.int8), prepend=0, append=0)
    return np.column_stack((np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)))


def _filled(runs: NDArray[np.int64], n_steps: int) -> NDArray[np.bool_]:
    """Return the mask (n_steps,) of runs: the inverse of `_runs`."""
    edges = np.zeros(n_steps + 1, dtype=np.int64)
    edges[runs[:, 0]] += 1
    edges[runs[:, 1]] -= 1
    return np.cumsum(edges[:-1]) > 0


def _cut_at_corners(
    track: _Track, bounds: NDArray[np.int64], corner: float, options: Segmentation
) -> NDArray[np.int64]:
    """Cut runs at speed minima where the path turns by `corner` [rad].

    The turn is measured between the chord from the place of largest speed before the minimum and the chord to the one
    after it. It depends neither on the speed nor on the position of the path.
    """
    from scipy.signal import find_peaks

    cuts = []
    for first, stop in bounds.tolist():
        speed, path = track.speed[first:stop], track.path[first:stop]
        prominence = max(options.noise_still * track.noise, 0.02 * float(speed.max()))
        minima, _ = find_peaks(-speed, prominence=prominence)
        if not len(minima):
            continue
        edges = np.concatenate(([0], minima, [len(speed)]))
        peaks = np.array(
            [low + first_largest(speed[low:high]) for low, high in zip(edges[:-1], edges[1:], strict=True)]
        )
        slow = speed[minima] < options.corner_depth * np.minimum(speed[peaks[:-1]], speed[peaks[1:]])
        before, after = path[minima] - path[peaks[:-1]], path[peaks[1:]] - path[minima]
        lengths = np.linalg.norm(before, axis=1) * np.linalg.norm(after, axis=1)
        cosine = np.einsum("ij,ij->i", before, after) / np.where(lengths > 0.0, lengths, 1.0)
        turned = np.arccos(cosine.clip(-1.0, 1.0)) >= corner
        cuts.append(first + minima[slow & turned & (lengths > 0.0)] + 1)
    inner = np.concatenate([np.empty(0, dtype=np.int64), *cuts])
    return np.column_stack((np.sort(np.r_[bounds[:, 0], inner]), np.sort(np.r_[bounds[:, 1], inner])))

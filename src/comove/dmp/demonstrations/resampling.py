"""Interpolation and smoothing of recorded positions and orientations.

Throughout, `time` is an array (n_steps,) [s], increasing from 0; `position` is (n_steps, n_dims) [m]; `orientation`
is (n_steps, 4), unit quaternions w x y z whose neighbours are in one hemisphere.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError


def resample(
    time: NDArray[np.float64], position: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate positions at times within `time` by a monotone cubic (PCHIP).

    A spline would be smoother, but two jittering time stamps may be microseconds apart, and the steep chord between
    their samples makes a spline overshoot by metres. PCHIP stays between neighbours.
    """
    from scipy.interpolate import PchipInterpolator

    return PchipInterpolator(time, position, axis=0)(at)


def slerp(
    time: NDArray[np.float64], orientation: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate orientations along the shortest turn at constant speed. Samples are exact."""
    before = (np.searchsorted(time, at, side="right") - 1).clip(0, len(time) - 2)
    share = ((at - time[before]) / (time[before + 1] - time[before])).clip(0.0, 1.0)[:, None]
    start, goal = orientation[before], orientation[before + 1]
    # Half the chord gives small angles exactly, for which the arc cosine of the product would round to zero.
    angle = 2.0 * np.arcsin(np.minimum(1.0, 0.5 * np.linalg.norm(goal - start, axis=1)))[:, None]
    near = angle < 1e-8
    scale = np.where(near, 1.0, np.sin(np.where(near, 1.0, angle)))
    left = np.where(near, 1.0 - share, np.sin((1.0 - share) * angle) / scale)
    right = np.where(near, share, np.sin(share * angle) / scale)
    between = left * start + right * goal
    between /= np.linalg.norm(between, axis=1, keepdims=True)
    return np.where(share == 0.0, start, np.where(share == 1.0, goal, between))


def smooth_orientation(
    time: NDArray[np.float64], orientation: NDArray[np.float64], cutoff_hz: float
) -> NDArray[np.float64]:
    """Filter quaternions as `smooth` does positions, and normalise them. Both ends stay exactly.

    Raises
    ------
    OptionError
        If it turns faster than the cutoff: filtered quaternions then become short and lose their direction.
    """
    smoothed = smooth(time, orientation, cutoff_hz)
    norm = np.linalg.norm(smoothed, axis=1, keepdims=True)
    if norm.min() < 0.5:
        raise OptionError(
            f"the hand turns faster than {cutoff_hz} Hz can follow",
            key="cutoff_hz",
            way_out="choose a higher frequency",
        )
    smoothed /= norm
    smoothed[[0, -1]] = orientation[[0, -1]]
    return smoothed


def noise(time: NDArray[np.float64], position: NDArray[np.float64]) -> float:
    """Estimate the standard deviation of a recording's noise, all dimensions together [m].

    It is estimated from fourth differences, in which movements vanish but noise does not; 0 for fewer than 8 samples.
    """
    if len(time) < 8:
        return 0.0
    if not is_even(time):
        position = resample(time, position, np.linspace(0.0, time[-1], len(time)))
    median = np.linalg.norm(np.median(np.abs(np.diff(position, n=4, axis=0)), axis=0))
    # The median of a normal variable's size, and the sum 1 + 16 + 36 + 16 + 1 by which fourth differences vary more.
    return float(median / (0.6745 * np.sqrt(70.0)))


def cutoff_of_noise(time: NDArray[np.float64], position: NDArray[np.float64]) -> float | None:
    """Return the lowest cutoff [Hz] that removes only noise, or None.

    This is the discrepancy principle. From 0.9 of the Nyquist frequency down to 2 oscillations during the movement
    are tried. It is None if the noise is below 1e-5 of the movement's extent, which is negligible.
    """
    deviation, extent = noise(time, position), float(np.ptp(position, axis=0).max())
    if deviation <= 1e-5 * extent:
        return None
    nyquist = 0.5 * (len(time) - 1) / time[-1]
    chosen = None
    for cutoff in np.geomspace(0.9 * nyquist, 2.0 / time[-1], 40):
        removed = np.sqrt(((position - smooth(time, position, cutoff)) ** 2).sum(axis=1).mean())
        if removed > 1.05 * deviation:  # what is more than the noise belongs to the movement
            break
        chosen = float(cutoff)
    return chosen


def is_even(time: NDArray[np.float64]) -> bool:
    """Return whether `time` has even steps, except for rounding."""
    n_steps = len(time)
    return bool(np.abs(time - np.linspace(0.0, time[-1], n_steps)).max() <= 1e-6 * time[-1] / (n_steps - 1))


def smooth(time: NDArray[np.float64], position: NDArray[np.float64], cutoff_hz: float) -> NDArray[np.float64]:
    """Remove frequencies above `cutoff_hz` by a zero-phase Butterworth filter. Both ends stay exactly.

    The line from start to goal is subtracted before filtering, so that the rest vanishes at both ends and its odd
    extension, with which the filter works, is smooth there. At `cutoff_hz` [Hz], which is below the Nyquist
    frequency, the amplitude is halved.
    """
    from scipy.signal import butter, sosfiltfilt

    n_steps = len(time)
    was_even = is_even(time)
    even = time if was_even else np.linspace(0.0, time[-1], n_steps)
    rate = (n_steps - 1) / time[-1]
    bend = (position if was_even else resample(time, position, even)) - _line(position, even)
    settled = min(n_steps - 1, int(np.ceil(3.0 * rate / cutoff_hz)))
    bend = sosfiltfilt(butter(2, cutoff_hz, fs=rate, output="sos"), bend, axis=0, padlen=settled)
    bend -= _line(bend, even)
    smoothed = (bend if was_even else resample(even, bend, time)) + _line(position, time)
    smoothed[[0, -1]] = position[[0, -1]]
    return smoothed


def _line(position: NDArray[np.float64], time: NDArray[np.float64]) -> NDArray[np.float64]:
    return position[0] + np.outer(time / time[-1], position[-1] - position[0])

"""Positions at other instants, and without tremor. Pure functions of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_ORDER = 2
"""Order of the Butterworth filter; forwards and backwards it acts as one of twice the order."""


def resample(
    time: NDArray[np.float64], position: NDArray[np.float64], at: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Interpolate by a monotone cubic (PCHIP).

    A spline would be smoother, but where stamps jitter two samples may lie microseconds apart, and the
    steep chord between them throws a spline metres away from the data. PCHIP stays between neighbours.

    Parameters
    ----------
    time : array, shape (n_steps,), [s], increasing
    position : array, shape (n_steps, n_dims), [m]
    at : array, shape (n_new_steps,), [s], within `time`

    Returns
    -------
    position : array, shape (n_new_steps, n_dims), [m]
    """
    from scipy.interpolate import PchipInterpolator

    return PchipInterpolator(time, position, axis=0)(at)


def smooth(time: NDArray[np.float64], position: NDArray[np.float64], cutoff_hz: float) -> NDArray[np.float64]:
    """Remove what is faster than `cutoff_hz` by a zero-phase Butterworth filter; both ends stay exactly.

    The line from start to goal is set aside, so that the rest vanishes at both ends and its odd extension,
    which the filter sees, is smooth there.

    Parameters
    ----------
    time : array, shape (n_steps,), [s], increasing, from 0
    position : array, shape (n_steps, n_dims), [m]
    cutoff_hz : frequency whose amplitude is halved [Hz], below the Nyquist frequency

    Returns
    -------
    position : array, shape (n_steps, n_dims), [m], at the same instants
    """
    from scipy.signal import butter, sosfiltfilt

    n_steps = len(time)
    even = np.linspace(0.0, time[-1], n_steps)
    rate = (n_steps - 1) / time[-1]
    bend = resample(time, position, even) - _line(position, even)
    settled = min(n_steps - 1, int(np.ceil(3.0 * rate / cutoff_hz)))
    bend = sosfiltfilt(butter(_ORDER, cutoff_hz, fs=rate, output="sos"), bend, axis=0, padlen=settled)
    bend -= _line(bend, even)
    smoothed = resample(even, bend, time) + _line(position, time)
    smoothed[[0, -1]] = position[[0, -1]]
    return smoothed


def _line(position: NDArray[np.float64], time: NDArray[np.float64]) -> NDArray[np.float64]:
    """Straight line from the first to the last row, shape (n_steps, n_dims), at even pace over `time`."""
    return position[0] + np.outer(time / time[-1], position[-1] - position[0])

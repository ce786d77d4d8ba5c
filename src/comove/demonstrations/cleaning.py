"""What makes a recording fit to learn from: the checks, and the few repairs that are said in words.

A check raises, because only the user can mend what it finds; a repair returns a note beside the arrays,
empty where there was nothing to do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import DemonstrationError

MAX_DIMS = 7
LARGEST = 1e12
"""Numbers beyond this are no measurement, and their squares overflow."""
SHORTEST = 1e-6
"""Recordings below this duration have no velocity to speak of [s]."""
MILLIMETRE_EXTENT = 5.0
"""A hand's movement with a larger extent than this was probably not recorded in metres [m]."""
UNIT_HINT = "looks like millimetres, divide by 1000"


@dataclass(frozen=True)
class Origin:
    """Where samples come from: names them in messages the way the user sees them.

    Attributes
    ----------
    file : the file they were read from, None for arrays in memory
    """

    file: object = None

    def time(self, sample: int) -> str:
        """Name the time stamp of a sample, counted from 0."""
        return f"time[{sample}]"

    def position(self, sample: int, dim: int) -> str:
        """Name one coordinate of a sample."""
        return f"position[{sample}, {dim}]"


IN_MEMORY = Origin()


def check(
    time: ArrayLike, position: ArrayLike, origin: Origin = IN_MEMORY
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Refuse what is no recorded movement.

    Parameters
    ----------
    time : array, shape (n_steps,), [s]
    position : array, shape (n_steps, n_dims), [m]
    origin : names samples in messages

    Returns
    -------
    time, position : new arrays of the same shapes

    Raises
    ------
    DemonstrationError
        Not numeric, shapes that do not belong together, fewer than two rows, a number that is not finite,
        time that goes back or stands still. Names the first bad row.
    """
    time, position = _numbers(time, "time", origin), _numbers(position, "position", origin)
    _check_shapes(time, position, origin)
    _check_finite(time, position, origin)
    _check_time(time, origin)
    return time, position


def start_at_zero(time: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """Shift `time`, shape (n_steps,), [s], to start at zero."""
    if time[0] == 0.0:
        return time, ""
    return time - time[0], f"time shifted by {-time[0]:.9g} s to start at 0"


def merge_repeated_stamps(
    time: NDArray[np.float64], position: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], str]:
    """Give each instant one position: the mean of the rows that share its stamp.

    Parameters
    ----------
    time : array, shape (n_steps,), [s], not decreasing
    position : array, shape (n_steps, n_dims), [m]

    Returns
    -------
    time : array, shape (n_distinct,), [s], increasing
    position : array, shape (n_distinct, n_dims), [m]
    note : what was merged, empty if nothing
    """
    repeated = np.diff(time) == 0.0
    if not repeated.any():
        return time, position, ""
    first = np.flatnonzero(np.concatenate(([True], ~repeated)))
    counts = np.diff(first, append=len(time))
    mean = np.add.reduceat(position, first, axis=0) / counts[:, None]
    note = (
        f"repeated time stamps (the first at {time[np.argmax(repeated)]:.9g} s) merged into their mean "
        f"position: {len(time)} rows became {len(first)}"
    )
    return time[first], mean, note


def unit_hint(position: NDArray[np.float64]) -> str:
    """Say so when `position`, shape (n_steps, n_dims), [m], looks like millimetres."""
    extent = np.ptp(position, axis=0).max()
    return f"the movement spans {extent:.4g} m: {UNIT_HINT}" if extent > MILLIMETRE_EXTENT else ""


def _numbers(values: ArrayLike, name: str, origin: Origin) -> NDArray[np.float64]:
    try:
        array = np.asarray(values)
    except ValueError:
        raise DemonstrationError(
            "its rows differ in length", file=origin.file, key=name, way_out="give every row the same columns"
        ) from None
    if array.dtype.kind not in "iuf":
        raise DemonstrationError(
            f"holds {array.dtype.name}, not numbers", file=origin.file, key=name, way_out="give real numbers"
        )
    return np.array(array, dtype=np.float64)


def _check_shapes(time: NDArray[np.float64], position: NDArray[np.float64], origin: Origin) -> None:
    def wrong(key: str, message: str, way_out: str) -> DemonstrationError:
        return DemonstrationError(message, file=origin.file, key=key, way_out=way_out)

    if time.ndim != 1:
        raise wrong("time", f"has shape {time.shape}", "give one stamp a row, shape (n_steps,)")
    if position.ndim != 2:
        raise wrong(
            "position", f"has shape {position.shape}", "give one row an instant, shape (n_steps, n_dims)"
        )
    n_steps, n_dims = position.shape
    if n_steps != len(time):
        transposed = n_dims == len(time)
        way_out = "transpose position to (n_steps, n_dims)" if transposed else "give one row a time stamp"
        raise wrong("position", f"has {n_steps} rows and time has {len(time)}", way_out)
    if n_steps < 2:
        raise wrong(
            "time", f"a movement needs two rows at least, this one has {n_steps}", "record more samples"
        )
    if not 1 <= n_dims <= MAX_DIMS:
        raise wrong("position", f"has {n_dims} columns", f"give 1 to {MAX_DIMS} coordinates")


def _check_finite(time: NDArray[np.float64], position: NDArray[np.float64], origin: Origin) -> None:
    bad = ~(np.abs(np.column_stack((time, position))) <= LARGEST)
    if not bad.any():
        return
    sample, column = np.argwhere(bad)[0]
    is_time = column == 0
    raise DemonstrationError(
        f"{time[sample] if is_time else position[sample, column - 1]} is not a number below {LARGEST:g}",
        file=origin.file,
        key=origin.time(sample) if is_time else origin.position(sample, column - 1),
        way_out="remove the row or fill in what was measured",
    )


def _check_time(time: NDArray[np.float64], origin: Origin) -> None:
    backwards = np.diff(time) < 0.0
    if backwards.any():
        row = int(np.argmax(backwards)) + 1
        raise DemonstrationError(
            f"time goes back from {time[row - 1]} s to {time[row]} s",
            file=origin.file,
            key=origin.time(row),
            way_out="sort the rows, or cut the recording there",
        )
    duration = time[-1] - time[0]
    if duration < SHORTEST:
        what = "stands still" if duration == 0.0 else f"passes only {duration:.3g} s in all, from here"
        raise DemonstrationError(
            f"time {what} at {time[1]} s",
            file=origin.file,
            key=origin.time(1),
            way_out="write the time of each row, in seconds",
        )

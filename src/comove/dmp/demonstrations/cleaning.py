"""Checks of recordings, and a few reported repairs.

A check raises, because only the user can correct the fault; a repair returns a note beside the arrays, which is empty
if there was nothing to repair. Throughout, `time` is an array (n_steps,) [s], `position` is (n_steps, n_dims) [m],
`orientation` is (n_steps, 4), quaternions w x y z; an `origin` names samples in messages.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.dmp.demonstrations.samples import AXES, IN_MEMORY, Origin, fault
from comove.errors import DemonstrationError

MAX_DIMS = 64
LARGEST = 1e12
"""Numbers beyond this are no measurement, and their squares overflow."""
SHORTEST = 1e-6
"""Recordings below this duration have no velocity to speak of [s]."""
NORM_TOLERANCE = 1e-3
"""Quaternions whose norm is off by more than this are no rounding, but a mistake."""
_NORM_ROUNDING = 8.0 * np.finfo(np.float64).eps
"""Norms this near to one are left alone, so that what was normalised once stays as it is, bit by bit."""


def check(
    time: ArrayLike, position: ArrayLike, origin: Origin = IN_MEMORY
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return time and position as new arrays, checked.

    Raises
    ------
    DemonstrationError
        If they are not numeric, their shapes disagree, there are fewer than two rows, a number is not finite, or
        time does not increase. Names the first bad row.
    """
    time, position = _numbers(time, "time", origin), _numbers(position, "position", origin)
    _check_shapes(time, position, origin)
    _check_finite(time, position, origin)
    _check_time(time, origin)
    return time, position


def check_orientation(
    orientation: ArrayLike, n_steps: int, origin: Origin = IN_MEMORY
) -> NDArray[np.float64]:
    """Return orientations as a new array of unit quaternions, checked.

    Raises
    ------
    DemonstrationError
        If they are not numeric, have another shape, are not finite, or a norm differs from 1 by more than
        `NORM_TOLERANCE`. Names the first bad row.
    """
    orientation = _numbers(orientation, "orientation", origin)
    if orientation.shape != (n_steps, 4):
        raise fault(
            origin.file,
            "orientation",
            f"has shape {orientation.shape} and position has {n_steps} rows",
            "give one quaternion w x y z a row, shape (n_steps, 4)",
        )
    norm = np.linalg.norm(np.clip(orientation, -LARGEST, LARGEST), axis=1)
    bad = ~(np.abs(norm - 1.0) <= NORM_TOLERANCE)
    if bad.any():
        row = int(np.argmax(bad))
        raise fault(
            origin.file,
            origin.orientation(row),
            f"the quaternion {orientation[row].tolist()} has norm {norm[row]:.4g}, not 1",
            "give unit quaternions in the order w x y z",
        )
    off = np.abs(norm - 1.0) > _NORM_ROUNDING
    orientation[off] /= norm[off, None]
    return orientation


def without_sign_changes(orientation: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """Return orientations without sign changes between neighbours, and a note."""
    flips = np.einsum("ij,ij->i", orientation[1:], orientation[:-1]) < 0.0
    if not flips.any():
        return orientation, ""
    turned = np.concatenate(([False], np.logical_xor.accumulate(flips)))
    return np.where(turned[:, None], -orientation, orientation), (
        f"{np.count_nonzero(flips)} changes of sign between quaternions undone"
    )


def merge_repeated_orientations(
    time: NDArray[np.float64], orientation: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return one mean orientation per instant. `time` does not decrease.

    The mean is the axis nearest to all of them (Markley), which does not depend on signs; single rows stay as they
    are.
    """
    first = np.flatnonzero(np.concatenate(([True], np.diff(time) > 0.0)))
    merged = orientation[first]
    repeated = np.diff(first, append=len(time)) > 1
    if repeated.any():
        products = np.add.reduceat(orientation[:, :, None] * orientation[:, None, :], first, axis=0)
        nearest = np.linalg.eigh(products[repeated])[1][:, :, -1]
        against = np.einsum("ij,ij->i", nearest, merged[repeated]) < 0.0
        merged[repeated] = np.where(against[:, None], -nearest, nearest)
    return merged


def check_axes(axes: Iterable[str], n_dims: int, origin: Origin = IN_MEMORY) -> tuple[str, ...]:
    """Return the names of `n_dims` coordinates, checked; () for x, y, z.

    Raises
    ------
    DemonstrationError
        If there are not as many names as coordinates, or a name is empty or repeated.
    """
    names = (axes,) if isinstance(axes, str) else tuple(axes)
    if names in ((), AXES[:n_dims]):
        return ()
    if len(names) != n_dims:
        message = f"{len(names)} names stand for {n_dims} coordinates"
    elif not all(isinstance(name, str) and name for name in names):
        message = f"{names!r} are not all names"
    elif len(set(names)) < n_dims:
        message = f"the name {next(name for name in names if names.count(name) > 1)!r} stands twice"
    else:
        return tuple(map(str, names))
    raise fault(origin.file, origin.axes, message, "give each coordinate a name of its own, or none")


def start_at_zero(time: NDArray[np.float64]) -> tuple[NDArray[np.float64], str]:
    """Return `time` shifted to start at zero, and a note."""
    if time[0] == 0.0:
        return time, ""
    return time - time[0], f"time shifted by {-time[0]:.9g} s to start at 0"


def merge_repeated_stamps(
    time: NDArray[np.float64], position: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64], str]:
    """Return distinct times with mean positions, and a note.

    `time` does not decrease; the one that is returned increases.
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


def _numbers(values: ArrayLike, name: str, origin: Origin) -> NDArray[np.float64]:
    try:
        array = np.asarray(values)
    except ValueError:
        raise fault(
            origin.file, name, "its rows differ in length", "give every row the same columns"
        ) from None
    if array.dtype.kind not in "iuf":
        raise fault(origin.file, name, f"holds {array.dtype.name}, not numbers", "give real numbers")
    return np.array(array, dtype=np.float64)


def _check_shapes(time: NDArray[np.float64], position: NDArray[np.float64], origin: Origin) -> None:
    def wrong(key: str, message: str, way_out: str) -> DemonstrationError:
        return fault(origin.file, key, message, way_out)

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
    raise fault(
        origin.file,
        origin.time(sample) if is_time else origin.position(sample, column - 1),
        f"{time[sample] if is_time else position[sample, column - 1]} is not a number below {LARGEST:g}",
        "remove the row or fill in what was measured",
    )


def _check_time(time: NDArray[np.float64], origin: Origin) -> None:
    backwards = np.diff(time) < 0.0
    if backwards.any():
        row = int(np.argmax(backwards)) + 1
        raise fault(
            origin.file,
            origin.time(row),
            f"time goes back from {time[row - 1]} s to {time[row]} s",
            "sort the rows, or cut the recording there",
        )
    duration = time[-1] - time[0]
    if duration < SHORTEST:
        what = "stands still" if duration == 0.0 else f"passes only {duration:.3g} s in all, from here"
        raise fault(
            origin.file,
            origin.time(1),
            f"time {what} at {time[1]} s",
            "write the time of each row, in seconds",
        )

"""One recorded movement."""

from __future__ import annotations

import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations import cleaning, resampling
from comove.errors import ComoveWarning, DemonstrationError, OptionError, near_name

_END_SAMPLES = 7
_END_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One recorded movement, clean by construction.

    Time starts at zero and increases, at whatever steps it was recorded; all numbers are finite. A later
    start is shifted, rows of one instant are merged into their mean; anything worse is refused.

    Parameters
    ----------
    time : array, shape (n_steps,), [s]
    position : array, shape (n_steps, n_dims), [m]; 1 to 7 dimensions
    name : what to call it in messages
    notes : what was done to the recording so far, in words; cleaning appends to it
    unit : unit of `position`; anything but "m" is exempt from the hint at millimetres

    Both arrays are read-only copies.

    Raises
    ------
    DemonstrationError
        It is no movement; names the row.

    Warns
    -----
    ComoveWarning
        Positions were merged, or look like millimetres.
    """

    time: NDArray[np.float64]
    position: NDArray[np.float64]
    name: str = ""
    notes: tuple[str, ...] = ()
    unit: str = "m"

    def __post_init__(self) -> None:
        time, position = cleaning.check(self.time, self.position)
        time, shifted = cleaning.start_at_zero(time)
        time, position, merged = cleaning.merge_repeated_stamps(time, position)
        hint = self._unit_hint(position)
        for array in (time, position):
            array.setflags(write=False)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "notes", (*self.notes, *filter(None, (shifted, merged, hint))))
        _warn(self.name, merged, hint, stacklevel=4)

    @property
    def n_steps(self) -> int:
        """Number of samples."""
        return self.position.shape[0]

    @property
    def n_dims(self) -> int:
        """Number of coordinates."""
        return self.position.shape[1]

    @property
    def duration(self) -> float:
        """Time of the last sample [s]."""
        return float(self.time[-1])

    @property
    def start(self) -> NDArray[np.float64]:
        """First position, shape (n_dims,), [m]."""
        return self.position[0]

    @property
    def goal(self) -> NDArray[np.float64]:
        """Last position, shape (n_dims,), [m]."""
        return self.position[-1]

    @property
    def start_velocity(self) -> NDArray[np.float64]:
        """Velocity at the first sample, shape (n_dims,), [m/s]; see `_end_velocity`."""
        return _end_velocity(self.time, self.position)

    @property
    def goal_velocity(self) -> NDArray[np.float64]:
        """Velocity at the last sample, shape (n_dims,), [m/s]; see `_end_velocity`."""
        return -_end_velocity(self.duration - self.time[::-1], self.position[::-1])

    def resampled(self, n_steps: int) -> Demonstration:
        """Return the movement at `n_steps` even time steps, interpolated between neighbours (PCHIP).

        Raises
        ------
        OptionError
            `n_steps` is not a whole number of at least 2.
        """
        if not isinstance(n_steps, int | np.integer) or isinstance(n_steps, bool) or n_steps < 2:
            raise OptionError(f"{n_steps!r} is no number of steps", key="n_steps", way_out="give 2 or more")
        time = np.linspace(0.0, self.duration, n_steps)
        position = resampling.resample(self.time, self.position, time)
        position[[0, -1]] = self.position[[0, -1]]
        return self._changed(time, position, f"resampled from {self.n_steps} to {n_steps} even time steps")

    def smoothed(self, cutoff_hz: float) -> Demonstration:
        """Return the movement without what is faster than `cutoff_hz` [Hz]; both ends stay exactly.

        Raises
        ------
        OptionError
            The recording holds no such frequency.

        Warns
        -----
        ComoveWarning
            Always, and says how far samples were moved at most: smoothing is never silent.
        """
        nyquist = 0.5 * (self.n_steps - 1) / self.duration
        if not 0.0 < cutoff_hz < nyquist:
            raise OptionError(
                f"{self.n_steps} samples in {self.duration:.4g} s know nothing of {cutoff_hz} Hz",
                key="cutoff_hz",
                way_out=f"choose one between 0 and {nyquist:.4g} Hz",
            )
        position = resampling.smooth(self.time, self.position, cutoff_hz)
        moved = np.linalg.norm(position - self.position, axis=1).max()
        filter_name = f"zero-phase Butterworth, {cutoff_hz:g} Hz"
        note = f"smoothed ({filter_name}): samples moved by up to {moved:.3g} {self.unit}"
        _warn(self.name, note, stacklevel=3)
        return self._changed(self.time, position, note)

    def trimmed(self, speed_threshold: float) -> Demonstration:
        """Return the movement without standing still, slower than `speed_threshold` [m/s], at its ends.

        Raises
        ------
        OptionError
            The movement is never that fast.
        """
        speed = np.linalg.norm(np.diff(self.position, axis=0), axis=1) / np.diff(self.time)
        moving = np.flatnonzero(speed > speed_threshold)
        if not moving.size:
            raise OptionError(
                f"the movement never exceeds {speed_threshold} {self.unit}/s",
                key="speed_threshold",
                way_out=f"its largest speed is {speed.max():.4g} {self.unit}/s; choose less",
            )
        first, last = moving[0], moving[-1] + 1
        if first == 0 and last == self.n_steps - 1:
            return self
        before, after = self.time[first], self.duration - self.time[last]
        note = f"standing still cut: {before:.4g} s at the start, {after:.4g} s at the end"
        kept = slice(first, last + 1)
        return self._changed(self.time[kept] - before, self.position[kept], note)

    @classmethod
    def load(cls, path: str | os.PathLike[str], manipulator: str | None = None) -> Demonstration:
        """Read a `.csv` or `.npz` file; see `from_csv` and `from_npz`."""
        readers = {".csv": cls.from_csv, ".npz": cls.from_npz}
        suffix = Path(path).suffix
        if suffix.lower() not in readers:
            raise DemonstrationError(
                f"its kind {suffix!r} is not known", file=path, way_out=near_name(suffix, readers)
            )
        return readers[suffix.lower()](path, manipulator)

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str], manipulator: str | None = None) -> Demonstration:
        """Read one movement from a CSV file; `manipulator` says which if there are several.

        Raises
        ------
        DemonstrationError
            The file cannot be read as `comove.demonstrations.csv` describes, or holds several
            manipulators and none, or an unknown one, was named.
        """
        from comove.demonstrations.csv import read_csv

        return _choose(read_csv(path), manipulator, path)

    @classmethod
    def from_npz(cls, path: str | os.PathLike[str], manipulator: str | None = None) -> Demonstration:
        """Read one movement from an NPZ file, as `from_csv` does."""
        from comove.demonstrations.npz import read_npz

        return _choose(read_npz(path), manipulator, path)

    @classmethod
    def from_lasa(cls, shape: str, demo: int = 0) -> Demonstration:
        """Read one recording of the LASA handwriting set; see `comove.demonstrations.lasa`."""
        from comove.demonstrations.lasa import read_lasa

        return read_lasa(shape, demo)

    def _changed(self, time: NDArray[np.float64], position: NDArray[np.float64], note: str) -> Demonstration:
        return replace(self, time=time, position=position, notes=(*self.notes, note))

    def _unit_hint(self, position: NDArray[np.float64]) -> str:
        told = any(cleaning.UNIT_HINT in note for note in self.notes)
        return "" if told or self.unit != "m" else cleaning.unit_hint(position)


def _warn(name: str, *notes: str, stacklevel: int) -> None:
    """Warn once of all `notes` that are not empty."""
    if text := "; ".join(filter(None, notes)):
        warnings.warn(f"{name or 'demonstration'}: {text}", ComoveWarning, stacklevel=stacklevel)


def _end_velocity(time: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Velocity at time zero, shape (n_dims,), from a parabola through the samples near it.

    Least squares over the first seven samples, and at least the first hundredth of the movement, so that
    neither noise nor a pair of stamps a moment apart decides. Exact for polynomials of degree 2.

    Parameters
    ----------
    time : array, shape (n_steps,), [s], increasing, from 0
    position : array, shape (n_steps, n_dims), [m]
    """
    n_near = max(_END_SAMPLES, int(np.searchsorted(time, _END_SHARE * time[-1], side="right")))
    near, positions = time[:n_near], position[:n_near]
    degree = min(2, len(near) - 1)
    powers = (near / near[-1])[:, None] ** np.arange(degree + 1)
    coefficients, *_ = np.linalg.lstsq(powers, positions - positions[0], rcond=1e-6)
    return coefficients[1] / near[-1]


def _choose(demos: Mapping[str, Demonstration], manipulator: str | None, file: object) -> Demonstration:
    """Pick one of the movements of a file."""
    if manipulator is None and len(demos) == 1:
        return next(iter(demos.values()))
    if manipulator in demos:
        return demos[manipulator]
    if list(demos) == [""]:
        raise DemonstrationError(
            f"it holds one movement without a name, not {manipulator!r}",
            file=file,
            key="manipulator",
            way_out="leave the manipulator out",
        )
    if manipulator is None:
        message, way_out = f"it holds {len(demos)} manipulators", f"name one of {', '.join(demos)}"
    else:
        message, way_out = f"there is no {manipulator!r}", near_name(manipulator, demos)
    raise DemonstrationError(message, file=file, key="manipulator", way_out=way_out)

"""The class of recorded movements, and their segmentation."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import wraps
from typing import TYPE_CHECKING, Any, ParamSpec, Self

import numpy as np
from numpy.typing import NDArray

from comove.arrays import first_largest
from comove.dmp.demonstrations import cleaning, formats, plausibility, resampling
from comove.dmp.demonstrations.samples import IN_MEMORY, RecordedSamples
from comove.dmp.demonstrations.segmentation import Segmentation, movements
from comove.dmp.demonstrations.units import base_unit, in_base_unit
from comove.errors import ComoveWarning, DemonstrationError, OptionError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_P = ParamSpec("_P")


@dataclass(frozen=True, eq=False)
class Demonstration(RecordedSamples):
    """One recorded movement, clean by construction.

    Time starts at zero and increases, in even or uneven steps; all numbers are finite. Time stamps are shifted to
    start at zero, rows of one instant are merged into their mean, and quaternions get unit norm and the sign that is
    nearest to their neighbour; all other faults are errors.

    Parameters
    ----------
    time : array, shape (n_steps,), [s]
    position : array, shape (n_steps, n_dims), [m]; 1 to 64 dimensions
    name : name of the movement in messages
    notes : reports of the processing so far, in words; cleaning appends to them
    unit : unit of `position`; "m" is checked for numbers that look like millimetres, "rad" for degrees
    orientation : array, shape (n_steps, 4), unit quaternions w x y z; None if none was recorded
    axes : names of the coordinates, such as those of joints; () if they are x, y, z or have no names
    stated : certain facts, which are not checked for plausibility: "time", that it is in seconds, and "unit"
    origin : names of the places of the samples in their file, for errors; forgotten after the checks

    All arrays are read-only copies.

    Raises
    ------
    DemonstrationError
        If it is not a movement, or the norm of a quaternion differs from 1 by more than 0.001; names the row.

    Warns
    -----
    ComoveWarning
        If positions were merged, or something looks wrong: units of time or position, time without samples, jumps, or
        that nothing moves (`comove.dmp.demonstrations.plausibility`).
    """

    def __post_init__(self) -> None:
        origin = self.origin
        time, position = cleaning.check(self.time, self.position, origin)
        orientation, flipped = self.orientation, ""
        if orientation is not None:
            orientation = cleaning.check_orientation(orientation, len(time), origin)
            orientation, flipped = cleaning.without_sign_changes(orientation)
        axes = cleaning.check_axes(self.axes, position.shape[1], origin)
        time, shifted = cleaning.start_at_zero(time)
        if orientation is not None:
            orientation = cleaning.merge_repeated_orientations(time, orientation)
        time, position, merged = cleaning.merge_repeated_stamps(time, position)
        stated = frozenset(self.stated)
        found = plausibility.doubts(time, position, self.unit, orientation, stated=stated, origin=origin)
        doubts = [doubt for doubt in found if not any(doubt.mark in note for note in self.notes)]
        notes = (*self.notes, *filter(None, (shifted, merged, flipped)), *(doubt.message for doubt in doubts))
        for name, array in (("time", time), ("position", position), ("orientation", orientation)):
            if array is not None:
                array.setflags(write=False)
            object.__setattr__(self, name, array)
        for name, value in (("axes", axes), ("notes", notes), ("stated", stated), ("origin", IN_MEMORY)):
            object.__setattr__(self, name, value)
        _warn(self.name, merged, *map(str, doubts), stacklevel=4)

    @classmethod
    def of(cls, samples: RecordedSamples) -> Self:
        """Return a reader's movement, checked; errors name places in its file."""
        return cls(**vars(samples))

    @property
    def start(self) -> NDArray[np.float64]:
        """Return the first position, shape (n_dims,), [m]."""
        return self.position[0]

    @property
    def goal(self) -> NDArray[np.float64]:
        """Return the last position, shape (n_dims,), [m]."""
        return self.position[-1]

    @property
    def rotation(self) -> Rotation | None:
        """Return the orientations as SciPy's rotations, None if none were recorded."""
        if self.orientation is None:
            return None
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.orientation[:, [1, 2, 3, 0]])

    @property
    def start_velocity(self) -> NDArray[np.float64]:
        """Return the velocity at the first sample, shape (n_dims,), [m/s]."""
        return _end_velocity(self.time, self.position)

    @property
    def goal_velocity(self) -> NDArray[np.float64]:
        """Return the velocity at the last sample, shape (n_dims,), [m/s]."""
        return -_end_velocity(self.duration - self.time[::-1], self.position[::-1])

    def resampled(self, n_steps: int) -> Demonstration:
        """Return the movement at `n_steps` even time steps, interpolated between neighbours.

        Positions are interpolated by a monotone cubic (PCHIP), orientations along the shortest turn (slerp).

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
        orientation = (
            None if self.orientation is None else resampling.slerp(self.time, self.orientation, time)
        )
        note = f"resampled from {self.n_steps} to {n_steps} even time steps"
        return self._changed(time, position, orientation, note)

    def smoothed(self, cutoff_hz: float) -> Demonstration:
        """Return the movement without frequencies above `cutoff_hz` [Hz]. Both ends stay exactly.

        Raises
        ------
        OptionError
            If the cutoff is not below the Nyquist frequency, or the recording turns too fast for it.

        Warns
        -----
        ComoveWarning
            Always; reports the largest displacement of a sample.
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
        orientation = None
        if self.orientation is not None:
            orientation = resampling.smooth_orientation(self.time, self.orientation, cutoff_hz)
            apart = np.linalg.norm(orientation - self.orientation, axis=1).max()
            note += f" and turned by up to {4.0 * np.arcsin(min(1.0, apart / 2.0)):.3g} rad"
        _warn(self.name, note, stacklevel=3)
        return self._changed(self.time, position, orientation, note)

    def in_base_unit(self) -> Demonstration:
        """Return the movement in metres, or in radians of joints; other units stay."""
        base = base_unit(self.unit)
        if base == self.unit:
            return self
        notes = (*self.notes, f"converted from {self.unit} to {base}")
        return replace(self, position=in_base_unit(self.unit) * self.position, unit=base, notes=notes)

    def cleaned(self) -> Demonstration:
        """Return the movement between the pauses, without its noise. Notes report the processing.

        If there are several movements, the one with the longest path is returned. The cutoff frequency is the lowest
        at which the filter removes no more than the noise, which is estimated from the recording itself.

        Raises
        ------
        DemonstrationError
            If nothing moves in it.
        """
        parts = segment(self)
        if not parts:
            raise DemonstrationError(
                "the hand never moves in it",
                file=self.name or None,
                way_out="record a movement between two pauses",
            )
        ways = [float(np.linalg.norm(np.diff(part.position, axis=0), axis=1).sum()) for part in parts]
        part = replace(parts[first_largest(ways)], name=self.name)
        cutoff = resampling.cutoff_of_noise(part.time, part.position)
        return part if cutoff is None else part.smoothed(float(f"{cutoff:.3g}"))

    def trimmed(self, speed_threshold: float) -> Demonstration:
        """Return the movement without ends slower than `speed_threshold` [m/s].

        Rotation without translation counts as standing still.

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
        first, last = int(moving[0]), int(moving[-1]) + 1
        if first == 0 and last == self.n_steps - 1:
            return self
        before, after = self.time[first], self.duration - self.time[last]
        note = f"standing still cut: {before:.4g} s at the start, {after:.4g} s at the end"
        return self._part(first, last + 1, note)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike[str],
        manipulator: str | None = None,
        *,
        episode: str | int | None = None,
        topic: str | None = None,
        unit: str | None = None,
        columns: Sequence[str] | None = None,
        delimiter: str | None = None,
        time: str | None = None,
        rate: float | None = None,
        clean: bool = False,
        **options: Any,
    ) -> Demonstration:
        """Read one movement from a file or folder of any supported kind.

        The suffix determines the kind: .npz; .hdf5 or .h5 (robomimic, ALOHA); .bag (ROS 1); .mcap or .db3 (ROS 2);
        text tables have .csv, .tsv, .txt or others. A folder with `meta/info.json` is a LeRobot dataset, one with
        `metadata.yaml` a rosbag2. Lengths are converted to metres, and angles of joints to radians.

        Parameters
        ----------
        path : file or folder
        manipulator : name of the manipulator or body, if several were recorded together
        episode : name or number of the recording, if the file holds several
        topic : topic of a bag
        unit : unit of positions ("mm") or of joints ("deg"), if the file states none; by default metres and radians
        columns, delimiter, time, rate : see `formats.tables.read`
        clean : whether to return the movement between the pauses, without noise (see `cleaned`)
        options : options of a single format: `dataset` of HDF5 files, `feature` of LeRobot datasets; see its `read`

        Raises
        ------
        DemonstrationError
            If it cannot be read, an option does not belong to the kind of file, or it holds several movements and the
            name is missing or unknown; lists the names.
        OptionError
            If the unit contradicts the one that the file states.
        """
        choices = {"episode": episode, "topic": topic, "rate": rate} | options
        layout = {"columns": columns, "delimiter": delimiter, "time": time}
        samples = formats.load(path, manipulator, unit=unit, options=choices | layout)
        recording = cls.of(samples).in_base_unit()
        return recording.cleaned() if clean else recording

    @classmethod
    def load_all(cls, path: str | os.PathLike[str]) -> tuple[Demonstration, ...]:
        """Read all movements of a file or folder, as `load` does.

        The name of each movement holds its episode, manipulator or topic.
        """
        return tuple(movement for found in cls.load_recordings(path) for movement in found.values())

    @classmethod
    def load_recordings(cls, path: str | os.PathLike[str]) -> tuple[dict[str, Demonstration], ...]:
        """Read all recordings of a file or folder by manipulator. A single movement without a name is under "".

        Raises
        ------
        DemonstrationError
            If it cannot be read.
        """
        found = formats.load_recordings(path)
        return tuple(
            {name: cls.of(samples).in_base_unit() for name, samples in recording.items()}
            for recording in found
        )

    @classmethod
    def from_csv(cls, path: str | os.PathLike[str], manipulator: str | None = None) -> Demonstration:
        """Read one movement from a text table, as `load` does."""
        return cls.load(path, manipulator)

    @classmethod
    def from_lasa(cls, shape: str, demo: int = 0) -> Demonstration:
        """Read one recording of the LASA handwriting set. See `comove.dmp.demonstrations.formats.lasa`."""
        from comove.dmp.demonstrations.formats import lasa

        return cls.of(lasa.read(shape, demo))

    def _changed(
        self,
        time: NDArray[np.float64],
        position: NDArray[np.float64],
        orientation: NDArray[np.float64] | None,
        note: str,
    ) -> Demonstration:
        notes = (*self.notes, note)
        return replace(self, time=time, position=position, orientation=orientation, notes=notes)

    def _part(self, first: int, stop: int, note: str, name: str | None = None) -> Demonstration:
        """Return the movement of the samples from `first` to before `stop`."""
        kept = slice(first, stop)
        orientation = None if self.orientation is None else self.orientation[kept]
        part = self._changed(self.time[kept] - self.time[first], self.position[kept], orientation, note)
        return part if name is None else replace(part, name=name)


def segment(
    demonstration: Demonstration,
    *,
    speed_share: float = 0.05,
    min_pause: float = 0.2,
    min_duration: float = 0.2,
    cutoff_hz: float = 6.0,
    corner: float | None = None,
) -> tuple[Demonstration, ...]:
    """Cut a recording into movements. The pauses between them are dropped.

    Parameters
    ----------
    demonstration : recording of any number of movements
    speed_share : share of the recording's largest speed that a movement must exceed, between 0 and 1; the movement
        begins and ends where the speed is 0.02 of its own largest
    min_pause : shortest duration of a pause [s]; the movement continues through shorter ones
    min_duration : shortest duration of a movement [s]; shorter ones are dropped
    cutoff_hz : frequency above which the recording counts as noise [Hz]; at most a fifth of the sampling rate is
        used
    corner : smallest angle between path directions [rad] at which minima of the speed are cut; None: cut at pauses
        only

    Returns
    -------
    movements : in the order of time, without common samples; empty if nothing moves. Time starts at zero in each;
        the last note gives the recording and the instants in it.

    Raises
    ------
    OptionError
        If a parameter is out of its range; names it.
    """
    options = Segmentation(speed_share, min_pause, min_duration, cutoff_hz, corner)
    bounds = movements(demonstration.time, demonstration.position, demonstration.orientation, options)
    name = demonstration.name or "recording"
    parts = []
    for number, (first, stop) in enumerate(bounds.tolist()):
        start, goal = demonstration.time[first], demonstration.time[stop - 1]
        note = f"movement {number} of {len(bounds)}, from {start:.6g} s to {goal:.6g} s of {name}"
        parts.append(demonstration._part(first, stop, note, name=f"{name} {number}"))
    return tuple(parts)


def each(read: Callable[_P, Mapping[str, RecordedSamples]]) -> Callable[_P, dict[str, Demonstration]]:
    """Return a reader of samples as one of demonstrations."""

    @wraps(read)
    def reader(*args: _P.args, **options: _P.kwargs) -> dict[str, Demonstration]:
        return {name: Demonstration.of(samples) for name, samples in read(*args, **options).items()}

    return reader


def each_episode(
    read: Callable[_P, Mapping[str, Mapping[str, RecordedSamples]]],
) -> Callable[_P, dict[str, dict[str, Demonstration]]]:
    """Return a reader of episodes as one of demonstrations by manipulator."""

    @wraps(read)
    def reader(*args: _P.args, **options: _P.kwargs) -> dict[str, dict[str, Demonstration]]:
        return {
            episode: {name: Demonstration.of(samples) for name, samples in found.items()}
            for episode, found in read(*args, **options).items()
        }

    return reader


def _warn(name: str, *notes: str, stacklevel: int) -> None:
    if text := "; ".join(filter(None, notes)):
        warnings.warn(f"{name or 'demonstration'}: {text}", ComoveWarning, stacklevel=stacklevel)


def _end_velocity(time: NDArray[np.float64], position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Estimate the velocity at time zero, shape (n_dims,), by a parabola.

    The fit is by least squares over the first seven samples, and at least the first hundredth of the movement, so
    that noise, or two stamps very close to each other, have little influence. Exact for polynomials of degree 2.

    Parameters
    ----------
    time : array, shape (n_steps,), [s], increasing, from 0
    position : array, shape (n_steps, n_dims), [m]
    """
    n_near = max(7, int(np.searchsorted(time, 0.01 * time[-1], side="right")))
    near, positions = time[:n_near], position[:n_near]
    degree = min(2, len(near) - 1)
    powers = (near / near[-1])[:, None] ** np.arange(degree + 1)
    coefficients, *_ = np.linalg.lstsq(powers, positions - positions[0], rcond=1e-6)
    return coefficients[1] / near[-1]

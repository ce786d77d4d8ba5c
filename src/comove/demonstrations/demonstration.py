"""One recorded movement."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations import cleaning, resampling, units
from comove.errors import ComoveWarning, DemonstrationError, OptionError
from comove.ties import first_largest

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_END_SAMPLES = 7
_END_SHARE = 0.01


@dataclass(frozen=True, eq=False)
class Demonstration:
    """One recorded movement, clean by construction.

    Time starts at zero and increases, at whatever steps it was recorded; all numbers are finite. A later
    start is shifted, rows of one instant are merged into their mean, quaternions get unit norm and the sign
    that lies near their neighbour's; anything worse is refused.

    Parameters
    ----------
    time : array, shape (n_steps,), [s]
    position : array, shape (n_steps, n_dims), [m]; 1 to 64 dimensions
    name : what to call it in messages
    notes : what was done to the recording so far, in words; cleaning appends to it
    unit : unit of `position`; anything but "m" is exempt from the hint at millimetres, and what is "rad" gets
        one at degrees
    orientation : array, shape (n_steps, 4), unit quaternions w x y z; None where none was recorded
    axes : names of the coordinates, such as those of joints; () where they are x, y, z or have none

    All arrays are read-only copies.

    Raises
    ------
    DemonstrationError
        It is no movement, or a quaternion is off unit norm by more than 0.001; names the row.

    Warns
    -----
    ComoveWarning
        Positions were merged, or look like millimetres or degrees.
    """

    time: NDArray[np.float64]
    position: NDArray[np.float64]
    name: str = ""
    notes: tuple[str, ...] = ()
    unit: str = "m"
    orientation: NDArray[np.float64] | None = field(default=None, kw_only=True)
    axes: tuple[str, ...] = field(default=(), kw_only=True)

    def __post_init__(self) -> None:
        time, position = cleaning.check(self.time, self.position)
        axes = cleaning.check_axes(self.axes, position.shape[1])
        orientation, flipped = self.orientation, ""
        if orientation is not None:
            orientation = cleaning.check_orientation(orientation, len(time))
            orientation, flipped = cleaning.same_hemisphere(orientation)
        time, shifted = cleaning.start_at_zero(time)
        if orientation is not None:
            orientation = cleaning.merge_repeated_orientations(time, orientation)
        time, position, merged = cleaning.merge_repeated_stamps(time, position)
        hint = self._unit_hint(position)
        for array in (time, position, orientation):
            if array is not None:
                array.setflags(write=False)
        object.__setattr__(self, "time", time)
        object.__setattr__(self, "position", position)
        object.__setattr__(self, "orientation", orientation)
        object.__setattr__(self, "axes", axes)
        object.__setattr__(self, "notes", (*self.notes, *filter(None, (shifted, merged, flipped, hint))))
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
    def rotation(self) -> Rotation | None:
        """The orientations as SciPy's rotations, None where none were recorded."""
        if self.orientation is None:
            return None
        from scipy.spatial.transform import Rotation

        return Rotation.from_quat(self.orientation[:, [1, 2, 3, 0]])

    @property
    def start_velocity(self) -> NDArray[np.float64]:
        """Velocity at the first sample, shape (n_dims,), [m/s]; see `_end_velocity`."""
        return _end_velocity(self.time, self.position)

    @property
    def goal_velocity(self) -> NDArray[np.float64]:
        """Velocity at the last sample, shape (n_dims,), [m/s]; see `_end_velocity`."""
        return -_end_velocity(self.duration - self.time[::-1], self.position[::-1])

    def resampled(self, n_steps: int) -> Demonstration:
        """Return the movement at `n_steps` even time steps, interpolated between neighbours.

        Positions by a monotone cubic (PCHIP), orientations along the shortest turn (slerp).

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
        orientation = self.orientation
        if orientation is not None:
            orientation = resampling.slerp(self.time, orientation, time)
        note = f"resampled from {self.n_steps} to {n_steps} even time steps"
        return self._changed(time, position, orientation, note)

    def smoothed(self, cutoff_hz: float) -> Demonstration:
        """Return the movement without what is faster than `cutoff_hz` [Hz]; both ends stay exactly.

        Raises
        ------
        OptionError
            The recording holds no such frequency, or turns faster than that.

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
        orientation = self.orientation
        if orientation is not None:
            orientation = resampling.smooth_orientation(self.time, orientation, cutoff_hz)
            apart = np.linalg.norm(orientation - self.orientation, axis=1).max()
            note += f" and turned by up to {4.0 * np.arcsin(min(1.0, apart / 2.0)):.3g} rad"
        _warn(self.name, note, stacklevel=3)
        return self._changed(self.time, position, orientation, note)

    def in_metres(self, unit: str | None) -> Demonstration:
        """Return the movement with its positions in metres, where they were written in `unit`; as it is for None.

        Raises
        ------
        OptionError
            The unit is not known, or the recording says another one.
        """
        if unit is None:
            return self
        factor = units.length(unit)
        if self.unit not in ("m", unit):
            raise OptionError(
                f"the recording says that it is in {self.unit}", key="unit", way_out="leave the unit out"
            )
        others = tuple(note for note in self.notes if cleaning.UNIT_HINT not in note)
        if unit == "m":
            hint = cleaning.unit_hint(self.position, "m")
            return replace(self, notes=(*others, cleaning.IN_ANY_CASE)) if hint else self
        notes = (*others, f"converted from {unit} to m")
        return replace(self, position=factor * self.position, unit="m", notes=notes)

    def cleaned(self) -> Demonstration:
        """Return the movement between the pauses, without its noise; notes say what was done.

        Of several movements, the one in which the hand comes farthest. The filter's frequency is the lowest at which
        it removes no more than the noise, which is read from the recording itself.

        Raises
        ------
        DemonstrationError
            Nothing moves in it.
        """
        from comove.demonstrations.segmentation import segment

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
        """Return the movement without standing still, slower than `speed_threshold` [m/s], at its ends.

        Turning on the spot counts as standing still.

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
    ) -> Demonstration:
        """Read one movement from a file or folder of any kind that `comove.demonstrations` reads.

        The suffix says the kind: .csv, .npz, .hdf5 or .h5 (robomimic, ALOHA), .bag (ROS 1), .mcap or .db3 (ROS 2);
        of folders, `meta/info.json` marks a LeRobot dataset and `metadata.yaml` a rosbag2.

        Parameters
        ----------
        path : file or folder
        manipulator : whose movement, where several were recorded together
        episode : which recording, by name or number, where the file holds several
        topic : which topic of a bag
        unit : of its lengths, such as "mm"; metres, or what the file says, unless given
        columns, delimiter, time, rate : of a text table as other programs write it, see `tables.read_table`
        clean : return the movement between the pauses, without noise (see `cleaned`)

        Raises
        ------
        DemonstrationError
            It cannot be read, or holds several movements and none, or an unknown one, was named; lists them.
        """
        from comove.demonstrations.loading import load

        if columns is delimiter is time is rate is None:
            with warnings.catch_warnings():
                if unit is not None:  # which says what the numbers look like
                    warnings.filterwarnings("ignore", f".*{cleaning.UNIT_HINT}", ComoveWarning)
                recording = load(path, manipulator, episode=episode, topic=topic)
            recording = recording.in_metres(unit)
        else:
            from comove.demonstrations.tables import read_table

            if not (manipulator is episode is topic is None):
                raise OptionError(
                    "a text table holds one movement",
                    key="columns",
                    way_out="choose it by its columns, and leave manipulator, episode and topic out",
                )
            recording = read_table(
                path, columns=columns, delimiter=delimiter, time=time, rate=rate, unit=unit
            )
        return recording.cleaned() if clean else recording

    @classmethod
    def load_all(cls, path: str | os.PathLike[str]) -> tuple[Demonstration, ...]:
        """Read all movements of a file or folder, as `load` does: each episode, each manipulator or topic.

        Their names tell which they are.
        """
        from comove.demonstrations.loading import load_all

        return load_all(path)

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
        from comove.demonstrations.loading import choose

        return choose(read_csv(path), manipulator, path)

    @classmethod
    def from_npz(cls, path: str | os.PathLike[str], manipulator: str | None = None) -> Demonstration:
        """Read one movement from an NPZ file, as `from_csv` does."""
        from comove.demonstrations.loading import choose
        from comove.demonstrations.npz import read_npz

        return choose(read_npz(path), manipulator, path)

    @classmethod
    def from_lasa(cls, shape: str, demo: int = 0) -> Demonstration:
        """Read one recording of the LASA handwriting set; see `comove.demonstrations.lasa`."""
        from comove.demonstrations.lasa import read_lasa

        return read_lasa(shape, demo)

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
        """Return the samples from `first` up to, not including, `stop`."""
        kept = slice(first, stop)
        orientation = None if self.orientation is None else self.orientation[kept]
        part = self._changed(self.time[kept] - self.time[first], self.position[kept], orientation, note)
        return part if name is None else replace(part, name=name)

    def _unit_hint(self, position: NDArray[np.float64]) -> str:
        told = any(hint in note for note in self.notes for hint in cleaning.UNIT_HINTS.values())
        return "" if told else cleaning.unit_hint(position, self.unit)


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

"""Demonstrations drawn in the page: cleaned, learned, kept in a library."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from comove.arrays import Array
from comove.dmp import Library, learn
from comove.dmp.demonstrations import Demonstration
from comove.dmp.demonstrations.resampling import cutoff_of_noise
from comove.errors import ComoveWarning, DemonstrationError
from comove.model.demonstration import LIBRARY

Taught = tuple[tuple[float, ...], ...]
"""Rows of time [s] and position [m]."""


@dataclass(frozen=True)
class StrokeSettings:
    """Settings for learning a drawn movement.

    Attributes
    ----------
    fewest : least number of points of a movement
    shortest : length below which a stroke counts as accidental, in longest sides of the workspace
    rate : points a second after resampling, as a page sends points unevenly [Hz]
    most : largest number of points after resampling
    still : speed below which the pointer rests, as a share of the mean one
    ramp : share of the time over which the speed rises from rest, and falls
    """

    fewest: int = 8
    shortest: float = 0.02
    rate: float = 60.0
    most: int = 600
    still: float = 0.1
    ramp: float = 0.25


class Stroke:
    """Movement while it is drawn.

    Parameters
    ----------
    n_dims : 2 in the plane, 3 in space
    settings : settings for learning
    """

    def __init__(self, n_dims: int, settings: StrokeSettings = StrokeSettings()):
        self.n_dims, self.settings = n_dims, settings
        self.rows: list[tuple[float, ...]] = []

    def add(self, time: float, point: Array) -> None:
        """Add a finite point [m] with a later time [s]."""
        place = np.asarray(point, dtype=float)[: self.n_dims]
        if np.isfinite(place).all() and (not self.rows or time > self.rows[-1][0]):
            self.rows.append((time, *place.tolist()))

    def taught(self, side: float) -> Taught:
        """Return the movement without noise and without rests at its ends.

        Parameters
        ----------
        side : longest side of the workspace [m]

        Raises
        ------
        DemonstrationError
            If it is too short.
        """
        table, settings = np.array(self.rows), self.settings
        few = len(table) < settings.fewest
        if few or np.linalg.norm(np.ptp(table[:, 1:], axis=0)) < settings.shortest * side:
            raise DemonstrationError("the stroke is too short", way_out="draw a longer one, in one go")
        raw = Demonstration(table[:, 0], table[:, 1:], name="drawn")
        n_even = np.clip(round(raw.duration * settings.rate), 2 * settings.fewest, settings.most)
        even = raw.resampled(int(n_even))
        speed = np.linalg.norm(np.diff(even.position, axis=0), axis=1).sum() / even.duration
        clean = even.trimmed(settings.still * speed)  # pauses within one stroke belong to it
        cutoff = cutoff_of_noise(clean.time, clean.position)
        if cutoff is not None:
            with warnings.catch_warnings(action="ignore", category=ComoveWarning):
                clean = clean.smoothed(cutoff)
        return tuple(
            map(tuple, np.column_stack([at_rest(clean.time, settings.ramp), clean.position]).tolist())
        )


def at_rest(time: Array, share: float) -> Array:
    """Return the times of a movement, changed to rest at both ends.

    Path and speed in between stay the same. A pointer starts and ends in full motion; end effectors with a payload
    start and end at rest. The speed rises from 0 over a share of the time, and falls likewise.

    Parameters
    ----------
    time : array, shape (n_steps,), from 0 on [s]
    """
    end, ramp = float(time[-1]), share * float(time[-1])

    def later(since: Array) -> Array:
        return np.where(since < 0.5 * ramp, np.sqrt(2.0 * ramp * since), since + 0.5 * ramp)

    first = time < 0.5 * end
    return np.where(first, later(time), end + ramp - later(end - time))


def demonstration_from(taught: Sequence[Sequence[float]], name: str = "drawn") -> Demonstration:
    """Return the recording of a drawn movement.

    Raises
    ------
    DemonstrationError
        If it is not valid.
    """
    table = np.array(taught, dtype=float)
    return Demonstration(table[:, 0], table[:, 1:], name=name)


def csv_of(taught: Taught) -> bytes:
    """Return a movement as CSV that reads back without loss."""
    names = ["time", "x", "y", "z"][: len(taught[0])]
    rows = (",".join(repr(float(value)) for value in row) for row in taught)
    return "\n".join([",".join(names), *rows, ""]).encode()


def keep(taught: Taught, name: str, folder: Path) -> Path:
    """Learn a primitive from a movement; add it to a library.

    Raises
    ------
    LibraryError
        If the name is taken or not valid, or the library cannot be written.
    """
    primitive = learn(demonstration_from(taught, name), name=name, source="drawn on the workbench")
    return Library(folder / LIBRARY).add(primitive, name)

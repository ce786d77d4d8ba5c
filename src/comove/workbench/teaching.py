"""Movements that a person shows in the page: points with their times, cleaned, learned, and kept in a library."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations import Demonstration
from comove.demonstrations.resampling import cutoff_of_noise
from comove.errors import ComoveWarning, DemonstrationError
from comove.primitives import Library, learn
from comove.scenes.demonstration import LIBRARY

Array = NDArray[np.float64]
Taught = tuple[tuple[float, ...], ...]
"""Rows of time [s] and position [m]."""

FEWEST = 8  # points that a movement has
SHORTEST = 0.02  # of the longest side of the workspace: length below which a stroke is a slip of the hand
RATE, MOST = 60.0, 600  # Hz, at which strokes are resampled, as a page sends points unevenly; and most points
RAMP = 0.25  # of the time, over which the speed rises from rest
STILL = 0.1  # of the mean speed, below which the hand rests


class Stroke:
    """A movement while it is shown.

    Parameters
    ----------
    n_dims : 2 in the plane, 3 in space
    """

    def __init__(self, n_dims: int):
        self.n_dims = n_dims
        self.rows: list[tuple[float, ...]] = []

    def add(self, time: float, point: Array) -> None:
        """Add a point [m] and when it was passed [s]; what is no number, or not later, is left out."""
        place = np.asarray(point, dtype=float)[: self.n_dims]
        if np.isfinite(place).all() and (not self.rows or time > self.rows[-1][0]):
            self.rows.append((time, *place.tolist()))

    def taught(self, side: float) -> Taught:
        """Return the movement without rests at its ends, and without noise.

        Parameters
        ----------
        side : longest side of the workspace [m]

        Raises
        ------
        DemonstrationError
            If it is too short.
        """
        table = np.array(self.rows)
        if len(table) < FEWEST or np.linalg.norm(np.ptp(table[:, 1:], axis=0)) < SHORTEST * side:
            raise DemonstrationError("the stroke is too short", way_out="draw a longer one, in one go")
        raw = Demonstration(table[:, 0], table[:, 1:], name="drawn")
        even = raw.resampled(int(np.clip(round(raw.duration * RATE), 2 * FEWEST, MOST)))
        speed = np.linalg.norm(np.diff(even.position, axis=0), axis=1).sum() / even.duration
        clean = even.trimmed(STILL * speed)  # pauses within one stroke belong to it
        cutoff = cutoff_of_noise(clean.time, clean.position)
        if cutoff is not None:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", ComoveWarning)
                clean = clean.smoothed(cutoff)
        return tuple(map(tuple, np.column_stack([at_rest(clean.time), clean.position]).tolist()))


def at_rest(time: Array) -> Array:
    """Return the times of a movement that starts and stops gently, on the same path and as quick in between.

    A pointer is caught in full motion, and let go in full motion; hands that carry begin and end at rest. The speed
    rises from 0 over a `RAMP` of the time, and falls likewise.

    Parameters
    ----------
    time : array, shape (n_steps,), from 0 on [s]
    """
    end, ramp = float(time[-1]), RAMP * float(time[-1])

    def later(since: Array) -> Array:
        return np.where(since < 0.5 * ramp, np.sqrt(2.0 * ramp * since), since + 0.5 * ramp)

    first = time < 0.5 * end
    return np.where(first, later(time), end + ramp - later(end - time))


def demonstration_from(taught: Sequence[Sequence[float]], name: str = "drawn") -> Demonstration:
    """Return the recording of a movement that was taught.

    Raises
    ------
    DemonstrationError
        If it is none.
    """
    table = np.array(taught, dtype=float)
    return Demonstration(table[:, 0], table[:, 1:], name=name)


def keep(taught: Taught, name: str, folder: Path) -> Path:
    """Learn a primitive from a movement that was taught, and add it to the library in a folder.

    Raises
    ------
    LibraryError
        If the name is taken or is none, or it cannot be written.
    """
    primitive = learn(demonstration_from(taught, name), name=name, source="drawn on the workbench")
    return Library(folder / LIBRARY).add(primitive, name)

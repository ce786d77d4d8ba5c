"""The motion of obstacles: `motion` of a scene file, and the positions and velocities that follow from it.

Obstacles keep their orientation. Kernels take a motion as the *offset* of the obstacle's centre from its position in
the file: a body is as far from a moving obstacle as the body, moved back by the offset, is from a resting one.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, model_validator

from comove.io.keys import NotNegative, Part, Positive, PositiveLength, Vector, Wrong, as_tuple, counted, show

Array = NDArray[np.float64]

FASTEST = 1000.0
"""Of obstacles; faster than sound, and faster than anything can be followed [m/s]."""
HOW = ("velocity", "waypoints", "circle")


class ObstacleMotion(Protocol):
    """The motion of an obstacle's centre, whose times are an array of shape (n_times,) [s]."""

    @property
    def kinks(self) -> tuple[float, ...]:
        """Return the times at which the velocity jumps [s]."""

    def offsets(self, time: Array) -> Array:
        """Return the offsets of the centre; array, shape (n_times, 3) [m]."""

    def velocities(self, time: Array) -> Array:
        """Return the velocities of the centre; array, shape (n_times, 3) [m/s]."""

    def sagittas(self, time: Array) -> Array:
        """Return bounds of the distance of the way from its chords; array, shape (n_times - 1,) [m]."""


class Circle(Part):
    """A circle of `radius` [m] in the xy plane that is passed counter-clockwise once in `period_s` [s]."""

    radius: PositiveLength
    period_s: Positive


class Motion(Part):
    """A motion of an obstacle, which is given in one of three ways.

    These are a constant `velocity` [m/s]; straight lines between `waypoints` [m], reached at `times` [s]; and a
    `circle`, whose centre lies in the direction of -x from the obstacle's first position. Before its first and after
    its last waypoint an obstacle stands still.
    """

    velocity: Vector | None = None
    waypoints: Annotated[tuple[Vector, ...], BeforeValidator(as_tuple)] | None = None
    times: Annotated[tuple[NotNegative, ...], BeforeValidator(as_tuple)] | None = None
    circle: Circle | None = None

    @model_validator(mode="after")
    def _one_of_three(self) -> Motion:
        given = [key for key in HOW if getattr(self, key) is not None]
        if len(given) != 1:
            said = f"{' and '.join(given)} are given" if given else "it does not say how"
            raise Wrong(said, f"give one of {', '.join(HOW)}")
        if (self.waypoints is None) != (self.times is None):
            lone, other = ("waypoints", "times") if self.times is None else ("times", "waypoints")
            raise Wrong(f"{lone} are given without {other}", "give both, or neither")
        if self.waypoints is not None and self.times is not None:
            _require_order(self.waypoints, self.times)
        if len({len(point) for point in self.waypoints or ()}) <= 1:  # else `checks` reports the error
            self._require_pace()
        return self

    def _require_pace(self) -> None:
        with np.errstate(over="ignore"):
            speed = self.speed
        if not speed <= FASTEST:
            raise Wrong(
                f"the obstacle moves at {speed:g} m/s", f"let it take its time: at most {FASTEST:g} m/s"
            )

    def offsets(self, time: Array) -> Array:
        """Return the offsets of the centre from its position at 0 s; array, shape (n_times, 3) [m]."""
        time = np.maximum(time, 0.0)
        result = np.zeros((len(time), 3))
        if self.velocity is not None:
            result[:, : len(self.velocity)] = time[:, None] * np.array(self.velocity)
        elif self.circle is not None:
            angle = 2 * np.pi / self.circle.period_s * time
            result[:, 0] = self.circle.radius * (np.cos(angle) - 1.0)
            result[:, 1] = self.circle.radius * np.sin(angle)
        else:
            for axis, column in enumerate(np.array(self.waypoints).T):
                result[:, axis] = np.interp(time, self.kinks, column) - column[0]
        return result

    def velocities(self, time: Array) -> Array:
        """Return the velocities of the centre, at a kink those after it; array, shape (n_times, 3) [m/s]."""
        result = np.zeros((len(time), 3))
        if self.velocity is not None:
            result[:, : len(self.velocity)] = self.velocity
        elif self.circle is not None:
            rate = 2 * np.pi / self.circle.period_s
            result[:, 0] = -self.circle.radius * rate * np.sin(rate * time)
            result[:, 1] = self.circle.radius * rate * np.cos(rate * time)
        elif len(self.kinks) > 1:
            points, times = np.array(self.waypoints), np.array(self.kinks)
            piece = np.searchsorted(times, time, side="right") - 1
            goes = (piece >= 0) & (piece < len(times) - 1)
            slopes = np.diff(points, axis=0) / np.diff(times)[:, None]
            result[goes, : points.shape[1]] = slopes[piece[goes]]
        return result

    @property
    def kinks(self) -> tuple[float, ...]:
        """Return the times at which the velocity may jump [s]."""
        return self.times or ()

    @property
    def speed(self) -> float:
        """Return the largest speed [m/s]."""
        if self.velocity is not None:
            return float(np.linalg.norm(self.velocity))
        if self.circle is not None:
            return 2 * np.pi / self.circle.period_s * self.circle.radius
        ways = np.linalg.norm(np.diff(np.array(self.waypoints), axis=0), axis=1)
        return float((ways / np.diff(self.kinks)).max(initial=0.0))

    def sagittas(self, time: Array) -> Array:
        """Return the largest distance of the centre from its chords between the times; array, shape (n_times - 1,)
        [m].
        """
        steps = np.diff(time)
        if self.circle is not None:  # chord of a curve with a bound second derivative
            rate = 2 * np.pi / self.circle.period_s
            return self.circle.radius * (rate * steps) ** 2 / 8
        sagittas = np.zeros(len(steps))
        if self.times is not None:  # the distance to a chord is convex between kinks: it is largest at one
            kinks = np.array([t for t in self.times if time[0] < t < time[-1]])
            if len(kinks):
                piece = np.clip(np.searchsorted(time, kinks, side="right") - 1, 0, len(steps) - 1)
                ends, share = self.offsets(time), (kinks - time[piece]) / steps[piece]
                chord = ends[piece] + share[:, None] * (ends[piece + 1] - ends[piece])
                np.maximum.at(sagittas, piece, np.linalg.norm(self.offsets(kinks) - chord, axis=1))
        return sagittas


def _require_order(waypoints: tuple[tuple[float, ...], ...], times: tuple[float, ...]) -> None:
    if len(times) != len(waypoints):
        raise Wrong(
            f"there are {counted(waypoints, 'waypoint')} and {counted(times, 'time')}",
            "give one time to each waypoint",
        )
    if not times:
        raise Wrong("there are no waypoints", "give the first at the obstacle's center")
    for i, (before, after) in enumerate(pairwise(times)):
        if not after > before:
            raise Wrong(
                f"times[{i + 1}] = {show(after)} does not come after times[{i}] = {show(before)}",
                "sort the waypoints by time",
            )

"""The motion of obstacles: `motion` of scene files, poses, velocities.

The pose of an obstacle is that of the file, displaced: its centre by an *offset*, its orientation by a *turn* about
an axis that does not change. A body is as far from a displaced obstacle as the body, displaced back, is from a
resting one.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, NamedTuple, Protocol

import numpy as np
from pydantic import AfterValidator, BeforeValidator, model_validator

from comove.arrays import Array
from comove.geometry.rotations import cross, exponential, matrices
from comove.io.keys import (
    Direction,
    NotNegative,
    Number,
    Part,
    Positive,
    PositiveLength,
    Sparse,
    Vector,
    Wrong,
    as_tuple,
    counted,
    show,
)

FASTEST = 1000.0
"""Of obstacles; faster than sound, and faster than anything can be followed [m/s]."""
FASTEST_TURN = 3600.0
"""Of obstacles: ten turns a second [deg/s]."""
HOW = ("velocity", "waypoints", "circle")


class ObstacleMotion(Protocol):
    """The motion of an obstacle; times have shape (n_times,) [s]."""

    @property
    def kinks(self) -> tuple[float, ...]:
        """Return the times at which the velocity jumps [s]."""

    @property
    def speed(self) -> float:
        """Return the largest speed of the centre [m/s]."""

    @property
    def spin(self) -> Array:
        """Return the angular velocity; array, shape (3,) [rad/s]."""

    def turns(self, time: Array) -> Array:
        """Return rotation vectors, multiples of `spin`; array, shape (n_times, 3) [rad]."""

    def offsets(self, time: Array) -> Array:
        """Return the offsets of the centre; array, shape (n_times, 3) [m]."""

    def velocities(self, time: Array) -> Array:
        """Return the velocities of the centre; array, shape (n_times, 3) [m/s]."""

    def sagittas(self, time: Array) -> Array:
        """Return bounds of the interpolation error; array, shape (n_times - 1,) [m]."""


def rotations(turns: Array) -> Array:
    """Return the rotation matrices of rotation vectors [rad]; (..., 3) -> (..., 3, 3)."""
    return matrices(exponential(turns))


def seen_from(points: Array, center: Array, offset: Array, turn: Array) -> Array:
    """Return points in the frame of an obstacle displaced from `center`.

    Parameters
    ----------
    points : array, shape (..., n_points, 3) [m]
    center : array, shape (3,), the obstacle's centre in the file [m]
    offset, turn : arrays, shape (..., 3), its displacement [m], [rad]
    """
    seen = points - offset[..., None, :]
    if not turn.any():
        return seen
    return center + (seen - center) @ rotations(turn)


class Circle(Part):
    """A circle of `radius` [m] in the xy plane. It is passed counter-clockwise once in `period_s` [s]."""

    radius: PositiveLength
    period_s: Positive


def _rate(rate: float) -> float:
    if rate == 0.0:
        raise Wrong("0 turns nothing", "give another rate, or leave out turn")
    if not abs(rate) <= FASTEST_TURN:
        raise Wrong(f"{show(rate)} is out of range", f"write a rate of at most {FASTEST_TURN:g}, in deg/s")
    return rate


class Turn(Sparse):
    """A turn at a constant rate about an axis in the world. It is counter-clockwise as seen from its tip.

    The axis passes through `hinge`, a point that is given relative to the obstacle's centre at 0 s [m]; through the
    centre unless given. In the plane it is z, and not given.
    """

    LATER = ("axis", "hinge")
    rate_deg_per_s: Annotated[Number, AfterValidator(_rate)]
    axis: Direction | None = None
    hinge: Vector | None = None

    @property
    def spin(self) -> Array:
        """Return the angular velocity; array, shape (3,) [rad/s]."""
        axis = np.array(self.axis or (0.0, 0.0, 1.0))
        return np.deg2rad(self.rate_deg_per_s) * axis / np.linalg.norm(axis)

    @property
    def arm(self) -> Array:
        """Return the centre relative to the hinge, at 0 s; array, shape (3,) [m]."""
        arm = np.zeros(3)
        if self.hinge is not None:
            arm[: len(self.hinge)] = np.negative(self.hinge)
        return arm

    def arms(self, time: Array) -> Array:
        """Return the centre relative to the hinge; array, shape (n_times, 3) [m]."""
        return rotations(time[:, None] * self.spin) @ self.arm

    @property
    def speed(self) -> float:
        """Return the speed of the centre about the hinge [m/s]."""
        return float(np.linalg.norm(cross(self.spin, self.arm)))


class Motion(Sparse):
    """A motion of an obstacle: a path, a `turn`, or both.

    The path of its centre is given in one of three ways: a constant `velocity` [m/s]; straight lines between
    `waypoints` [m], reached at `times` [s]; and a `circle`, whose centre lies in the direction of -x from the
    obstacle's first position. Before its first and after its last waypoint an obstacle keeps its place. A hinge goes
    along the path, and the centre turns about it.
    """

    LATER = ("turn",)
    velocity: Vector | None = None
    waypoints: Annotated[tuple[Vector, ...], BeforeValidator(as_tuple)] | None = None
    times: Annotated[tuple[NotNegative, ...], BeforeValidator(as_tuple)] | None = None
    circle: Circle | None = None
    turn: Turn | None = None

    @model_validator(mode="after")
    def _one_of_three(self) -> Motion:
        given = [key for key in HOW if getattr(self, key) is not None]
        if len(given) > 1 or not (given or self.turn):
            said = f"{' and '.join(given)} are given" if given else "it does not say how"
            raise Wrong(said, f"give one of {', '.join(HOW)}; a turn may be added, or be all")
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
        elif self.waypoints is not None:
            for axis, column in enumerate(np.array(self.waypoints).T):
                result[:, axis] = np.interp(time, self.kinks, column) - column[0]
        if self.turn is not None and self.turn.hinge is not None:
            result += self.turn.arms(time) - self.turn.arm
        return result

    def velocities(self, time: Array) -> Array:
        """Return the centre's velocities; array, shape (n_times, 3) [m/s]. At a kink they are those after it."""
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
        if self.turn is not None and self.turn.hinge is not None:
            result += cross(self.turn.spin, self.turn.arms(np.maximum(time, 0.0)))
        return result

    @property
    def spin(self) -> Array:
        """Return the angular velocity; array, shape (3,) [rad/s]."""
        return np.zeros(3) if self.turn is None else self.turn.spin

    def turns(self, time: Array) -> Array:
        """Return rotation vectors from the orientation at 0 s; shape (n_times, 3) [rad]."""
        return np.maximum(time, 0.0)[:, None] * self.spin

    @property
    def kinks(self) -> tuple[float, ...]:
        """Return the times at which the velocity may jump [s]."""
        return self.times or ()

    @property
    def speed(self) -> float:
        """Return an upper bound of the centre's speed [m/s]."""
        about = 0.0 if self.turn is None else self.turn.speed
        if self.velocity is not None:
            return about + float(np.linalg.norm(self.velocity))
        if self.circle is not None:
            return about + 2 * np.pi / self.circle.period_s * self.circle.radius
        if self.waypoints is None:
            return about
        ways = np.linalg.norm(np.diff(np.array(self.waypoints), axis=0), axis=1)
        return about + float((ways / np.diff(self.kinks)).max(initial=0.0))

    def sagittas(self, time: Array) -> Array:
        """Return the centre's interpolation error between times; shape (n_times - 1,) [m]."""
        steps = np.diff(time)
        sagittas = np.zeros(len(steps))
        if self.turn is not None:  # chords of curves with bound second derivatives
            sagittas += self.turn.speed * np.linalg.norm(self.turn.spin) * steps**2 / 8
        if self.circle is not None:
            rate = 2 * np.pi / self.circle.period_s
            sagittas += self.circle.radius * (rate * steps) ** 2 / 8
        if self.times is not None:  # the distance to a chord is convex between kinks: it is largest at one
            kinks = np.array([t for t in self.times if time[0] < t < time[-1]])
            if len(kinks):
                piece = np.clip(np.searchsorted(time, kinks, side="right") - 1, 0, len(steps) - 1)
                path = self if self.turn is None else self.model_copy(update={"turn": None})
                ends, share = path.offsets(time), (kinks - time[piece]) / steps[piece]
                chord = ends[piece] + share[:, None] * (ends[piece + 1] - ends[piece])
                strays = np.zeros(len(steps))
                np.maximum.at(strays, piece, np.linalg.norm(path.offsets(kinks) - chord, axis=1))
                sagittas += strays
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


class Displacements(NamedTuple):
    """Displacements of obstacles from their poses at 0 s, by table row.

    Between two samples, offsets and angles change linearly. All arrays are read-only and C-contiguous: kernels are
    compiled for one kind of array. `of` makes them so.

    Attributes
    ----------
    offsets : array, shape (n_samples, n_rows, 3), translations of the centres [m]; n_samples = 0 if nothing moves
    angles : array, shape (n_samples, n_rows), rotation angles, not wrapped [rad]; 0 for rows that do not turn
    axes : array, shape (n_rows, 3), unit vectors of the rotation axes; any for rows that do not turn
    centers : array, shape (n_rows, 3), centres of the obstacles at 0 s, through which the axes pass [m]
    """

    offsets: Array
    angles: Array
    axes: Array
    centers: Array

    @classmethod
    def of(
        cls, offsets: Array, centers: Array, angles: Array | None = None, axes: Array | None = None
    ) -> Displacements:
        """Return displacements; without angles and axes nothing turns."""
        if angles is None:
            angles = np.zeros(offsets.shape[:2])
        if axes is None:
            axes = np.tile([0.0, 0.0, 1.0], (len(centers), 1))
        arrays = [np.array(array, dtype=float, order="C") for array in (offsets, angles, axes, centers)]
        for array in arrays:
            array.setflags(write=False)
        return cls(*arrays)

    def shifted(self, more: Array) -> Displacements:
        """Return the displacements with further translations; array, shape (n_samples, n_rows, 3) [m]."""
        if len(self.offsets):
            return self.of(self.offsets + more, self.centers, self.angles, self.axes)
        return self.of(more, self.centers, None, self.axes)

"""The kinds of constraints between end effectors and on payloads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import degrees, radians
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from comove.arrays import listed
from comove.io.keys import Direction, Length, PositiveLength, Sparse, Wrong, no_minus_zero
from comove.model.constraints.constraint import (
    ROUNDING,
    Array,
    Constraint,
    ConstraintKeys,
    Course,
    Hands,
    PairConstraint,
    PairKeys,
)


@dataclass(frozen=True)
class DistanceConstraint(PairConstraint):
    """A constraint on a distance [m]: ``| |y_first - y_second| - distance | <= tolerance``."""

    distance: float
    tolerance: float
    kind = "distance"
    report = "distance_error_max"
    sampled = False

    def error(self, position: Array, n_dims: int) -> Array:
        """Return the deviation of the distance [m]."""
        return np.abs(self.apart(position) - self.distance)

    def bound(self, course: Course) -> float:
        """Return an upper bound of the error at every instant [m]."""
        least, most = course.apart(self.first, self.second)
        return max(self.distance - least, most - self.distance)

    def measure(self, error: float) -> float:
        """Return the error [m]."""
        return error

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words that the distance is not kept."""
        off = f"off by up to {error:.3g} m" if np.isfinite(error) else "off by more than can be bounded"
        return f"the distance between {self.pair(names)} is {off} (tolerance {self.tolerance:g} m)"


def distance_tolerance(tolerance: float | None, distance: float) -> float:
    """Return the tolerance of a distance or relative pose [m]. By default it is a thousandth of the distance."""
    return 1e-3 * distance if tolerance is None else tolerance


class DistanceKeys(PairKeys):
    """A constraint that keeps two end effectors `distance` apart, within `tolerance` [m]."""

    type: Literal["distance"]
    distance: PositiveLength
    tolerance: Length | None = None

    def resolved(self, hands: Hands) -> DistanceConstraint:
        """Return the constraint, its tolerance a thousandth by default."""
        first, second = hands.numbers(self.between)
        tolerance = distance_tolerance(self.tolerance, self.distance)
        return DistanceConstraint(first, second, self.distance, tolerance)


@dataclass(frozen=True)
class RelativePoseConstraint(PairConstraint):
    """A constraint that makes two end effectors parts of one body.

    Start and goal may miss their distance by `tolerance` [m]. A `DistanceConstraint` of the same end effectors states
    how far they are apart.
    """

    tolerance: float
    kind = "relative_pose"
    report = ""
    sampled = False
    turning = True

    def error(self, position: Array, n_dims: int) -> Array:
        """Return 0, as positions do not determine orientations. The distance is a constraint of its own."""
        return np.zeros(len(position))

    def bound(self, course: Course) -> float:
        """Return 0 if one body holds both with their roll, else infinity. In the plane it is 0."""
        return 0.0 if course.n_dims == 2 or course.rigid(self.first, self.second, roll=True) else np.inf

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words that nothing holds the pose."""
        return f"the motion's coordinates do not hold the relative pose of {self.pair(names)}"

    def needs_body(self, ends: Array) -> bool:
        """Return True in space; in the plane the pose is a distance."""
        return ends.shape[-1] == 3


class RelativePoseKeys(PairKeys):
    """A constraint that moves two end effectors as one rigid body.

    They keep their relative pose at the start. Ends may miss their distance by `tolerance` [m].
    """

    type: Literal["relative_pose"]
    tolerance: Length | None = None

    def resolved(self, hands: Hands) -> RelativePoseConstraint:
        """Return the constraint, its tolerance a thousandth by default."""
        first, second = hands.numbers(self.between)
        apart = float(np.linalg.norm(hands.start[first] - hands.start[second]))
        return RelativePoseConstraint(first, second, distance_tolerance(self.tolerance, apart))


@dataclass(frozen=True)
class SeparationConstraint(PairConstraint):
    """A constraint on a distance [m]: ``|y_first - y_second| >= distance - tolerance``."""

    distance: float
    tolerance: float
    kind = "separation"
    report = "separation_spare_min"
    sampled = False

    @property
    def least(self) -> float:
        """Return the required distance less the tolerance [m]."""
        return self.distance - self.tolerance

    @property
    def allowed(self) -> float:
        """Return rounding, as `least` has the tolerance in it."""
        return ROUNDING

    def error(self, position: Array, n_dims: int) -> Array:
        """Return the missing distance, negative where there is a margin [m]."""
        return self.least - self.apart(position)

    def bound(self, course: Course) -> float:
        """Return an upper bound of the error at every instant [m]."""
        return self.least - course.apart(self.first, self.second)[0]

    def measure(self, error: float) -> float:
        """Return the spare distance [m]."""
        return -error

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words how near the end effectors come."""
        near = self.least - error
        return (
            f"{self.pair(names)} come as near as {max(near, 0.0):.4g} m (at least {self.least:g} m asked for)"
        )

    def unmet(self, end: str, error: float, names: Sequence[str]) -> tuple[str, str]:
        """Return a message about the distance at an end, and advice."""
        apart = f"{self.pair(names)} are {self.least - error:.4g} m apart at the {end}"
        return (
            f"{apart}, but they must stay at least {self.least:g} m apart",
            "move one of them, or ask for less",
        )


class SeparationKeys(PairKeys):
    """A constraint that keeps two end effectors apart: `distance` less `tolerance`, or more [m]."""

    type: Literal["separation"]
    distance: PositiveLength
    tolerance: Length = 0.0

    @model_validator(mode="after")
    def _demands_something(self) -> SeparationKeys:
        if self.tolerance >= self.distance:
            raise Wrong(
                f"a tolerance of {self.tolerance:g} m leaves nothing of the distance {self.distance:g} m",
                "give a smaller tolerance",
            )
        return self

    def resolved(self, hands: Hands) -> SeparationConstraint:
        """Return the constraint."""
        first, second = hands.numbers(self.between)
        return SeparationConstraint(first, second, self.distance, self.tolerance)


@dataclass(frozen=True)
class SameHeightConstraint(PairConstraint):
    """A constraint on heights, the last coordinates [m]: ``|h_first - h_second| <= tolerance``."""

    tolerance: float
    kind = "same_height"
    report = "height_error_max"
    sampled = False

    def error(self, position: Array, n_dims: int) -> Array:
        """Return the difference of the heights [m]."""
        return np.abs(position[:, self.first, n_dims - 1] - position[:, self.second, n_dims - 1])

    def bound(self, course: Course) -> float:
        """Return an upper bound of the height difference [m]."""
        relative, stray = course.relative(self.first, self.second, slice(course.n_dims - 1, course.n_dims))
        gap = np.abs(relative[:, 0])
        return float((np.maximum(gap[1:], gap[:-1]) + stray).max())

    def measure(self, error: float) -> float:
        """Return the difference of the heights [m]."""
        return error

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words how much the heights differ."""
        differ = f"the heights of {self.pair(names)} differ by up to {error:.3g} m"
        return f"{differ} (tolerance {self.tolerance:g} m)"

    def unmet(self, end: str, error: float, names: Sequence[str]) -> tuple[str, str]:
        """Return a message about the heights at an end, and advice."""
        differ = f"at the {end} the heights of {self.pair(names)} differ by {error:.3g} m"
        return f"{differ} (tolerance {self.tolerance:g} m)", "move one of them, or widen the tolerance"

    def level(self, ends: Array) -> tuple[tuple[int, int], ...]:
        """Return the pair itself, which shares a height."""
        return ((self.first, self.second),)


class SameHeightKeys(PairKeys):
    """A constraint that keeps two end effectors level: equal last coordinates, within `tolerance` [m]."""

    type: Literal["same_height"]
    tolerance: Length = 1e-3

    def resolved(self, hands: Hands) -> SameHeightConstraint:
        """Return the constraint."""
        first, second = hands.numbers(self.between)
        return SameHeightConstraint(first, second, self.tolerance)


LEVEL = 1e-12
"""[m], by which hands at one height may differ by rounding."""
UP = np.array([0.0, 0.0, 1.0])
FREE = radians(1.0)
"""Tolerance of a tilt above which a payload may lean on the way [rad]; up to it, the tilt of the start is kept."""


@dataclass(frozen=True)
class UprightConstraint(Constraint):
    """A constraint on the tilt of lines between `members`: at most `tolerance` [rad]."""

    members: tuple[int, ...]
    tolerance: float
    kind = "upright"
    report = "tilt_max"
    sampled = False
    turning = True

    @property
    def hands(self) -> tuple[int, ...]:
        """Return the numbers of the holders."""
        return self.members

    def error(self, position: Array, n_dims: int) -> Array:
        """Return the largest tilt of lines between holders since the start [rad]."""
        tilt = np.zeros(len(position))
        for i, j in combinations(self.members, 2):
            line = position[:, i] - position[:, j]
            x, y = (line[:, 0], line[:, 1]) if n_dims == 2 else (np.hypot(line[:, 0], line[:, 1]), line[:, 2])
            tilt = np.maximum(tilt, np.arctan2(np.abs(x[0] * y - y[0] * x), x[0] * x + y[0] * y))
        return tilt

    def bound(self, course: Course) -> float:
        """Return an upper bound of the tilt at every instant [rad]."""
        tilt = self.error(course.position, course.n_dims)
        return float((np.maximum(tilt[1:], tilt[:-1]) + course.tilting(self.members)).max())

    def measure(self, error: float) -> float:
        """Return the tilt [rad]."""
        return error

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words how far the payload tilts."""
        if not np.isfinite(error):
            return "the motion's coordinates let the load tilt, and it must stay upright"
        return f"the load tilts by up to {degrees(error):.3g} deg (tolerance {degrees(self.tolerance):g} deg)"

    def level(self, ends: Array) -> tuple[tuple[int, int], ...]:
        """Return pairs of all holders if, in space, both ends are level."""
        heights = ends[:, list(self.members), -1]
        if ends.shape[-1] == 2 or not (np.ptp(heights, axis=1) <= LEVEL).all():
            return ()
        return tuple((self.members[0], other) for other in self.members[1:])

    def needs_body(self, ends: Array) -> bool:
        """Return whether holders at different heights require a rigid body."""
        return len(self.level(ends)) < len(self.members) - 1


@dataclass(frozen=True, eq=False)
class PoseConstraint(Constraint):
    """A constraint on a payload's pose beyond its holders' positions.

    Attributes
    ----------
    members : numbers of the holders
    tolerance : [rad], of a plane [m]
    """

    members: tuple[int, ...]
    tolerance: float
    sampled = False
    turning = True

    @property
    def hands(self) -> tuple[int, ...]:
        """Return the numbers of the holders."""
        return self.members

    def error(self, position: Array, n_dims: int) -> Array:
        """Return 0, as positions do not determine the orientation."""
        return np.zeros(len(position))

    def needs_body(self, ends: Array) -> bool:
        """Return True, as only a body's coordinates hold it."""
        return True


@dataclass(frozen=True, eq=False)
class DirectionConstraint(PoseConstraint):
    """A constraint on a payload's direction: within `tolerance` of one of the world [rad].

    Attributes
    ----------
    own, world : arrays, shape (3,), unit vectors in the world: the payload's direction at the start, and the
        direction near which it stays
    by_mask : whether coordinates hold it; else the direction is free within the tolerance
    """

    own: Array
    world: Array
    by_mask: bool = True
    kind = "axis"

    @property
    def report(self) -> str:  # type: ignore[override]
        """Return the name of its measure in reports."""
        return "constraint_excess_max" if self.by_mask else "tilt_max"

    def bound(self, course: Course) -> float:
        """Return an upper bound of the angle at every instant [rad]."""
        return course.leans(self.members[0], self.own, self.world)

    def measure(self, error: float) -> float:
        """Return the tilt [rad], less the tolerance if coordinates hold it."""
        return error - self.tolerance if self.by_mask else error

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words how far the payload leans."""
        off = f"by up to {degrees(error):.3g} deg" if np.isfinite(error) else "by more than can be bounded"
        axis = listed(self.world, 4)
        return f"the payload leans {off} from {axis} (tolerance {degrees(self.tolerance):g} deg)"


@dataclass(frozen=True, eq=False)
class RotationConstraint(PoseConstraint):
    """A constraint that keeps a payload's orientation. The rotation about an axis may be free."""

    kind = "no_rotation"

    def bound(self, course: Course) -> float:
        """Return an upper bound of the rotation angle from the start [rad].

        A rotation by an angle a about a unit vector n turns the axis i by an angle b with ``sin(b/2) = sin(a/2)
        sqrt(1 - n_i^2)``. Over all three axes, or both axes of the plane, the squares sum to ``2 sin(a/2)^2``.
        """
        axes = np.eye(3)[: course.n_dims]
        turned = np.array([course.leans(self.members[0], axis, axis) for axis in axes])
        if not np.isfinite(turned).all():
            return np.inf
        sine = np.sqrt(0.5 * (np.sin(np.minimum(turned, np.pi) / 2) ** 2).sum())
        return float(2.0 * np.arcsin(min(sine, 1.0)))

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words how far the payload turns."""
        off = f"by up to {degrees(error):.3g} deg" if np.isfinite(error) else "by more than can be bounded"
        return f"the payload turns {off} (tolerance {degrees(self.tolerance):g} deg)"


@dataclass(frozen=True, eq=False)
class PlaneConstraint(PoseConstraint):
    """A constraint that keeps a payload in a plane, within `tolerance` [m].

    Attributes
    ----------
    normal : array, shape (3,), unit normal of the plane, which contains the payload at the start
    turn : the constraint that the payload turns about the normal only
    """

    normal: Array
    turn: DirectionConstraint
    kind = "planar"

    def error(self, position: Array, n_dims: int) -> Array:
        """Return the first holder's distance from its initial plane [m]."""
        return np.abs((position[:, self.members[0]] - position[0, self.members[0]]) @ self.normal)

    def bound(self, course: Course) -> float:
        """Return an upper bound of the distance from the plane [m]."""
        error = self.error(course.position, course.n_dims)
        return float((np.maximum(error[1:], error[:-1]) + course.stray(self.members[:1])).max())

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words how far the payload leaves the plane."""
        return f"the payload leaves its plane by up to {error:.3g} m (tolerance {self.tolerance:g} m)"


MAX_TOLERANCE = 45.0
"""Largest tolerance of an angle [deg]."""
Degrees = Annotated[float, Field(ge=0, le=MAX_TOLERANCE), AfterValidator(no_minus_zero)]


class UprightKeys(ConstraintKeys, Sparse):
    """A constraint that keeps the payload upright.

    The payload may turn about the vertical, and lean from it by `tolerance_deg` at most. `up`, in the payload's
    frame, is the direction that stays near the vertical; unless given, the one that is vertical at the start. Without
    `up`, the tilt of the start is kept during the motion, and the goal may miss it by the tolerance, where the
    tolerance is one degree or less, the scene is planar, or the payload has no poses.
    """

    LATER = ("up",)

    type: Literal["upright"]
    tolerance_deg: Degrees = 0.1
    up: Direction | None = None

    def resolved(self, hands: Hands) -> Constraint:
        """Return the constraint on all holders of the payload."""
        tolerance = radians(self.tolerance_deg)
        if self.up is None and (hands.payload is None or hands.n_dims == 2 or tolerance <= FREE):
            return UprightConstraint(hands.holders, tolerance)
        own = UP if self.up is None else _require_pose(hands, "up") @ _unit(self.up)
        return DirectionConstraint(hands.holders, tolerance, own, UP, by_mask=False)


class NoRotationKeys(ConstraintKeys):
    """A constraint that keeps the payload's orientation. The goal may miss it by `tolerance_deg`."""

    type: Literal["no_rotation"]
    tolerance_deg: Degrees = 0.1

    def resolved(self, hands: Hands) -> RotationConstraint:
        """Return the constraint on all holders of the payload."""
        _require_pose(hands, self.type, n_dims=2)
        return RotationConstraint(hands.holders, radians(self.tolerance_deg))


class AxisKeys(ConstraintKeys):
    """A constraint that lets the payload turn about one axis.

    The axis is given in the world or in the payload's frame. The goal may miss it by `tolerance_deg`.
    """

    type: Literal["axis"]
    axis: Direction
    frame: Literal["world", "payload"] = "world"
    tolerance_deg: Degrees = 0.1

    def resolved(self, hands: Hands) -> DirectionConstraint:
        """Return the constraint on all holders of the payload."""
        turned = _require_pose(hands, self.type)
        axis = _unit(self.axis) if self.frame == "world" else turned @ _unit(self.axis)
        return DirectionConstraint(hands.holders, radians(self.tolerance_deg), axis, axis)


class PlanarKeys(ConstraintKeys):
    """A constraint that moves the payload as a planar joint does.

    It moves in a plane and turns about the `normal` only. The goal may leave the start's plane by `tolerance` [m],
    and lean by `tolerance_deg`.
    """

    type: Literal["planar"]
    normal: Direction = (0.0, 0.0, 1.0)
    tolerance: Length = 1e-3
    tolerance_deg: Degrees = 0.1

    def resolved(self, hands: Hands) -> PlaneConstraint:
        """Return the constraint on all holders of the payload."""
        _require_pose(hands, self.type)
        normal = _unit(self.normal)
        turn = DirectionConstraint(hands.holders, radians(self.tolerance_deg), normal, normal)
        return PlaneConstraint(hands.holders, self.tolerance, normal, turn)


def _unit(vector: Sequence[float]) -> Array:
    return np.array(vector) / np.linalg.norm(vector)


def _require_pose(hands: Hands, what: str, n_dims: int = 3) -> Array:
    """Return the payload's start orientation, or raise `Wrong`. It is required to have a pose, in space."""
    if hands.n_dims < n_dims:
        way_out = "leave it out; {type: no_rotation} keeps the orientation of a payload in the plane"
        raise Wrong(f"'{what}' is for payloads in space, and the scene is planar", way_out)
    if hands.payload is None:
        raise Wrong(
            f"'{what}' is about the pose of a payload, and the scene gives none",
            "write it in version 2, with payload and grasps: comove scene upgrade FILE",
        )
    return hands.payload

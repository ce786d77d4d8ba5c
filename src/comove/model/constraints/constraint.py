"""Protocol of constraints: keys in a scene file, error, and a bound of that error.

The keys are a pydantic model, `ConstraintKeys`; its method `resolved` returns the constraint itself, a frozen
`Constraint` with end effectors by number and SI units. The error is a function of sampled positions. Its bound in
continuous time follows from bounds of the interpolation error between samples, which a `Course` provides.

The vertical is the last coordinate: z in space, y in the plane.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np

from comove.arrays import Array, inner
from comove.io.keys import Pair, Part

ROUNDING = 1e-9
"""[m] or [rad], allowed where a tolerance of nothing is asked for."""


class Hands(NamedTuple):
    """The end effectors of a scene file, for the resolution of keys.

    Attributes
    ----------
    names : names of the end effectors
    holders : numbers of those that hold the payload
    start : array, shape (n_hands, 3), [m]
    payload : array, shape (3, 3), orientation at the start of a payload whose poses are given; None for others
    n_dims : 2 in the plane, 3 in space
    """

    names: tuple[str, ...]
    holders: tuple[int, ...]
    start: Array
    payload: Array | None = None
    n_dims: int = 3

    def numbers(self, names: Sequence[str]) -> tuple[int, ...]:
        """Return the numbers of end effectors by name."""
        return tuple(self.names.index(name) for name in names)


class Course(ABC):
    """The end effectors at every instant: knots and interpolation errors.

    Attributes
    ----------
    position : array, shape (n_knots, n_hands, 3), [m]
    n_dims : 2 in the plane, 3 in space
    """

    position: Array
    n_dims: int

    @abstractmethod
    def stray(self, hands: Sequence[int]) -> Array:
        """Return the summed interpolation errors; array, shape (n_intervals,) [m]."""

    @abstractmethod
    def relative(self, first: int, second: int, axes: slice) -> tuple[Array, Array]:
        """Return relative coordinates of two end effectors, and interpolation errors.

        Arrays, shapes (n_knots, n_axes) and (n_intervals,) [m].
        """

    @abstractmethod
    def rigid(self, first: int, second: int, *, roll: bool = False) -> bool:
        """Return whether two end effectors are on one body; with `roll`, whether that includes their roll."""

    @abstractmethod
    def tilting(self, hands: Sequence[int]) -> Array:
        """Return how much lines may tilt beyond their tilt at knots.

        The lines are between end effectors. Array, shape (n_intervals,) [rad]; infinite where unknown.
        """

    @abstractmethod
    def direction(self, hand: int, own: Array) -> tuple[Array, Array]:
        """Return a direction fixed in a body, and its interpolation error.

        Arrays, shapes (n_knots, 3) and (n_intervals,); infinite where unknown.

        Parameters
        ----------
        own : array, shape (3,), the direction in the world at the first knot
        """

    def leans(self, hand: int, own: Array, world: Array) -> float:
        """Return a bound of the angle between two directions [rad].

        One is of the body, the other of the world; it holds at every instant. Directions within an angle of another
        form a convex cone, which holds a chord if it holds its ends.
        """
        there, stray = self.direction(hand, own)
        angle = np.arctan2(np.linalg.norm(np.cross(there, world), axis=1), there @ world)
        with np.errstate(invalid="ignore"):
            beyond = np.arcsin(np.minimum(stray / np.maximum(nearest_on_chords(there), 1e-9), 1.0))
        return float(np.where(stray < 0.5, np.maximum(angle[1:], angle[:-1]) + beyond, np.inf).max())

    def apart(self, first: int, second: int) -> tuple[float, float]:
        """Return bounds of two end effectors' distance at every instant [m]. The first is the lower one."""
        if self.rigid(first, second):
            distance = np.linalg.norm(self.position[:, first] - self.position[:, second], axis=1)
            return float(distance.min()), float(distance.max())
        relative, stray = self.relative(first, second, slice(self.n_dims))
        distance = np.linalg.norm(relative, axis=1)
        farthest = np.maximum(distance[1:], distance[:-1]) + stray
        return float((nearest_on_chords(relative) - stray).min()), float(farthest.max())


def nearest_on_chords(points: Array) -> Array:
    """Return the least distances from 0 of chords between points. (n_points, n_dims) -> (n_points - 1,)."""
    here, step = points[:-1], np.diff(points, axis=0)
    along = -inner(here, step) / np.maximum(inner(step, step), 1e-300)
    nearest = here + np.clip(along, 0.0, 1.0)[:, None] * step
    return np.sqrt(inner(nearest, nearest))


class Constraint(ABC):
    """A requirement at every instant: its error is within its tolerance.

    A kind without support in the search is sampled there, and bounded here by the properties of its error.

    Attributes
    ----------
    tolerance : the error that is accepted [m] or [rad]
    kind : the kind's name in scene files
    report : name of the kind's measure in reports
    sampled : whether the search has to sample the error; False where coordinates hold it or distances are measured
    turning : whether it concerns a body's orientation, which positions do not determine
    convex : whether the error along a chord is never larger than at its ends
    slope : upper bound of the change of the error per metre that one end effector moves
    n_pieces : pieces into which a chord is cut where the error may be larger inside than at its ends
    """

    tolerance: float
    kind: ClassVar[str]
    report: ClassVar[str] = "constraint_excess_max"
    sampled: ClassVar[bool] = True
    turning: ClassVar[bool] = False
    convex: ClassVar[bool] = False
    slope: ClassVar[float] = 1.0
    n_pieces: ClassVar[int] = 32

    @property
    @abstractmethod
    def hands(self) -> tuple[int, ...]:
        """Return the numbers of its end effectors."""

    @abstractmethod
    def error(self, position: Array, n_dims: int) -> Array:
        """Return the samples' errors, [m] or [rad]; array, shape (n_samples,).

        Parameters
        ----------
        position : array, shape (n_samples, n_hands, 3), samples in order of time [m]
        n_dims : 2 in the plane, 3 in space
        """

    @abstractmethod
    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words why the constraint does not hold."""

    @property
    def allowed(self) -> float:
        """Return the largest accepted error."""
        return max(self.tolerance, ROUNDING)

    def bound(self, course: Course) -> float:
        """Return an upper bound of the error at every instant."""
        position, stray = course.position, self.slope * course.stray(self.hands)
        error = self.error(position, course.n_dims)
        worst = np.maximum(error[1:], error[:-1])
        if not self.convex:
            share = np.linspace(0.0, 1.0, self.n_pieces, endpoint=False)[:, None, None]
            steps = np.diff(position, axis=0)
            inner = (position[:-1, None] + share * steps[:, None]).reshape(-1, *position.shape[1:])
            inner_error = self.error(np.concatenate([position[:1], inner]), course.n_dims)[1:]
            way = np.linalg.norm(steps[:, list(self.hands)], axis=2).sum(axis=1)
            worst = np.maximum(worst, inner_error.reshape(-1, self.n_pieces).max(axis=1))
            stray = stray + self.slope * way / (2 * self.n_pieces)
        return float((worst + stray).max())

    def measure(self, error: float) -> float:
        """Return the measure in reports: the error beyond the tolerance."""
        return error - self.tolerance

    def unmet(self, end: str, error: float, names: Sequence[str]) -> tuple[str, str]:
        """Return a message about a start or goal, and advice."""
        return f"at the {end} {self.reason(error, names)}", "move a hand, or ask for less"

    def level(self, ends: Array) -> tuple[tuple[int, int], ...]:
        """Return the pairs of end effectors that always share a height. Such pairs share a column of the coordinates.

        Parameters
        ----------
        ends : array, shape (2, n_hands, n_dims), the end effectors at start and goal [m]
        """
        return ()

    def needs_body(self, ends: Array) -> bool:
        """Return whether only a rigid body's coordinates hold the constraint. `ends` is as for `level`."""
        return False


@dataclass(frozen=True)
class PairConstraint(Constraint):
    """A constraint between two end effectors, given by their numbers."""

    first: int
    second: int

    @property
    def hands(self) -> tuple[int, ...]:
        """Return the numbers of both end effectors."""
        return self.first, self.second

    def apart(self, position: Array) -> Array:
        """Return their distances; array, shape (n_samples,) [m]."""
        return np.linalg.norm(position[:, self.first] - position[:, self.second], axis=1)

    def pair(self, names: Sequence[str]) -> str:
        """Return both names, as messages show them."""
        return f"'{names[self.first]}' and '{names[self.second]}'"


class ConstraintKeys(Part):
    """The keys of a constraint in a scene file; `type` names its kind."""

    type: str

    def resolved(self, hands: Hands) -> Constraint:
        """Return the constraint with numbers and the default tolerance."""
        raise NotImplementedError(f"{type(self).__name__} has no method `resolved`")


class PairKeys(ConstraintKeys):
    """The keys of a constraint between two end effectors."""

    between: Pair

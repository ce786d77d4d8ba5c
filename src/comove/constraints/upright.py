"""The load turns about the vertical only; in the plane, where any turn is a tilt, not at all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import degrees, radians
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from comove.constraints.constraint import Array, Constraint, ConstraintKeys, Course, Hands
from comove.io.keys import no_minus_zero

LEVEL = 1e-12
"""[m], by which hands at one height may differ by rounding."""


@dataclass(frozen=True)
class UprightConstraint(Constraint):
    """A constraint that keeps the inclination of lines between the load's holders, `members`, within `tolerance`
    [rad].
    """

    members: tuple[int, ...]
    tolerance: float
    kind = "upright"
    report = "tilt_max"
    sampled = False

    @property
    def hands(self) -> tuple[int, ...]:
        """Return the numbers of the holders."""
        return self.members

    def error(self, position: Array, n_dims: int) -> Array:
        """Return the largest change, since the first sample, of the inclination of a line between holders [rad]."""
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
        """Return in words how far the load tilts."""
        if not np.isfinite(error):
            return "the motion's coordinates let the load tilt, and it must stay upright"
        return f"the load tilts by up to {degrees(error):.3g} deg (tolerance {degrees(self.tolerance):g} deg)"

    def level(self, ends: Array) -> tuple[tuple[int, int], ...]:
        """Return pairs of all holders where, in space, they are at one height at start and goal, and so always."""
        heights = ends[:, list(self.members), -1]
        if ends.shape[-1] == 2 or not (np.ptp(heights, axis=1) <= LEVEL).all():
            return ()
        return tuple((self.members[0], other) for other in self.members[1:])

    def needs_body(self, ends: Array) -> bool:
        """Return whether only a rigid body holds the tilt, as the holders do not share a height."""
        return len(self.level(ends)) < len(self.members) - 1


class UprightKeys(ConstraintKeys):
    """A constraint that lets the load turn about the vertical only.

    The goal may miss the tilt of the start by `tolerance_deg`.
    """

    type: Literal["upright"]
    tolerance_deg: Annotated[float, Field(ge=0, le=45), AfterValidator(no_minus_zero)] = 0.1

    def resolved(self, hands: Hands) -> UprightConstraint:
        """Return the constraint on all holders of the load."""
        return UprightConstraint(hands.holders, radians(self.tolerance_deg))

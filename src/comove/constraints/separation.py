"""Two hands stay at least a given distance apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from pydantic import model_validator

from comove.constraints.constraint import ROUNDING, Array, Course, Hands, PairConstraint, PairKeys
from comove.io.keys import Length, PositiveLength, Wrong


@dataclass(frozen=True)
class SeparationConstraint(PairConstraint):
    """A constraint that keeps ``|y_first - y_second| >= distance - tolerance`` at every instant, [m]."""

    distance: float
    tolerance: float
    kind = "separation"
    report = "separation_spare_min"
    sampled = False

    @property
    def least(self) -> float:
        """Return the distance that must be kept, the tolerance subtracted [m]."""
        return self.distance - self.tolerance

    @property
    def allowed(self) -> float:
        """Return rounding, as `least` has the tolerance in it."""
        return ROUNDING

    def error(self, position: Array, n_dims: int) -> Array:
        """Return by how much the hands are too near, negative where they have room to spare [m]."""
        return self.least - self.apart(position)

    def bound(self, course: Course) -> float:
        """Return an upper bound of the error at every instant [m]."""
        return self.least - course.apart(self.first, self.second)[0]

    def measure(self, error: float) -> float:
        """Return the spare distance [m]."""
        return -error

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words how near the hands come."""
        near = self.least - error
        return (
            f"{self.pair(names)} come as near as {max(near, 0.0):.4g} m (at least {self.least:g} m asked for)"
        )

    def unmet(self, end: str, error: float, names: Sequence[str]) -> tuple[str, str]:
        """Return in words that hands are too near at the start or the goal, and what to write instead."""
        apart = f"{self.pair(names)} are {self.least - error:.4g} m apart at the {end}"
        return (
            f"{apart}, but they must stay at least {self.least:g} m apart",
            "move one of them, or ask for less",
        )


class SeparationKeys(PairKeys):
    """A constraint that keeps two hands at least `distance` apart, less `tolerance` [m]."""

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

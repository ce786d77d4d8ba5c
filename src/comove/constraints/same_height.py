"""Two hands are at the same height."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from comove.constraints.constraint import Array, Course, Hands, PairConstraint, PairKeys
from comove.io.keys import Length


@dataclass(frozen=True)
class SameHeightConstraint(PairConstraint):
    """A constraint that keeps ``|h_first - h_second| <= tolerance`` at every instant, h the last coordinate, [m]."""

    tolerance: float
    kind = "same_height"
    report = "height_error_max"
    sampled = False

    def error(self, position: Array, n_dims: int) -> Array:
        """Return the difference of the heights [m]."""
        return np.abs(position[:, self.first, n_dims - 1] - position[:, self.second, n_dims - 1])

    def bound(self, course: Course) -> float:
        """Return an upper bound of the difference of the heights at every instant [m]."""
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
        """Return in words how much the heights differ at the start or the goal, and what to write instead."""
        differ = f"at the {end} the heights of {self.pair(names)} differ by {error:.3g} m"
        return f"{differ} (tolerance {self.tolerance:g} m)", "move one of them, or widen the tolerance"

    def level(self, ends: Array) -> tuple[tuple[int, int], ...]:
        """Return the pair itself, which shares a height."""
        return ((self.first, self.second),)


class SameHeightKeys(PairKeys):
    """A constraint that keeps two hands at the same height (last coordinate), within `tolerance` [m]."""

    type: Literal["same_height"]
    tolerance: Length = 1e-3

    def resolved(self, hands: Hands) -> SameHeightConstraint:
        """Return the constraint."""
        first, second = hands.numbers(self.between)
        return SameHeightConstraint(first, second, self.tolerance)

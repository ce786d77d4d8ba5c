"""Two hands stay a given distance apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from comove.constraints.constraint import Array, Course, Hands, PairConstraint, PairKeys
from comove.io.keys import Length, PositiveLength


@dataclass(frozen=True)
class DistanceConstraint(PairConstraint):
    """A constraint that keeps ``| |y_first - y_second| - distance | <= tolerance`` at every instant, [m]."""

    distance: float
    tolerance: float
    kind = "distance"
    report = "distance_error_max"
    sampled = False

    def error(self, position: Array, n_dims: int) -> Array:
        """Return by how much the distance is off [m]."""
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
    """Return the tolerance of a distance or relative pose [m]; where it is None, a thousandth of the distance."""
    return 1e-3 * distance if tolerance is None else tolerance


class DistanceKeys(PairKeys):
    """A constraint that keeps two hands `distance` apart, within `tolerance` (None: not given) [m]."""

    type: Literal["distance"]
    distance: PositiveLength
    tolerance: Length | None = None

    def resolved(self, hands: Hands) -> DistanceConstraint:
        """Return the constraint, with a thousandth of the distance as its tolerance where none is given."""
        first, second = hands.numbers(self.between)
        tolerance = distance_tolerance(self.tolerance, self.distance)
        return DistanceConstraint(first, second, self.distance, tolerance)

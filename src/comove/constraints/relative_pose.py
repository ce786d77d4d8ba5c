"""Two hands move as parts of one rigid body."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from comove.constraints.constraint import Array, Course, Hands, PairConstraint, PairKeys
from comove.constraints.distance import distance_tolerance
from comove.io.keys import Length


@dataclass(frozen=True)
class RelativePoseConstraint(PairConstraint):
    """A constraint that makes two hands parts of one rigid body.

    Start and goal may miss the hands' distance by `tolerance` [m].

    A `DistanceConstraint` of the same hands states how far they are apart.
    """

    tolerance: float
    kind = "relative_pose"
    report = ""
    sampled = False

    def error(self, position: Array, n_dims: int) -> Array:
        """Return 0: positions do not tell how hands are turned, and their distance is a constraint of its own."""
        return np.zeros(len(position))

    def bound(self, course: Course) -> float:
        """Return 0 where one body holds both hands and its roll, or in the plane a distance does; else infinity."""
        return 0.0 if course.n_dims == 2 or course.rigid(self.first, self.second, roll=True) else np.inf

    def reason(self, error: float, names: Sequence[str]) -> str:
        """Return in words that nothing holds the pose."""
        return f"the motion's coordinates do not hold the relative pose of {self.pair(names)}"

    def needs_body(self, ends: Array) -> bool:
        """Return whether only a rigid body holds the pose, which in the plane is a distance."""
        return ends.shape[-1] == 3


class RelativePoseKeys(PairKeys):
    """A constraint that moves two hands as one rigid body, as they start.

    Ends may miss the hands' distance by `tolerance` [m].
    """

    type: Literal["relative_pose"]
    tolerance: Length | None = None

    def resolved(self, hands: Hands) -> RelativePoseConstraint:
        """Return the constraint, with a thousandth of the hands' distance as its tolerance where none is given."""
        first, second = hands.numbers(self.between)
        apart = float(np.linalg.norm(hands.start[first] - hands.start[second]))
        return RelativePoseConstraint(first, second, distance_tolerance(self.tolerance, apart))

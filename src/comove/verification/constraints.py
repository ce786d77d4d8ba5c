"""Bounds of how far a motion violates the constraints of its scene, at every instant.

What a block of the coordinates keeps by construction is read off from the block: hands of one block are images of
fixed points under one rigid motion, and a block that only shifts, or only turns about the vertical, keeps all tilts.
Hands of different blocks are bounded by their derivatives between the knots.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.constraints import Constraint, Course
from comove.coordination.coordinates import ANGLE, DIRECTION, POINT, Block
from comove.coordination.motion import CoordinatedMotion
from comove.primitives.forcing import INTERVAL, N_INTERVALS
from comove.verification.bounds import NodeBounds, derivative_bounds

Array = NDArray[np.float64]

CHORD_DEVIATION = INTERVAL**2 / 8  # by which a point leaves its chord, per second derivative


class Finding(NamedTuple):
    """The result of the check of one constraint.

    Attributes
    ----------
    constraint : the constraint
    error : upper bound of its error at every instant
    reason : why it does not hold, in words; empty where it does
    """

    constraint: Constraint
    error: float
    reason: str


def examine(course: Course, constraints: Sequence[Constraint], names: Sequence[str]) -> list[Finding]:
    """Judge every constraint over continuous time; `names` are those of the hands."""
    errors = [(c, c.bound(course)) for c in constraints]
    return [Finding(c, error, "" if error <= c.allowed else c.reason(error, names)) for c, error in errors]


def measures(findings: Sequence[Finding]) -> dict[str, float]:
    """Return the worst measures by their names in reports, of the constraints that have one."""
    worst: dict[str, float] = {}
    for c, error, _ in findings:
        if c.report:
            worse = min if c.report.endswith("_min") else max
            worst[c.report] = worse(worst.get(c.report, c.measure(error)), c.measure(error))
    return worst


class MotionCourse(Course):
    """The hands of a motion, whose coordinates say what is rigid and whose derivatives bound the rest."""

    def __init__(self, motion: CoordinatedMotion, bounds: NodeBounds, position: Array):
        self.motion, self.position, self.n_dims = motion, position, motion.scene.n_dims
        self._acceleration = bounds.acceleration

    def stray(self, hands: Sequence[int]) -> Array:
        """Return the sum of the largest distances of hands from their chords."""
        return CHORD_DEVIATION * self._acceleration[:, list(hands)].sum(axis=1)

    def relative(self, first: int, second: int, axes: slice) -> tuple[Array, Array]:
        """Return one hand relative to another; exactly, where both are columns of q and constants."""
        blocks = [self._block(first), self._block(second)]
        if not all(self._is_shifted(part, axes) for part, _ in blocks):
            apart = self.position[:, first, axes] - self.position[:, second, axes]
            return apart, self.stray((first, second))
        columns = np.arange(self.motion.coordinates.n_columns)
        knots = [self.motion.knots[:, :, columns[part.columns][: self.n_dims][axes]] for part, _ in blocks]
        relative = knots[0] - knots[1]
        relative[0] += np.subtract(*(part.points[i, axes] for part, i in blocks))
        return relative[0], CHORD_DEVIATION * derivative_bounds(relative)[2]

    def rigid(self, first: int, second: int, *, roll: bool = False) -> bool:
        """Return whether one block moves both hands, and does not leave their roll open."""
        part, _ = self._block(first)
        return second in part.nodes and not (roll and part.kind == DIRECTION)

    def tilting(self, hands: Sequence[int]) -> Array:
        """Return zeros where a block, or a height that all share, keeps lines from tilting; else infinity."""
        part, _ = self._block(hands[0])
        kept = set(hands) <= set(part.nodes.tolist()) and self._keeps_tilt(part)
        return np.full(N_INTERVALS, 0.0 if kept or self._is_level(hands) else np.inf)

    def _is_level(self, hands: Sequence[int]) -> bool:
        """Return whether hands in space are at one height, whatever q is."""
        columns = np.arange(self.motion.coordinates.n_columns)
        blocks = [self._block(hand) for hand in hands]
        if self.n_dims != 3 or not all(self._keeps_tilt(part) for part, _ in blocks):
            return False
        return len({(int(columns[part.columns][2]), float(part.points[i, 2])) for part, i in blocks}) == 1

    def _block(self, hand: int) -> tuple[Block, int]:
        """Return the block that moves a hand, and the hand's index among the block's points."""
        for part in self.motion.coordinates.parts:
            found = np.flatnonzero(part.nodes == hand)
            if len(found):
                return part, int(found[0])
        raise LookupError(f"no block moves hand {hand}")

    def _keeps_tilt(self, part: Block) -> bool:
        """Return whether a block keeps the tilt of the body that it moves, whatever q is."""
        return part.kind == POINT or (part.kind == ANGLE and self.n_dims == 3)

    def _is_shifted(self, part: Block, axes: slice) -> bool:
        """Return whether a block only shifts its points along some axes: all of a point's, the height in space."""
        return part.kind == POINT or (self._keeps_tilt(part) and axes == slice(2, 3))

"""Constraints that must hold at every instant; see `comove.model.constraints.constraint`.

============== =================================================================================
constraint     requirement
============== =================================================================================
distance       two hands stay a given distance apart
relative pose  two hands move as one rigid body, also about the line through them
separation     two hands stay at least a given distance apart
upright        the load turns about the vertical only (in the plane: not at all)
same height    two hands are at the same height
============== =================================================================================
"""

from comove.model.constraints.constraint import (
    Constraint,
    ConstraintKeys,
    Course,
    Hands,
    PairConstraint,
    PairKeys,
)
from comove.model.constraints.kinds import DistanceConstraint, DistanceKeys
from comove.model.constraints.kinds import RelativePoseConstraint, RelativePoseKeys
from comove.model.constraints.kinds import SameHeightConstraint, SameHeightKeys
from comove.model.constraints.kinds import SeparationConstraint, SeparationKeys
from comove.model.constraints.kinds import UprightConstraint, UprightKeys

KINDS: dict[str, type[ConstraintKeys]] = {
    "distance": DistanceKeys,
    "relative_pose": RelativePoseKeys,
    "separation": SeparationKeys,
    "upright": UprightKeys,
    "same_height": SameHeightKeys,
}
"""The keys of every kind of constraint, by its name in scene files."""

__all__ = [
    "KINDS",
    "Constraint",
    "ConstraintKeys",
    "Course",
    "DistanceConstraint",
    "Hands",
    "PairConstraint",
    "PairKeys",
    "RelativePoseConstraint",
    "SameHeightConstraint",
    "SeparationConstraint",
    "UprightConstraint",
    "UprightKeys",
]

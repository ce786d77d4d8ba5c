"""Constraints that must hold at every instant; see `comove.model.constraints.constraint`.

============== =================================================================================
constraint     requirement
============== =================================================================================
distance       two end effectors stay a given distance apart
relative pose  two end effectors move as one rigid body, also about the line through them
separation     two end effectors stay at least a given distance apart
upright        the payload turns about the vertical only, or leans little (in the plane: not at all)
no rotation    the payload keeps its orientation
axis           the payload turns about one axis only
planar         the payload moves in a plane and turns about its normal only
same height    two end effectors are at the same height
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
from comove.model.constraints.kinds import AxisKeys, DirectionConstraint
from comove.model.constraints.kinds import DistanceConstraint, DistanceKeys
from comove.model.constraints.kinds import NoRotationKeys, RotationConstraint
from comove.model.constraints.kinds import PlanarKeys, PlaneConstraint
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
    "no_rotation": NoRotationKeys,
    "axis": AxisKeys,
    "planar": PlanarKeys,
}
"""The keys of every kind of constraint, by its name in scene files."""

__all__ = [
    "KINDS",
    "Constraint",
    "ConstraintKeys",
    "Course",
    "DirectionConstraint",
    "DistanceConstraint",
    "Hands",
    "PairConstraint",
    "PairKeys",
    "PlaneConstraint",
    "RelativePoseConstraint",
    "RotationConstraint",
    "SameHeightConstraint",
    "SeparationConstraint",
    "UprightConstraint",
    "UprightKeys",
]

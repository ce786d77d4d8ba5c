"""Coordinates that hold the constraints, and movements of several manipulators in them."""

from comove.coordination.adaptation import modulate
from comove.coordination.coordinates import (
    Coordinates,
    arms_coordinates,
    load_coordinates,
    projected_coordinates,
)
from comove.coordination.motion import CoordinatedDMP, CoordinatedMotion, rollouts
from comove.errors import ConstraintError
from comove.primitives.cooperative import CooperativeDMP, CooperativeState
from comove.primitives.projection import (
    Constraint,
    HandDistance,
    Poses,
    ProjectionSettings,
    RelativePose,
    SameHeight,
    Separation,
    Upright,
    project,
)

__all__ = [
    "Constraint",
    "ConstraintError",
    "CooperativeDMP",
    "CooperativeState",
    "CoordinatedDMP",
    "CoordinatedMotion",
    "Coordinates",
    "HandDistance",
    "Poses",
    "ProjectionSettings",
    "RelativePose",
    "SameHeight",
    "Separation",
    "Upright",
    "arms_coordinates",
    "load_coordinates",
    "modulate",
    "project",
    "projected_coordinates",
    "rollouts",
]

"""Scenes: the manipulators, their load, the obstacles and the constraints; signed distances between them."""

from comove.scenes.constraints import (
    Constraint,
    DistanceConstraint,
    RelativePoseConstraint,
    SameHeightConstraint,
    SeparationConstraint,
    UprightConstraint,
)
from comove.scenes.grasp import Grasp
from comove.scenes.scene import Scene

__all__ = [
    "Constraint",
    "DistanceConstraint",
    "Grasp",
    "RelativePoseConstraint",
    "SameHeightConstraint",
    "Scene",
    "SeparationConstraint",
    "UprightConstraint",
]

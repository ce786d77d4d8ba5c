"""Scenes: what moves, what it carries, what stands in the way; signed distances."""

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

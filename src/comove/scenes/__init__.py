"""Scenes: what moves, what it carries, what stands in the way; signed distances."""

from comove.scenes.scene import DistanceConstraint, Scene

__all__ = ["DistanceConstraint", "Scene"]

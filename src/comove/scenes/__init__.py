"""Scenes: the manipulators, their load, the obstacles and the constraints; signed distances between them."""

from comove.scenes.demonstration import demonstration_of, fitted, recording_of
from comove.scenes.grasp import Grasp
from comove.scenes.scene import Scene

__all__ = ["Grasp", "Scene", "demonstration_of", "fitted", "recording_of"]

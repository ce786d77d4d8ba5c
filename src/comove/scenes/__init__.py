"""Scenes: the manipulators, their load, the obstacles and the constraints; signed distances between them."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.scenes.demonstration import (
        demonstration_of as demonstration_of,
        fitted as fitted,
        followed_in as followed_in,
        recording_of as recording_of,
    )
    from comove.scenes.grasp import Grasp as Grasp
    from comove.scenes.scene import Scene as Scene

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "scenes.demonstration": ["demonstration_of", "fitted", "followed_in", "recording_of"],
        "scenes.grasp": ["Grasp"],
        "scenes.scene": ["Scene"],
    },
)

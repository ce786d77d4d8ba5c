"""The model: scenes with payload, grasps, obstacles, constraints, and coordinated motions."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.model.adaptation import modulate as modulate
    from comove.model.coordinated_dmp import CoordinatedDMP as CoordinatedDMP
    from comove.model.coordinates import (
        Coordinates as Coordinates,
        arms_coordinates as arms_coordinates,
        load_coordinates as load_coordinates,
        projected_coordinates as projected_coordinates,
    )
    from comove.model.demonstration import (
        demonstration_of as demonstration_of,
        fitted as fitted,
        followed_in as followed_in,
        recording_of as recording_of,
    )
    from comove.model.grasp import Grasp as Grasp
    from comove.model.motion import CoordinatedMotion as CoordinatedMotion
    from comove.model.online_motion import OnlineMotion as OnlineMotion
    from comove.model.scene import Scene as Scene

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "model.adaptation": ["modulate"],
        "model.coordinated_dmp": ["CoordinatedDMP"],
        "model.coordinates": [
            "Coordinates",
            "arms_coordinates",
            "load_coordinates",
            "projected_coordinates",
        ],
        "model.demonstration": ["demonstration_of", "fitted", "followed_in", "recording_of"],
        "model.grasp": ["Grasp"],
        "model.motion": ["CoordinatedMotion"],
        "model.online_motion": ["OnlineMotion"],
        "model.scene": ["Scene"],
    },
)

"""Coordinates that hold the constraints, and movements of several manipulators in them."""

from typing import TYPE_CHECKING

from comove._doors import lazily

if TYPE_CHECKING:
    from comove.coordination.adaptation import modulate as modulate
    from comove.coordination.coordinates import (
        Coordinates as Coordinates,
        arms_coordinates as arms_coordinates,
        load_coordinates as load_coordinates,
        projected_coordinates as projected_coordinates,
    )
    from comove.coordination.dmp import CoordinatedDMP as CoordinatedDMP
    from comove.coordination.motion import CoordinatedMotion as CoordinatedMotion
    from comove.coordination.online import OnlineMotion as OnlineMotion
    from comove.dmp.basis import rollouts as rollouts
    from comove.dmp.cooperative import (
        CooperativeDMP as CooperativeDMP,
        CooperativeState as CooperativeState,
    )

__all__, __getattr__, __dir__ = lazily(
    __name__,
    {
        "coordination.adaptation": ["modulate"],
        "coordination.coordinates": [
            "Coordinates",
            "arms_coordinates",
            "load_coordinates",
            "projected_coordinates",
        ],
        "coordination.dmp": ["CoordinatedDMP"],
        "coordination.motion": ["CoordinatedMotion"],
        "coordination.online": ["OnlineMotion"],
        "dmp.basis": ["rollouts"],
        "dmp.cooperative": ["CooperativeDMP", "CooperativeState"],
    },
)

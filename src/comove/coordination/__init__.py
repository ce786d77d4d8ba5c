"""Coordinates that hold the constraints, and movements of several manipulators in them."""

from comove.coordination.coordinates import (
    Coordinates,
    arms_coordinates,
    load_coordinates,
    projected_coordinates,
)
from comove.coordination.motion import CoordinatedDMP, CoordinatedMotion, modulate, rollouts

__all__ = [
    "CoordinatedDMP",
    "CoordinatedMotion",
    "Coordinates",
    "arms_coordinates",
    "load_coordinates",
    "modulate",
    "projected_coordinates",
    "rollouts",
]

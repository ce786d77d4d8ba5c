"""Coordinates that hold the constraints, and movements of several manipulators in them."""

from comove.coordination.coordinates import Coordinates, load_coordinates, projected_coordinates
from comove.coordination.motion import CoordinatedDMP, CoordinatedMotion, modulate, rollouts

__all__ = [
    "CoordinatedDMP",
    "CoordinatedMotion",
    "Coordinates",
    "load_coordinates",
    "modulate",
    "projected_coordinates",
    "rollouts",
]

"""Reaction to moving obstacles: modulation of the desired velocities to collision-free ones."""

from comove.reaction.modulation import Directions, Field, Modulation, Sharing, field, modulated
from comove.reaction.obstacles import MovingObstacle, level, level_obstacle
from comove.reaction.shapes import Box, Capsule, Cylinder, Ellipsoid, Shape, Sphere, Superquadric
from comove.reaction.unions import united

__all__ = [
    "Box",
    "Capsule",
    "Cylinder",
    "Directions",
    "Ellipsoid",
    "Field",
    "Modulation",
    "MovingObstacle",
    "Shape",
    "Sharing",
    "Sphere",
    "Superquadric",
    "field",
    "level",
    "level_obstacle",
    "modulated",
    "united",
]

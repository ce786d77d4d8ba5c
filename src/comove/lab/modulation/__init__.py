"""Velocity modulation by moving obstacles (paper, III-B) for comparison."""

from comove.lab.modulation.matrices import Directions, Field, Modulation, Sharing, field, modulated
from comove.lab.modulation.obstacles import MovingObstacle, level, level_obstacle, united
from comove.lab.modulation.shapes import (
    Box,
    Capsule,
    Cylinder,
    Ellipsoid,
    Shape,
    Sphere,
    Superquadric,
)

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

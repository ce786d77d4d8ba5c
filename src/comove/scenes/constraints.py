"""What must hold at every instant, as the scene's builder hands it out: hands by their number, SI units.

============== =================================================================================
constraint     what it demands
============== =================================================================================
distance       two hands stay a given distance apart
relative pose  two hands move as one rigid body, also about the line through them
separation     two hands stay at least a given distance apart
upright        the load turns about the vertical only (in the plane: not at all)
same height    two hands are at the same height
============== =================================================================================

The vertical is the last coordinate: z in space, y in the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

DISTANCE_TOLERANCE = 1e-3
"""Tolerance of a distance or relative pose that states none, as a part of the distance."""
HEIGHT_TOLERANCE = 1e-3
"""Tolerance of a same height that states none [m]."""
UPRIGHT_TOLERANCE_DEG = 0.1
"""Tolerance of an upright load that states none [deg]."""
ROUNDING = 1e-12
"""[m]"""


@dataclass(frozen=True)
class DistanceConstraint:
    """``| |y_first - y_second| - distance | <= tolerance`` at every instant, [m]."""

    first: int
    second: int
    distance: float
    tolerance: float


@dataclass(frozen=True)
class RelativePoseConstraint:
    """Two hands are parts of one rigid body; ends may miss their distance by `tolerance` [m].

    A `DistanceConstraint` of the same hands states how far they are apart.
    """

    first: int
    second: int
    tolerance: float


@dataclass(frozen=True)
class SeparationConstraint:
    """``|y_first - y_second| >= distance - tolerance`` at every instant, [m]."""

    first: int
    second: int
    distance: float
    tolerance: float

    @property
    def least(self) -> float:
        """The distance that must be kept [m]."""
        return self.distance - self.tolerance


@dataclass(frozen=True)
class UprightConstraint:
    """The lines between `members`, who hold the load, keep their inclination within `tolerance` [rad]."""

    members: tuple[int, ...]
    tolerance: float


@dataclass(frozen=True)
class SameHeightConstraint:
    """``|h_first - h_second| <= tolerance`` at every instant, h the last coordinate, [m]."""

    first: int
    second: int
    tolerance: float


Constraint = (
    DistanceConstraint
    | RelativePoseConstraint
    | SeparationConstraint
    | UprightConstraint
    | SameHeightConstraint
)


def distance_tolerance(tolerance: float | None, distance: float) -> float:
    """The tolerance of a distance [m], where None stands for the usual part of it."""
    return DISTANCE_TOLERANCE * distance if tolerance is None else tolerance

"""Constraints that must hold at every instant, as the scene's builder returns them: hands by number, SI units.

============== =================================================================================
constraint     requirement
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
    """A constraint that keeps ``| |y_first - y_second| - distance | <= tolerance`` at every instant, [m]."""

    first: int
    second: int
    distance: float
    tolerance: float


@dataclass(frozen=True)
class RelativePoseConstraint:
    """A constraint that makes two hands parts of one rigid body.

    Start and goal may miss the hands' distance by `tolerance` [m].

    A `DistanceConstraint` of the same hands states how far they are apart.
    """

    first: int
    second: int
    tolerance: float


@dataclass(frozen=True)
class SeparationConstraint:
    """A constraint that keeps ``|y_first - y_second| >= distance - tolerance`` at every instant, [m]."""

    first: int
    second: int
    distance: float
    tolerance: float

    @property
    def least(self) -> float:
        """Return the distance that must be kept, the tolerance subtracted [m]."""
        return self.distance - self.tolerance


@dataclass(frozen=True)
class UprightConstraint:
    """A constraint that keeps the inclination of lines between the load's holders, `members`, within `tolerance`
    [rad].
    """

    members: tuple[int, ...]
    tolerance: float


@dataclass(frozen=True)
class SameHeightConstraint:
    """A constraint that keeps ``|h_first - h_second| <= tolerance`` at every instant, h the last coordinate, [m]."""

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
    """Return the tolerance of a distance [m]; where it is None, the default fraction of the distance."""
    return DISTANCE_TOLERANCE * distance if tolerance is None else tolerance

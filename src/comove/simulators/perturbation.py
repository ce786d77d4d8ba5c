"""Perturbations of a simulation: friction, mass, gains, the load's place in the hands, and a push."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from math import inf
from numbers import Real
from typing import Any

import numpy as np

from comove.errors import OptionError

FRICTION, MASS, GAINS = 0.3, 0.3, 0.2  # by which share they differ at most
START_ERROR = 0.005  # m
PUSH_FORCE, PUSH_DURATION = 5.0, 0.1  # N at most, s
MIDDLE = (0.3, 0.7)  # of the motion: when the push comes


@dataclass(frozen=True)
class Push:
    """A force on the load's middle for a short time.

    Attributes
    ----------
    at : beginning, as a share of the motion's duration
    duration : duration [s]
    force : force in the scene's axes [N]
    """

    at: float
    duration: float
    force: tuple[float, float, float]

    def __post_init__(self) -> None:
        _require("push.at", self.at)
        _require("push.duration", self.duration, positive=True)
        _require("push.force", *self.force)


@dataclass(frozen=True)
class Perturbation:
    """Deviations of a simulation from the plan.

    Attributes
    ----------
    friction, mass : factors on the friction between fingers and load, and on the load's mass
    gains : factors on stiffness and damping of the servos, one for all joints or one each
    start_error : displacement of the load from its planned place when it is grasped, in its own axes [m]; it is
        unknown to the robot, so the hands carry the load displaced
    push : force during the motion, None where there is none
    """

    friction: float = 1.0
    mass: float = 1.0
    gains: tuple[float, ...] = (1.0,)
    start_error: tuple[float, float, float] = (0.0, 0.0, 0.0)
    push: Push | None = None

    def __post_init__(self) -> None:
        _require("friction", self.friction, positive=True)
        _require("mass", self.mass, positive=True)
        _require("gains", *self.gains, positive=True)
        _require("start_error", *self.start_error)

    @classmethod
    def drawn(cls, rng: np.random.Generator, n_joints: int = 1) -> Perturbation:
        """Draw a random perturbation.

        Friction and mass are within 30 %, gains within 20 %; the start error is 5 mm in a random direction of the x-y
        plane of the load's own axes; the push is up to 5 N for 0.1 s in any direction.

        Parameters
        ----------
        n_joints : number of the robot's joints, each of which gets its own gains
        """
        angle = rng.uniform(0.0, 2 * np.pi)
        force = rng.normal(size=3)
        force *= rng.uniform(0.0, PUSH_FORCE) / np.linalg.norm(force)
        return cls(
            friction=float(rng.uniform(1 - FRICTION, 1 + FRICTION)),
            mass=float(rng.uniform(1 - MASS, 1 + MASS)),
            gains=tuple(rng.uniform(1 - GAINS, 1 + GAINS, n_joints).tolist()),
            start_error=(START_ERROR * float(np.cos(angle)), START_ERROR * float(np.sin(angle)), 0.0),
            push=Push(float(rng.uniform(*MIDDLE)), PUSH_DURATION, tuple(force.tolist())),
        )

    def asdict(self) -> dict[str, Any]:
        """Return the perturbation as plain values."""
        return asdict(self)


def _require(key: str, *values: float, positive: bool = False) -> None:
    """Refuse values that are not finite numbers, or not greater than 0 where they must be."""
    for value in values:
        if not (isinstance(value, Real) and -inf < value < inf) or (positive and value <= 0):
            least = " greater than 0" if positive else ""
            raise OptionError(f"{value!r} is not possible", key=key, way_out=f"give a finite number{least}")


PLAN = Perturbation()
"""Everything as planned."""

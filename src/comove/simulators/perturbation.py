"""What differs from the plan: friction, mass, gains, where the load lies in the hands, and a push."""

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
    """A force on the load's middle.

    Attributes
    ----------
    at : when it begins, as a share of the motion's duration
    duration : how long it lasts [s]
    force : in the scene's axes [N]
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
    """What differs from the plan.

    Attributes
    ----------
    friction, mass : factors on the friction between fingers and load, and on the load's mass
    gains : factors on stiffness and damping of the servos, one for all joints or one each
    start_error : where the load lies when it is grasped, from where it should, in its own axes [m]; the
        robot does not know it, so the hands carry it so
    push : a force in mid-motion, None where there is none
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
        """Draw one: friction and mass within 30 %, gains within 20 %, a start error of 5 mm along and across the
        load in the plane on which it lies, a push of up to 5 N for 0.1 s in any direction.

        Parameters
        ----------
        n_joints : of the robot, each of which gets gains of its own
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
        """As plain values."""
        return asdict(self)


def _require(key: str, *values: float, positive: bool = False) -> None:
    """Refuse what is no finite number, or not greater than 0 where it must be."""
    for value in values:
        if not (isinstance(value, Real) and -inf < value < inf) or (positive and value <= 0):
            least = " greater than 0" if positive else ""
            raise OptionError(f"{value!r} is not possible", key=key, way_out=f"give a finite number{least}")


PLAN = Perturbation()
"""Everything as planned."""

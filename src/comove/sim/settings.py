"""Settings and limits of a simulation, and perturbations of the plan."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from numbers import Real

import numpy as np

from comove.errors import OptionError


@dataclass(frozen=True)
class Settings:
    """Settings of a simulation.

    Attributes
    ----------
    log_rate : samples per second in an execution [Hz], from 10 to 500; rounded to whole steps of 2 ms
    settle, hold : time at rest before and after the motion [s]
    slip_limit : largest slip of an end effector on the payload [m]
    end_error_limit : largest distance of the payload from its goal at the end [m]
    internal_force_limit : largest internal force between end effectors [N]
    """

    log_rate: float = 100.0
    settle: float = 0.5
    hold: float = 0.5
    slip_limit: float = 0.002
    end_error_limit: float = 0.003
    internal_force_limit: float = 40.0

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name not in ("settle", "hold") or value != 0.0:
                require_finite(name, value, positive=True)
        if not 10.0 <= self.log_rate <= 500.0:
            raise OptionError(
                f"{self.log_rate} Hz are not possible", key="log_rate", way_out="give a number from 10 to 500"
            )


@dataclass(frozen=True)
class Push:
    """Force on the payload's centre for a short time.

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
        require_finite("push.at", self.at)
        require_finite("push.duration", self.duration, positive=True)
        require_finite("push.force", *self.force)


@dataclass(frozen=True)
class Perturbation:
    """Deviations of a simulation from the plan.

    Attributes
    ----------
    friction, mass : factors on the friction between fingers and payload, and on the payload's mass, unknown to the
        servos: they compensate the mass of the scene
    gains : factors on stiffness and damping of the servos, one for all joints or one each
    start_error : displacement of the payload from its planned pose when it is grasped, in its own axes [m]; it is
        unknown to the robot, so the payload stays displaced
    push : force during the motion, None where there is none
    """

    friction: float = 1.0
    mass: float = 1.0
    gains: tuple[float, ...] = (1.0,)
    start_error: tuple[float, float, float] = (0.0, 0.0, 0.0)
    push: Push | None = None

    def __post_init__(self) -> None:
        require_finite("friction", self.friction, positive=True)
        require_finite("mass", self.mass, positive=True)
        require_finite("gains", *self.gains, positive=True)
        require_finite("start_error", *self.start_error)

    @classmethod
    def drawn(cls, rng: np.random.Generator, n_joints: int) -> Perturbation:
        """Sample a random perturbation.

        Friction and mass are within 30 %, gains within 20 %; the start error is 5 mm in a random direction of the x-y
        plane of the payload's own axes; the push is up to 5 N for 0.1 s in any direction, in the middle of the
        motion.

        Parameters
        ----------
        n_joints : number of the robot's joints, each of which gets its own gains
        """
        angle = rng.uniform(0.0, 2 * np.pi)
        force = rng.normal(size=3)
        force *= rng.uniform(0.0, 5.0) / np.linalg.norm(force)
        x, y, z = force.tolist()
        return cls(
            friction=float(rng.uniform(0.7, 1.3)),
            mass=float(rng.uniform(0.7, 1.3)),
            gains=tuple(rng.uniform(0.8, 1.2, n_joints).tolist()),
            start_error=(0.005 * float(np.cos(angle)), 0.005 * float(np.sin(angle)), 0.0),
            push=Push(at=float(rng.uniform(0.3, 0.7)), duration=0.1, force=(x, y, z)),
        )


def require_finite(key: str, *values: float, positive: bool = False) -> None:
    """Raise `OptionError` unless values are finite, and positive if required."""
    for value in values:
        if not (isinstance(value, Real) and -inf < value < inf) or (positive and value <= 0):
            least = " greater than 0" if positive else ""
            raise OptionError(f"{value!r} is not possible", key=key, way_out=f"give a finite number{least}")


USUAL, PLAN = Settings(), Perturbation()
"""The settings unless others are given, and everything as planned."""

"""The judge: decides whether a motion is safe, and is the only maker of `VerifiedMotion`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import POINT, coordinates_for
from comove.coordination.motion import CoordinatedMotion
from comove.scenes.scene import DistanceConstraint
from comove.trajectory import Trajectory
from comove.verification.bounds import (
    distance_error,
    largest_acceleration,
    largest_speed,
    node_bounds,
)
from comove.verification.certificate import Clearance, certify

Array = NDArray[np.float64]

END_ERROR = 1e-9  # m
END_SPEED = 1e-9  # m/s
ROUNDING = 1e-9  # m, allowed where a tolerance of nothing is asked for

_SEAL = object()


@dataclass(frozen=True)
class Report:
    """What was measured; bounds hold at every instant, not only at samples.

    Attributes
    ----------
    clearance_min : certified lower bound of the clearance [m]
    distance_error_max : upper bound of the error of every distance constraint [m]
    end_error : largest miss of a start or a goal [m]
    end_speed : largest speed at the end [m/s]
    speed_max : upper bound of a hand's speed [m/s]
    acceleration_max : upper bound of a hand's acceleration [m/s^2]
    """

    clearance_min: float
    distance_error_max: float
    end_error: float
    end_speed: float
    speed_max: float
    acceleration_max: float

    def asdict(self) -> dict[str, float]:
        """The measures by name."""
        return asdict(self)


class VerifiedMotion:
    """A motion that passed every check. Only `verify` makes it.

    Attributes
    ----------
    motion : CoordinatedMotion
    report : Report
    """

    __slots__ = ("motion", "report")

    def __init__(self, motion: CoordinatedMotion, report: Report, *, seal: object = None):
        if seal is not _SEAL:
            raise TypeError(
                "a VerifiedMotion comes from comove.verification.verify, not from its constructor"
            )
        object.__setattr__(self, "motion", motion)
        object.__setattr__(self, "report", report)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError("a VerifiedMotion does not change")

    def __copy__(self) -> VerifiedMotion:
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> VerifiedMotion:
        return self

    def __reduce__(self) -> NoReturn:
        raise TypeError("a VerifiedMotion is not pickled: send its `motion` and verify that anew")

    def __delattr__(self, name: str) -> None:
        raise AttributeError("a VerifiedMotion does not change")

    @property
    def clearance_min(self) -> float:
        """Certified lower bound of the clearance [m]."""
        return self.report.clearance_min

    def trajectory(self, n_steps: int | None = None) -> Trajectory:
        """Samples of the motion, at 100 Hz or finer unless `n_steps` is given."""
        return self.motion.trajectory(n_steps)


@dataclass(frozen=True)
class Verdict:
    """The judgement on a motion.

    Attributes
    ----------
    verified : the verified motion, or None
    report : what was measured
    reasons : why it was rejected, in words
    """

    verified: VerifiedMotion | None
    report: Report
    reasons: tuple[str, ...]


class Check(Protocol):
    """A further check: takes the motion, gives the reasons against it (none: passed)."""

    def __call__(self, motion: CoordinatedMotion) -> Sequence[str]:
        """Reasons against `motion`."""


def verify(motion: CoordinatedMotion, checks: Sequence[Check] = ()) -> Verdict:
    """Judge a motion: ends, distances, limits and clearance, in continuous time.

    Parameters
    ----------
    motion
        The candidate, on the scene that it carries.
    checks
        Further checks, a robot's for example.
    """
    scene, duration = motion.scene, motion.scene.duration
    position, velocity, acceleration = motion.coordinates.motion(motion.knots)[
        :, :, : len(scene.manipulators)
    ]
    ends = np.abs(position[[0, -1], :, : scene.n_dims] - np.stack([scene.start, scene.goal]))
    bounds = node_bounds(motion)
    clearance = certify(motion, bounds)
    errors = [_distance_error(motion, c, position) for c in scene.constraints]
    report = Report(
        clearance_min=clearance.lower,
        distance_error_max=max(errors, default=0.0),
        end_error=float(ends.max()),
        end_speed=float(np.linalg.norm(velocity[-1], axis=-1).max() / duration),
        speed_max=largest_speed(motion, velocity, bounds.jerk),
        acceleration_max=largest_acceleration(motion, acceleration, bounds.jerk, scene.acceleration_limit),
    )
    names, reasons = scene.manipulators, []
    if not motion.coordinates.same_as(coordinates_for(scene, motion.coordinates.kind)):
        reasons.append("the motion's coordinates are not those of the scene")
    if not np.isfinite(motion.knots).all():
        reasons.append("the motion is not finite")
    if not report.end_error <= END_ERROR:
        reasons.append(f"an end is missed by {report.end_error:.3g} m")
    if not report.end_speed <= END_SPEED:
        reasons.append(f"a hand still moves at {report.end_speed:.3g} m/s at the end")
    for c, error in zip(scene.constraints, errors, strict=True):
        if not error <= max(c.tolerance, ROUNDING):
            reasons.append(
                f"the distance between '{names[c.first]}' and '{names[c.second]}' is off by up to {error:.3g} m "
                f"(tolerance {c.tolerance:g} m)"
            )
    if not report.speed_max <= scene.speed_limit:
        reasons.append(f"a hand moves at up to {report.speed_max:.4g} m/s (limit {scene.speed_limit:g} m/s)")
    if not report.acceleration_max <= scene.acceleration_limit:
        reasons.append(
            f"a hand accelerates by up to {report.acceleration_max:.4g} m/s^2 "
            f"(limit {scene.acceleration_limit:g} m/s^2)"
        )
    if not clearance.lower >= scene.clearance:
        reasons.append(_contact(motion, clearance))
    for check in checks:
        reasons.extend(check(motion))
    verified = None if reasons else VerifiedMotion(motion, report, seal=_SEAL)
    return Verdict(verified, report, tuple(reasons))


def _distance_error(motion: CoordinatedMotion, constraint: DistanceConstraint, position: Array) -> float:
    """Bound of a distance's error; position (n_knots, n_manipulators, 3) at the knots.

    Two hands in one block of the coordinates are images of two fixed points under one rigid motion: between the
    knots their distance is that of their grasps. Free hands leave what the knots show as their derivatives allow.
    """
    i, j, coordinates = constraint.first, constraint.second, motion.coordinates
    for group in coordinates.groups:
        if {i, j} <= set(group.members):
            apart = np.linalg.norm(position[:, i] - position[:, j], axis=1)
            grasps = group.grasps[[group.members.index(i), group.members.index(j)]]
            held = float(np.linalg.norm(grasps[0] - grasps[1]))
            return float(np.abs(np.append(apart, held) - constraint.distance).max())
    first, second = (next(part for part in coordinates.parts if hand in part.nodes) for hand in (i, j))
    if first.kind != POINT or second.kind != POINT:
        return np.inf
    relative = motion.knots[:, :, first.columns] - motion.knots[:, :, second.columns]
    return distance_error(relative, constraint.distance)


def _contact(motion: CoordinatedMotion, clearance: Clearance) -> str:
    scene = motion.scene
    if clearance.nearest < 0:
        what = "the border of the workspace"
    else:
        what = f"obstacles[{clearance.nearest}] ({scene.file.obstacles[clearance.nearest].shape})"
    when = f"at {clearance.time * scene.duration:.2f} s"
    if clearance.upper < 0:
        return f"the load or a hand reaches {-clearance.upper:.3g} m or more into {what} {when}"
    if clearance.upper < scene.clearance:
        return f"only {clearance.upper:.3g} m from {what} {when} (clearance {scene.clearance:g} m asked for)"
    return (
        f"the clearance of {clearance.upper:.3g} m from {what} {when} could not be certified to be at least "
        f"{scene.clearance:g} m"
    )

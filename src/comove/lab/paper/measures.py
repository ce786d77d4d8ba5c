"""Measures of a motion: verification, smoothness, and errors along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comove.arrays import Array
from comove.lab.systems import distance_errors
from comove.model.motion import CoordinatedMotion
from comove.planning import Solution
from comove.verification.certificate import certify
from comove.verification.verify import verify

N_JERK, N_ALONG = 4001, 801  # samples of a motion, for its jerk and for what happens along it


@dataclass(frozen=True)
class Measures:
    """Figures of one motion.

    Attributes
    ----------
    verified : whether it is verified
    distance_error, clearance : bounds over all instants [m]
    end_error : distance from the wanted ends [m]
    cost : J of equation (4), unit duration
    acceleration : largest acceleration of an end effector [m/s^2]
    jerk : squared third derivative, integrated over time and summed over the end effectors [m^2/s^5]
    turn : largest change of the direction from the first end effector to the second [rad]; 0 for a single one
    first : processor time to the first verified motion [s], None if none was found
    total : processor time of the whole search [s]
    reasons : reasons why it is not verified
    generations : number of generations of the search
    nearest : name of the nearest or most deeply penetrated body at the least clearance: an obstacle of the scene's
        file, or the border of the workspace
    """

    verified: bool
    distance_error: float
    clearance: float
    end_error: float
    cost: float
    acceleration: float
    jerk: float
    turn: float
    first: float | None
    total: float
    reasons: tuple[str, ...] = ()
    generations: int = 0
    nearest: str = ""


@dataclass(frozen=True)
class Along:
    """Objective and errors along a motion, as in the paper's Figure 5.

    Attributes
    ----------
    at_start, at_end : terms of goal and velocity at both ends, unit duration
    rise : largest climb above the least value so far, after its first peak
    rise_near : whether an obstacle is near at the highest point of that climb
    error : largest error of a distance [m]
    error_near, error_far : root-mean-square error of the distances while an obstacle is near, and while none is [m]
    """

    at_start: float
    at_end: float
    rise: float
    rise_near: bool
    error: float
    error_near: float
    error_far: float


def measure(solution: Solution) -> Measures:
    """Measure the final motion of a solution, whose times are processor times."""
    first, total = solution.effort.first_verified, solution.effort.seconds
    found = _measures(solution.attempt, solution.cost.total, first, total)
    return replace(found, generations=solution.effort.generations)


def measure_motion(motion: CoordinatedMotion) -> Measures:
    """Measure a motion that does not come from a search."""
    return _measures(motion, np.nan, None, 0.0)


def _measures(motion: CoordinatedMotion, cost: float, first: float | None, total: float) -> Measures:
    verdict = verify(motion)
    report = verdict.report
    return Measures(
        verified=verdict.verified is not None,
        distance_error=report.distance_error_max,
        clearance=report.clearance_min,
        end_error=report.end_error,
        cost=cost,
        acceleration=report.acceleration_max,
        jerk=squared_jerk(motion),
        turn=largest_turn(motion),
        first=first,
        total=total,
        reasons=verdict.reasons,
        nearest=motion.scene.name_of(certify(motion).nearest),
    )


def count_verified(found: Sequence[Measures]) -> str:
    """Return the number of verified motions and of all, in words."""
    return f"{sum(m.verified for m in found)} of {len(found)}"


def apart_in_the_mean(one: CoordinatedMotion, other: CoordinatedMotion) -> float:
    """Return the mean distance between two motions' centres at equal times [m]."""
    s = np.linspace(0.0, 1.0, N_ALONG)
    middles = [motion.hands(s)[0].mean(axis=1) for motion in (one, other)]
    return float(np.linalg.norm(middles[0] - middles[1], axis=1).mean())


def squared_jerk(motion: CoordinatedMotion) -> float:
    """Compute the integrated squared jerk of all end effectors [m^2/s^5]."""
    s = np.linspace(0.0, 1.0, N_JERK)
    jerk = np.diff(motion.hands(s)[2], axis=0) * (N_JERK - 1)
    return float((jerk**2).sum() / (N_JERK - 1) / motion.scene.duration**5)


def largest_turn(motion: CoordinatedMotion) -> float:
    """Return the largest turn of the line between end effectors [rad]. It is 0 for a single one."""
    hands = motion.hands(np.linspace(0.0, 1.0, N_ALONG))[0]
    if hands.shape[1] < 2:
        return 0.0
    apart = hands[:, 1] - hands[:, 0]
    apart = apart / np.linalg.norm(apart, axis=1, keepdims=True)
    return float(np.arccos(np.clip(apart @ apart[0], -1.0, 1.0)).max())


def follow(motion: CoordinatedMotion, weight: float, within: float = 0.05) -> Along:
    """Measure objective and errors along a motion.

    Parameters
    ----------
    weight : c_vel of equation (4)
    within : clearance below which an obstacle is near [m]
    """
    scene, s = motion.scene, np.linspace(0.0, 1.0, N_ALONG)
    position, velocity, _ = motion.hands(s)
    value = ((position - scene.goal) ** 2).sum(axis=(1, 2)) + weight * (velocity**2).sum(axis=(1, 2))
    error = distance_errors(scene, position)
    nodes = motion.coordinates.motion(motion.at(s))[0]
    clearance = scene.clearances(nodes, s * scene.duration)
    near = clearance < within
    first_fall = int(np.argmax(np.diff(value) < 0))  # the velocity term rises from rest
    climb = value[first_fall:] - np.minimum.accumulate(value[first_fall:])
    top = int(np.argmax(climb))
    return Along(
        at_start=float(value[0]),
        at_end=float(value[-1]),
        rise=float(climb[top]),
        rise_near=bool(near[first_fall + top]),
        error=float(error.max()),
        error_near=_rms(error[near]),
        error_far=_rms(error[~near]),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean())) if len(values) else 0.0

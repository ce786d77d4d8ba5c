"""The shortest durations of motions, and of searches among moving obstacles."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from math import ceil, floor, log10
from typing import Any

import numpy as np

from comove.arrays import ROUNDING
from comove.dmp.basis import motion_basis
from comove.dmp.dmp import DMP
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import load_coordinates
from comove.model.files.keys import DEFAULT_LIMITS, MAX_DURATION, MIN_DURATION
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.solution import Solution
from comove.verification.bounds import largest_rates

LIMITS = DEFAULT_LIMITS
NONE = dict.fromkeys(LIMITS, 1e6)  # limits so high that they have no effect


def with_limits(scene: Scene, limits: Mapping[str, float] = LIMITS) -> Scene:
    """Return the scene with default limits where it leaves them out."""
    return scene.with_limits(limits)


def in_least_time(motion: CoordinatedMotion, scene: Scene, least: float = 0.0) -> CoordinatedMotion:
    """Return the movement on the scene, as fast as the limits allow.

    Parameters
    ----------
    least : lower bound of the duration for other reasons [s]
    """
    once = motion.on(scene.timed(1.0))
    limits = scene.speed_limit, scene.acceleration_limit, scene.jerk_limit
    paces = [
        (rate / limit) ** (1.0 / order)
        for order, (rate, limit) in enumerate(zip(largest_rates(once), limits, strict=True), start=1)
    ]
    return once.on(scene.timed(min(max(rounded_up(max(least, *paces)), MIN_DURATION), MAX_DURATION)))


def too_short(scene: Scene, needed: float) -> str:
    """Return the message that a duration is too short. 2 % more than `needed` [s] suffices, from other starts too."""
    return f"{scene.duration:g} s are too short for the limits: {rounded_up(1.02 * needed, 3):g} s would do"


def would_do(needed: float) -> str:
    """Return the message of a sufficient duration, 2 % above `needed` [s]."""
    return f"a duration of {rounded_up(1.02 * needed, 3):g} s would do"


def least_possible(scene: Scene) -> float:
    """Bound any motion's duration [s] from below. Straight lines from rest to rest keep each limit by itself.

    For scenes that continue another movement no bound is known, and the result is 0.
    """
    if scene.begins > 0 or any(group.start_twist.any() for group in scene.groups):
        return 0.0
    way = float(np.linalg.norm(scene.goal - scene.start, axis=1).max())
    return max(
        way / scene.speed_limit,
        2.0 * (way / scene.acceleration_limit) ** (1 / 2),
        (32.0 * way / scene.jerk_limit) ** (1 / 3),
    )


def rounded_up(duration: float, digits: int = 5) -> float:
    """Return a duration, rounded up to some significant digits."""
    if not 0.0 < duration < MAX_DURATION:
        return duration if duration <= 0.0 else MAX_DURATION  # also where an orientation is not defined
    decimals = digits - 1 - floor(log10(duration))
    return round(ceil(duration * (1 + ROUNDING) * 10**decimals) / 10**decimals, decimals)


@dataclass(frozen=True)
class DurationSettings:
    """Settings of the search for the shortest duration.

    Attributes
    ----------
    longer : ratio of a duration to the one tried before
    near : ratio of the shortest duration with a motion to a shorter one without, which is accurate enough
    digits : significant digits of durations that are tried
    share : largest share of the work of the budget for the try of one duration
    """

    longer: float = 1.25
    near: float = 1.03
    digits: int = 4
    share: float = 0.2


SETTINGS = DurationSettings()


def alone(scene: Scene, taught: tuple[DMP, ...] | None, n_basis: int = 30) -> float:
    """Return the least duration without obstacles [s]. The path is straight, or that of the demonstration.

    Parameters
    ----------
    n_basis : shape weights a column of a demonstration
    """
    scene = scene.timed(1.0)
    if taught is None:
        return in_least_time(CoordinatedMotion.straight(scene), scene).scene.duration
    coordinates, basis = load_coordinates(scene), motion_basis(n_basis, "jerk")
    motion = CoordinatedDMP.from_demonstration(taught, scene, coordinates, basis).rollout()
    return in_least_time(motion, scene).scene.duration


def shortest(
    attempt: Callable[[float], Generator[Any, Any, Solution]],
    least: float,
    over: Callable[[], bool],
    *,
    closely: bool,
    settings: DurationSettings = SETTINGS,
) -> Generator[Any, Any, list[Solution]]:
    """Increase the duration until a motion is verified. If `closely`, bisect down to the last failure then.

    A duration longer than a successful one may fail, as obstacles are elsewhere at each instant: the result is the
    shortest success among the durations tried.

    Parameters
    ----------
    attempt : procedure that searches for a motion of a given duration [s]
    least : first duration [s]
    over : function that returns whether to end

    Returns
    -------
    list of all tries, at least one; the last is the shortest verified one, if there is any
    """
    shorter, duration = 0.0, rounded_up(least, settings.digits)
    tries = [(yield from attempt(duration))]
    while not tries[-1].verified and duration < MAX_DURATION and not over():
        shorter, duration = duration, rounded_up(settings.longer * duration, settings.digits)
        tries.append((yield from attempt(duration)))
    while closely and tries[-1].verified and not over():
        found = tries[-1]
        middle = rounded_up(np.sqrt(shorter * found.scene.duration), settings.digits)
        if shorter == 0.0 or found.scene.duration < settings.near * shorter or middle >= found.scene.duration:
            break
        tried = yield from attempt(middle)
        tries = [*tries[:-1], found, tried] if tried.verified else [*tries[:-1], tried, found]
        shorter = shorter if tried.verified else middle
    return tries

"""The shortest duration of a motion within its limits, from bounds that hold at every instant."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, floor, log10

import numpy as np

from comove.coordination.motion import CoordinatedMotion
from comove.scenes.model import MAX_DURATION, MIN_DURATION
from comove.scenes.scene import Scene
from comove.verification.bounds import largest_rates

# m/s, m/s^2 and m/s^3, of hands, where a scene has none.
LIMITS = {"speed": 1.0, "acceleration": 1.0, "jerk": 5.0}
DIGITS = 5  # of a duration that is found
NONE = dict.fromkeys(LIMITS, 1e6)  # limits so high that they have no effect
EASE = 1.02  # ratio of the duration that messages name to the shortest found: other starts reach it as well
ROUNDING = 1e-9  # relative difference of bounds between two computations


def with_limits(scene: Scene, limits: Mapping[str, float] = LIMITS) -> Scene:
    """Return the scene with `LIMITS`, or other values, in place of the limits that it leaves out."""
    given = scene.file.limits
    return scene.limited(**{key: value for key, value in limits.items() if getattr(given, key) is None})


def in_least_time(motion: CoordinatedMotion, scene: Scene, least: float = 0.0) -> CoordinatedMotion:
    """Return the movement, made as fast as the limits of a scene allow, on that scene with the new duration.

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
    """Return the message that a duration is too short, and that a little more than `needed` [s] would do."""
    return f"{scene.duration:g} s are too short for the limits: {rounded_up(EASE * needed, 3):g} s would do"


def least_possible(scene: Scene) -> float:
    """Return a lower bound of the duration of any motion [s]: straight lines from rest to rest, each limit by itself.

    For scenes that go on from another movement no bound is known, and the result is 0.
    """
    if scene.begins > 0 or any(group.start_twist.any() for group in scene.groups):
        return 0.0
    way = float(np.linalg.norm(scene.goal - scene.start, axis=1).max())
    return max(
        way / scene.speed_limit,
        2.0 * (way / scene.acceleration_limit) ** (1 / 2),
        (32.0 * way / scene.jerk_limit) ** (1 / 3),
    )


def rounded_up(duration: float, digits: int = DIGITS) -> float:
    """Return a duration, rounded up to some significant digits."""
    if not 0.0 < duration < MAX_DURATION:
        return duration if duration <= 0.0 else MAX_DURATION  # also where an orientation is not defined
    decimals = digits - 1 - floor(log10(duration))
    return round(ceil(duration * (1 + ROUNDING) * 10**decimals) / 10**decimals, decimals)

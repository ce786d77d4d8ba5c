"""How fast a motion may be made: the shortest duration within limits, by bounds that hold at every instant."""

from __future__ import annotations

from collections.abc import Mapping
from math import ceil, floor, log10

import numpy as np

from comove.coordination.motion import CoordinatedMotion
from comove.scenes.model import MAX_DURATION, MIN_DURATION
from comove.scenes.scene import Scene
from comove.verification.rates import largest_rates

# m/s, m/s^2 and m/s^3, of hands, where a scene has none.
LIMITS = {"speed": 1.0, "acceleration": 1.0, "jerk": 5.0}
DIGITS = 5  # of a duration that is found
NONE = dict.fromkeys(LIMITS, 1e6)  # what limits nothing
EASE = 1.02  # times the shortest found, that is named to somebody who asked for less: met from another start as well
ROUNDING = 1e-9  # relative, by which bounds may differ from one computation to the next


def with_limits(scene: Scene, limits: Mapping[str, float] = LIMITS) -> Scene:
    """Return the scene with `LIMITS`, or other values, for those that it leaves out."""
    given = scene.file.limits
    return scene.limited(**{key: value for key, value in limits.items() if getattr(given, key) is None})


def in_least_time(motion: CoordinatedMotion, scene: Scene, least: float = 0.0) -> CoordinatedMotion:
    """Return the same movement as fast as the limits of `scene` allow, on that scene with this duration.

    Parameters
    ----------
    least : duration that it takes for other reasons [s]
    """
    once = motion.on(scene.timed(1.0))
    limits = scene.speed_limit, scene.acceleration_limit, scene.jerk_limit
    paces = [
        (rate / limit) ** (1.0 / order)
        for order, (rate, limit) in enumerate(zip(largest_rates(once), limits, strict=True), start=1)
    ]
    return once.on(scene.timed(min(max(rounded_up(max(least, *paces)), MIN_DURATION), MAX_DURATION)))


def too_short(scene: Scene, needed: float) -> str:
    """Say that the duration of a scene is too short, and which one would do, a little more than `needed` [s]."""
    return f"{scene.duration:g} s are too short for the limits: {rounded_up(EASE * needed, 3):g} s would do"


def least_possible(scene: Scene) -> float:
    """Return a duration that no motion can undercut [s]: each limit by itself, straight ways from rest to rest.

    Nothing is known, and 0 returned, of motions that go on from one under way.
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
    """Return a duration in few digits, no shorter than the one given."""
    if not 0.0 < duration < MAX_DURATION:
        return duration if duration <= 0.0 else MAX_DURATION  # also where an orientation is not defined
    decimals = digits - 1 - floor(log10(duration))
    return round(ceil(duration * (1 + ROUNDING) * 10**decimals) / 10**decimals, decimals)

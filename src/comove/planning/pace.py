"""How fast a motion may be made: the shortest duration within limits, by bounds that hold at every instant."""

from __future__ import annotations

from math import ceil, floor, log10

from comove.coordination.motion import CoordinatedMotion
from comove.scenes.model import MAX_DURATION, MIN_DURATION
from comove.scenes.scene import Scene
from comove.verification.rates import largest_rates

# m/s, m/s^2 and m/s^3, of hands, where a scene has none.
LIMITS = {"speed": 1.0, "acceleration": 1.0, "jerk": 5.0}
DIGITS = 5  # of a duration that is found
EASE = 1.02  # times the shortest found, that is named to somebody who asked for less
ROOM = 1.3  # the same for arms, whose way is another one next time
ROUNDING = 1e-9  # relative, by which bounds may differ from one computation to the next


def with_limits(scene: Scene) -> Scene:
    """Return the scene with `LIMITS` for those that it leaves out."""
    given = scene.file.limits
    return scene.limited(**{key: value for key, value in LIMITS.items() if getattr(given, key) is None})


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


def comfortable(duration: float, ease: float = EASE) -> float:
    """Return a duration a little longer, in few digits: one that a search meets again from another start."""
    return rounded_up(ease * duration, 3)


def rounded_up(duration: float, digits: int = DIGITS) -> float:
    """Return a duration in few digits, no shorter than the one given."""
    if not 0.0 < duration < MAX_DURATION:
        return duration if duration <= 0.0 else MAX_DURATION  # also where an orientation is not defined
    decimals = digits - 1 - floor(log10(duration))
    return round(ceil(duration * (1 + ROUNDING) * 10**decimals) / 10**decimals, decimals)

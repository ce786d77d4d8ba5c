"""The search for the shortest duration of a motion among moving obstacles."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from comove.coordination.coordinates import load_coordinates
from comove.coordination.motion import CoordinatedDMP, CoordinatedMotion
from comove.planning.pace import in_least_time, rounded_up
from comove.planning.solution import Solution
from comove.primitives.basis import motion_basis
from comove.primitives.dmp import DMP
from comove.scenes.model import MAX_DURATION
from comove.scenes.scene import Scene

LONGER = 1.25  # ratio of a duration to the one tried before
NEAR = 1.03  # ratio of the shortest duration with a motion to a shorter one without, which is accurate enough
DIGITS = 4  # of durations that are tried
N_BASIS = 30  # shape weights a column of a demonstration


def alone(scene: Scene, taught: tuple[DMP, ...] | None) -> float:
    """Return the least duration of the straight way, or of the demonstration, if there were no obstacles [s]."""
    scene = scene.timed(1.0)
    if taught is None:
        return in_least_time(CoordinatedMotion.straight(scene), scene).scene.duration
    coordinates, basis = load_coordinates(scene), motion_basis(N_BASIS, "jerk")
    motion = CoordinatedDMP.from_demonstration(taught, scene, coordinates, basis).rollout()
    return in_least_time(motion, scene).scene.duration


def shortest(
    attempt: Callable[[float], Solution], least: float, over: Callable[[], bool], *, closely: bool
) -> list[Solution]:
    """Try increasing durations until a motion is verified; then, if `closely`, bisect down to the last that failed.

    A duration longer than a successful one may fail, as obstacles are elsewhere at each instant: the result is the
    shortest success among the durations tried.

    Parameters
    ----------
    attempt : function that searches for a motion of a given duration [s]
    least : first duration [s]
    over : function that returns whether to end

    Returns
    -------
    list of all tries, at least one; the last is the shortest verified one, if there is any
    """
    shorter, duration = 0.0, rounded_up(least, DIGITS)
    tries = [attempt(duration)]
    while not tries[-1].verified and duration < MAX_DURATION and not over():
        shorter, duration = duration, rounded_up(LONGER * duration, DIGITS)
        tries.append(attempt(duration))
    while closely and tries[-1].verified and not over():
        found = tries[-1]
        middle = rounded_up(np.sqrt(shorter * found.scene.duration), DIGITS)
        if shorter == 0.0 or found.scene.duration < NEAR * shorter or middle >= found.scene.duration:
            break
        tried = attempt(middle)
        tries = [*tries[:-1], found, tried] if tried.verified else [*tries[:-1], tried, found]
        shorter = shorter if tried.verified else middle
    return tries

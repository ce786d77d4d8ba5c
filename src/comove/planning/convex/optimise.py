"""Sequential quadratic programming of motions, with warps of time between the steps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.planning.convex.programme import ConvexProgramme, ConvexSettings, QuadraticCost
from comove.planning.convex.steps import SOUND, stand, step
from comove.planning.convex.warp import warped

Array = NDArray[np.float64]

MOST_SLACK_COST = 1e8  # largest cost of a metre of slack


@dataclass
class ConvexOutcome:
    """The result of `optimise`.

    Attributes
    ----------
    z : array, shape (n_columns * n_basis,), shape weights
    value : value of the cost, raised where obstacles are nearer than wished for
    missed : amounts by which margins and limits are missed beyond the tolerance, summed [m]
    iterations, programmes : numbers of steps tried and of quadratic programmes solved
    """

    z: Array
    value: float
    missed: float
    iterations: int = 0
    programmes: int = 0


def optimise(
    programme: ConvexProgramme,
    cost: QuadraticCost,
    z: Array,
    settings: ConvexSettings,
    reference: Array | None = None,
    over: Callable[[], bool] = lambda: False,
) -> ConvexOutcome:
    """Optimise shape weights until steps bring no gain.

    Parameters
    ----------
    z : array, shape (n_columns * n_basis,), initial shape weights
    reference : array, shape (n_fine, n_columns), movement without contact about which the first clearances are
        linearised; that of `z` unless given
    over : function that is called before every step and returns whether to end
    """
    radius, mu = settings.radius, settings.slack_cost
    here = stand(programme, cost, z, settings, radius, reference)
    outcome, stall = ConvexOutcome(z, np.inf, here.missed), 0.0
    for _ in range(settings.iterations):
        if over():
            break
        trial = step(programme, cost, here, settings, radius, mu)
        outcome.iterations += 1
        if trial is None:
            radius *= 0.3
            if radius < settings.least:
                break
            continue
        outcome.programmes += trial.programmes
        ahead = programme.moves @ trial.dz - here.off[programme.watched].ravel()
        size = float(np.abs(ahead / programme.scale).max())
        first = not np.isfinite(here.missed)
        actual = here.value - trial.value + mu * (here.missed - trial.missed)
        restoring = trial.predicted <= 0 and trial.missed <= here.missed and trial.value < 1.01 * here.value
        even = abs(actual) < settings.gain * here.value and trial.missed <= here.missed
        taken = first or actual > max(0.05 * trial.predicted, 0.0) or even or restoring
        if not taken:
            radius = 0.4 * min(radius, size)
        elif not first and actual > 0.5 * trial.predicted and size > 0.9 * radius:
            radius = min(2 * radius, settings.most)
        elif not first and actual < 0.25 * trial.predicted and not restoring:
            radius = max(0.5 * size, 2 * settings.least)
        if taken:
            z = here.z + trial.dz
            if trial.missed == 0:
                z = warped(programme, cost, z, settings)
            here = stand(programme, cost, z, settings, radius)
        worth = here.value * (1 + settings.worth * here.wish)
        gained = here.missed < SOUND and worth < outcome.value * (1 - settings.gain)
        if here.missed < SOUND and worth < outcome.value:
            outcome.z, outcome.value, outcome.missed = here.z, worth, 0.0
        stall = 0.0 if gained else stall + (1.0 if taken and here.missed < SOUND else 0.2)
        if stall >= settings.patience or radius < settings.least:
            break
        if trial.slack > 1e-6 and (here.seen.depth > programme.need(settings)).any():
            mu = min(5 * mu, MOST_SLACK_COST)
    if not np.isfinite(outcome.value):
        outcome.z, outcome.value, outcome.missed = here.z, here.value, here.missed
    return outcome

"""Warps of time, by which movements follow their path at other times.

Linearised clearances keep every sample on its side of a plane of its own, so that the instant at which a payload
passes a corner hardly moves by more than a sample in a step. But a movement without contact has only warps without
contact: these need no planes, and are optimised separately between steps.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from comove.arrays import Array
from comove.planning.convex.costs import Moves, SumOfSquares
from comove.planning.convex.programme import ConvexProgramme, ConvexSettings


def warped(
    programme: ConvexProgramme,
    cost: SumOfSquares,
    z: Array,
    value: float,
    hands: Array,
    settings: ConvexSettings,
) -> Array:
    """Return the weights of a cheaper warp that keeps the margins; else `z`.

    Time is shifted by a sum of waves ``sin(k pi t)`` that minimises the cost with linearised residuals. `value` and
    `hands` are those of `z`, as of `ConvexProgramme.value`.
    """
    if cost.haste > 0:
        return z
    warp = settings.warp
    speed = _slopes(hands)
    moves = Moves(speed[:, :, None], _waves(len(hands), warp.n_waves), np.zeros(1, dtype=bool))
    square, gradient = cost.normal_equations(hands, moves)
    order = np.arange(1, warp.n_waves + 1)
    square.flat[:: len(order) + 1] += warp.smooth * np.trace(square) / len(order) * (np.pi * order) ** 2
    heights = -np.linalg.solve(square, gradient)
    if -gradient @ heights < settings.gain * value:  # the gain that it promises
        return z
    curves = programme.curves
    t = np.linspace(0.0, 1.0, len(curves.fine.base))
    shift = _waves(len(t), warp.n_waves) @ heights
    shift *= min(1.0, warp.steepest / max(np.abs(_slopes(shift)).max(), 1e-12))
    way, rate = curves.fine.q(z), curves.fine_rate.q(z)
    near = settings.margin + 1e-3 + curves.scene.clearance
    for share in warp.shares:
        later = curves.fit(interpolated(way, rate, t + share * shift), warp.ridge)
        cheaper, hands = programme.value(cost, later, settings.gauge)
        if cheaper > (1 - settings.gain) * value:
            continue
        seen = programme.look(curves.fine.q(later), near, programme.need(settings))
        if programme.missed(seen, hands, settings, cost) == 0.0:
            return later
    return z


def interpolated(way: Array, rate: Array, t: Array) -> Array:
    """Interpolate a movement at other times by cubic Hermite splines.

    Parameters
    ----------
    way, rate : arrays, shape (n_samples, n_columns), movement and its derivative by normalised time
    t : array, shape (n,), normalised times
    """
    n_intervals = len(way) - 1
    i = np.clip((t * n_intervals).astype(int), 0, n_intervals - 1)
    u = (t * n_intervals - i)[:, None]
    here, further = way[i], way[i + 1] - way[i]
    begin, end = rate[i] / n_intervals, rate[i + 1] / n_intervals
    return np.asarray(
        here + u * (begin + u * (3 * further - 2 * begin - end + u * (begin + end - 2 * further)))
    )


def _slopes(y: Array) -> Array:
    """Return derivatives by normalised time, from even samples along the first axis."""
    slopes = np.empty_like(y)
    slopes[0], slopes[-1] = 2 * (y[1] - y[0]), 2 * (y[-1] - y[-2])
    np.subtract(y[2:], y[:-2], out=slopes[1:-1])
    slopes *= 0.5 * (len(y) - 1)
    return slopes


@lru_cache(maxsize=8)
def _waves(n: int, n_waves: int) -> Array:
    """Return sampled waves that vanish at both ends; array, shape (n, n_waves)."""
    waves = np.sin(np.pi * np.outer(np.linspace(0.0, 1.0, n), np.arange(1, n_waves + 1)))
    return waves

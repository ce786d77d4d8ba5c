"""The quadratic programme of a step, solved by an active subset.

Of hundreds of linearised clearances some ten are active at the solution. So a programme begins with those that are
nearly active, and rows that its solution violates are added until there are none. This gives the same solution
several times faster. Limits of speed, acceleration and jerk are half-spaces that touch balls, anew where the solution
violates them; inactive ones are removed again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import daqp
import numpy as np

from comove.arrays import Array, Integers
from comove.planning.convex.limits import LinearLimits

FREE = 1e30  # infinite bound for DAQP
UNIT = 1e-3  # m, unit of the slack in a programme
# DAQP takes steps without progress for a cycle; beside the price of the slack in its dual objective, progress may be
# less than what rounding leaves. A programme of 600 variables may need more than 2000 steps, each adding one row.
PATIENCE = {"cycle_tol": 100, "iter_limit": 20_000}
BROKEN = 1e-6  # m by which rows may be violated that are not part of it; for the trust region, a share of its radius


@dataclass(frozen=True)
class QuadraticSettings:
    """Settings of the active subset of a programme's rows.

    Attributes
    ----------
    nearly : distance from its bound below which a clearance is part of the programme from the beginning [m]
    active : share of a limit from which on it is part of the programme from the beginning
    few : rows added at once, the most violated ones
    rounds : largest number of times that rows are added
    excess : relative excess over a limit up to which no tangent is added
    curved : curvature that is added to the cost of a pace, as a share of it, so that the programme has one solution
    """

    nearly: float = 5e-3
    active: float = 0.7
    few: int = 40
    rounds: int = 30
    excess: float = 1e-3
    curved: float = 1e-2


SETTINGS = QuadraticSettings()


class Rows(NamedTuple):
    """The linearised clearances of a programme.

    Attributes
    ----------
    rows, bound : arrays, shapes (n, n_variables) and (n,), of ``rows dz >= bound`` [m]
    owner : array of int, shape (n,), owner of each clearance
    further : array, shape (n,), additional soft clearance [m]; -inf without one
    """

    rows: Array
    bound: Array
    owner: Integers
    further: Array

    def with_more(self, rows: Array, bound: Array, owner: Integers, further: Array) -> Rows:
        """Return these rows followed by others."""
        more = (rows, bound, owner, further)
        return Rows(*(np.concatenate(pair) for pair in zip(self, more, strict=True)))


class Trust(NamedTuple):
    """The trust region of a step.

    Attributes
    ----------
    moves, center, radius : arrays, shapes (n, n_variables), (n,) and (n,), of ``|moves dz - center| <= radius``
    """

    moves: Array
    center: Array
    radius: Array


class Prices(NamedTuple):
    """Prices of violations and of time in a programme.

    Attributes
    ----------
    slack : cost of a metre by which clearances are missed
    wish : cost of a square metre, for the squared distance by which an owner misses the soft clearance
    duration : cost of one more duration
    pace : number of durations in which limits are kept so far
    faster : largest share of the pace that may be saved
    """

    slack: float
    wish: float
    duration: float
    pace: float
    faster: float


class Minimum(NamedTuple):
    """The solution of a programme.

    Attributes
    ----------
    w : array, shape (n,), whitened change of the weights
    slack : largest amount by which clearances are missed [m]
    short : sum over owners of the squared distance by which each misses the soft clearance [m^2]
    slower : growth of the pace, in durations
    programmes : number of programmes that were solved, one for each set of rows
    """

    w: Array
    slack: float
    short: float
    slower: float
    programmes: int


def minimum(
    gradient: Array,
    whiten: Array,
    clearances: Rows,
    trust: Trust,
    limits: LinearLimits,
    prices: Prices,
    settings: QuadraticSettings = SETTINGS,
    over: Callable[[], bool] = lambda: False,
) -> Minimum | None:
    """Minimise ``|w|^2 / 2 + gradient w`` plus half of the `prices`. The variables are ``dz = whiten' w``.

    Return None if that fails, or once `over`, which is called before every set of rows, returns True.
    """
    n = len(gradient)
    rows, bound, owner, further = clearances
    wished = np.flatnonzero(np.isfinite(further) & (bound + further > -np.inf))
    is_wished = np.bincount(owner[wished]) > 0
    mine = (np.cumsum(is_wished) - 1)[owner[wished]]
    k, m, more = len(rows), len(wished), int(is_wished.sum())
    # Variables: the weights, the slack, the amount by which each owner's wish is missed, and the change of the pace.
    dear = prices.duration * prices.pace
    square = np.concatenate(
        [np.ones(n), [1e-3], np.full(more, max(prices.wish * UNIT**2, 1e-6)), [settings.curved * dear or 1.0]]
    )
    linear = np.concatenate([gradient, [0.5 * prices.slack * UNIT], np.zeros(more), [0.5 * dear]])
    least = np.concatenate([bound, bound[wished] + further[wished]])
    of_row = np.concatenate([np.arange(k), wished])
    slack_of = np.concatenate([np.full(k, n), n + 1 + mine]).astype(int)

    matrix = np.zeros((0, len(square)))
    below = np.concatenate([np.full(n, -FREE), np.zeros(1 + more), [-prices.faster]])
    above, known = np.full(len(below), FREE), np.zeros(len(below))
    is_cut = np.zeros(len(below), dtype=bool)
    absent, free = np.ones(k + m, dtype=bool), np.ones(len(trust.moves), dtype=bool)
    near, beyond = np.flatnonzero(least > -settings.nearly), np.zeros(0, dtype=int)
    cut, limit = limits.cuts(np.zeros(n), 0.0, settings.active)
    programmes = 0
    for _ in range(settings.rounds):
        if over():
            return None
        programmes += 1
        block = np.zeros((len(near) + len(beyond) + len(cut), matrix.shape[1]))
        block[:, :n] = np.concatenate([rows[of_row[near]], trust.moves[beyond], cut]) @ whiten.T
        block[np.arange(len(near)), slack_of[near]] = UNIT
        block[len(block) - len(cut) :, -1] = prices.pace
        middle, radius = trust.center[beyond], trust.radius[beyond]
        free_above = np.full(len(near), FREE), middle + radius, np.full(len(cut), FREE)
        matrix = np.concatenate([matrix, block])
        below = np.concatenate([below, least[near], middle - radius, limit])
        above = np.concatenate([above, *free_above])
        known = np.concatenate([known, np.zeros(len(block))])
        is_cut = np.concatenate([is_cut, np.arange(len(block)) >= len(block) - len(cut)])
        absent[near], free[beyond] = False, False
        found = _solved(np.diag(square), linear, matrix, below, above, known)
        if found is None:
            return None
        x, known = found
        stays = ~is_cut | (known != 0.0)  # cuts that do not count now are made anew, elsewhere, where they do
        matrix, is_cut = matrix[stays[len(square) :]], is_cut[stays]
        below, above, known = below[stays], above[stays], known[stays]
        dz, slower = x[:n] @ whiten, prices.pace * float(x[-1])
        broken = np.where(absent, least - (rows @ dz)[of_row] - UNIT * x[slack_of], -1.0)
        near = _worst(broken, settings.few)
        too_far = np.where(free, np.abs(trust.moves @ dz - trust.center) / trust.radius - 1.0, -1.0)
        beyond = _worst(too_far, settings.few)
        cut, limit = limits.cuts(dz, slower, 1.0 + settings.excess)
        if not (len(near) or len(beyond) or len(cut)):
            break
    short = float(((x[n + 1 : n + 1 + more] * UNIT) ** 2).sum())
    return Minimum(x[:n], float(x[n]) * UNIT, short, slower, programmes)


def _worst(broken: Array, few: int) -> Integers:
    """Return the indices of violated rows, of at most the worst `few`."""
    at = np.flatnonzero(broken > BROKEN)
    return at if len(at) <= few else np.sort(at[np.argsort(-broken[at], kind="stable")[:few]])


def _solved(
    square: Array, linear: Array, matrix: Array, below: Array, above: Array, known: Array
) -> tuple[Array, Array] | None:
    """Solve a programme from `known` multipliers; return solution and multipliers. None without a solution."""
    for guess in (known, None) if known.any() else (None,):  # from a guess the solver may cycle
        x, _, flag, told = daqp.solve(
            square,
            linear,
            matrix,
            above,
            below,
            np.zeros(len(above), dtype=np.int32),
            dual_start=guess,
            primal_tol=1e-7,
            **PATIENCE,
        )
        if flag >= 1:
            return x, told["lam"]
    return None

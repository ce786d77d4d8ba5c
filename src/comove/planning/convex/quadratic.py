"""The quadratic programme of one step, solved with the few of its rows that matter.

Of hundreds of linearised clearances some ten are active in the end. So a programme begins with those that are nearly
active, and what its solution breaks is added until nothing is: the same solution, several times sooner.
"""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from comove.planning.convex.limits import ACTIVE, LinearLimits

Array = NDArray[np.float64]

FREE = 1e30  # what bounds nothing, as DAQP takes it
UNIT = 1e-3  # m, of the slack in a programme
NEARLY = 5e-3  # m, from which on a clearance takes part from the beginning
BROKEN = 1e-6  # m, by which one that takes no part may be missed; of the trust region as a share
FEW = 40  # of the worst that are added at once
ROUNDS = 30  # of adding
LIMIT_TOLERANCE = 1e-3  # of a limit, up to which it is linearised
CURVED = 1e-2  # of the cost of a pace, by which its model is bent, so that the programme has one solution


class Rows(NamedTuple):
    """Linearised clearances of a programme.

    Attributes
    ----------
    rows, bound : ``rows dz >= bound`` [m]
    owner : array of int, shape (n,), whom they keep away from
    further : array, shape (n,), by how much more is wished for [m]; -inf where nothing is
    """

    rows: Array
    bound: Array
    owner: NDArray[np.int64]
    further: Array

    def with_more(self, rows: Array, bound: Array, owner: NDArray[np.int64], further: Array) -> Rows:
        """These and others."""
        more = (rows, bound, owner, further)
        return Rows(*(np.concatenate(pair) for pair in zip(self, more, strict=True)))


class Trust(NamedTuple):
    """A region in which the model is trusted.

    Attributes
    ----------
    moves, center, radius : ``|moves dz - center| <= radius``
    """

    moves: Array
    center: Array
    radius: Array


class Prices(NamedTuple):
    """What it costs to miss something.

    Attributes
    ----------
    slack : of a metre that clearances are missed by
    wish : of the square of a metre by which an owner is nearer than wished for
    duration : of one more duration
    pace : in how many durations limits are kept so far
    faster : share of the pace that may be saved
    """

    slack: float
    wish: float
    duration: float
    pace: float
    faster: float


class Minimum(NamedTuple):
    """A solution.

    Attributes
    ----------
    w : array, shape (n,), the whitened weights
    slack : by how much clearances are missed at most [m]
    short : squared distances by which owners are nearer than wished for, summed [m^2]
    slower : by how much the pace grows, in durations
    """

    w: Array
    slack: float
    short: float
    slower: float


def minimum(
    gradient: Array, whiten: Array, clearances: Rows, trust: Trust, limits: LinearLimits, prices: Prices
) -> Minimum | None:
    """Minimise ``|w|^2 / 2 + gradient w`` and half the `prices` over ``dz = whiten' w``; None where that fails."""
    n = len(gradient)
    rows, bound, owner, further = clearances
    wished = np.flatnonzero(np.isfinite(further) & (bound + further > -np.inf))
    owners, mine = np.unique(owner[wished], return_inverse=True)
    k, m, more = len(rows), len(wished), len(owners)
    # Variables: the weights, the slack, what is missed of each owner's wish, and the change of the pace.
    dear = prices.duration * prices.pace
    square = np.concatenate(
        [np.ones(n), [1e-3], np.full(more, max(prices.wish * UNIT**2, 1e-6)), [CURVED * dear or 1.0]]
    )
    linear = np.concatenate([gradient, [0.5 * prices.slack * UNIT], np.zeros(more), [0.5 * dear]])
    least = np.concatenate([bound, bound[wished] + further[wished]])
    of_row = np.concatenate([np.arange(k), wished])
    slack_of = np.concatenate([np.full(k, n), n + 1 + mine]).astype(int)

    matrix = np.zeros((0, len(square)))
    below = np.concatenate([np.full(n, -FREE), np.zeros(1 + more), [-prices.faster]])
    above, known = np.full(len(below), FREE), np.zeros(len(below))
    absent, free = np.ones(k + m, dtype=bool), np.ones(len(trust.moves), dtype=bool)
    near, beyond = np.flatnonzero(least > -NEARLY), np.zeros(0, dtype=int)
    cut, limit = limits.cuts(np.zeros(n), 0.0, ACTIVE)
    for _ in range(ROUNDS):
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
        absent[near], free[beyond] = False, False
        found = _solved(np.diag(square), linear, matrix, below, above, known)
        if found is None:
            return None
        x, known = found
        dz, slower = x[:n] @ whiten, prices.pace * float(x[-1])
        broken = np.where(absent, least - (rows @ dz)[of_row] - UNIT * x[slack_of], -1.0)
        near = _worst(broken)
        beyond = _worst(np.where(free, np.abs(trust.moves @ dz - trust.center) / trust.radius - 1.0, -1.0))
        cut, limit = limits.cuts(dz, slower, 1.0 + LIMIT_TOLERANCE)
        if not (len(near) or len(beyond) or len(cut)):
            break
    short = float(((x[n + 1 : n + 1 + more] * UNIT) ** 2).sum())
    return Minimum(x[:n], float(x[n]) * UNIT, short, slower)


def _worst(broken: Array) -> NDArray[np.int64]:
    """Which are broken, the worst few of them."""
    at = np.flatnonzero(broken > BROKEN)
    return at if len(at) <= FEW else np.sort(at[np.argsort(-broken[at], kind="stable")[:FEW]])


def _solved(
    square: Array, linear: Array, matrix: Array, below: Array, above: Array, known: Array
) -> tuple[Array, Array] | None:
    """Solution and multipliers, from multipliers that are `known`; None where there is none."""
    for guess in (known, None) if known.any() else (None,):  # from a guess it may go round in circles
        x, _, flag, told = daqp.solve(
            square,
            linear,
            matrix,
            above,
            below,
            np.zeros(len(above), dtype=np.int32),
            dual_start=guess,
            primal_tol=1e-7,
            iter_limit=2000,
        )
        if flag >= 1:
            return x, told["lam"]
    return None

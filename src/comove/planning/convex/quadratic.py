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
from comove.compiled import copy_to, kernel
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
    n, rows = len(gradient), clearances.rows
    least, of_row, slack_of, more = _parted(clearances.bound, clearances.owner, clearances.further, n)
    # Variables: the weights, the slack, the amount by which each owner's wish is missed, and the change of the pace.
    square, linear, below, above = np.ones(n + more + 2), np.zeros(n + more + 2), *np.empty((2, n + more + 2))
    dear = prices.duration * prices.pace
    square[n], square[n + 1 : -1] = 1e-3, max(prices.wish * UNIT**2, 1e-6)
    square[-1], linear[-1] = settings.curved * dear or 1.0, 0.5 * dear
    linear[:n], linear[n] = gradient, 0.5 * prices.slack * UNIT
    below[:n], below[n:-1], below[-1], above[:] = -FREE, 0.0, -prices.faster, FREE
    hessian = np.diag(square)

    matrix, known, is_cut = np.zeros((0, len(square))), np.zeros(len(square)), np.zeros(0, dtype=bool)
    absent, free = np.ones(len(least), dtype=bool), np.ones(len(trust.moves), dtype=bool)
    near, beyond = np.flatnonzero(least > -settings.nearly), np.zeros(0, dtype=np.int64)
    cut, limit = limits.cuts(np.zeros(n), 0.0, settings.active)
    programmes = 0
    for _ in range(settings.rounds):
        if over():
            return None
        programmes += 1
        block = np.concatenate([rows[of_row[near]], trust.moves[beyond], cut]) @ whiten.T
        absent[near], free[beyond] = False, False
        # Cuts that do not count now are made anew, elsewhere, where they do.
        matrix, below, above, known, is_cut = _extended(
            matrix, below, above, known, is_cut, block, slack_of[near], least[near], len(beyond), prices.pace
        )
        fixed, added = len(square) + len(matrix) - len(block), len(near) + len(beyond)
        middle, radius = trust.center[beyond], trust.radius[beyond]
        below[fixed + len(near) : fixed + added] = middle - radius
        above[fixed + len(near) : fixed + added] = middle + radius
        below[fixed + added :] = limit
        found = _solved(hessian, linear, matrix, below, above, known)
        if found is None:
            return None
        x, known = found
        dz, slower = x[:n] @ whiten, prices.pace * float(x[-1])
        moved = (trust.moves @ dz - trust.center) / trust.radius
        near, beyond = _violated(absent, least, rows @ dz, of_row, slack_of, x, free, moved, settings.few)
        cut, limit = limits.cuts(dz, slower, 1.0 + settings.excess)
        if not (len(near) or len(beyond) or len(cut)):
            break
    short = float(((x[n + 1 : -1] * UNIT) ** 2).sum())
    return Minimum(x[:n], float(x[n]) * UNIT, short, slower, programmes)


@kernel
def _parted(bound, owner, further, n):
    """Return least values of clearances, their rows and slacks.

    Soft clearances follow the others; the number of their owners comes last. Variable n is the slack of all
    clearances; those of owners of soft clearances follow it.
    """
    k, n_owners = bound.shape[0], 0
    last, size = -1, k
    for i in range(k):
        last, size = max(last, owner[i]), size + (bound[i] + further[i] > -np.inf)
    own, least = np.zeros(last + 1, dtype=np.int64), np.empty(size)
    of_row, slack_of = np.empty(size, dtype=np.int64), np.empty(size, dtype=np.int64)
    for i in range(k):
        least[i], of_row[i], slack_of[i] = bound[i], i, n
        own[owner[i]] += bound[i] + further[i] > -np.inf
    for i in range(last + 1):
        if own[i] > 0:
            n_owners += 1
            own[i] = n + n_owners
    for i in range(bound.shape[0]):
        if bound[i] + further[i] > -np.inf:
            least[k], of_row[k], slack_of[k] = bound[i] + further[i], i, own[owner[i]]
            k += 1
    return least, of_row, slack_of, n_owners


@kernel
def _extended(matrix, below, above, known, is_cut, block, slack_of, least, n_beyond, pace):
    """Return a programme's rows without idle cuts, followed by others.

    Idle cuts have the multiplier 0. The last of the others are cuts. The bounds of their rows beyond the trust
    region and of their cuts are to be filled in.
    """
    n, n_near, kept = matrix.shape[1], slack_of.shape[0], 0
    for row in range(matrix.shape[0]):
        kept += not is_cut[row] or known[n + row] != 0.0
    total = kept + block.shape[0]
    rows, low, high = np.zeros((total, n)), np.empty(n + total), np.empty(n + total)
    multipliers, cuts, k = np.empty(n + total), np.empty(total, dtype=np.bool_), 0
    for i in range(n + matrix.shape[0]):
        if i < n or not is_cut[i - n] or known[i] != 0.0:
            low[k], high[k], multipliers[k] = below[i], above[i], known[i]
            if i >= n:
                copy_to(matrix[i - n], rows[k - n])
                cuts[k - n] = is_cut[i - n]
            k += 1
    for i in range(block.shape[0]):
        copy_to(block[i], rows[kept + i])
        high[k + i], multipliers[k + i], cuts[kept + i] = FREE, 0.0, i >= n_near + n_beyond
        if i < n_near:
            rows[kept + i, slack_of[i]], low[k + i] = UNIT, least[i]
        elif i >= n_near + n_beyond:
            rows[kept + i, n - 1] = pace
    return rows, low, high, multipliers, cuts


@kernel
def _violated(absent, least, reached, of_row, slack_of, x, free, ratio, few):
    """Return the most violated absent clearances and trust-region rows.

    Parameters
    ----------
    reached : values of all rows
    ratio : displacements, as shares of the radii of the trust region
    """
    broken, beyond = np.empty(least.shape[0]), np.empty(free.shape[0])
    for i in range(least.shape[0]):
        broken[i] = least[i] - reached[of_row[i]] - UNIT * x[slack_of[i]] if absent[i] else -1.0
    for i in range(free.shape[0]):
        beyond[i] = abs(ratio[i]) - 1.0 if free[i] else -1.0
    return _worst(broken, few), _worst(beyond, few)


@kernel
def _worst(broken, few):
    """Return the indices of violated rows, of at most the worst `few`."""
    is_worst, count = np.zeros(broken.shape[0], dtype=np.bool_), 0
    for i in range(broken.shape[0]):
        count += broken[i] > BROKEN
    for _ in range(few if count > few else 0):
        worst = -1
        for i in range(broken.shape[0]):
            if not is_worst[i] and broken[i] > BROKEN and (worst < 0 or broken[i] > broken[worst]):
                worst = i
        is_worst[worst] = True
    at, k = np.empty(min(count, few), dtype=np.int64), 0
    for i in range(broken.shape[0]):
        if is_worst[i] or (count <= few and broken[i] > BROKEN):
            at[k], k = i, k + 1
    return at


def _solved(
    hessian: Array, linear: Array, matrix: Array, below: Array, above: Array, known: Array
) -> tuple[Array, Array] | None:
    """Solve a programme from `known` multipliers; return solution and multipliers. None without a solution."""
    for guess in (known, None) if known.any() else (None,):  # from a guess the solver may cycle
        x, _, flag, told = daqp.solve(
            hessian,
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

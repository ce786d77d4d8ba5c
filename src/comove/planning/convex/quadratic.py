"""The quadratic programme of one step, solved with an active subset of its rows.

Of hundreds of linearised clearances some ten are active at the solution. So a programme begins with those that are
nearly active, and rows that its solution violates are added until there are none. This gives the same solution
several times faster. Limits of speed, acceleration and jerk are half-spaces that touch balls, anew where the solution
violates them; those that do not count any more are left out again. Where clearances are added to a programme that was
solved, it begins with the rows and the multipliers of the solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.planning.convex.limits import LinearLimits

FREE = 1e30  # infinite bound for DAQP
UNIT = 1e-3  # m, unit of the slack in a programme
# DAQP takes steps without progress for a cycle; beside the price of the slack in its dual objective, progress may be
# less than what rounding leaves. A programme of 600 variables may need more than 2000 steps, each adding one row.
PATIENCE = {"cycle_tol": 100, "iter_limit": 20_000}
CUT = np.iinfo(np.int64).min  # in place of the number of a row
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
    further : array, shape (n,), additional distance that is wished for [m]; -inf for no wish
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
    wish : cost of a square metre, for the squared distance by which an owner is nearer than wished for
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
    short : sum over owners of the squared distance by which each is nearer than wished for [m^2]
    slower : growth of the pace, in durations
    programmes : number of programmes that were solved, one for each set of rows
    """

    w: Array
    slack: float
    short: float
    slower: float
    programmes: int


class Programme:
    """The quadratic programme of a step, to which clearances can be added.

    It minimises ``|w|^2 / 2 + gradient w`` plus half of the `prices`, with ``dz = whiten' w``.
    """

    def __init__(
        self,
        gradient: Array,
        whiten: Array,
        trust: Trust,
        limits: LinearLimits,
        prices: Prices,
        settings: QuadraticSettings = SETTINGS,
    ):
        self.whiten, self.trust, self.limits = whiten, trust, limits
        self.prices, self.settings = prices, settings
        # Variables: the weights, the slack, the change of the pace, and by how much each owner's wish is missed.
        self._n, dear = len(gradient), prices.duration * prices.pace
        self._square = np.diag(np.append(np.ones(self._n), [1e-3, settings.curved * dear or 1.0]))
        self._linear = np.append(gradient, [0.5 * prices.slack * UNIT, 0.5 * dear])
        self._lowest = np.append(np.full(self._n, -FREE), [0.0, -prices.faster])
        self._wishes, self._solution = np.zeros(0, dtype=np.int64), np.zeros(0)
        # The rows, their bounds and multipliers, and their numbers: 2 i for a clearance, 2 i + 1 for the wish there,
        # -1 - i for the trust region.
        self._matrix, self._below, self._above = np.zeros((0, self._n + 2)), np.zeros(0), np.zeros(0)
        self._known, self._number = np.zeros(self._n + 2), np.zeros(0, dtype=np.int64)

    def minimum(self, clearances: Rows) -> Minimum | None:
        """Return the solution; None if that fails.

        Parameters
        ----------
        clearances : those of the last call, whose bounds may have changed, and any others
        """
        n, pace, none = self._n, self.prices.pace, np.zeros(0, dtype=np.int64)
        rows, bound, owner, further = clearances
        least = np.stack([bound, bound + further], axis=1)
        self._wish(owner[further > -np.inf])
        wish_of = np.zeros(owner.max(initial=0) + 1, dtype=np.int64)
        wish_of[self._wishes] = n + 2 + np.arange(len(self._wishes))
        missed_by = np.stack([np.full(len(rows), n), wish_of[owner]], axis=1)
        present = self._number >= 0
        self._below[present] = least.flat[self._number[present]]
        is_near, beyond = least.ravel() > -self.settings.nearly, none
        if len(self._solution):
            violated, beyond, cut, limit = self._violated(rows, least, missed_by)
            is_near[violated] = True
        else:
            cut, limit = self.limits.cuts(np.zeros(n), 0.0, self.settings.active)
        is_near[self._number[present]] = False
        near, programmes = is_near.nonzero()[0], 0
        for _ in range(self.settings.rounds):
            programmes += 1
            self._add(near, rows[near // 2], least.flat[near], FREE, missed_by.flat[near], UNIT)
            middle, radius = self.trust.center[beyond], self.trust.radius[beyond]
            self._add(-1 - beyond, self.trust.moves[beyond], middle - radius, middle + radius, none, 0.0)
            self._add(np.full(len(cut), CUT), cut, limit, FREE, np.full(len(cut), n + 1), pace)
            found = self._solved()
            if found is None:
                return None
            self._solution, self._known = found
            # Cuts that do not count now are made anew, elsewhere, where they do.
            self._keep((self._number != CUT) | (self._known[len(self._linear) :] != 0.0))
            near, beyond, cut, limit = self._violated(rows, least, missed_by)
            if not (len(near) or len(beyond) or len(cut)):
                break
        x = self._solution
        short = float(((x[n + 2 :] * UNIT) ** 2).sum())
        return Minimum(x[:n], float(x[n]) * UNIT, short, pace * float(x[n + 1]), programmes)

    def _wish(self, owners: Integers) -> None:
        """Add variables for the wishes of owners that had none."""
        is_new = np.bincount(owners, minlength=self._wishes.max(initial=-1) + 1) > 0
        is_new[self._wishes] = False
        new, before = np.flatnonzero(is_new), len(self._linear)
        if not len(new):
            return
        none, now, matrix = np.zeros(len(new)), before + len(new), self._matrix
        square = np.zeros((now, now))
        square[:before, :before] = self._square
        square.flat[before * (now + 1) :: now + 1] = max(self.prices.wish * UNIT**2, 1e-6)
        self._square, self._wishes = square, np.concatenate([self._wishes, new])
        self._linear, self._lowest = (np.concatenate([one, none]) for one in (self._linear, self._lowest))
        self._matrix = np.concatenate([matrix, np.zeros((len(matrix), len(new)))], axis=1)
        self._known = np.concatenate([self._known[:before], none, self._known[before:]])
        if len(self._solution):
            self._solution = np.concatenate([self._solution, none])

    def _add(
        self, number: Integers, rows: Array, below: Array, above: Array | float, variable: Integers, by: float
    ) -> None:
        """Add rows, each with a variable besides the weights."""
        if not len(number):
            return
        block = np.zeros((len(rows), self._matrix.shape[1]))
        block[:, : self._n] = rows @ self.whiten.T
        if len(variable):
            block[np.arange(len(rows)), variable] = by
        self._matrix = np.concatenate([self._matrix, block])
        self._number = np.concatenate([self._number, number])
        self._below = np.concatenate([self._below, below])
        self._above = np.concatenate([self._above, np.broadcast_to(above, len(rows))])
        self._known = np.concatenate([self._known, np.zeros(len(rows))])

    def _keep(self, kept: NDArray[np.bool_]) -> None:
        """Leave out all other rows."""
        if kept.all():
            return
        n = len(self._linear)
        self._matrix, self._number = self._matrix[kept], self._number[kept]
        self._below, self._above = self._below[kept], self._above[kept]
        self._known = np.concatenate([self._known[:n], self._known[n:][kept]])

    def _violated(
        self, rows: Array, least: Array, missed_by: Integers
    ) -> tuple[Integers, Integers, Array, Array]:
        """Return clearances and parts of the trust region that the solution violates, and cuts that exclude it.

        Parameters
        ----------
        least, missed_by : arrays, shape (n, 2), bounds of each clearance and of the wish there, and their variables
        """
        n, x = self._n, self._solution
        dz, slower = x[:n] @ self.whiten, self.prices.pace * float(x[n + 1])
        broken = (least - (rows @ dz)[:, None] - UNIT * x[missed_by]).ravel()
        broken[self._number[self._number >= 0]] = -1.0
        too_far = np.abs(self.trust.moves @ dz - self.trust.center) / self.trust.radius - 1.0
        too_far[-1 - self._number[(self._number < 0) & (self._number != CUT)]] = -1.0
        few = self.settings.few
        return (
            _worst(broken, few),
            _worst(too_far, few),
            *self.limits.cuts(dz, slower, 1.0 + self.settings.excess),
        )

    def _solved(self) -> tuple[Array, Array] | None:
        """Return solution and multipliers, None if there is no solution."""
        above = np.concatenate([np.full(len(self._linear), FREE), self._above])
        below, kinds = np.concatenate([self._lowest, self._below]), np.zeros(len(above), dtype=np.int32)
        guesses = (self._known, None) if self._known.any() else (None,)  # from a guess the solver may cycle
        for guess in guesses:
            x, _, flag, told = daqp.solve(
                self._square,
                self._linear,
                self._matrix,
                above,
                below,
                kinds,
                dual_start=guess,
                primal_tol=1e-7,
                **PATIENCE,
            )
            if flag >= 1:
                return x, told["lam"]
        return None


def _worst(broken: Array, few: int) -> Integers:
    """Return the indices of violated rows; of the worst `few` if there are more."""
    at = (broken > BROKEN).nonzero()[0]
    return at if len(at) <= few else np.sort(at[np.argsort(-broken[at], kind="stable")[:few]])

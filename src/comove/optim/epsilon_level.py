"""CMA-ES with epsilon-level ranking and repair by the constraints' Jacobian.

Two points whose violation is at most epsilon are compared by their objective, all others by their violation, and
epsilon falls to zero (Takahama and Sakai, 2006). Some infeasible samples are repaired by Gauss-Newton steps
x <- x - J^+ v of the violations v (Chootinan and Chen, 2006; with matrix adaptation: Hellwig and Beyer, 2018). The
Jacobian J does not need finite differences: it is learned from the samples, which are evaluated in any case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.optim.cmaes import check_number, check_whole
from comove.optim.method import OptimiserRun, Request, Start
from comove.optim.models import LinearModel


@dataclass(frozen=True)
class EpsilonLevel:
    """Epsilon-level ranking with repair: robust for rough constraints, else slower than the Lagrangian.

    Attributes
    ----------
    quantile : quantile of the first generation's violations that gives the first epsilon
    horizon : generations after which epsilon is zero
    repaired : share of the infeasible samples that are repaired, in every generation
    repeats : number of Gauss-Newton steps of a repair

    Raises
    ------
    OptionError
        If a number is out of range.
    """

    quantile: float = 0.2
    horizon: int = 200
    repaired: float = 0.2
    repeats: int = 3

    def __post_init__(self) -> None:
        for name in ("quantile", "repaired"):
            check_number(name, getattr(self, name), 0.0, 1.0)
        check_whole("horizon", self.horizon, 1)
        check_whole("repeats", self.repeats, 0)

    def start(self, start: Start) -> EpsilonLevelRun:
        """Return a new run of the method."""
        return EpsilonLevelRun(self, start)


class EpsilonLevelRun(OptimiserRun):
    """One run of `EpsilonLevel`. Each generation: constraints, repairs, then the objective.

    Attributes
    ----------
    epsilon : violation up to which a point counts as feasible
    """

    def __init__(self, settings: EpsilonLevel, start: Start) -> None:
        super().__init__(start)
        n, m = len(start.x), len(start.equality)
        self.settings = settings
        self._model = LinearModel(n, m, capacity=max(3 * n + 2, self._es.parameters.population))
        self.epsilon = np.inf
        self._next()

    def _sample(self) -> None:
        self._x = self._start.inside(self._es.ask())
        self._values = np.full((len(self._x), len(self._start.equality)), np.nan)
        self._open, self._repeat = np.arange(len(self._x)), 0
        self._wait(Request(self._x, constraints=True), self._constraints_told)

    def _constraints_told(self, _: Array | None, constraints: Array) -> None:
        self._model.add(self.ask().x, constraints)
        better = self._repeat == 0 or self._total(constraints) < self._total(self._values[self._open])
        accepted = np.flatnonzero(np.broadcast_to(better, len(self._open)))
        self._x[self._open[accepted]] = self.ask().x[accepted]
        self._values[self._open[accepted]] = constraints[accepted]
        if self._repeat == 0:
            self._slope = self._jacobian()
            if not np.isfinite(self.epsilon):
                totals = self._total(self._values)
                finite = totals[np.isfinite(totals)]
                self._first = float(np.quantile(finite, self.settings.quantile)) if len(finite) else np.inf
                self.epsilon = self._first
            infeasible = np.flatnonzero(self._total(self._values) > 0)
            self._open = infeasible[self._es.rng.random(len(infeasible)) < self.settings.repaired]
        else:
            self._open = self._open[self._total(self._values[self._open]) > 0]
        self._open = self._open[np.isfinite(self._values[self._open]).all(axis=1)]
        if self._repeat < self.settings.repeats and len(self._open) and self._slope is not None:
            self._repeat += 1
            missed = self._start.violation(self._values[self._open])
            signed = np.where(self._start.equality, np.sign(self._values[self._open]) * missed, missed)
            points = self._start.inside(self._x[self._open] - corrections(self._slope, signed))
            self._wait(Request(points, constraints=True), self._constraints_told)
        else:
            self._wait(Request(self._x, objective=True, known=self._values), self._objective_told)

    def _jacobian(self) -> Array | None:
        """Return the constraints' slopes in x, shape (m, n), or None. There must be three points at least."""
        if len(self._model) < 3:
            return None
        local = self._model.around_mean(self._es)
        return local.slope @ self._shape.inverse_root / self._es.sigma

    def _total(self, constraints: Array) -> Array:
        return self._start.violation(constraints).sum(axis=1)

    def _objective_told(self, objective: Array, _: Array | None) -> None:
        es = self._es
        violation = self._total(self._values)
        objective = np.where(np.isnan(objective), np.inf, objective)
        allowed = (violation <= self.epsilon) & np.isfinite(objective)
        order = np.lexsort((objective, np.where(allowed, 0.0, violation), ~allowed))
        for i in np.flatnonzero((self._x != es.mean + es.sigma * es.y).any(axis=1)):
            es.inject(int(i), self._x[i])
        es.tell(np.argsort(order).astype(float))  # ranks
        left = max(0.0, 1.0 - es.generation / self.settings.horizon)
        self.epsilon = self._first * left**3 if left > 0 else 0.0
        self._end_generation(np.where(allowed, objective, np.inf))


def corrections(slope: Array, missed: Array) -> Array:
    """Compute J^+ v per row of violations; array, shape (n_points, n). J has the violated constraints only.

    Parameters
    ----------
    slope : array, shape (m, n), slopes of all constraints
    missed : array, shape (n_points, m), signed violations, 0 where a constraint is met
    """
    masked = slope[None] * (missed != 0)[:, :, None]
    square = masked.transpose(0, 2, 1) @ masked  # n by n, however many constraints there are
    pulled = masked.transpose(0, 2, 1) @ missed[:, :, None]
    return (np.linalg.pinv(square, rcond=1e-12, hermitian=True) @ pulled)[:, :, 0]

"""The evaluations of a search: their numbers, the best point among them, and its improvements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.errors import OptionError

SIGN = "h <= 0 is feasible"


@dataclass(frozen=True, eq=False)
class BestPoint:
    """The best point: feasible before infeasible, then the lower objective or violation.

    Attributes
    ----------
    x : array, shape (n,)
    fun : objective at `x`; NaN if it was not evaluated there
    violation : sum of all violations at `x`
    """

    x: Array
    fun: float = np.nan
    violation: float = np.inf

    @property
    def feasible_fun(self) -> float:
        """Return the objective of a feasible point; NaN of another."""
        return self.fun if self.violation == 0.0 else np.nan

    def among(self, x: Array, objective: Array, violation: Array) -> BestPoint:
        """Return the best of this point and others; arrays, shapes (n_points, n), (n_points,), (n_points,)."""
        known = not np.isnan(self.feasible_fun)
        better = (violation == 0.0) & (objective < self.fun if known else np.isfinite(objective))
        if better.any():
            i = int(np.argmin(np.where(better, objective, np.inf)))
        elif known or not violation.min() < self.violation:
            return self
        else:
            i = int(np.argmin(violation))
        return BestPoint(x[i].copy(), float(objective[i]), float(violation[i]))


class Evaluations:
    """What was evaluated so far.

    Attributes
    ----------
    best : the best point
    n_objective, n_constraint : numbers of evaluations
    improvements : a row for every improvement of the best point, as `Result.history`
    finite_objective, finite_constraints : whether any value was finite
    """

    def __init__(self, best: BestPoint) -> None:
        self.best = best
        self.n_objective = self.n_constraint = 0
        self.improvements: list[tuple[float, ...]] = []
        self.finite_objective = self.finite_constraints = False

    @property
    def spent(self) -> int:
        """Return the larger of both numbers of evaluations."""
        return max(self.n_objective, self.n_constraint)

    def count(self, objective: Array | None, constraints: Array | None) -> None:
        """Count new evaluations; arrays, shapes (n_points,) and (n_points, m)."""
        if objective is not None:
            self.n_objective += len(objective)
            self.finite_objective |= bool(np.isfinite(objective).any())
        if constraints is not None:
            self.n_constraint += len(constraints) * (constraints.shape[1] > 0)
            self.finite_constraints |= bool(np.isfinite(constraints).all(axis=1).any())

    def compare(self, x: Array, objective: Array | None, violation: Array) -> None:
        """Keep the best of all points; arrays, shapes (n_points, n), (n_points,) and (n_points,)."""
        values = np.full(len(x), np.nan) if objective is None else objective
        best = self.best.among(x, values, violation)
        if best is not self.best:
            self.best = best
            self.improvements.append((self.n_objective, self.n_constraint, best.fun, best.violation))

    def check_finite(self) -> None:
        """Raise `OptionError` if no value was ever finite."""
        if self.n_constraint and not self.finite_constraints:
            raise OptionError(
                f"no constraint value of {self.n_constraint} points was finite ({SIGN})",
                key="constraints",
                way_out="start where they are defined",
            )
        if self.n_objective and not self.finite_objective:
            raise OptionError(
                f"no objective value of {self.n_objective} points was finite",
                key="objective",
                way_out="start where it is defined",
            )

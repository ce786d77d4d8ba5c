"""What a method of constrained minimisation is: it starts runs, and runs ask and are told."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from comove.optimisers.reasons import Reason

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Request:
    """Points at which something is to be evaluated.

    Attributes
    ----------
    x : array, shape (n_points, n)
    objective, constraints : what is wanted at these points
    known : constraint values at these points where they are known already; array, shape (n_points, m)
    """

    x: Array
    objective: bool = False
    constraints: bool = False
    known: Array | None = None


@dataclass(frozen=True)
class Start:
    """What a run is given.

    Attributes
    ----------
    x : first mean; array, shape (n,)
    sigma : first step size
    rng : source of all random numbers of the run
    equality : which constraints are equalities; array of bool, shape (m,)
    tolerance : by which an equality may be missed
    lower, upper : bounds of x, infinite where there are none; arrays, shape (n,)
    population : samples a generation, None for the method's own
    failures : runs before this one that diverged
    """

    x: Array
    sigma: float
    rng: np.random.Generator
    equality: NDArray[np.bool_]
    tolerance: float
    lower: Array
    upper: Array
    population: int | None = None
    failures: int = 0

    @property
    def bounded(self) -> bool:
        """Whether any variable has a bound."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    def violation(self, constraints: Array) -> Array:
        """How far each constraint is missed, NaN counted as infinitely; arrays, shape (.., m)."""
        missed = np.where(self.equality, np.abs(constraints) - self.tolerance, constraints)
        return np.where(np.isnan(missed), np.inf, np.maximum(missed, 0.0))


class OptimiserRun(Protocol):
    """One run of a method, from a start to a reason to end; may be copied and pickled at any time."""

    reason: Reason | None

    def ask(self) -> Request:
        """What to evaluate next; asking twice gives the same."""

    def tell(self, objective: Array | None, constraints: Array | None) -> None:
        """Values at the points of the last request; arrays, shapes (n_points,) and (n_points, m)."""


class ConstrainedMethod(Protocol):
    """A way to minimise under constraints: a frozen description that starts runs."""

    def start(self, start: Start) -> OptimiserRun:
        """Begin a run."""


@dataclass
class Patience:
    """Rules by which a run ends, watched over the generations.

    Attributes
    ----------
    sigma : first step size
    window : generations over which the spread must shrink
    smallest_step : relative to the first step size
    smallest_spread : of the values of a generation
    """

    sigma: float
    window: int
    smallest_step: float = 1e-12
    smallest_spread: float = 1e-12
    spreads: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, start: Start, population: int, times: float = 1.0) -> Patience:
        """The rules for a run: more generations where there are more variables than samples, `times` the usual."""
        return cls(start.sigma, window=int(times * (100 + 50 * len(start.x) / population)))

    def reason(self, deviations: Array, axis_ratio: float, values: Array) -> Reason | None:
        """Whether to end after a generation with these values, array of shape (population,)."""
        finite = values[np.isfinite(values)]
        if len(finite) > 1:
            low, high = np.quantile(finite, [0.25, 0.75])
            self.spreads.append(float(high - low))
        else:
            self.spreads.append(np.inf)
        del self.spreads[: -3 * self.window]
        recent = self.spreads[-(10 + self.window // 4) :]
        if deviations.max() < self.smallest_step * self.sigma:
            return Reason.CONVERGED
        rounding = 1e-15 * (np.abs(finite).max() if len(finite) else 0.0)
        if len(recent) >= 10 + self.window // 4 and max(recent) < max(self.smallest_spread, rounding):
            return Reason.CONVERGED
        if axis_ratio > 1e7:
            return Reason.ILL_CONDITIONED
        if len(self.spreads) == 3 * self.window:
            first, second, third = np.median(np.reshape(self.spreads, (3, self.window)), axis=1)
            if third >= max(first, second):
                return Reason.STAGNATED
        return None

"""The interface of methods of constrained minimisation: a method starts runs, and a run is asked and told."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from comove.optimisers.reasons import Reason

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Request:
    """Points that are to be evaluated.

    Attributes
    ----------
    x : array, shape (n_points, n)
    objective, constraints : whether the objective and the constraints are to be evaluated
    known : constraint values at these points if they are known already; array, shape (n_points, m)
    """

    x: Array
    objective: bool = False
    constraints: bool = False
    known: Array | None = None


@dataclass(frozen=True)
class Start:
    """Holds the input of a run.

    Attributes
    ----------
    x : first mean; array, shape (n,)
    sigma : first step size
    rng : source of all random numbers of the run
    equality : which constraints are equalities; array of bool, shape (m,)
    tolerance : largest absolute value of an equality that counts as met
    lower, upper : bounds of x, infinite where there are none; arrays, shape (n,)
    population : samples per generation, None for the method's own
    failures : number of earlier runs that diverged
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
        """Return whether any variable has a bound."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    def violation(self, constraints: Array) -> Array:
        """Return the violation of each constraint, infinite for NaN; arrays, shape (.., m)."""
        missed = np.where(self.equality, np.abs(constraints) - self.tolerance, constraints)
        return np.where(np.isnan(missed), np.inf, np.maximum(missed, 0.0))


class OptimiserRun(Protocol):
    """One run of a method, from its start until it has a reason to end; may be copied and pickled at any time."""

    reason: Reason | None

    def ask(self) -> Request:
        """Return the next request for evaluations; repeated calls return the same request."""

    def tell(self, objective: Array | None, constraints: Array | None) -> None:
        """Receive the values at the points of the last request; arrays, shapes (n_points,) and (n_points, m)."""


class ConstrainedMethod(Protocol):
    """A method of constrained minimisation: a frozen description that starts runs."""

    def start(self, start: Start) -> OptimiserRun:
        """Return a new run of the method."""


@dataclass
class Patience:
    """Rules that end a run, checked after every generation.

    Attributes
    ----------
    sigma : first step size
    window : number of generations over which the spread must shrink
    smallest_step : smallest step size relative to the first
    smallest_spread : smallest spread of the values of a generation
    """

    sigma: float
    window: int
    smallest_step: float = 1e-12
    smallest_spread: float = 1e-12
    spreads: list[float] = field(default_factory=list)

    @classmethod
    def of(cls, start: Start, population: int, times: float = 1.0) -> Patience:
        """Return the rules for a run; the window grows with variables per sample, and by the factor `times`."""
        return cls(start.sigma, window=int(times * (100 + 50 * len(start.x) / population)))

    def reason(self, deviations: Array, axis_ratio: float, values: Array) -> Reason | None:
        """Return the reason to end after a generation with these values, array of shape (population,), or None."""
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

"""Base classes of constrained minimisation: methods, and runs asked and told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.optim.cmaes import CMAES, Covariance, FullCovariance, Parameters

VALUELESS = 10  # generations in a row without any value, after which a run ends


class Reason(Enum):
    """The reason for the end of a run or search. The value describes it and gives advice."""

    CONVERGED = (
        "the steps or the differences between samples are below the tolerance; restarts may find better"
    )
    STAGNATED = "the samples' spread no longer shrinks; give a larger population or restarts"
    ILL_CONDITIONED = "the longest axis is 1e14 times the shortest in variance; rescale the variables"
    DIVERGED = "penalties outgrew the objective; give a smaller sigma0 or a feasible x0"
    STALLED = "resampling found no feasible samples; widen the bands, give a feasible x0 or another method"
    NOT_POSITIVE_DEFINITE = "the printed update lost positive definiteness; use another form"
    NOT_FINITE = "too few finite values; start where the objective and all constraints are finite"
    TARGET = "the target was reached"
    EVALUATIONS = "the evaluations are used up; give more, or a smaller sigma0 to begin nearer"
    SECONDS = "the time is used up; give more"
    CALLBACK = "the callback asked to stop"


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
    """The input of a run.

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
    covariance : first covariance in units of sigma^2; array, shape (n, n), None for the identity
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
    covariance: Array | None = None

    @property
    def bounded(self) -> bool:
        """Return whether any variable has a bound."""
        return bool(np.isfinite(self.lower).any() or np.isfinite(self.upper).any())

    def inside(self, x: Array) -> Array:
        """Return the points within the bounds nearest to x; arrays, shape (n_points, n)."""
        return np.clip(x, self.lower, self.upper)

    def violation(self, constraints: Array) -> Array:
        """Return the violation of each constraint, infinite for NaN; arrays, shape (.., m)."""
        missed = np.where(self.equality, np.abs(constraints) - self.tolerance, constraints)
        return np.where(np.isnan(missed), np.inf, np.maximum(missed, 0.0))


class AskAndTell:
    """A process that requests values and is told them. It may be copied and pickled at any time."""

    _request: Request | None = None
    _then: Callable[[Any, Any], None]  # each takes what its request asked for

    def ask(self) -> Request:
        """Return the next request for evaluations; repeated calls return the same request."""
        if self._request is None:
            self._sample()
        assert self._request is not None
        return self._request

    def _sample(self) -> None:
        raise NotImplementedError

    def tell(self, objective: Array | None, constraints: Array | None) -> None:
        """Process the values at the requested points; shapes (n_points,), (n_points, m)."""
        self._then(objective, constraints)

    def _wait(self, request: Request, then: Callable[[Any, Any], None]) -> None:
        self._request, self._then = request, then

    def _next(self) -> None:
        self._request = None


class OptimiserRun(AskAndTell):
    """One run of CMA-ES under a method, until a reason to end.

    Parameters
    ----------
    start : input of the run
    parameters : constants of CMA-ES; by default Hansen's with negative weights of bad samples
    covariance : model of the distribution's shape; by default a `FullCovariance`
    patience : factor on the number of generations without progress after which the run has stagnated
    """

    def __init__(
        self,
        start: Start,
        parameters: Parameters | None = None,
        covariance: Covariance | None = None,
        patience: float = 1.0,
    ) -> None:
        n = len(start.x)
        self.reason: Reason | None = None
        self._start = start
        parameters = parameters or Parameters.default(n, start.population, active=True)
        covariance = FullCovariance(n, start.covariance) if covariance is None else covariance
        self._es = CMAES(start.x, start.sigma, start.rng, parameters=parameters, covariance=covariance)
        # The window grows with the number of variables per sample.
        self._patience = Patience(start.sigma, int(patience * (100 + 50 * n / parameters.population)))

    @property
    def _shape(self) -> FullCovariance:
        assert isinstance(self._es.covariance, FullCovariance)
        return self._es.covariance

    @property
    def distribution(self) -> tuple[Array, float, Array]:
        """Return mean, step size and covariance of the samples; shapes (n,), (), (n, n)."""
        return self._es.mean, self._es.sigma, self._es.covariance.as_matrix()

    @property
    def guests(self) -> Array:
        """Return the points that wait for a generation; array, shape (n_points, n)."""
        return self._es.guests

    def invite(self, points: Array) -> None:
        """Replace samples of the next generations by points, (n_points, n)."""
        self._es.invite(points)

    def _teaches(self, known: bool) -> bool:
        """Return whether values are finite; otherwise draw the generation again."""
        if self._patience.is_spent(known):
            self.reason = Reason.NOT_FINITE
        elif not known:
            self._next()
        return known

    def _end_generation(self, values: Array) -> None:
        """Begin the next generation unless there is a reason to end."""
        es = self._es
        self.reason = self._patience.reason(es.standard_deviations(), es.covariance.axis_ratio(), values)
        if self.reason is None:
            self._next()


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
    spreads : those of the latest generations
    valueless : number of generations in a row without any value
    """

    sigma: float
    window: int
    smallest_step: float = 1e-12
    smallest_spread: float = 1e-12
    spreads: list[float] = field(default_factory=list)
    valueless: int = 0

    def is_spent(self, known: bool) -> bool:
        """Return whether too many generations in a row had no value.

        Parameters
        ----------
        known : whether the last one had one
        """
        self.valueless = 0 if known else self.valueless + 1
        return self.valueless >= VALUELESS

    def reason(self, deviations: Array, axis_ratio: float, values: Array) -> Reason | None:
        """Return the reason to end after values, shape (population,), or None."""
        finite = values[np.isfinite(values)]
        self.spreads.append(spread(finite) if len(finite) > 1 else np.inf)
        del self.spreads[: -3 * self.window]
        recent = self.spreads[-(10 + self.window // 4) :]
        if deviations.max() < self.smallest_step * self.sigma:
            return Reason.CONVERGED
        rounding = 1e-15 * (np.median(np.abs(finite)) if len(finite) else 0.0)
        if len(recent) >= 10 + self.window // 4 and max(recent) < max(self.smallest_spread, rounding):
            return Reason.CONVERGED
        if axis_ratio > 1e7:
            return Reason.ILL_CONDITIONED
        if len(self.spreads) == 3 * self.window:
            first, second, third = np.median(np.reshape(self.spreads, (3, self.window)), axis=1)
            if third >= max(first, second):
                return Reason.STAGNATED
        return None


def spread(values: Array) -> float:
    """Return the distance between the quartiles of finite values."""
    low, high = np.quantile(values, [0.25, 0.75])
    return float(high - low)

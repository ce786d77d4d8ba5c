"""A whole search with an ask-and-tell interface: runs of a method, restarts, and the best point."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError
from comove.optimisers.augmented_lagrangian import AugmentedLagrangian
from comove.optimisers.cmaes import check_start
from comove.optimisers.method import ConstrainedMethod, OptimiserRun, Request, Start
from comove.optimisers.parameters import default_population
from comove.optimisers.reasons import Reason
from comove.optimisers.restarts import BIPOP, Ended, Restarts, Setting
from comove.optimisers.restoration import Restoration
from comove.optimisers.simple import Plain

Array = NDArray[np.float64]

SIGN = "h <= 0 is feasible"
SPREAD = 2.0  # step sizes around x0 in which restarts without bounds begin
HUGE = 1e100  # finite values beyond are told to methods as this: products of them would overflow


@dataclass(frozen=True)
class Result:
    """Holds the result of a search.

    Attributes
    ----------
    x : the best point with every h <= 0 (equalities within their tolerance) ever seen, otherwise the least
        violated; array, shape (n,)
    fun : objective at `x`; NaN if it was not evaluated there
    violation : sum of all violations at `x`; 0 for a feasible point
    n_objective, n_constraint : numbers of evaluations
    history : a row for every improvement of the best point: evaluations of objective and constraints, objective,
        violation; array, shape (n_improvements, 4)
    reason : reason for the end of the search
    """

    x: Array
    fun: float
    violation: float
    n_objective: int
    n_constraint: int
    history: Array
    reason: Reason

    @property
    def feasible(self) -> bool:
        """Return whether every constraint is met."""
        return self.violation == 0.0


class Minimiser:
    """A constrained minimiser that asks for values and is told them.

    Copies and pickles continue with exactly the same samples.

    Parameters
    ----------
    x0 : array, shape (n,)
        First mean.
    sigma0 : float
        First step size: the optimum should lie within a few steps.
    n_constraints : int
        Number of constraints h; h <= 0 is feasible.
    equality : array of bool, shape (n_constraints,)
        Which of them are equalities, h = 0; none by default.
    tolerance : float
        Largest absolute value of an equality that counts as met.
    bounds : pair of arrays, each of shape (n,) or a number
        Lowest and highest x; no point outside is ever requested.
    method : ConstrainedMethod
        By default an `AugmentedLagrangian` if there are constraints, otherwise `Plain`.
    restarts : Restarts
        Rule of restarts; by default `BIPOP`.
    population : int
        Samples per generation of the first run; by default the method's own number.
    seed : int
        Seed of all random numbers.

    Raises
    ------
    OptionError
        If an argument is out of range or shapes do not match.
    """

    def __init__(
        self,
        x0: Array,
        sigma0: float,
        *,
        n_constraints: int = 0,
        equality: object = None,
        tolerance: float = 1e-4,
        bounds: tuple[object, object] | None = None,
        method: ConstrainedMethod | None = None,
        restarts: Restarts | None = None,
        population: int | None = None,
        seed: int = 0,
    ):
        self._x0, self._sigma0 = check_start(x0, sigma0)
        n = len(self._x0)
        self._lower, self._upper = checked_bounds(bounds, n)
        self._equality = _checked_mask(equality, n_constraints)
        if not 0 <= tolerance < np.inf:
            raise OptionError(f"tolerance = {tolerance!r}", way_out="give a number, 0 or more")
        _check_whole("seed", seed, 0)
        if population is not None:
            _check_whole("population", population, 2)
        for key, part, needed in (("method", method, "start"), ("restarts", restarts, "following")):
            if part is not None and (isinstance(part, type) or not hasattr(part, needed)):
                raise OptionError(
                    f"{part!r} is none", key=key, way_out="give an object, such as CCMAES() or BIPOP()"
                )
        self._tolerance, self._seed = float(tolerance), int(seed)
        self._method = method or (AugmentedLagrangian() if n_constraints else Plain())
        self._restarts = restarts or BIPOP()
        self._choices = np.random.default_rng([self._seed, 0])
        self.n_objective = self.n_constraint = 0
        self.reason: Reason | None = None
        self._best_x, self._best_fun, self._least_violation = self._x0, np.nan, np.inf
        self._history: list[tuple[float, ...]] = []
        self._finite_objective = self._finite_constraints = False
        self._ended: list[Ended] = []
        self._failures = 0
        self._begin(Setting(population), np.clip(self._x0, self._lower, self._upper))

    def ask(self) -> Request:
        """Return the next request for evaluations."""
        return (self._restoration or self._run).ask()

    def tell(self, objective: Array | None = None, constraints: Array | None = None) -> None:
        """Receive the values at the points of the last request.

        Parameters
        ----------
        objective
            Values if the objective was requested; array, shape (n_points,).
        constraints
            Values if the constraints were requested; array, shape (n_points, n_constraints); <= 0 is feasible.

        Raises
        ------
        OptionError
            If requested values are missing or have another shape.
        """
        request = self.ask()
        n_points = len(request.x)
        if request.objective:
            objective = _checked_values(objective, (n_points,), "objective")
            self.n_objective += n_points
        if request.constraints:
            constraints = _checked_values(constraints, (n_points, len(self._equality)), "constraints")
            self.n_constraint += n_points * (len(self._equality) > 0)
        self._remember(request, objective, constraints)
        objective = _moderate(objective) if request.objective else None
        constraints = _moderate(constraints) if request.constraints else None
        if self._restoration is not None:
            self._restoration.tell(None, constraints)
            if self._restoration.done:
                self._start_run(self._restoration.x)
            return
        self._run.tell(objective, constraints)
        if self._run.reason is not None:
            self._end_run(self._run.reason)

    @property
    def best_fun(self) -> float:
        """Return the objective of the best feasible point; NaN if there is none."""
        return self._best_fun if self._least_violation == 0.0 else np.nan

    def result(self, reason: Reason | None = None) -> Result:
        """Return the result so far."""
        return Result(
            x=self._best_x.copy(),
            fun=self._best_fun,
            violation=float(self._least_violation),
            n_objective=self.n_objective,
            n_constraint=self.n_constraint,
            history=np.array(self._history).reshape(-1, 4),
            reason=reason or self.reason or Reason.CALLBACK,
        )

    def _begin(self, setting: Setting, x: Array) -> None:
        self._setting, self._cost = setting, max(self.n_objective, self.n_constraint)
        self._restoration: Restoration | None = None
        self._begun = Start(
            x=x,
            sigma=self._sigma0 * setting.sigma,
            rng=np.random.default_rng([self._seed, 1, len(self._ended)]),
            equality=self._equality,
            tolerance=self._tolerance,
            lower=self._lower,
            upper=self._upper,
            population=setting.population,
            failures=self._failures,
        )
        if len(self._equality):
            self._restoration = Restoration(self._begun)
        else:
            self._start_run(x)

    def _start_run(self, x: Array) -> None:
        self._restoration = None
        self._run: OptimiserRun = self._method.start(replace(self._begun, x=x))

    def check_finite(self) -> None:
        """Raise `OptionError` if values were told and none of them was ever finite."""
        if self.n_constraint and not self._finite_constraints:
            raise OptionError(
                f"no constraint value of {self.n_constraint} points was finite ({SIGN})",
                key="constraints",
                way_out="start where they are defined",
            )
        if self.n_objective and not self._finite_objective:
            raise OptionError(
                f"no objective value of {self.n_objective} points was finite",
                key="objective",
                way_out="start where it is defined",
            )

    def _end_run(self, reason: Reason) -> None:
        """Restart from another point, or end the search."""
        self.check_finite()
        self._failures += reason is Reason.DIVERGED
        population = self._setting.population or default_population(len(self._x0))
        cost = max(self.n_objective, self.n_constraint) - self._cost
        self._ended.append(Ended(self._setting, population, cost))
        following = self._restarts.following(self._ended, self._choices)
        if following is None:
            self.reason = reason
            return
        normal = self._choices.standard_normal(len(self._x0))
        uniform = self._choices.random(len(self._x0))
        with np.errstate(invalid="ignore"):
            x = np.where(
                np.isfinite(self._lower) & np.isfinite(self._upper),
                self._lower + uniform * (self._upper - self._lower),
                self._x0 + SPREAD * self._sigma0 * normal,
            )
        self._begin(following, np.clip(x, self._lower, self._upper))

    def _remember(self, request: Request, objective: Array | None, constraints: Array | None) -> None:
        """Keep the best point: feasible before infeasible, then the lower objective or violation."""
        h = constraints if request.constraints else request.known
        violation = np.zeros(len(request.x)) if h is None else self._begun.violation(h).sum(axis=1)
        values = objective if request.objective else np.full(len(request.x), np.nan)
        self._finite_objective |= bool(np.isfinite(values).any())
        self._finite_constraints |= h is not None and bool(np.isfinite(h).all(axis=1).any())
        if not np.isnan(self.best_fun):
            good = (violation == 0.0) & (values < self._best_fun)
            i = int(np.argmin(np.where(good, values, np.inf)))
        elif (violation == 0.0).any() and np.isfinite(values[violation == 0.0]).any():
            good = (violation == 0.0) & np.isfinite(values)
            i = int(np.argmin(np.where(good, values, np.inf)))
        else:
            i = int(np.argmin(violation))
            good = violation < self._least_violation
        if good[i]:
            self._best_x, self._best_fun = request.x[i].copy(), float(values[i])
            self._least_violation = float(violation[i])
            self._history.append((self.n_objective, self.n_constraint, self._best_fun, self._least_violation))


def _check_whole(key: str, value: object, least: int) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise OptionError(f"{key} = {value!r}", way_out=f"give a whole number, {least} or more")


def _checked_values(values: object, shape: tuple[int, ...], name: str) -> Array:
    """Return a copy of the told values, after a check of their shape."""
    meaning = f" ({SIGN})" if name == "constraints" else ""
    try:
        told = np.array(values)
        told = np.array(None) if np.iscomplexobj(told) else told.astype(float)
    except (TypeError, ValueError):
        told = np.array(None)
    if told.dtype != float:
        raise OptionError(
            f"no real numbers were told, an array of shape {shape} is needed{meaning}",
            key=name,
            way_out="give real numbers, NaN where there is no value",
        )
    if told.shape != shape:
        raise OptionError(
            f"values of shape {told.shape} were told, {shape} are needed{meaning}",
            key=name,
            way_out="give one row a point",
        )
    return told


def _moderate(values: Array) -> Array:
    """Limit finite values to `HUGE` in absolute value, so that products of them do not overflow."""
    return np.where(np.isfinite(values), np.clip(values, -HUGE, HUGE), values)


def checked_bounds(bounds: object, n: int) -> tuple[Array, Array]:
    """Return the lowest and highest x as arrays, shape (n,), infinite where there is no bound."""
    if bounds is None:
        return np.full(n, -np.inf), np.full(n, np.inf)
    try:
        lower, upper = (np.broadcast_to(np.asarray(bound, dtype=float), (n,)).copy() for bound in bounds)
    except (TypeError, ValueError):
        lower, upper = np.full(n, np.nan), np.full(n, np.nan)
    if not (lower < upper).all():
        raise OptionError(
            "bounds must be a lower and a higher end for every variable",
            key="bounds",
            way_out=f"give a pair of numbers, or of arrays of shape ({n},), -inf or inf where there is no bound",
        )
    return lower, upper


def _checked_mask(equality: object, n_constraints: int) -> NDArray[np.bool_]:
    _check_whole("n_constraints", n_constraints, 0)
    if equality is None:
        return np.zeros(n_constraints, dtype=bool)
    mask = np.array(equality)
    if mask.dtype != bool or mask.shape != (n_constraints,):
        raise OptionError(
            f"the mask has shape {mask.shape} and type {mask.dtype} for {n_constraints} constraints",
            key="equality",
            way_out=f"give {n_constraints} booleans: True where h = 0 is wanted, False where {SIGN}",
        )
    return mask

"""A whole search: runs of a method, restarts, and the best point."""

from __future__ import annotations

import builtins
import os
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.errors import ComoveWarning, OptionError
from comove.optim.augmented_lagrangian import AugmentedLagrangian
from comove.optim.cmaes import check_start, check_whole, default_population, numbers
from comove.optim.method import ConstrainedMethod, OptimiserRun, Reason, Request, Start
from comove.optim.restarts import BIPOP, Ended, Restarts, Setting
from comove.optim.restoration import Restoration
from comove.optim.simple import Plain, ProjectionRepair

SIGN = "h <= 0 is feasible"
GROWING = BIPOP(3.0, before=4, least=1)  # where a run of a Lagrangian fails, few samples help soon, or many
SPREAD = 2.0  # step sizes around x0 in which restarts without bounds begin
HUGE = 1e100  # finite values beyond are told to methods as this: products of them would overflow


@dataclass(frozen=True)
class Result:
    """The result of a search.

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


def minimise(
    f: Callable,
    x0: Array,
    sigma0: float,
    *,
    constraints: Callable | None = None,
    equality: object = None,
    tolerance: float = 1e-4,
    bounds: tuple[object, object] | None = None,
    method: ConstrainedMethod | None = None,
    restarts: Restarts | None = None,
    population: int | None = None,
    covariance: object = None,
    injected: object = None,
    seed: int = 0,
    target: float = -np.inf,
    max_evaluations: int | None = None,
    max_seconds: float = np.inf,
    callback: Callable[[Minimiser], bool | None] | None = None,
    vectorized: bool = True,
    map: Callable = builtins.map,
) -> Result:
    """Minimise f(x) subject to h(x) <= 0, by CMA-ES.

    Parameters
    ----------
    f
        Objective: array, shape (n_points, n) -> array, shape (n_points,). NaN counts as infeasible.
    constraints
        h: array, shape (n_points, n) -> array, shape (n_points, m); h <= 0 is feasible, NaN is not.
    x0, sigma0, equality, tolerance, bounds, method, restarts, population, covariance, seed
        As in `Minimiser`.
    injected
        Points of the first generations, such as guesses; array, shape (n_points, n).
    target
        Objective value at which the search ends, as soon as a feasible point is at least as good.
    max_evaluations
        Largest number of evaluations of the objective and of the constraints, each; 10000 n by default. Restarts
        continue until they are used.
    max_seconds
        Longest processor time [s], of this process and of the calls that `map` gives to others.
    callback
        Function called with the `Minimiser` after every batch of evaluations; the search ends if it returns True.
    vectorized
        If False, f is (n,) -> float and h is (n,) -> (m,), called by `map`.
    map
        The map for functions that are not vectorized, such as a process pool's; results do not depend on it.

    Returns
    -------
    Result
        The best point with every h <= 0 ever seen, otherwise the least violated.

    Raises
    ------
    OptionError
        If arguments or returned values have the wrong shape or range, or no constraint value is ever finite.
    Exception
        Exceptions of f or h are passed on; once the search has begun, their attribute `search` is the `Minimiser`,
        which can be saved or continued.
    """
    begun, others = time.process_time(), _Others()
    for name, function in (("f", f), ("constraints", constraints), ("callback", callback), ("map", map)):
        if not callable(function) and (function is not None or name == "f"):
            raise OptionError(f"{function!r} is no function", key=name)
    if not isinstance(vectorized, (bool, np.bool_)):
        raise OptionError(f"vectorized = {vectorized!r}", way_out="give True or False")
    x0, sigma0 = check_start(x0, sigma0)
    limit = 10_000 * len(x0) if max_evaluations is None else max_evaluations
    for name, value in (("max_evaluations", limit), ("max_seconds", max_seconds), ("target", target)):
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            raise OptionError(f"{value!r} is no number", key=name)
    if not limit >= 1 or not max_seconds > 0:
        raise OptionError("no evaluations or time are left to search", way_out="give positive limits")
    objective, h = f, constraints or _no_constraints
    if not vectorized:
        objective = partial(others.one_by_one, f, map)
        h = partial(others.one_by_one, constraints, map) if constraints else h
    at_start = _row(h, np.clip(x0, *_checked_bounds(bounds, len(x0))))
    search = Minimiser(
        x0,
        sigma0,
        n_constraints=len(at_start),
        equality=equality,
        tolerance=tolerance,
        bounds=bounds,
        method=method,
        restarts=restarts,
        population=population,
        covariance=covariance,
        seed=seed,
    )
    if injected is not None:
        search.inject(injected)
    search._count_start(at_start)
    while True:
        if search.reason is not None:
            return search.result()
        if time.process_time() - begun + others.seconds >= max_seconds:
            search.check_finite()
            return search.result(Reason.SECONDS)
        request = search.ask()
        n_objective = search.n_objective + len(request.x) * request.objective
        if max(n_objective, search.n_constraint + len(request.x) * request.constraints) > limit:
            search.check_finite()
            return search.result(Reason.EVALUATIONS)
        search.tell(*_answers(search, request, objective, h))
        if search.best_fun <= target:
            return search.result(Reason.TARGET)
        if callback is not None and callback(search):
            return search.result(Reason.CALLBACK)


def _answers(
    search: Minimiser, request: Request, objective: Callable, h: Callable
) -> tuple[Array | None, Array | None]:
    """Return the requested values; attach the search to exceptions."""
    try:
        values = objective(request.x.copy()) if request.objective else None
        missed = h(request.x.copy()) if request.constraints else None
    except Exception as error:
        error.add_note(
            f"raised after {search.n_objective} evaluations of the objective and {search.n_constraint} of "
            "the constraints; this exception's attribute `search` holds the search and can be pickled"
        )
        error.search = search  # type: ignore[attr-defined]
        raise
    return values, missed


class Minimiser:
    """A constrained minimiser that is asked and told. Copies and pickles continue with exactly the same samples.

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
    bounds : pair of arrays, each of shape (n,) or a number Lowest and highest x; no point outside is ever requested.
        A variable whose bounds are equal is fixed: the search omits it.
    method : ConstrainedMethod
        By default an `AugmentedLagrangian` if there are constraints, otherwise `Plain`.
    restarts : Restarts
        Rule of restarts; by default `BIPOP`, for an `AugmentedLagrangian` `BIPOP(3.0, before=4, least=1)`.
    population : int
        Samples per generation of the first run; by default the method's own number.
    covariance : array, shape (n, n), or (n,) for variances along the axes
        First covariance of every run in units of sigma0^2; the identity by default.
    seed : int
        Seed of all random numbers.

    Raises
    ------
    OptionError
        If an argument is out of range or shapes do not match.

    Warns
    -----
    ComoveWarning
        If x0 lies outside the bounds; the search begins at the nearest point inside.
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
        covariance: object = None,
        seed: int = 0,
    ):
        self._x0, self._sigma0 = check_start(x0, sigma0)
        n = len(self._x0)
        self._lower, self._upper = _checked_bounds(bounds, n)
        self._free = _free(self._lower, self._upper, method)
        self._covariance, self._shaped = _checked_covariance(covariance, n), covariance is not None
        _tell_outside(self._x0, self._lower, self._upper)
        check_whole("n_constraints", n_constraints, 0)
        self._equality = _checked_mask(equality, n_constraints)
        if not 0 <= tolerance < np.inf:
            raise OptionError(f"tolerance = {tolerance!r}", way_out="give a number, 0 or more")
        check_whole("seed", seed, 0)
        if population is not None:
            check_whole("population", population, 2)
        for key, part, needed in (("method", method, "start"), ("restarts", restarts, "following")):
            if part is not None and (isinstance(part, type) or not hasattr(part, needed)):
                raise OptionError(
                    f"{part!r} is none", key=key, way_out="give an object, such as CCMAES() or BIPOP()"
                )
        self._tolerance, self._seed = float(tolerance), int(seed)
        self._method = method or (AugmentedLagrangian() if n_constraints else Plain())
        lagrangian = isinstance(self._method, AugmentedLagrangian)
        self._restarts = restarts or (GROWING if lagrangian else BIPOP())
        self._choices = np.random.default_rng([self._seed, 0])
        self.n_objective = self.n_constraint = 0
        self.reason: Reason | None = None
        self._best_x, self._best_fun, self._least_violation = self._x0, np.nan, np.inf
        self._history: list[tuple[float, ...]] = []
        self._finite_objective = self._finite_constraints = False
        self._ended: list[Ended] = []
        self._failures = 0
        self._asked = False
        self._guests = np.zeros((0, n))
        self._begun: Start
        self._begin(Setting(population), np.clip(self._x0, self._lower, self._upper))

    def ask(self) -> Request:
        """Return the next request for evaluations; repeated calls return the same request."""
        self._asked = True
        request = (self._restoration or self._run).ask()
        return request if self._free.all() else replace(request, x=self._whole(request.x))

    def inject(self, points: object) -> None:
        """Replace samples of the next generations by points.

        They are evaluated as they are; the distribution learns from them as if they were no farther away than samples
        usually are (Hansen, 2011).

        Parameters
        ----------
        points : array, shape (n_points, n), or (n,) for one

        Raises
        ------
        OptionError
            If they have another shape, are not finite, or lie outside the bounds.
        """
        guests = numbers(points)
        guests = guests[None] if guests.ndim == 1 else guests
        if guests.ndim != 2 or guests.shape[1] != len(self._x0) or not np.isfinite(guests).all():
            raise OptionError(
                f"points of shape {guests.shape} cannot be injected",
                way_out=f"give finite numbers, (n_points, {len(self._x0)})",
            )
        outside = np.flatnonzero(((guests < self._lower) | (guests > self._upper)).any(axis=1))
        if outside.size:
            raise OptionError(
                f"the injected point {outside[0]} lies outside the bounds", way_out="move it inside"
            )
        self._guests = np.concatenate([self._guests, guests])
        if self._restoration is None:
            self._invite()

    def change_bounds(self, bounds: tuple[object, object] | None) -> None:
        """Continue within other bounds, keeping the samples' distribution.

        Its mean is moved inside. The best point so far is forgotten if it lies outside. Variables may become fixed,
        or free again.

        Raises
        ------
        OptionError
            If a request waits for its values, or the bounds are none.
        """
        if self._asked:
            raise OptionError("the last request still waits for its values", way_out="tell them first")
        lower, upper = _checked_bounds(bounds, len(self._x0))
        free = _free(lower, upper, self._method)
        mean, covariance = self._whole((self._restoration or self._begun).x[None])[0], self._covariance.copy()
        sigma = self._begun.sigma
        if self._restoration is None:
            inner, sigma, learned = self._run.distribution
            mean = self._whole(inner[None])[0]
            self._guests = np.concatenate([self._guests, self._whole(self._run.guests)])
            covariance[np.ix_(self._free, self._free)] = learned
        self._lower, self._upper, self._free = lower, upper, free
        if not ((self._best_x >= lower) & (self._best_x <= upper)).all():
            self._best_x, self._best_fun = np.clip(self._best_x, lower, upper), np.nan
            self._least_violation = np.inf
        self._guests = np.clip(self._guests, lower, upper)
        x = np.clip(mean, lower, upper)
        self._begun = replace(
            self._begun,
            x=x[free],
            sigma=sigma,
            lower=lower[free],
            upper=upper[free],
            covariance=covariance[np.ix_(free, free)],
        )
        self._start_run(x[free])

    def _whole(self, x: Array) -> Array:
        """Return points with the fixed variables at their values; arrays, (n_points, n_free) -> (n_points, n)."""
        whole = np.repeat(self._lower[None], len(x), axis=0)
        whole[:, self._free] = x
        return whole

    def _invite(self) -> None:
        if len(self._guests):
            self._run.invite(self._guests[:, self._free])
            self._guests = self._guests[:0]

    def tell(self, objective: Array | None = None, constraints: Array | None = None) -> None:
        """Process the values at the points of the last request.

        Parameters
        ----------
        objective
            Values if the objective was requested; array, shape (n_points,).
        constraints
            Values if the constraints were requested; array, shape (n_points, n_constraints); <= 0 is feasible.

        Raises
        ------
        OptionError
            If requested values are missing or have another shape, or nothing was requested since the last ones.
        """
        if not self._asked:
            raise OptionError(
                "values were told that nobody asked for", way_out="ask() first, and tell() once"
            )
        request, m = self.ask(), len(self._equality)
        n_points = len(request.x)
        f = _checked_values(objective, (n_points,), "objective") if request.objective else None
        h = _checked_values(constraints, (n_points, m), "constraints") if request.constraints else None
        self._asked = False
        self.n_objective += n_points * request.objective
        self.n_constraint += n_points * (request.constraints and m > 0)
        self._remember(request, f, h)
        asked = self._restoration or self._run
        asked.tell(None if f is None else _moderate(f), None if h is None else _moderate(h))
        if self._restoration is not None:
            if self._restoration.done:
                self._start_run(self._restoration.x)
        elif self._run.reason is not None:
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
            x=x[self._free],
            sigma=self._sigma0 * setting.sigma,
            rng=np.random.default_rng([self._seed, 1, len(self._ended)]),
            equality=self._equality,
            tolerance=self._tolerance,
            lower=self._lower[self._free],
            upper=self._upper[self._free],
            population=setting.population,
            failures=self._failures,
            covariance=self._covariance[np.ix_(self._free, self._free)] if self._shaped else None,
        )
        if len(self._equality):
            self._restoration = Restoration(self._begun)
        else:
            self._start_run(self._begun.x)

    def _start_run(self, x: Array) -> None:
        self._restoration = None
        self._run: OptimiserRun = self._method.start(replace(self._begun, x=x))
        self._invite()

    def _count_start(self, constraints: Array) -> None:
        """Count an evaluation of the constraints at the start."""
        self.n_constraint += len(constraints) > 0
        self._finite_constraints |= bool(np.isfinite(constraints).all())

    def check_finite(self) -> None:
        """Raise `OptionError` if values were told but none was finite."""
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
        population = self._setting.population or default_population(int(self._free.sum()))
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
                self._x0 + SPREAD * self._sigma0 * self._drawn(normal),
            )
        self._begin(following, np.clip(x, self._lower, self._upper))

    def _drawn(self, normal: Array) -> Array:
        return np.linalg.cholesky(self._covariance) @ normal if self._shaped else normal

    def _remember(self, request: Request, objective: Array | None, constraints: Array | None) -> None:
        """Keep the best point: feasible before infeasible, then the lower objective or violation."""
        h = request.known if constraints is None else constraints
        violation = np.zeros(len(request.x)) if h is None else self._begun.violation(h).sum(axis=1)
        values = np.full(len(request.x), np.nan) if objective is None else objective
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


def _checked_values(values: object, shape: tuple[int, ...], name: str) -> Array:
    """Return a copy of the told values, checked for their shape."""
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
    """Limit finite values to `HUGE`, so that their products do not overflow."""
    return np.where(np.isfinite(values), np.clip(values, -HUGE, HUGE), values)


def _checked_bounds(bounds: tuple[object, object] | None, n: int) -> tuple[Array, Array]:
    """Return the bounds of x as arrays, shape (n,), infinite where open."""
    try:
        ends = (np.asarray(bound, dtype=np.float64) for bound in bounds or (-np.inf, np.inf))
        lower, upper = (np.broadcast_to(bound, (n,)).copy() for bound in ends)
    except (TypeError, ValueError):
        lower, upper = np.full(n, np.nan), np.full(n, np.nan)
    if not ((lower <= upper) & (lower < np.inf) & (upper > -np.inf)).all():
        raise OptionError(
            "bounds must be a lower and a higher end for every variable, or the same twice to fix it",
            key="bounds",
            way_out=f"give a pair of numbers, or of arrays of shape ({n},), -inf or inf where there is no bound",
        )
    return lower, upper


def _free(lower: Array, upper: Array, method: object) -> NDArray[np.bool_]:
    """Return which variables are not fixed by equal bounds; array of bool, shape (n,)."""
    free = lower < upper
    if not free.any():
        raise OptionError("every variable is fixed", key="bounds", way_out="leave one of them free")
    if isinstance(method, ProjectionRepair) and not free.all():
        raise OptionError(
            "a projection would move fixed variables", key="bounds", way_out="leave them out of the problem"
        )
    return free


def _tell_outside(x0: Array, lower: Array, upper: Array) -> None:
    """Warn if the first mean lies outside the bounds."""
    away = np.maximum(lower - x0, x0 - upper)
    i = int(np.argmax(away))
    if away[i] > 0 and lower[i] < upper[i]:
        warnings.warn(
            f"x0[{i}] = {x0[i]:g} lies outside its bounds, {lower[i]:g} to {upper[i]:g}: the search begins at the "
            "nearest point inside",
            ComoveWarning,
            stacklevel=3,
        )


def _checked_covariance(covariance: object, n: int) -> Array:
    """Return the first covariance, checked, as a matrix of shape (n, n)."""
    matrix = np.eye(n) if covariance is None else numbers(covariance)
    matrix = np.diag(matrix) if matrix.shape == (n,) else matrix
    good = matrix.shape == (n, n) and np.isfinite(matrix).all() and np.allclose(matrix, matrix.T, rtol=1e-9)
    if not good or not np.linalg.eigvalsh(matrix)[0] > 0:
        raise OptionError(
            f"a covariance of shape {matrix.shape} that is none",
            key="covariance",
            way_out=f"give {n} positive variances, or a symmetric positive definite matrix ({n}, {n})",
        )
    return 0.5 * (matrix + matrix.T)


def _checked_mask(equality: object, n_constraints: int) -> NDArray[np.bool_]:
    mask = np.zeros(n_constraints, dtype=bool) if equality is None else np.array(equality)
    if mask.dtype != bool or mask.shape != (n_constraints,):
        raise OptionError(
            f"the mask has shape {mask.shape} and type {mask.dtype} for {n_constraints} constraints",
            key="equality",
            way_out=f"give {n_constraints} booleans: True where h = 0 is wanted, False where {SIGN}",
        )
    return mask


def _no_constraints(x: Array) -> Array:
    return np.zeros((len(x), 0))


class _Others:
    """Other processes that evaluate: `seconds` is their processor time [s]."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def one_by_one(self, function: Callable, map: Callable, x: Array) -> list:
        """Return the values of a function of one point at many points."""
        values = []
        for process, seconds, value in map(partial(_timed, function), x):
            values.append(value)
            self.seconds += seconds if process != os.getpid() else 0.0
        return values


def _timed(function: Callable, x: Array) -> tuple[int, float, Any]:
    """Return the process, its processor time [s], and the value."""
    begun = time.process_time()
    value = function(x)
    return os.getpid(), time.process_time() - begun, value


def _row(h: Callable, x0: Array) -> Array:
    """Return the values of the constraints at x0; array, shape (n_constraints,)."""
    told = h(x0[None].copy())
    try:
        values = np.asarray(told, dtype=float)
    except (TypeError, ValueError) as error:
        raise OptionError(f"no numbers came back ({error}; {SIGN})", key="constraints") from error
    if values.ndim != 2 or len(values) != 1:
        raise OptionError(
            f"one point gives values of shape {values.shape}, (1, m) are needed ({SIGN})",
            key="constraints",
            way_out="return a row a point and a column a constraint; with vectorized=False, shape (m,)",
        )
    return values[0]

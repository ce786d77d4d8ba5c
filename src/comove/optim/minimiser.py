"""A whole search: runs of a method, restarts, and the best point."""

from __future__ import annotations

import builtins
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.errors import OptionError
from comove.optim.augmented_lagrangian import AugmentedLagrangian
from comove.optim.cmaes import check_start, check_whole, default_population, numbers
from comove.optim.domain import Bounds, Prior, checked_covariance
from comove.optim.evaluations import SIGN, BestPoint, Evaluations
from comove.optim.method import ConstrainedMethod, OptimiserRun, Reason, Request, Start
from comove.optim.restarts import BIPOP, Restarts, RunSequence, Setting
from comove.optim.restoration import Restoration
from comove.optim.simple import Plain, ProjectionRepair

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
    at_start = _row(h, Bounds.checked(bounds, len(x0)).nearest(x0))
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
        mean, sigma = check_start(x0, sigma0)
        self._box = _checked_box(bounds, len(mean), method)
        shape = None if covariance is None else checked_covariance(covariance, len(mean))
        self._prior = Prior(mean, sigma, shape)
        self._box.warn_outside(mean)
        check_whole("n_constraints", n_constraints, 0)
        self._equality = _checked_mask(equality, n_constraints)
        if not 0 <= tolerance < np.inf:
            raise OptionError(f"tolerance = {tolerance!r}", way_out="give a number, 0 or more")
        self._tolerance = float(tolerance)
        check_whole("seed", seed, 0)
        if population is not None:
            check_whole("population", population, 2)
        for key, part, needed in (("method", method, "start"), ("restarts", restarts, "following")):
            if part is not None and (isinstance(part, type) or not hasattr(part, needed)):
                raise OptionError(
                    f"{part!r} is none", key=key, way_out="give an object, such as CCMAES() or BIPOP()"
                )
        self._method = method or (AugmentedLagrangian() if n_constraints else Plain())
        rule = restarts or (GROWING if isinstance(self._method, AugmentedLagrangian) else BIPOP())
        self._runs = RunSequence(rule, int(seed), Setting(population))
        self._evaluations = Evaluations(BestPoint(mean))
        self.reason: Reason | None = None
        self._asked = False
        self._guests = np.zeros((0, len(mean)))
        self._begun: Start
        self._begin(self._box.nearest(mean))

    @property
    def n_objective(self) -> int:
        """Return the number of evaluations of the objective."""
        return self._evaluations.n_objective

    @property
    def n_constraint(self) -> int:
        """Return the number of evaluations of the constraints."""
        return self._evaluations.n_constraint

    def ask(self) -> Request:
        """Return the next request for evaluations; repeated calls return the same request."""
        self._asked = True
        request = (self._restoration or self._run).ask()
        return request if self._box.free.all() else replace(request, x=self._box.whole(request.x))

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
        guests, n = numbers(points), len(self._prior.mean)
        guests = guests[None] if guests.ndim == 1 else guests
        if guests.ndim != 2 or guests.shape[1] != n or not np.isfinite(guests).all():
            raise OptionError(
                f"points of shape {guests.shape} cannot be injected",
                way_out=f"give finite numbers, (n_points, {n})",
            )
        outside = np.flatnonzero(~self._box.holds(guests))
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
        before, prior, best = self._box, self._prior, self._evaluations.best
        box = _checked_box(bounds, len(prior.mean), self._method)
        covariance = np.eye(len(prior.mean)) if prior.covariance is None else prior.covariance.copy()
        if self._restoration is not None:
            mean, sigma = self._restoration.x, self._begun.sigma
        else:
            mean, sigma, learned = self._run.distribution
            self._guests = np.concatenate([self._guests, before.whole(self._run.guests)])
            covariance[np.ix_(before.free, before.free)] = learned
        self._box = box
        if not box.holds(best.x):
            self._evaluations.best = BestPoint(box.nearest(best.x))
        self._guests = box.nearest(self._guests)
        x, free = box.nearest(before.whole(mean)), box.free
        self._begun = replace(
            self._begun,
            x=x[free],
            sigma=sigma,
            lower=box.lower[free],
            upper=box.upper[free],
            covariance=covariance[np.ix_(free, free)],
        )
        self._start_run(x[free])

    def _invite(self) -> None:
        if len(self._guests):
            self._run.invite(self._guests[:, self._box.free])
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
        self._evaluations.count(f, h)
        known = request.known if h is None else h
        violation = np.zeros(n_points) if known is None else self._begun.violation(known).sum(axis=1)
        self._evaluations.compare(request.x, f, violation)
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
        return self._evaluations.best.feasible_fun

    def result(self, reason: Reason | None = None) -> Result:
        """Return the result so far."""
        evaluations, best = self._evaluations, self._evaluations.best
        return Result(
            x=best.x.copy(),
            fun=best.fun,
            violation=float(best.violation),
            n_objective=evaluations.n_objective,
            n_constraint=evaluations.n_constraint,
            history=np.array(evaluations.improvements).reshape(-1, 4),
            reason=reason or self.reason or Reason.CALLBACK,
        )

    def _begin(self, x: Array) -> None:
        """Begin a run at a point, array of shape (n,)."""
        box, prior, setting, free = self._box, self._prior, self._runs.setting, self._box.free
        self._begun = Start(
            x=x[free],
            sigma=prior.sigma * setting.sigma,
            rng=self._runs.generator(),
            equality=self._equality,
            tolerance=self._tolerance,
            lower=box.lower[free],
            upper=box.upper[free],
            population=setting.population,
            failures=self._runs.n_diverged,
            covariance=None if prior.covariance is None else prior.covariance[np.ix_(free, free)],
        )
        if len(self._equality):
            self._restoration: Restoration | None = Restoration(self._begun)
        else:
            self._start_run(self._begun.x)

    def _start_run(self, x: Array) -> None:
        self._restoration = None
        self._run: OptimiserRun = self._method.start(replace(self._begun, x=x))
        self._invite()

    def _count_start(self, constraints: Array) -> None:
        """Count an evaluation of the constraints at the start."""
        self._evaluations.count(None, constraints[None])

    def check_finite(self) -> None:
        """Raise `OptionError` if values were told but none was finite."""
        self._evaluations.check_finite()

    def _end_run(self, reason: Reason) -> None:
        """Restart from another point, or end the search."""
        self.check_finite()
        population = default_population(len(self._begun.x))
        if not self._runs.follow(population, self._evaluations.spent, reason is Reason.DIVERGED):
            self.reason = reason
            return
        n, choices = len(self._prior.mean), self._runs.choices
        drawn = self._prior.at(choices.standard_normal(n), SPREAD)
        self._begin(self._box.nearest(self._box.uniform(choices.random(n), drawn)))


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


def _checked_box(bounds: tuple[object, object] | None, n: int, method: object) -> Bounds:
    """Return the box of bounds in which a method can search."""
    box = Bounds.checked(bounds, n)
    if not box.free.any():
        raise OptionError("every variable is fixed", key="bounds", way_out="leave one of them free")
    if isinstance(method, ProjectionRepair) and not box.free.all():
        raise OptionError(
            "a projection would move fixed variables", key="bounds", way_out="leave them out of the problem"
        )
    return box


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

"""The function `minimise`, the main entry point of this package."""

from __future__ import annotations

import builtins
import time
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError
from comove.optimisers.cmaes import check_start
from comove.optimisers.method import ConstrainedMethod
from comove.optimisers.minimiser import SIGN, Minimiser, Result, checked_bounds
from comove.optimisers.reasons import Reason
from comove.optimisers.restarts import Restarts

Array = NDArray[np.float64]

EVALUATIONS = 10_000  # a dimension, unless the user says otherwise


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
    x0, sigma0
        First mean, array of shape (n,), and first step size: the optimum should lie within a few steps.
    constraints
        h: array, shape (n_points, n) -> array, shape (n_points, m); h <= 0 is feasible, NaN is not.
    equality
        Which constraints are equalities, h = 0; array of bool, shape (m,).
    tolerance
        Largest absolute value of an equality that counts as met.
    bounds
        Lowest and highest x, a pair of numbers or arrays of shape (n,); nothing outside is evaluated.
    method, restarts, population, seed
        As in `Minimiser`.
    target
        Objective value at which the search ends, as soon as a feasible point is at least as good.
    max_evaluations
        Largest number of evaluations of the objective and of the constraints, each; 10000 n by default. Restarts
        continue until they are used.
    max_seconds
        Longest wall time [s].
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
    begun = time.perf_counter()
    for name, function in (("f", f), ("constraints", constraints), ("callback", callback), ("map", map)):
        if not callable(function) and (function is not None or name == "f"):
            raise OptionError(f"{function!r} is no function", key=name)
    if not isinstance(vectorized, (bool, np.bool_)):
        raise OptionError(f"vectorized = {vectorized!r}", way_out="give True or False")
    x0, sigma0 = check_start(x0, sigma0)
    limit = EVALUATIONS * len(x0) if max_evaluations is None else max_evaluations
    for name, value in (("max_evaluations", limit), ("max_seconds", max_seconds), ("target", target)):
        if isinstance(value, bool) or not isinstance(value, (int, float, np.number)):
            raise OptionError(f"{value!r} is no number", key=name)
    if not limit >= 1 or not max_seconds > 0:
        raise OptionError("no evaluations or time are left to search", way_out="give positive limits")
    objective, h = (f, constraints) if vectorized else (_one_by_one(f, map), _one_by_one(constraints, map))
    h = h or _no_constraints
    n_constraints = _count(h, np.clip(x0, *checked_bounds(bounds, len(x0))))
    search = Minimiser(
        x0,
        sigma0,
        n_constraints=n_constraints,
        equality=equality,
        tolerance=tolerance,
        bounds=bounds,
        method=method,
        restarts=restarts,
        population=population,
        seed=seed,
    )
    search.n_constraint += n_constraints > 0
    while True:
        if search.reason is not None:
            return search.result()
        if time.perf_counter() - begun >= max_seconds:
            return _ended(search, Reason.SECONDS)
        request = search.ask()
        n_points = len(request.x)
        if (
            max(
                search.n_objective + n_points * request.objective,
                search.n_constraint + n_points * request.constraints,
            )
            > limit
        ):
            return _ended(search, Reason.EVALUATIONS)
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
        search.tell(values, missed)
        if search.best_fun <= target:
            return search.result(Reason.TARGET)
        if callback is not None and callback(search):
            return search.result(Reason.CALLBACK)


def _ended(search: Minimiser, reason: Reason) -> Result:
    search.check_finite()
    return search.result(reason)


def _no_constraints(x: Array) -> Array:
    """Return an empty row of constraints for every point."""
    return np.zeros((len(x), 0))


def _one_by_one(function: Callable | None, map: Callable) -> Callable | None:
    """Return a function of many points that calls a function of one point."""
    if function is None:
        return None
    return _OneByOne(function, map)


class _OneByOne:
    def __init__(self, function: Callable, map: Callable) -> None:
        self._function, self._map = function, map

    def __call__(self, x: Array) -> list:
        return list(self._map(self._function, x))


def _count(h: Callable, x0: Array) -> int:
    """Return the number of constraints, from their values at x0."""
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
    return values.shape[1]

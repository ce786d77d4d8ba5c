"""Simple methods: without constraints, by projection, or by a static penalty."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from comove.arrays import Array
from comove.errors import OptionError
from comove.optim.cmaes import DiagonalCovariance, Parameters, check_positive, numbers
from comove.optim.method import OptimiserRun, Request, Start, spread


@dataclass(frozen=True)
class Plain:
    """CMA-ES without constraints. Bounds hold by a penalty on the distance to the nearest point inside.

    Attributes
    ----------
    active : whether bad samples get negative weights
    separable : whether only variances along the axes are learned
    """

    active: bool = True
    separable: bool = False

    def start(self, start: Start) -> PlainRun:
        """Return a new run of the method."""
        return PlainRun(start, self, None, 0.0)


@dataclass(frozen=True)
class Penalty:
    """CMA-ES with a static penalty on squared violations. It is simple, inexact, and depends on scales.

    Attributes
    ----------
    weight : weight of the squared violations

    Raises
    ------
    OptionError
        If the weight is not positive.
    """

    weight: float = 1e3

    def __post_init__(self) -> None:
        check_positive("weight", self.weight)

    def start(self, start: Start) -> PlainRun:
        """Return a new run of the method."""
        return PlainRun(start, Plain(), None, self.weight)


@dataclass(frozen=True)
class ProjectionRepair:
    """CMA-ES that projects its samples by a function of the user.

    Attributes
    ----------
    project : array, shape (n_points, n) -> array of the same shape, feasible points near the given ones
    weight : weight of the squared violations that the projection leaves
    """

    project: Callable[[Array], Array]
    weight: float = 1e6

    def start(self, start: Start) -> PlainRun:
        """Return a new run of the method."""
        return PlainRun(start, Plain(), self.project, self.weight)


@dataclass(frozen=True)
class Affine:
    """A function that projects points orthogonally onto {x : A x = b}.

    Raises `OptionError` if that set is empty, or A and b are not a matrix and a vector of numbers with matching
    shapes.

    Attributes
    ----------
    matrix, right : A and b; arrays, shapes (m, n) and (m,)
    """

    matrix: Array
    right: Array

    def __post_init__(self) -> None:
        for name in ("matrix", "right"):
            object.__setattr__(self, name, numbers(getattr(self, name)))
        finite = np.isfinite(self.matrix).all() and np.isfinite(self.right).all()
        if not finite or self.matrix.ndim != 2 or self.right.shape != self.matrix.shape[:1]:
            raise OptionError(
                f"A x = b with A of shape {self.matrix.shape} and b of shape {self.right.shape}",
                way_out="give finite numbers in arrays of shapes (m, n) and (m,)",
            )
        if not np.allclose(self.matrix @ (self._inverse @ self.right), self.right):
            raise OptionError("the linear equalities contradict each other", way_out="give consistent ones")

    @cached_property
    def _inverse(self) -> Array:
        return np.asarray(np.linalg.pinv(self.matrix), dtype=np.float64)

    def __call__(self, x: Array) -> Array:
        """Return the nearest points that satisfy the equalities; arrays, shape (n_points, n)."""
        return x - (x @ self.matrix.T - self.right) @ self._inverse.T


class PlainRun(OptimiserRun):
    """One run of CMA-ES that evaluates each sample once."""

    def __init__(
        self, start: Start, settings: Plain, project: Callable[[Array], Array] | None, weight: float
    ) -> None:
        n, separable = len(start.x), settings.separable
        active = settings.active and not separable
        super().__init__(
            start,
            Parameters.default(n, start.population, active=active, separable=separable),
            DiagonalCovariance(n, start.covariance) if separable else None,
        )
        self._project, self._weight = project, weight
        self._spread = 1.0
        self._next()

    def _sample(self) -> None:
        self._sampled = self._es.ask()
        points = self._sampled if self._project is None else self._project(self._sampled)
        has_constraints = len(self._start.equality) > 0
        self._inside = self._start.inside(points)
        self._wait(Request(self._inside, objective=True, constraints=has_constraints), self._values_told)

    def _values_told(self, objective: Array, constraints: Array | None) -> None:
        es, start = self._es, self._start
        values = np.array(objective, dtype=float)
        if constraints is not None:
            violation = start.violation(constraints)
            with np.errstate(over="ignore", invalid="ignore"):
                values = values + self._weight * (violation**2).sum(axis=1)
            values = np.where(np.isfinite(violation).all(axis=1), values, np.inf)
        finite = np.isfinite(values)
        if not self._teaches(bool(finite.any())):
            return
        if finite.sum() > 1:
            self._spread = spread(values[finite])
        moved = (self._sampled - self._inside) / es.standard_deviations()
        es.tell(values + self._spread * (moved**2).sum(axis=1) / len(start.x))
        self._end_generation(values)

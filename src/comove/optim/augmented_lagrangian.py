"""CMA-ES on the augmented Lagrangian, with multipliers from linear models.

Samples are ranked by

    L(x) = f(x) + sum_j mu_j h_j(x) + rho_j/2 h_j(x)^2

(inactive inequalities, mu_j + rho_j h_j <= 0, contribute -mu_j^2 / (2 rho_j); Hestenes, 1969; Powell, 1969;
Rockafellar, 1973; with CMA-ES: Arnold and Porter, 2015; Atamna, Auger and Hansen, 2017). In these papers the
multipliers slowly follow mu += rho h(mean). Here they are those of the quadratic programme

    min_z  g z + kappa/2 |z|^2   subject to   c + G z <= 0,

in the units z of the search distribution. g, c and G are linear models learned from the samples; kappa is the
Lagrangian's curvature, estimated from the models' residuals, and determines the penalties rho_j as well. The step of
that programme, made feasible by the same models, joins the samples (injection: Hansen, 2011).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.optim.cmaes import CMAES, FullCovariance, check_number, check_positive, check_whole
from comove.optim.method import OptimiserRun, Reason, Request, Start
from comove.optim.models import UNKNOWN, LinearModel, Local, bound_rows, nearest_feasible

TINY = 1e-150
INSIDE = 1e-9  # part of an equality's tolerance that is kept for rounding


@dataclass(frozen=True)
class AugmentedLagrangian:
    """The augmented Lagrangian with modelled multipliers, a method that suits smooth constraints.

    Objective and constraints are evaluated on both sides of the constraints' boundaries.

    Attributes
    ----------
    penalty : rho_j in units of the curvature
    growth : factor on `penalty` for every earlier run that diverged
    learning : step of the multipliers towards the programme's in a generation, as a share
    integral : share of rho h(mean) that is added to the multipliers, as in the classical rule
    adaptation : step of the penalties towards their target in a generation, as a share in logarithms
    repairs : largest number of evaluations of the constraints to make the programme's step feasible
    trust : least slope of a constraint's model, in units of its residuals, for the programme to have the constraint
        in a run's first generations; distant disconnected feasible sets have no slope
    early : number of these first generations, in which constraints may still be distant
    longest : longest step of the programme, in root-n lengths of the distribution
    far : squared distance a dimension, in units of the distribution, beyond which models are not trusted
    divergence : growth of the curvature over its least value that no converging run shows

    Raises
    ------
    OptionError
        If a number is out of range.
    """

    penalty: float = 0.5
    growth: float = 4.0
    learning: float = 0.1
    integral: float = 0.1
    adaptation: float = 0.1
    repairs: int = 8
    trust: float = 1.0
    early: int = 60
    longest: float = 2.0
    far: float = 100.0
    divergence: float = 1e3

    def __post_init__(self) -> None:
        for name in ("penalty", "longest", "far"):
            check_positive(name, getattr(self, name))
        for name in ("integral", "trust"):
            check_number(name, getattr(self, name), 0.0)
        for name in ("learning", "adaptation"):
            check_number(name, getattr(self, name), 0.0, 1.0)
        for name in ("growth", "divergence"):
            check_number(name, getattr(self, name), 1.0)
        for name in ("repairs", "early"):
            check_whole(name, getattr(self, name), 0)

    def start(self, start: Start) -> AugmentedLagrangianRun:
        """Return a new run of the method."""
        return AugmentedLagrangianRun(self, start)


@dataclass(frozen=True, eq=False)
class Lagrangian:
    """The function L that ranks the samples.

    Attributes
    ----------
    equality : which constraints are equalities; array, shape (m,)
    multipliers, penalties : mu and rho; arrays, shape (m,)
    shift : value that an optimum gives to each constraint, as it uses the tolerance of an equality; array, shape (m,)
    """

    equality: NDArray[np.bool_]
    multipliers: Array
    penalties: Array
    shift: Array

    @classmethod
    def zero(cls, equality: NDArray[np.bool_]) -> Lagrangian:
        """Return the objective alone."""
        return cls(equality, *np.zeros((3, len(equality))))

    def within(self, tolerance: float) -> Lagrangian:
        """Return the same function of equalities that are met within a tolerance."""
        shift = np.sign(self.multipliers) * tolerance * (1 - INSIDE)
        return replace(self, shift=np.where(self.equality, shift, 0.0))

    @np.errstate(over="ignore", invalid="ignore")
    def __call__(self, objective: Array, constraints: Array) -> Array:
        """Compute L at points; arrays, shapes (n_points,), (n_points, m) -> (n_points,); infinite if not finite."""
        mu, rho = self.multipliers, self.penalties
        h = constraints - self.shift
        active = self.equality | (mu + rho * h > 0)
        terms = np.where(active, mu * h + 0.5 * rho * h**2, -(mu**2) / (2 * rho))
        values = objective + terms.sum(axis=1)
        return np.where(np.isfinite(values), values, np.inf)


class Curvature:
    """The Lagrangian's curvature kappa: the median of its last estimates.

    Attributes
    ----------
    memory : number of estimates
    value : kappa; NaN before the first estimate
    least : least curvature once a run has settled
    """

    def __init__(self, memory: int) -> None:
        self.memory, self.value, self.least = memory, np.nan, np.inf
        self._estimates: list[float] = []

    def __len__(self) -> int:
        return len(self._estimates)

    @property
    def is_finite(self) -> bool:
        """Return whether the last estimate is finite."""
        return bool(np.isfinite(self._estimates[-1]))

    def add(self, local: Local, multipliers: Array, stationary: Array) -> None:
        """Record an estimate, at least half of the slope `stationary`."""
        n = len(stationary)
        residual = np.abs(local.residual[:, -1] + local.residual[:, :-1] @ multipliers)
        bent = 1.4826 * local.inflation * np.median(residual) / np.sqrt(n / 2)
        slope = np.sqrt(stationary @ stationary)
        floor = 1e-6 * np.sqrt(local.slope[-1] @ local.slope[-1])
        self._estimates.append(max(bent, 0.5 * slope, floor) + TINY)
        del self._estimates[: -self.memory]
        self.value = float(np.median(self._estimates))


@dataclass(frozen=True, eq=False)
class Programme:
    """The quadratic programme of a generation, with rows of unit length.

    Attributes
    ----------
    rows, missed : G and c, of constraints and finite bounds; arrays, shapes (m + n_bounds, n), (m + n_bounds,)
    free : which of them are equalities; array, shape (m + n_bounds,)
    length : lengths of the constraints' slopes, infinite where they are unknown; array, shape (m,)
    """

    rows: Array
    missed: Array
    free: NDArray[np.bool_]
    length: Array

    @classmethod
    def of(cls, local: Local, shift: Array, length: Array, start: Start, es: CMAES) -> Programme:
        """Return the programme of models around the mean of a search."""
        rows, missed = local.slope[:-1] / length[:, None], (local.value[:-1] - shift) / length
        if not start.bounded:
            return cls(rows, missed, start.equality, length)
        assert isinstance(es.covariance, FullCovariance)
        walls, distances = bound_rows(es.sigma * es.covariance.root, es.mean, start.lower, start.upper)
        free = np.append(start.equality, np.zeros(len(distances), dtype=bool))
        return cls(np.vstack([rows, walls]), np.concatenate([missed, distances]), free, length)

    def multipliers(self, gradient: Array, curvature: float) -> Array:
        """Return the multipliers of the programme's solution; array, shape (m + n_bounds,)."""
        shifted = self.missed - self.rows @ gradient / curvature
        return curvature * nearest_feasible(self.rows, shifted, self.free)


@dataclass(frozen=True, eq=False)
class Repair:
    """A point on its way to feasibility, in units z.

    Attributes
    ----------
    origin : point to which the feasible one shall be near; array, shape (n,)
    offset : c of the programme, corrected by the constraints' values; array, shape (m + n_bounds,)
    margin : distance inside the inequalities that is aimed at
    tries : evaluations of the constraints so far
    """

    origin: Array
    offset: Array
    margin: float = 1e-9
    tries: int = 0

    def change(self, programme: Programme) -> Array:
        """Return the shortest step to the models' feasible set; array, shape (n,)."""
        rows, m = programme.rows, len(programme.length)
        margin = np.zeros(len(self.offset))
        margin[:m] = np.where(programme.free[:m], 0.0, self.margin)
        return rows.T @ nearest_feasible(rows, rows @ self.origin + self.offset + margin, programme.free)

    def corrected(self, programme: Programme, here: Array, constraints: Array, violation: Array) -> Repair:
        """Return the next repair.

        Parameters
        ----------
        here : array, shape (n,), the point tried
        constraints, violation : arrays, shape (m,), values there
        """
        m, offset = len(constraints), self.offset.copy()
        offset[:m] = constraints / programme.length - programme.rows[:m] @ here
        margin = 0.3 * float((violation / programme.length).max())
        return Repair(self.origin, offset, margin, self.tries + 1)


class AugmentedLagrangianRun(OptimiserRun):
    """One run of `AugmentedLagrangian`; each generation consists of samples and the programme's repaired step."""

    def __init__(self, settings: AugmentedLagrangian, start: Start) -> None:
        super().__init__(start)
        n, population = len(start.x), self._es.parameters.population
        self.settings = settings
        self._model = LinearModel(n, len(start.equality) + 1, capacity=max(3 * n + 2, population))
        self._curvature = Curvature(5 + 3 * n // population)
        self._lagrangian = Lagrangian.zero(start.equality)
        self._next()

    # --- Samples ---

    def _sample(self) -> None:
        self._sampled = self._es.ask()
        inside = self._start.inside(self._sampled)
        self._wait(Request(inside, objective=True, constraints=True), self._samples_told)

    @np.errstate(over="ignore", invalid="ignore")  # `_update` finds what overflows
    def _samples_told(self, objective: Array, constraints: Array) -> None:
        inside = self.ask().x
        self._model.add(inside, np.column_stack([constraints, objective]))
        if not self._teaches(len(self._model) >= 3):
            return
        local = self._model.around_mean(self._es)
        if not np.isfinite(local.slope).all() or not self._update(local):
            self.reason = Reason.DIVERGED
            return
        outside = (self._sampled - inside) / self._es.standard_deviations()
        values = self._lagrangian(objective, constraints)
        self._values = values + 0.5 * self._curvature.value * (outside**2).sum(axis=1)
        self._propose()

    def _update(self, local: Local) -> bool:
        """Learn from the models around the mean; return whether all is finite, so that the run can continue."""
        settings, curvature, gradient = self.settings, self._curvature, local.slope[-1]
        lagrangian = self._lagrangian.within(self._start.tolerance)
        length = np.sqrt((local.slope[:-1] ** 2).sum(axis=1))
        rough = 1.4826 * local.inflation * np.median(np.abs(local.residual[:, :-1]), axis=0)
        scale = np.sqrt(length**2 + rough**2)  # by which the values vary within the distribution
        scale = np.where(scale > UNKNOWN, scale, np.inf)
        least = settings.trust * rough if self._es.generation < settings.early else 0.0
        length = np.where(length > np.maximum(least, UNKNOWN), length, np.inf)
        self._programme = Programme.of(local, lagrangian.shift, length, self._start, self._es)
        if not len(curvature):
            curvature.add(local, np.zeros(len(length)), gradient)
            known = np.where(np.isfinite(scale), scale, 1e150)
            lagrangian = replace(lagrangian, penalties=TINY + self._penalty * curvature.value / known**2)
        forces = self._programme.multipliers(gradient, curvature.value)
        stationary = gradient + forces @ self._programme.rows
        self._step = -stationary / curvature.value
        wanted = forces[: len(length)] / length
        curvature.add(local, wanted, stationary)
        value = local.value[:-1] - lagrangian.shift
        self._lagrangian = self._followed(lagrangian, wanted, value, length, scale)
        numbers = self._lagrangian.multipliers, self._lagrangian.penalties
        return curvature.is_finite and all(np.isfinite(x).all() for x in numbers)

    @property
    def _penalty(self) -> float:
        """Return rho_j in units of the curvature."""
        return self.settings.penalty * self.settings.growth ** (self._start.failures % 3)

    def _followed(
        self, before: Lagrangian, wanted: Array, value: Array, length: Array, scale: Array
    ) -> Lagrangian:
        """Return the Lagrangian nearer to the multipliers and penalties wanted.

        Parameters
        ----------
        wanted : multipliers of the programme
        value, length, scale : constraints at the mean, lengths of their slopes, and spread in the distribution
        """
        settings, curvature, equality = self.settings, self._curvature.value, before.equality
        known = np.where(np.isfinite(length), length, 0.0)
        surprise = np.abs(wanted - before.multipliers) * known / (10 * curvature)
        mu = before.multipliers + np.clip(surprise, settings.learning, 1.0) * (wanted - before.multipliers)
        mu = mu + settings.integral * before.penalties * np.where(np.isfinite(scale), value, 0.0)
        away = np.where(equality, np.abs(value), np.maximum(value, 0.0)) / scale
        target = self._penalty * curvature * (1 + away**2) / np.where(np.isfinite(scale), scale, 1.0) ** 2
        return replace(
            before,
            multipliers=np.where(equality, mu, np.maximum(mu, 0.0)),
            penalties=before.penalties * (target / before.penalties + TINY) ** settings.adaptation,
        )

    # --- The programme's step, repaired ---

    def _propose(self) -> None:
        """Begin to repair the programme's step or, alternately, the best sample."""
        if self._es.generation % 2:
            origin = self._es.z[np.argmin(self._values)]
        else:
            longest = self.settings.longest * np.sqrt(len(self._step))
            origin = self._step * min(1.0, longest / (np.linalg.norm(self._step) + TINY))
        self._try(Repair(origin, self._programme.missed))

    def _try(self, repair: Repair) -> None:
        """Request the constraints at the models' feasible point nearest to the origin."""
        es, settings = self._es, self.settings
        self._repair, change = repair, repair.change(self._programme)
        if repair.tries >= settings.repairs or not change @ change <= settings.far * len(change):
            self._finish()
            return
        step = es.covariance.scaled((repair.origin - change)[None])[0]
        candidate = self._start.inside(es.mean + es.sigma * step)[None]
        self._wait(Request(candidate, constraints=True), self._repair_told)

    def _repair_told(self, _: Array | None, constraints: Array) -> None:
        candidate, violation = self.ask().x, self._start.violation(constraints[0])
        if not violation.any():
            self._wait(Request(candidate, objective=True, known=constraints), self._candidate_told)
        elif not np.isfinite(constraints).all():
            self._finish()
        else:
            here, values = self._es.whitened(candidate)[0], constraints[0] - self._lagrangian.shift
            self._try(self._repair.corrected(self._programme, here, values, violation))

    def _candidate_told(self, objective: Array, _: Array | None) -> None:
        request = self.ask()
        assert request.known is not None
        self._model.add(request.x, np.column_stack([request.known, objective]))
        value = self._lagrangian(objective, request.known)[0]
        worst = int(np.argmax(self._values))
        if value < self._values[worst]:
            self._es.inject(worst, request.x[0])
            self._values[worst] = value
        self._finish()

    def _finish(self) -> None:
        es, settings, curvature = self._es, self.settings, self._curvature
        es.tell(self._values)
        self._end_generation(self._values)
        if es.generation > settings.early and curvature.value > settings.divergence * curvature.least:
            self.reason = Reason.DIVERGED
        if es.generation > settings.early // 2:
            curvature.least = min(curvature.least, curvature.value)

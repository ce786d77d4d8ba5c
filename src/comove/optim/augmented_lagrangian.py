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

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.optim.cmaes import check_number, check_positive, check_whole
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


class AugmentedLagrangianRun(OptimiserRun):
    """One run of `AugmentedLagrangian`; each generation consists of samples and the programme's repaired step."""

    def __init__(self, settings: AugmentedLagrangian, start: Start) -> None:
        super().__init__(start)
        n, population = len(start.x), self._es.parameters.population
        self.settings = settings
        self._model = LinearModel(n, len(start.equality) + 1, capacity=max(3 * n + 2, population))
        self._penalty = settings.penalty * settings.growth ** (start.failures % 3)
        self._multipliers = np.zeros(len(start.equality))
        self._penalties = np.zeros(len(start.equality))
        self._memory = 5 + 3 * n // population
        self._curvatures: list[float] = []
        self._least_curvature = np.inf
        self._next()

    # --- Samples ---

    def _sample(self) -> None:
        self._sampled = self._es.ask()
        self._inside = self._start.inside(self._sampled)
        self._wait(Request(self._inside, objective=True, constraints=True), self._samples_told)

    @np.errstate(over="ignore", invalid="ignore")  # what overflows is found by `_sound`
    def _samples_told(self, objective: Array, constraints: Array) -> None:
        self._model.add(self._inside, np.column_stack([constraints, objective]))
        if not self._teaches(len(self._model) >= 3):
            return
        local = self._model.around_mean(self._es)
        if np.isfinite(local.slope).all():
            self._update(local)
        if not self._sound(local):
            self.reason = Reason.DIVERGED
            return
        values = self._lagrangian(objective, constraints)
        outside = (self._sampled - self._inside) / self._es.standard_deviations()
        self._values = values + 0.5 * self._curvature * (outside**2).sum(axis=1)
        self._propose()

    def _update(self, local: Local) -> None:
        """Update multipliers and penalties from the models around the mean."""
        start, settings = self._start, self.settings
        self._shift = np.where(
            start.equality, np.sign(self._multipliers) * start.tolerance * (1 - INSIDE), 0.0
        )  # an optimum uses the tolerance of an equality
        length = np.sqrt((local.slope[:-1] ** 2).sum(axis=1))
        rough = 1.4826 * local.inflation * np.median(np.abs(local.residual[:, :-1]), axis=0)
        least = settings.trust * rough if self._es.generation < settings.early else 0.0
        self._length = np.where(length > np.maximum(least, UNKNOWN), length, np.inf)
        gradient = local.slope[-1]
        scale = np.sqrt(length**2 + rough**2)  # by which the values vary within the distribution
        scale = np.where(scale > UNKNOWN, scale, np.inf)
        rows = local.slope[:-1] / self._length[:, None]
        value = local.value[:-1] - self._shift
        missed = value / self._length
        m = len(missed)
        self._rows, self._missed, self._free = self._with_bounds(rows, missed)
        if not self._curvatures:
            self._remember_curvature(local, np.zeros(m), gradient)
            self._penalties = (
                np.full(m, TINY)
                + self._penalty * self._curvature / np.where(np.isfinite(scale), scale, 1e150) ** 2
            )
        curvature = self._curvature
        forces = curvature * nearest_feasible(
            self._rows, self._missed - self._rows @ gradient / curvature, self._free
        )
        stationary = gradient + forces @ self._rows
        self._step = -stationary / curvature
        wanted = forces[:m] / self._length
        self._remember_curvature(local, wanted, stationary)
        known = np.where(np.isfinite(self._length), self._length, 0.0)
        surprise = np.abs(wanted - self._multipliers) * known / (10 * self._curvature)
        self._multipliers += np.clip(surprise, settings.learning, 1.0) * (wanted - self._multipliers)
        self._multipliers += settings.integral * self._penalties * np.where(np.isfinite(scale), value, 0.0)
        self._multipliers = np.where(start.equality, self._multipliers, np.maximum(self._multipliers, 0.0))
        away = np.where(start.equality, np.abs(value), np.maximum(value, 0.0)) / scale
        target = (
            self._penalty * self._curvature * (1 + away**2) / np.where(np.isfinite(scale), scale, 1.0) ** 2
        )
        self._penalties *= (target / self._penalties + TINY) ** settings.adaptation

    def _with_bounds(self, rows: Array, missed: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
        """Return constraints and bounds as rows, and which are equalities."""
        start, es = self._start, self._es
        if not start.bounded:
            return rows, missed, start.equality
        walls, distances = bound_rows(es.sigma * self._shape.root, es.mean, start.lower, start.upper)
        rows, missed = np.vstack([rows, walls]), np.concatenate([missed, distances])
        free = np.zeros(len(missed), dtype=bool)
        free[: len(start.equality)] = start.equality
        return rows, missed, free

    def _remember_curvature(self, local: Local, multipliers: Array, stationary: Array) -> None:
        """Record the Lagrangian's curvature from the models' residuals; at least half of its slope."""
        n = len(stationary)
        residual = np.abs(local.residual[:, -1] + local.residual[:, :-1] @ multipliers)
        bent = 1.4826 * local.inflation * np.median(residual) / np.sqrt(n / 2)
        slope = np.sqrt(stationary @ stationary)
        floor = 1e-6 * np.sqrt(local.slope[-1] @ local.slope[-1])
        self._curvatures.append(max(bent, 0.5 * slope, floor) + TINY)
        del self._curvatures[: -self._memory]

    def _sound(self, local: Local) -> bool:
        """Return whether the models and the multipliers are finite."""
        numbers = local.slope.ravel(), self._curvatures[-1:], self._multipliers, self._penalties
        return bool(self._curvatures) and all(np.isfinite(x).all() for x in numbers)

    @property
    def _curvature(self) -> float:
        return float(np.median(self._curvatures))

    @np.errstate(over="ignore", invalid="ignore")
    def _lagrangian(self, objective: Array, constraints: Array) -> Array:
        """Compute L at points, infinite if not finite; array, shape (n_points,)."""
        mu, rho = self._multipliers, self._penalties
        h = constraints - self._shift
        active = self._start.equality | (mu + rho * h > 0)
        terms = np.where(active, mu * h + 0.5 * rho * h**2, -(mu**2) / (2 * rho))
        values = objective + terms.sum(axis=1)
        return np.where(np.isfinite(values), values, np.inf)

    # --- The programme's step, repaired ---

    def _propose(self) -> None:
        """Begin to repair the programme's step or, alternately, the best sample."""
        if self._es.generation % 2:
            self._origin = self._es.z[np.argmin(self._values)]
        else:
            longest = self.settings.longest * np.sqrt(len(self._step))
            self._origin = self._step * min(1.0, longest / (np.linalg.norm(self._step) + TINY))
        self._offset, self._margin, self._tries = self._missed.copy(), 1e-9, 0
        self._repair()

    def _repair(self) -> None:
        """Request the constraints at the models' feasible point nearest to the origin."""
        start, es = self._start, self._es
        m = len(start.equality)
        margin = np.zeros(len(self._offset))
        margin[:m] = np.where(start.equality, 0.0, self._margin)
        change = self._rows.T @ nearest_feasible(
            self._rows, self._rows @ self._origin + self._offset + margin, self._free
        )
        self._tries += 1
        if self._tries > self.settings.repairs or not change @ change <= self.settings.far * len(change):
            self._finish()
            return
        step = es.covariance.scaled((self._origin - change)[None])[0]
        self._candidate = start.inside(es.mean + es.sigma * step)[None]
        self._wait(Request(self._candidate, constraints=True), self._repair_told)

    def _repair_told(self, _: Array | None, constraints: Array) -> None:
        violation = self._start.violation(constraints[0])
        if not violation.any():
            self._found = constraints
            self._wait(Request(self._candidate, objective=True, known=constraints), self._candidate_told)
            return
        if not np.isfinite(constraints).all():
            self._finish()
            return
        m = len(violation)
        here = self._es.whitened(self._candidate)[0]
        self._offset[:m] = (constraints[0] - self._shift) / self._length - self._rows[:m] @ here
        self._margin = 0.3 * float((violation / self._length).max())
        self._repair()

    def _candidate_told(self, objective: Array, _: Array | None) -> None:
        self._model.add(self._candidate, np.column_stack([self._found, objective]))
        value = self._lagrangian(objective, self._found)[0]
        worst = int(np.argmax(self._values))
        if value < self._values[worst]:
            self._es.inject(worst, self._candidate[0])
            self._values[worst] = value
        self._finish()

    def _finish(self) -> None:
        es = self._es
        es.tell(self._values)
        self._end_generation(self._values)
        if (
            es.generation > self.settings.early
            and self._curvature > self.settings.divergence * self._least_curvature
        ):
            self.reason = Reason.DIVERGED
        if es.generation > self.settings.early // 2:
            self._least_curvature = min(self._least_curvature, self._curvature)

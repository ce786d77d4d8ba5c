"""Constrained CMA-ES, with records of violated constraints.

The paper, section III-A, equations (5) and (6), after Arnold and Hansen, "A (1+1)-CMA-ES for constrained
optimisation" (2012), extended to (mu/mu, lambda) selection. Samples that violate constraints each shorten the
distribution, and are drawn again from it until all are feasible; only then is the objective evaluated.

Forms of the reduction, for a sample x = m + sigma A z that violates a_0 constraints j:

- `PrintedForm`: equation (6), C <- C - beta/a_0 sum_j v_j v_j^T / |v_j|^2, with records v_j of steps A z,
  equation (5). Not invariant under scaling, and C soon stops being positive definite; the run then ends and reports
  it.
- `FactorForm`: A <- A - beta/a_0 sum_j v_j w_j^T / (w_j^T w_j), w_j = A^-1 v_j (Arnold and Hansen, 2012), which
  keeps the bracket's eigenvalues at 1 - beta or more. Records are transformed along with A: v_j <- A' A^-1 v_j.
  Without that (`StaleForm`), steps recorded before a reduction are too long in the direction that it shortens. The
  records then turn towards this direction more and more, and it is shortened again, no matter which constraint is
  violated. With one sample per iteration, as in Arnold and Hansen, records fade faster than this effect grows; with a
  population that is drawn repeatedly they do not.
- `MatrixForm`: the same with records u_j of z itself, M <- M - beta/a_0 sum_j (M u_j) u_j^T / |u_j|^2: it needs
  neither inverse nor decomposition, as M is learned by MA-ES.
- `NoForm`: no reduction; samples that violate constraints are drawn again from the same distribution.

If the start violates constraints, viability boundaries b_j >= 0 are moved from the samples' violations to zero
(Arampatzis et al., 2019), and the run then begins anew. Equalities are bands |h_j| <= b_j that shrink to the
tolerance.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, cast

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.optim.cmaes import (
    CMAES,
    Covariance,
    FullCovariance,
    Parameters,
    TransformationMatrix,
    check_number,
    check_positive,
    check_whole,
)
from comove.optim.method import OptimiserRun, Reason, Request, Start


@dataclass(frozen=True)
class Reduction:
    """Rates of the reduction: learning rate c_v (`fading`) and size beta (`size`), both divided by n + 2 in use."""

    fading: float = 1.0
    size: float = 0.1

    def __post_init__(self) -> None:
        for name in ("fading", "size"):
            check_number(name, getattr(self, name), 0.0)


class ReducibleCovariance(Covariance, Protocol):
    """A covariance that can be reduced towards recorded directions."""

    def reduce(self, records: Array, shares: Array) -> Array:
        """Shorten the distribution along records (m, n) by shares (m,); return new records."""

    def record(self, z: Array, y: Array) -> Array:
        """Return samples or steps, as recorded; array, shape (n_samples, n)."""


class NoForm(FullCovariance):
    """A covariance that is not reduced."""

    def reduce(self, records: Array, shares: Array) -> Array:
        """Leave the covariance unchanged; return the records."""
        return records

    def record(self, z: Array, y: Array) -> Array:
        """Return the steps."""
        return y


class PrintedForm(NoForm):
    """Equation (6) exactly as printed, which acts on the covariance matrix."""

    def reduce(self, records: Array, shares: Array) -> Array:
        """Reduce C <- C - sum_j share_j v_j v_j^T / |v_j|^2. Raises LinAlgError once C is not positive definite."""
        hit = shares > 0
        steps, shares = records[hit], shares[hit]
        lengths = (steps**2).sum(axis=1)
        self.matrix -= (steps.T * (shares / lengths)) @ steps
        variances = np.linalg.eigvalsh(self.matrix)
        if variances[0] <= 0:
            raise np.linalg.LinAlgError("not positive definite")
        self._decompose()
        return records


class FactorForm(NoForm):
    """The reduction of a factor A of the covariance, with transformed records. From Arnold and Hansen (2012)."""

    def reduce(self, records: Array, shares: Array) -> Array:
        """Reduce A <- A - sum_j share_j v_j w_j^T / (w_j^T w_j); return new records. w_j = A^-1 v_j."""
        if self._age > 0:  # what was learned since A was last made
            self._decompose()
        whitened, hit = self.whitened(records), shares > 0
        directions = whitened[hit]
        lengths = (directions**2).sum(axis=1)
        factor = self.root - (directions.T * (shares[hit] / lengths)) @ records[hit]
        self.matrix, self.root, self.inverse_root = factor.T @ factor, factor, np.linalg.inv(factor)
        return whitened @ factor


class StaleForm(FactorForm):
    """The factor form whose records are not transformed by later reductions."""

    def reduce(self, records: Array, shares: Array) -> Array:
        """Reduce A as the factor form does; return the records as they are."""
        super().reduce(records, shares)
        return records


class MatrixForm(TransformationMatrix):
    """The reduction of the transformation matrix, with records of samples z."""

    def reduce(self, records: Array, shares: Array) -> Array:
        """Reduce M <- M - sum_j share_j (M u_j) u_j^T / |u_j|^2; return the records."""
        hit = shares > 0
        directions, shares = records[hit], shares[hit]
        directions = directions / np.sqrt((directions**2).sum(axis=1, keepdims=True))
        self.matrix = self.matrix - (self.scaled(directions).T * shares) @ directions
        return records

    def record(self, z: Array, y: Array) -> Array:
        """Return the samples before scaling."""
        return z


@dataclass(frozen=True)
class CCMAES:
    """Constrained CMA-ES for constraints that reveal little beyond feasibility.

    Attributes
    ----------
    form : form of the reduction: `MatrixForm`, `FactorForm`, `StaleForm`, `PrintedForm` or `NoForm`
    reduction : rates of the reduction
    passes : largest number of times that the infeasible samples of a generation are drawn again
    stalls : number of successive generations without any feasible sample after which the run has stalled
    patience : factor on the usual number of generations without progress after which a run has stagnated
    shrinkage : strongest factor on the bands of equalities in a generation; they do not shrink faster than the mean
        follows
    followed : share of the samples' spread in |h|, by which a band may leave half of them outside

    Raises
    ------
    OptionError
        If a number is out of range.
    """

    form: Callable[..., ReducibleCovariance] = MatrixForm
    reduction: Reduction = Reduction()
    passes: int = 100
    stalls: int = 10
    patience: float = 1.0
    shrinkage: float = 0.9
    followed: float = 0.3

    def __post_init__(self) -> None:
        for name in ("passes", "stalls"):
            check_whole(name, getattr(self, name), 1)
        check_positive("patience", self.patience)
        for name in ("shrinkage", "followed"):
            check_number(name, getattr(self, name), 0.0, 1.0)

    def shape(self, start: Start) -> ReducibleCovariance:
        """Return the distribution's shape at the beginning of a run."""
        n, first = len(start.x), start.covariance
        return self.form(n) if first is None else self.form(n, first)

    def start(self, start: Start) -> CCMAESRun:
        """Return a new run of the method."""
        return CCMAESRun(self, start)


@dataclass(eq=False)
class Offspring:
    """The samples of a generation, of which infeasible ones are drawn again.

    Attributes
    ----------
    x : array, shape (population, n)
    constraints : their values; array, shape (population, m)
    open : numbers of the samples that are infeasible, or not evaluated yet
    violation : distances of these outside bands, boundaries and bounds; array, shape (n_open,)
    passes : how often they were evaluated
    before : the distribution's shape and the records before the generation
    """

    x: Array
    constraints: Array
    open: NDArray[np.intp]
    violation: Array
    passes: int
    before: tuple[ReducibleCovariance, Array]

    @classmethod
    def of(cls, x: Array, m: int, before: tuple[ReducibleCovariance, Array]) -> Offspring:
        """Return unevaluated samples; array, shape (population, n)."""
        return cls(x, np.full((len(x), m), np.nan), np.arange(len(x)), np.zeros(len(x)), 0, before)

    @property
    def kept(self) -> NDArray[np.intp]:
        """Return the numbers of the feasible samples."""
        return np.setdiff1d(np.arange(len(self.x)), self.open)


class CCMAESRun(OptimiserRun):
    """One run of `CCMAES`. Each generation: samples, drawn again until feasible; then their objective.

    Attributes
    ----------
    bands : half widths of the equalities' bands, zero for inequalities; array, shape (m,)
    boundaries : viability boundaries of inequalities; array, shape (m,); both None before the first values
    """

    def __init__(self, settings: CCMAES, start: Start) -> None:
        n = len(start.x)
        parameters = Parameters.default(n, start.population)
        super().__init__(start, parameters, settings.shape(start), settings.patience)
        self.settings = settings
        self.bands: Array | None = None
        self.boundaries: Array | None = None
        # Of every constraint and, where there are bounds, of every variable's.
        self._records = np.zeros((len(start.equality) + n * start.bounded, n))
        self._stalled = 0
        self._next()

    @property
    def _form(self) -> ReducibleCovariance:
        return cast(ReducibleCovariance, self._es.covariance)

    @property
    def _viable(self) -> bool:
        """Return whether all boundaries have come to zero."""
        return self.boundaries is not None and not self.boundaries.any()

    # --- Samples ---

    def _sample(self) -> None:
        before = copy.deepcopy((self._form, self._records))
        self._drawn = Offspring.of(self._es.ask(), len(self._start.equality), before)
        self._ask_open()

    def _ask_open(self) -> None:
        points = self._start.inside(self._drawn.x[self._drawn.open])
        self._wait(Request(points, constraints=True), self._constraints_told)

    def _constraints_told(self, _: Array | None, constraints: Array) -> None:
        start, drawn = self._start, self._drawn
        if self.bands is None:
            self._begin_bands(constraints)
        drawn.constraints[drawn.open] = constraints
        missed = self._missed(constraints)
        if start.bounded:  # bounds are constraints that cost nothing
            x = drawn.x[drawn.open]
            missed = np.column_stack([missed, (x > start.upper) | (x < start.lower)])
        violated = missed > 0
        bad = violated.any(axis=1)
        if drawn.passes == 0:
            with np.errstate(invalid="ignore"):  # infinite values have no spread
                low, middle, high = np.quantile(np.abs(constraints), [0.25, 0.5, 0.75], axis=0)
                self._inner = middle - self.settings.followed * (high - low)
        if bad.any():
            try:
                self._learn(drawn.open[bad], violated[bad])
            except np.linalg.LinAlgError:
                self.reason = Reason.NOT_POSITIVE_DEFINITE
                return
        drawn.open = drawn.open[bad]
        drawn.passes += 1
        finite = np.where(np.isfinite(missed[bad]), np.maximum(missed[bad], 0.0), np.inf)
        drawn.violation = finite.sum(axis=1)
        if len(drawn.open) and drawn.passes <= self.settings.passes:
            self._resample()
        elif len(drawn.open) < len(drawn.x):
            self._stalled = 0
            self._evaluate()
        else:
            self._stall()

    def _stall(self) -> None:
        """Undo the generation's reductions, widen bands, and learn from the violation."""
        self._stalled += 1
        if self._stalled >= self.settings.stalls:
            self.reason = Reason.STALLED
            return
        self._es.covariance, self._records = self._drawn.before
        assert self.bands is not None
        self.bands = self.bands / self.settings.shrinkage**2
        self._es.tell(self._drawn.violation)
        self._next()

    def _resample(self) -> None:
        """Draw the infeasible samples again, from the shortened distribution."""
        es, which = self._es, self._drawn.open
        z = es.rng.standard_normal((len(which), len(es.mean)))
        es.z[which] = z
        es.y[which] = es.covariance.scaled(z)
        self._drawn.x[which] = es.mean + es.sigma * es.y[which]
        self._ask_open()

    def _begin_bands(self, constraints: Array) -> None:
        """Set bands and boundaries to hold half of the first samples."""
        equality, tolerance = self._start.equality, self._start.tolerance
        finite = np.where(np.isfinite(constraints), constraints, np.inf)
        self.bands = np.where(equality, np.maximum(np.median(np.abs(finite), axis=0), tolerance), 0.0)
        self.boundaries = np.where(equality, 0.0, np.maximum(np.median(finite, axis=0), 0.0))
        self.bands[~np.isfinite(self.bands)] = np.finfo(float).max
        self.boundaries[~np.isfinite(self.boundaries)] = np.finfo(float).max

    def _missed(self, constraints: Array) -> Array:
        """Return the distances outside bands and boundaries, infinite for NaN; array, shape (n_points, m)."""
        signed = np.where(self._start.equality, np.abs(constraints), constraints)
        assert self.bands is not None and self.boundaries is not None
        missed = signed - self.bands - self.boundaries
        return np.where(np.isnan(missed), np.inf, missed)

    def _learn(self, samples: NDArray[np.intp], violated: NDArray[np.bool_]) -> None:
        """Apply equations (5) and (6) for all violating samples, in order."""
        es, n = self._es, len(self._es.mean)
        settings = self.settings.reduction
        fading, size = settings.fading / (n + 2), settings.size / (n + 2)
        told = self._form.record(es.z[samples], es.y[samples])
        # v_j after a sequence of updates is a weighted sum: the k-th of K samples weighs c (1 - c)^(K - k).
        later = violated[::-1].cumsum(axis=0)[::-1] - violated
        weights = violated * fading * (1 - fading) ** later
        self._records *= (1 - fading) ** violated.sum(axis=0)[:, None]
        self._records += weights.T @ told
        shares = (violated / violated.sum(axis=1, keepdims=True)).sum(axis=0)
        shares = size * np.where((self._records**2).sum(axis=1) > 0, shares, 0.0)
        shares *= min(1.0, 0.5 / (shares.sum() or 1.0))  # one batch must not shorten by more than half
        self._records = self._form.reduce(self._records, shares)

    # --- Values ---

    def _evaluate(self) -> None:
        drawn = self._drawn
        if self._viable:
            points, kept = self._start.inside(drawn.x), drawn.kept
            request = Request(points[kept], objective=True, known=drawn.constraints[kept])
            self._wait(request, self._objective_told)
        else:  # on the way to viability the violation is the objective
            signed = np.where(self._start.equality, 0.0, drawn.constraints)
            missed = np.where(np.isnan(signed), np.inf, np.maximum(signed, 0.0)).sum(axis=1)
            self._rank(missed, np.zeros(len(missed)))

    def _objective_told(self, objective: Array, _: Array | None) -> None:
        drawn = self._drawn
        values, excess = np.full(len(drawn.x), np.inf), np.zeros(len(drawn.x))
        values[drawn.kept] = np.where(np.isnan(objective), np.inf, objective)
        excess[drawn.open] = drawn.violation
        self._rank(values, excess)

    def _rank(self, values: Array, excess: Array) -> None:
        """Update by samples ranked by value, then by violation; arrays, shape (population,)."""
        es = self._es
        order = np.lexsort((excess, values))
        es.tell(np.argsort(order).astype(float))  # ranks
        self._shrink(order[: es.parameters.mu])
        self._end_generation(values)

    def _shrink(self, best: NDArray[np.intp]) -> None:
        """Move boundaries towards zero and bands towards the tolerance."""
        assert self.bands is not None and self.boundaries is not None
        if not self._viable:
            signed = np.where(self._start.equality, 0.0, np.maximum(self._drawn.constraints[best], 0.0)).max(
                axis=0
            )
            halfway = np.maximum(0.0, np.minimum(self.boundaries, (signed + self.boundaries) / 2))
            self.boundaries = np.where(halfway < 1e-9 * self.boundaries.max(), 0.0, halfway)
            if not np.nan_to_num(signed).any():
                self.boundaries = np.zeros_like(self.boundaries)
            if self._viable:
                self._begin_anew()
        else:
            narrower = np.fmax(self._inner, self.settings.shrinkage * self.bands)
            narrower = np.clip(narrower, self._start.tolerance, self.bands)
            self.bands = np.where(self._start.equality, narrower, 0.0)

    def _begin_anew(self) -> None:
        start, es = self._start, self._es
        shape = self.settings.shape(start)
        self._es = CMAES(es.mean, start.sigma, start.rng, parameters=es.parameters, covariance=shape)
        self._records = np.zeros_like(self._records)


class PrintedCCMAES:
    """Algorithm 1 of the paper, exactly with equations (3), (5), (6).

    Samples are drawn again until none violates a constraint; then the distribution is adapted.

    The paper leaves its constants open: those of CMA-ES are Hansen's (arXiv 1604.00772), c_v and beta are Arnold and
    Hansen's (2012), 1/(n + 2) and 0.1/(n + 2). The factor c_mu of (3), which the paper does not list, belongs to
    c_cov. The factor 1/rho^2 in (3) belongs to other constants than these: with these, the terms that (3) adds do not
    balance those that it subtracts.

    Parameters
    ----------
    mean : array, shape (n,), mu_0
    sigma : sigma_0
    rng : source of all samples
    population : K; K_0 is half of it

    Attributes
    ----------
    mean, sigma, covariance : mu_i, sigma_i and Sigma_i
    samples : array, shape (K, n), w_k
    """

    def __init__(self, mean: Array, sigma: float, rng: np.random.Generator, population: int | None = None):
        self.mean, self.sigma, self.rng = np.array(mean, dtype=float), float(sigma), rng
        n = len(self.mean)
        self.parameters = Parameters.default(n, population)
        self.covariance = np.eye(n)
        self.fading, self.size = 1.0 / (n + 2), 0.1 / (n + 2)
        self.samples = np.zeros((self.parameters.population, n))
        self._records: Array | None = None
        self._p_sigma, self._p_c = np.zeros(n), np.zeros(n)

    def sample(self, which: NDArray[np.bool_] | None = None) -> Array:
        """Draw all samples, or only those selected by `which` (line 4).

        Raises
        ------
        LinAlgError
            If the covariance is no longer positive definite, so that no samples can be drawn.

        Returns
        -------
        array, shape (n_drawn, n)
        """
        drawn = np.ones(len(self.samples), dtype=bool) if which is None else which
        z = self.rng.standard_normal((int(drawn.sum()), len(self.mean)))
        self.samples[drawn] = self.mean + self.sigma * z @ np.linalg.cholesky(self.covariance).T
        return self.samples[drawn]

    def constrain(self, points: Array, violated: NDArray[np.bool_]) -> None:
        """Update records and covariance, equations (5) and (6), point by point.

        Parameters
        ----------
        points : array, shape (n_points, n)
        violated : array, shape (n_points, m), whether h_j > 0
        """
        if self._records is None:
            self._records = np.zeros((violated.shape[1], len(self.mean)))
        c, v = self.fading, self._records
        for w, a in zip(points[violated.any(axis=1)], violated[violated.any(axis=1)], strict=True):
            v[a] = (1 - c) * v[a] + c / self.sigma * (w - self.mean)
            unit = v[a] / np.linalg.norm(v[a], axis=1, keepdims=True)
            self.covariance -= self.size / a.sum() * unit.T @ unit

    def adapt(self, values: Array) -> None:
        """Perform lines 6 to 11 with values J(w_k), shape (K,), to minimise."""
        p = self.parameters
        alpha = p.weights[: p.mu]
        rho = 1.0 / np.sqrt((alpha**2).sum())
        best = self.samples[np.argsort(values, kind="stable")[: p.mu]]
        mean = self.mean + alpha @ (best - self.mean)
        step = (mean - self.mean) / self.sigma
        variances, axes = np.linalg.eigh(self.covariance)
        whitened = axes @ ((axes.T @ step) / np.sqrt(variances))
        self._p_sigma = (1 - p.c_sigma) * self._p_sigma + rho * np.sqrt(1 - (1 - p.c_sigma) ** 2) * whitened
        sigma = self.sigma * np.exp(
            p.c_sigma / p.d_sigma * (np.linalg.norm(self._p_sigma) / p.expected_length - 1)
        )
        self._p_c = (1 - p.c_c) * self._p_c + rho * np.sqrt(1 - (1 - p.c_c) ** 2) * step
        steps = (best - self.mean) / self.sigma
        self.covariance = (
            (1 - p.c_mu - p.c_1) * self.covariance
            + p.c_1 / rho**2 * np.outer(self._p_c, self._p_c)
            + p.c_mu * (steps.T * alpha) @ steps
        )
        self.mean, self.sigma = mean, sigma

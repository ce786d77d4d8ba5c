"""CMA-ES (Algorithm 1 of the paper) with three models of the covariance.

All models turn standard normal samples z into steps y = A z with covariance A A^T, and learn from ranked samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from comove.arrays import Array
from comove.errors import OptionError


@dataclass(frozen=True)
class Parameters:
    """Constants of one CMA-ES run. See Hansen's tutorial, arXiv 1604.00772, table 1.

    Attributes
    ----------
    n : dimension of the search space
    population : samples per generation, K
    weights : array, shape (population,), weights of the samples from best to worst; the positive ones add up to 1
    mu : number of samples with a positive weight, K_0
    mu_eff : variance-effective number of samples with a positive weight
    c_sigma, d_sigma : learning rate and damping of the step size
    c_c : learning rate of the evolution path
    c_1, c_mu : learning rates of the rank-one and the rank-mu update (c_cov and c_mu of the paper)
    """

    n: int
    population: int
    weights: Array
    mu: int
    mu_eff: float
    c_sigma: float
    d_sigma: float
    c_c: float
    c_1: float
    c_mu: float

    @classmethod
    def default(
        cls, n: int, population: int | None = None, *, active: bool = False, separable: bool = False
    ) -> Parameters:
        """Return the constants that Hansen recommends.

        Parameters
        ----------
        n
            Dimension of the search space.
        population
            Samples per generation; 4 + 3 ln n by default.
        active
            Whether bad samples get negative weights (Jastrebski and Arnold, 2006), which shortens bad directions.
        separable
            Whether only n variances are learned, faster by (n + 2)/3 (Ros and Hansen, 2008).

        Raises
        ------
        OptionError
            If the population is below 2.
        """
        population = default_population(n) if population is None else population
        if isinstance(population, bool) or int(population) != population or population < 2:
            raise OptionError(f"population = {population!r}", way_out="give a whole number, 2 or more")
        raw = np.log((population + 1) / 2) - np.log(np.arange(1, population + 1))
        mu = population // 2
        mu_eff = float(raw[:mu].sum() ** 2 / (raw[:mu] ** 2).sum())
        c_1 = 2 / ((n + 1.3) ** 2 + mu_eff)
        c_mu = min(1 - c_1, 2 * (0.25 + mu_eff - 2 + 1 / mu_eff) / ((n + 2) ** 2 + mu_eff))
        if separable:
            total = min(1.0, (n + 2) / 3 * (c_1 + c_mu))
            c_1, c_mu = total * c_1 / (c_1 + c_mu), total * c_mu / (c_1 + c_mu)
        weights = np.concatenate([raw[:mu] / raw[:mu].sum(), np.zeros(population - mu)])
        negative = raw[mu:]
        if active and negative.any():
            against = float(negative.sum() ** 2 / (negative**2).sum())
            limits = 1 + c_1 / c_mu, 1 + 2 * against / (mu_eff + 2), max(0.0, 1 - c_1 - c_mu) / (n * c_mu)
            weights[mu:] = negative / np.abs(negative).sum() * min(limits)
        c_sigma = (mu_eff + 2) / (n + mu_eff + 5)
        return cls(
            n=n,
            population=int(population),
            weights=weights,
            mu=mu,
            mu_eff=mu_eff,
            c_sigma=c_sigma,
            d_sigma=1 + 2 * max(0.0, np.sqrt((mu_eff - 1) / (n + 1)) - 1) + c_sigma,
            c_c=(4 + mu_eff / n) / (n + 4 + 2 * mu_eff / n),
            c_1=c_1,
            c_mu=c_mu,
        )

    @property
    def expected_length(self) -> float:
        """Return E|N(0, I)|, the mean length of a sample, to third order."""
        return np.sqrt(self.n) * (1 - 1 / (4 * self.n) + 1 / (21 * self.n**2))

    @property
    def lazy_gap(self) -> int:
        """Return the number of generations between decompositions of the covariance."""
        return max(1, int(0.5 / (self.n * (self.c_1 + self.c_mu) + 1e-23)))


def default_population(n: int) -> int:
    """Return the recommended number of samples per generation for n dimensions."""
    return 4 + int(3 * np.log(n))


class Covariance(Protocol):
    """A covariance that can be sampled and learned."""

    def scaled(self, z: Array) -> Array:
        """Return the steps of standard normal samples; arrays, shape (n_samples, n)."""

    def whitened(self, y: Array) -> Array:
        """Return the standard normal samples of steps, the inverse of `scaled`."""

    def learn(self, parameters: Parameters, z: Array, y: Array, path: Path) -> None:
        """Update from samples and their steps, best first; arrays, shape (population, n)."""

    def standard_deviations(self) -> Array:
        """Return the steps' standard deviations along the axes; array, shape (n,)."""

    def axis_ratio(self) -> float:
        """Return the ratio of the longest to the shortest principal axis."""

    def as_matrix(self) -> Array:
        """Return the covariance of the steps; array, shape (n, n)."""


class Path:
    """The evolution paths of one generation.

    Attributes
    ----------
    step : cumulated steps of the mean, p_c; array, shape (n,)
    whitened : cumulated whitened steps, p_sigma; array, shape (n,)
    held : whether p_c was held because p_sigma is too long
    """

    def __init__(self, n: int) -> None:
        self.step, self.whitened, self.held = np.zeros(n), np.zeros(n), False


class FullCovariance:
    """A covariance matrix, decomposed only when it has changed noticeably.

    Algorithm 1 of the paper, line 11. A is the symmetric root of the covariance.

    Parameters
    ----------
    n : dimension of the search space
    matrix : the first covariance, array, shape (n, n); the identity by default
    """

    def __init__(self, n: int, matrix: Array | None = None) -> None:
        self.matrix = np.eye(n) if matrix is None else matrix.copy()
        self.root, self.inverse_root, self.axes = np.eye(n), np.eye(n), np.ones(n)
        self._age = 0
        if matrix is not None:
            self._decompose()

    def scaled(self, z: Array) -> Array:
        return z @ self.root

    def whitened(self, y: Array) -> Array:
        return y @ self.inverse_root

    def learn(self, parameters: Parameters, z: Array, y: Array, path: Path) -> None:
        p, weights = parameters, parameters.weights
        used = len(weights) if weights[-1] < 0 else p.mu
        if used > p.mu:  # a bad sample counts by its direction, whatever its length
            weights = weights.copy()
            weights[p.mu :] *= p.n / (1e-300 + (z[p.mu :] ** 2).sum(axis=1))
        kept = 1 - p.c_1 - p.c_mu * p.weights.sum() + path.held * p.c_1 * p.c_c * (2 - p.c_c)
        self.matrix *= kept
        scaled = np.vstack([y[:used], path.step])
        rates = np.append(p.c_mu * weights[:used], p.c_1)
        self.matrix += (scaled.T * rates) @ scaled
        self._age += 1
        if self._age >= p.lazy_gap:
            self._decompose()

    def _decompose(self) -> None:
        self._age = 0
        self.matrix = 0.5 * (self.matrix + self.matrix.T)
        variances, basis = np.linalg.eigh(self.matrix)
        self.axes = np.sqrt(np.maximum(variances, 1e-28 * variances[-1]))
        self.root = (basis * self.axes) @ basis.T
        self.inverse_root = (basis / self.axes) @ basis.T

    def standard_deviations(self) -> Array:
        return np.sqrt(np.diag(self.matrix))

    def axis_ratio(self) -> float:
        return float(self.axes.max() / self.axes.min())

    def as_matrix(self) -> Array:
        return self.matrix


class DiagonalCovariance:
    """A covariance of variances along the axes only. Suits large or well-scaled spaces (Ros and Hansen, 2008).

    Parameters
    ----------
    n : dimension of the search space
    matrix : the first covariance, array, shape (n, n), of which the variances count; the identity by default
    """

    def __init__(self, n: int, matrix: Array | None = None) -> None:
        self.variances = np.ones(n) if matrix is None else np.diag(matrix).copy()

    def scaled(self, z: Array) -> Array:
        return z * np.sqrt(self.variances)

    def whitened(self, y: Array) -> Array:
        return y / np.sqrt(self.variances)

    def learn(self, parameters: Parameters, z: Array, y: Array, path: Path) -> None:
        p = parameters
        kept = 1 - p.c_1 - p.c_mu + path.held * p.c_1 * p.c_c * (2 - p.c_c)
        best = y[: p.mu]
        self.variances = (
            kept * self.variances + p.c_1 * path.step**2 + p.c_mu * (p.weights[: p.mu] @ (best * best))
        )

    def standard_deviations(self) -> Array:
        return np.sqrt(self.variances)

    def axis_ratio(self) -> float:
        return float(np.sqrt(self.variances.max() / self.variances.min()))

    def as_matrix(self) -> Array:
        return np.diag(self.variances)


class TransformationMatrix:
    """A covariance that learns its factor A, without decompositions. It is MA-ES (Beyer and Sendhoff, 2017).

    Parameters
    ----------
    n : dimension of the search space
    matrix : the first covariance, array, shape (n, n), of which A is the Cholesky factor; the identity by default
    """

    def __init__(self, n: int, matrix: Array | None = None) -> None:
        self.matrix = np.eye(n) if matrix is None else np.linalg.cholesky(matrix)

    def scaled(self, z: Array) -> Array:
        return z @ self.matrix.T

    def whitened(self, y: Array) -> Array:
        return np.asarray(np.linalg.solve(self.matrix, y.T).T, dtype=np.float64)

    def learn(self, parameters: Parameters, z: Array, y: Array, path: Path) -> None:
        p = parameters
        best = z[: p.mu]
        product = 0.5 * p.c_mu * (self.scaled(best).T * p.weights[: p.mu]) @ best
        product += 0.5 * p.c_1 * np.outer(self.scaled(path.whitened), path.whitened)
        self.matrix = (1 - 0.5 * p.c_1 - 0.5 * p.c_mu) * self.matrix + product

    def standard_deviations(self) -> Array:
        return np.sqrt((self.matrix**2).sum(axis=1))

    def axis_ratio(self) -> float:
        return float(np.linalg.cond(self.matrix))

    def as_matrix(self) -> Array:
        return self.matrix @ self.matrix.T


class CMAES:
    """A minimiser by covariance matrix adaptation, without constraints or stopping rule.

    Equations are Algorithm 1's of the paper (after Hansen, arXiv 1604.00772). Objects may be copied and pickled
    between any two calls, and continue with exactly the same samples.

    Parameters
    ----------
    mean : array, shape (n,)
        First mean.
    sigma : float
        First step size.
    rng : numpy.random.Generator
        Source of all samples.
    parameters : Parameters
        Constants; by default Hansen's.
    covariance : Covariance
        Model of the distribution's shape; by default a `FullCovariance`.

    Attributes
    ----------
    guests : points that wait for a generation; array, shape (n_points, n)

    Raises
    ------
    OptionError
        If the mean is not a vector of finite numbers, or the step size is not positive.
    """

    def __init__(
        self,
        mean: Array,
        sigma: float,
        rng: np.random.Generator,
        *,
        parameters: Parameters | None = None,
        covariance: Covariance | None = None,
    ):
        self.mean, self.sigma = check_start(mean, sigma)
        n = len(self.mean)
        self.parameters = Parameters.default(n) if parameters is None else parameters
        self.covariance: Covariance = FullCovariance(n) if covariance is None else covariance
        self.path = Path(n)
        self.generation = 0
        self.rng = rng
        self.z = self.y = np.zeros((0, n))
        self.guests = np.zeros((0, n))

    def ask(self) -> Array:
        """Draw the samples of a generation (line 4); array, shape (population, n). Points invited come first."""
        population = self.parameters.population
        self.z = self.rng.standard_normal((population, len(self.mean)))
        self.y = self.covariance.scaled(self.z)
        x = self.mean + self.sigma * self.y
        guests, self.guests = self.guests[:population], self.guests[population:]
        for i, guest in enumerate(guests):
            self.inject(i, guest)
            x[i] = guest
        return x

    def invite(self, points: Array) -> None:
        """Replace samples of the next generations by points, (n_points, n)."""
        self.guests = np.concatenate([self.guests, points])

    def whitened(self, x: Array) -> Array:
        """Return points in units z of the distribution; arrays, shape (n_points, n). x = mean + sigma A z."""
        return self.covariance.whitened((x - self.mean) / self.sigma)

    def standard_deviations(self) -> Array:
        """Return the standard deviations of the samples along the axes; array, shape (n,)."""
        return self.sigma * self.covariance.standard_deviations()

    def inject(self, index: int, x: Array) -> None:
        """Replace a sample by a point, shortened to usual lengths (Hansen, 2011)."""
        z = self.whitened(x[None])[0]
        root = np.sqrt(len(z))
        z *= min(1.0, (root + 2 * root / (len(z) + 2)) / (np.linalg.norm(z) + 1e-300))
        self.z[index] = z
        self.y[index] = self.covariance.scaled(z[None])[0]

    def tell(self, values: Array) -> None:
        """Learn from the samples' values, shape (population,); NaN ranks last. These are lines 6 to 11."""
        p, path = self.parameters, self.path
        order = np.argsort(np.where(np.isnan(values), np.inf, values), kind="stable")
        z, y = self.z[order], self.y[order]
        weights = p.weights[: p.mu]
        step = weights @ y[: p.mu]
        self.mean = self.mean + self.sigma * step
        self.generation += 1

        c = p.c_sigma
        path.whitened = (1 - c) * path.whitened + np.sqrt(c * (2 - c) * p.mu_eff) * (weights @ z[: p.mu])
        length = float(np.linalg.norm(path.whitened))
        relative = length / np.sqrt(1 - (1 - c) ** (2 * self.generation)) / p.expected_length
        path.held = bool(relative >= 1.4 + 2 / (p.n + 1))
        c = p.c_c
        path.step = (1 - c) * path.step
        if not path.held:
            path.step += np.sqrt(c * (2 - c) * p.mu_eff) * step
        self.covariance.learn(p, z, y, path)
        grown = p.c_sigma / p.d_sigma * (length / p.expected_length - 1)
        self.sigma *= float(np.exp(min(1.0, grown)))


def check_start(mean: object, sigma: object) -> tuple[Array, float]:
    """Check the first mean and step size; return the mean as an array."""
    start = numbers(mean)
    if start.ndim != 1 or not len(start) or not np.isfinite(start).all():
        raise OptionError("the first mean must be a vector of finite numbers", key="x0")
    if not isinstance(sigma, (int, float, np.number)) or not 0 < sigma < np.inf:
        raise OptionError(f"{sigma!r} is no step size", key="sigma0", way_out="give a positive number")
    return start, float(sigma)


def numbers(values: object) -> Array:
    """Convert values to a new array of floats; return a zero-dimensional NaN if that is impossible."""
    try:
        return np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return np.array(np.nan)


def check_number(key: str, value: object, least: float, most: float = np.inf) -> None:
    """Raise `OptionError` unless a value is finite and between two bounds."""
    if not _finite(value) or not least <= value <= most:  # type: ignore[operator]
        allowed = f"{least:g} or more" if most == np.inf else f"between {least:g} and {most:g}"
        raise OptionError(f"{key} = {value!r}", way_out=f"give a finite number, {allowed}")


def check_positive(key: str, value: object) -> None:
    """Raise an `OptionError` unless a value is a finite number above zero."""
    if not _finite(value) or not value > 0:  # type: ignore[operator]
        raise OptionError(f"{key} = {value!r}", way_out="give a finite number above 0")


def _finite(value: object) -> bool:
    number = isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)
    return number and bool(np.isfinite(value))  # type: ignore[call-overload]


def check_whole(key: str, value: object, least: int) -> None:
    """Raise `OptionError` unless a value is an integer, `least` or more."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
        raise OptionError(f"{key} = {value!r}", way_out=f"give a whole number, {least} or more")

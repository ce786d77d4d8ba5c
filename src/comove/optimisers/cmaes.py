"""CMA-ES (Algorithm 1 of the paper) with an interface of asking for samples and telling their values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError
from comove.optimisers.covariance import Covariance, FullCovariance, Path
from comove.optimisers.parameters import Parameters

Array = NDArray[np.float64]


class CMAES:
    """A minimiser by covariance matrix adaptation, without constraints and without a stopping rule.

    Equations are Algorithm 1's of the paper (after Hansen, arXiv 1604.00772). Objects may be copied and
    pickled between any two calls, and continue with exactly the same samples.

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

    def ask(self) -> Array:
        """Draw the samples of a generation (line 4); array, shape (population, n)."""
        self.z = self.rng.standard_normal((self.parameters.population, len(self.mean)))
        self.y = self.covariance.scaled(self.z)
        return self.mean + self.sigma * self.y

    def whitened(self, x: Array) -> Array:
        """Return points in units z of the distribution, (x - mean) = sigma A z; arrays, shape (n_points, n)."""
        return self.covariance.whitened((x - self.mean) / self.sigma)

    def standard_deviations(self) -> Array:
        """Return the standard deviations of the samples along the axes; array, shape (n,)."""
        return self.sigma * self.covariance.standard_deviations()

    def inject(self, index: int, x: Array) -> None:
        """Replace a sample by another point, moved closer if samples are rarely as far away (Hansen, 2011)."""
        z = self.whitened(x[None])[0]
        root = np.sqrt(len(z))
        z *= min(1.0, (root + 2 * root / (len(z) + 2)) / (np.linalg.norm(z) + 1e-300))
        self.z[index] = z
        self.y[index] = self.covariance.scaled(z[None])[0]

    def tell(self, values: Array) -> None:
        """Learn from the samples' values (lines 6 to 11), array of shape (population,); NaN ranks last."""
        p, path = self.parameters, self.path
        order = np.argsort(np.where(np.isnan(values), np.inf, values), kind="stable")
        z, y = self.z[order], self.y[order]
        weights = p.weights[: p.mu]
        step = weights @ y[: p.mu]
        self.mean = self.mean + self.sigma * step
        self.generation += 1

        c = p.c_sigma
        path.whitened = (1 - c) * path.whitened + np.sqrt(c * (2 - c) * p.mu_eff) * (weights @ z[: p.mu])
        length = np.linalg.norm(path.whitened)
        relative = length / np.sqrt(1 - (1 - c) ** (2 * self.generation)) / p.expected_length
        path.held = bool(relative >= 1.4 + 2 / (p.n + 1))
        c = p.c_c
        path.step = (1 - c) * path.step
        if not path.held:
            path.step += np.sqrt(c * (2 - c) * p.mu_eff) * step
        self.covariance.learn(p, z, y, path)
        self.sigma *= np.exp(min(1.0, p.c_sigma / p.d_sigma * (length / p.expected_length - 1)))


def check_start(mean: object, sigma: object) -> tuple[Array, float]:
    """Return the first mean as a new array and the first step size, after checking both."""
    try:
        start = np.array(mean, dtype=float)
    except (TypeError, ValueError):
        start = np.array(np.nan)
    if start.ndim != 1 or not len(start) or not np.isfinite(start).all():
        raise OptionError("the first mean must be a vector of finite numbers", key="x0")
    if not isinstance(sigma, (int, float, np.number)) or not 0 < sigma < np.inf:
        raise OptionError(f"{sigma!r} is no step size", key="sigma0", way_out="give a positive number")
    return start, float(sigma)

"""Strategy parameters of CMA-ES."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Parameters:
    """Constants of one CMA-ES run (Algorithm 1 of the paper; Hansen's tutorial, arXiv 1604.00772, table 1).

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
        """Return the mean length of a standard normal vector, E|N(0, I)|, to third order."""
        return np.sqrt(self.n) * (1 - 1 / (4 * self.n) + 1 / (21 * self.n**2))

    @property
    def lazy_gap(self) -> int:
        """Return the number of generations for which a decomposition of the covariance remains accurate enough."""
        return max(1, int(0.5 / (self.n * (self.c_1 + self.c_mu) + 1e-23)))


def default_population(n: int) -> int:
    """Return the recommended number of samples per generation for n dimensions."""
    return 4 + int(3 * np.log(n))

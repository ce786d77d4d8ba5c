"""Separable CMA-ES (Ros and Hansen, 2008): Algorithm 1 of the paper with a diagonal covariance."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError

Array = NDArray[np.float64]


class SeparableCMAES:
    """Ask-and-tell minimiser for well-scaled spaces.

    The constants are those of Hansen's tutorial (arXiv 1604.00772); the learning rates of the covariance are
    (n + 2)/3 times larger, as only n variances are learned.

    Parameters
    ----------
    mean : array, shape (n,)
        Where to begin.
    sigma : float
        Step size.
    rng : numpy.random.Generator
        Source of all samples.
    population : int
        Samples a generation.
    sigma_floor : float
        The root mean square step along an axis never falls below it.

    Raises
    ------
    OptionError
        If the mean is not finite, the step size not positive or the population below 4.
    """

    def __init__(
        self,
        mean: Array,
        sigma: float,
        rng: np.random.Generator,
        *,
        population: int = 16,
        sigma_floor: float = 0.0,
    ):
        self.mean = np.array(mean, dtype=float)
        if self.mean.ndim != 1 or not np.isfinite(self.mean).all():
            raise OptionError("the mean must be a vector of finite numbers", key="mean")
        if not sigma > 0:
            raise OptionError(f"sigma = {sigma}", way_out="give a positive step size")
        if population < 4:
            raise OptionError(f"population = {population}", way_out="give 4 or more")
        n = len(self.mean)
        self.sigma, self.sigma_floor, self.population = float(sigma), sigma_floor, population
        self._rng = rng
        weights = np.log((population + 1) / 2) - np.log(np.arange(1, population // 2 + 1))
        self._weights = weights / weights.sum()
        effective = 1.0 / (self._weights**2).sum()
        self._effective = effective
        self._c_sigma = (effective + 2) / (n + effective + 5)
        self._d_sigma = 1 + 2 * max(0.0, np.sqrt((effective - 1) / (n + 1)) - 1) + self._c_sigma
        self._c_c = (4 + effective / n) / (n + 4 + 2 * effective / n)
        faster = (n + 2) / 3
        c_1 = 2 / ((n + 1.3) ** 2 + effective)
        c_mu = min(1 - c_1, 2 * (effective - 2 + 1 / effective) / ((n + 2) ** 2 + effective))
        total = min(1.0, faster * (c_1 + c_mu))
        self._c_1, self._c_mu = total * c_1 / (c_1 + c_mu), total * c_mu / (c_1 + c_mu)
        self._expected = np.sqrt(n) * (1 - 1 / (4 * n) + 1 / (21 * n**2))
        self._variance, self._path_c, self._path_sigma = np.ones(n), np.zeros(n), np.zeros(n)
        self.generation = 0
        self._steps = np.zeros((population, n))

    def ask(self) -> Array:
        """Sample a generation; array, shape (population, n)."""
        self._steps = self._rng.standard_normal(self._steps.shape) * np.sqrt(self._variance)
        return self.mean + self.sigma * self._steps

    def tell(self, fitness: Array) -> None:
        """Learn from the values of the last generation, array of shape (population,); NaN ranks last."""
        order = np.argsort(np.where(np.isnan(fitness), np.inf, fitness), kind="stable")
        best = self._steps[order[: len(self._weights)]]
        step = self._weights @ best
        self.mean = self.mean + self.sigma * step
        self.generation += 1

        c = self._c_sigma
        self._path_sigma = (1 - c) * self._path_sigma + np.sqrt(c * (2 - c) * self._effective) * (
            step / np.sqrt(self._variance)
        )
        length = np.linalg.norm(self._path_sigma)
        self.sigma *= np.exp(c / self._d_sigma * (length / self._expected - 1))

        n, c = len(self.mean), self._c_c
        stalled = (
            length / np.sqrt(1 - (1 - self._c_sigma) ** (2 * self.generation))
            >= (1.4 + 2 / (n + 1)) * self._expected
        )
        hold = 0.0 if stalled else 1.0
        self._path_c = (1 - c) * self._path_c + hold * np.sqrt(c * (2 - c) * self._effective) * step
        self._variance = (
            (1 - self._c_1 - self._c_mu + (1 - hold) * self._c_1 * c * (2 - c)) * self._variance
            + self._c_1 * self._path_c**2
            + self._c_mu * (self._weights @ best**2)
        )
        step_size = self.sigma * np.sqrt(self._variance.mean())
        self.sigma *= max(1.0, self.sigma_floor / step_size)

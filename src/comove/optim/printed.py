"""Algorithm 1 of the paper with its equations (3), (5) and (6), line by line, without any addition."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.optim.cmaes import Parameters


class PrintedCCMAES:
    """A run of the algorithm: sample, constrain and draw again until no sample violates a constraint, then adapt.

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
        """Update the records, equation (5), and the covariance, equation (6), point by point.

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
        """Carry out lines 6 to 11 with the values J(w_k), which are to be minimised; array, shape (K,)."""
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

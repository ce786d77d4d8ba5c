"""Three models of the covariance of the search distribution of CMA-ES.

All turn standard normal samples z into steps y = A z with covariance A A^T, and learn from ranked samples.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from comove.optimisers.parameters import Parameters

Array = NDArray[np.float64]


class Covariance(Protocol):
    """A covariance that can be sampled and learned."""

    def scaled(self, z: Array) -> Array:
        """Return the steps of standard normal samples; arrays, shape (n_samples, n)."""

    def whitened(self, y: Array) -> Array:
        """Return the standard normal samples of steps, the inverse of `scaled`."""

    def learn(self, parameters: Parameters, z: Array, y: Array, path: Path) -> None:
        """Update from samples and their steps, best first; arrays, shape (population, n)."""

    def standard_deviations(self) -> Array:
        """Return the standard deviations of the steps along the axes of the search space; array, shape (n,)."""

    def axis_ratio(self) -> float:
        """Return the ratio of the longest to the shortest principal axis."""


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
    """A covariance matrix that is decomposed only as often as it changes noticeably.

    Algorithm 1 of the paper, line 11. A is the symmetric root of the covariance.
    """

    def __init__(self, n: int) -> None:
        self.matrix = np.eye(n)
        self.root, self.inverse_root, self.axes = np.eye(n), np.eye(n), np.ones(n)
        self._age = 0

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


class DiagonalCovariance:
    """A covariance that has variances along the axes only (Ros and Hansen, 2008): for large or well-scaled spaces."""

    def __init__(self, n: int) -> None:
        self.variances = np.ones(n)

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


class TransformationMatrix:
    """A covariance whose factor A itself is learned, without any decomposition (MA-ES; Beyer and Sendhoff, 2017)."""

    def __init__(self, n: int) -> None:
        self.matrix = np.eye(n)

    def scaled(self, z: Array) -> Array:
        return z @ self.matrix.T

    def whitened(self, y: Array) -> Array:
        return np.linalg.solve(self.matrix, y.T).T

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

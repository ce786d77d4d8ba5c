"""The domain and the prior distribution of a search."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.errors import ComoveWarning, OptionError
from comove.optim.cmaes import numbers


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of all variables; equal ones fix a variable, of which a run knows nothing.

    Attributes
    ----------
    lower, upper : lowest and highest x, infinite where there is no bound; arrays, shape (n,)
    """

    lower: Array
    upper: Array

    @classmethod
    def checked(cls, bounds: tuple[object, object] | None, n: int) -> Bounds:
        """Return those of a pair of bounds, numbers or arrays; raise `OptionError` if they are none."""
        try:
            ends = (np.asarray(bound, dtype=np.float64) for bound in bounds or (-np.inf, np.inf))
            lower, upper = (np.broadcast_to(bound, (n,)).copy() for bound in ends)
        except (TypeError, ValueError):
            lower, upper = np.full(n, np.nan), np.full(n, np.nan)
        if not ((lower <= upper) & (lower < np.inf) & (upper > -np.inf)).all():
            raise OptionError(
                "bounds must be a lower and a higher end for every variable, or the same twice to fix it",
                key="bounds",
                way_out=f"give a pair of numbers, or of arrays of shape ({n},), -inf or inf where there is no bound",
            )
        return cls(lower, upper)

    @property
    def free(self) -> NDArray[np.bool_]:
        """Return which variables are not fixed; array, shape (n,)."""
        return self.lower < self.upper

    def nearest(self, x: Array) -> Array:
        """Return the nearest points inside; arrays, shape (.., n)."""
        return np.clip(x, self.lower, self.upper)

    def holds(self, x: Array) -> NDArray[np.bool_]:
        """Return which points lie inside; arrays, shapes (.., n) -> (..)."""
        return np.asarray(((x >= self.lower) & (x <= self.upper)).all(axis=-1))

    def whole(self, x: Array) -> Array:
        """Return points with the fixed variables at their values; arrays, (.., n_free) -> (.., n)."""
        whole = np.broadcast_to(self.lower, (*x.shape[:-1], len(self.lower))).copy()
        whole[..., self.free] = x
        return whole

    def uniform(self, share: Array, otherwise: Array) -> Array:
        """Return a point at shares of the ranges; array, shape (n,).

        Where a range has no end, the value is that of `otherwise`.
        """
        with np.errstate(invalid="ignore"):
            within = self.lower + share * (self.upper - self.lower)
        return np.where(np.isfinite(self.lower) & np.isfinite(self.upper), within, otherwise)

    def warn_outside(self, x: Array) -> None:
        """Warn if a first mean, array of shape (n,), lies outside."""
        away = np.maximum(self.lower - x, x - self.upper)
        i = int(np.argmax(away))
        if away[i] > 0 and self.free[i]:
            warnings.warn(
                f"x0[{i}] = {x[i]:g} lies outside its bounds, {self.lower[i]:g} to {self.upper[i]:g}: the search "
                "begins at the nearest point inside",
                ComoveWarning,
                stacklevel=3,
            )


@dataclass(frozen=True, eq=False)
class Prior:
    """The normal distribution that the caller expects the optimum in.

    Attributes
    ----------
    mean : array, shape (n,)
    sigma : step size
    covariance : in units of sigma^2; array, shape (n, n), None for the identity
    """

    mean: Array
    sigma: float
    covariance: Array | None

    def at(self, normal: Array, spread: float) -> Array:
        """Return the point of standard normal numbers; array, shape (n,).

        It is `spread` times as far from the mean.
        """
        drawn = normal if self.covariance is None else np.linalg.cholesky(self.covariance) @ normal
        return self.mean + spread * self.sigma * drawn


def checked_covariance(covariance: object, n: int) -> Array:
    """Return a covariance as a symmetric, positive definite array, shape (n, n)."""
    matrix = numbers(covariance)
    matrix = np.diag(matrix) if matrix.shape == (n,) else matrix
    good = matrix.shape == (n, n) and np.isfinite(matrix).all() and np.allclose(matrix, matrix.T, rtol=1e-9)
    if not good or not np.linalg.eigvalsh(matrix)[0] > 0:
        raise OptionError(
            f"a covariance of shape {matrix.shape} that is none",
            key="covariance",
            way_out=f"give {n} positive variances, or a symmetric positive definite matrix ({n}, {n})",
        )
    return 0.5 * (matrix + matrix.T)

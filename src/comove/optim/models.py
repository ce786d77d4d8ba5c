"""Linear models of objective and constraints, learned from evaluated points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.optim.cmaes import CMAES, FullCovariance

UNKNOWN = 1e-200  # slopes below are no slopes


@dataclass(frozen=True)
class Local:
    """Linear models, value + slope z, in units z of the distribution.

    Attributes
    ----------
    value : array, shape (n_outputs,)
    slope : array, shape (n_outputs, n)
    residual : residuals at the points to which the model was fitted; array, shape (n_points, n_outputs)
    inflation : factor by which residuals underestimate errors, because the slopes were fitted to the same points
    """

    value: Array
    slope: Array
    residual: Array
    inflation: float


class LinearModel:
    """A linear model whose slopes change least to explain new points.

    A block form of Broyden's update (1965) in the metric of the search distribution: the slope stays in directions
    about which the newest points give no information. Picklable.

    Parameters
    ----------
    n, n_outputs : numbers of variables and of modelled outputs
    capacity : number of points that are stored
    near : squared distance a dimension, in units of the distribution, at which a point counts half
    rank : share of the largest singular value below which others carry no slope

    Attributes
    ----------
    points : stored points, the newest `capacity`; array, shape (n_points, n)
    """

    def __init__(self, n: int, n_outputs: int, capacity: int, near: float = 4.0, rank: float = 1e-3) -> None:
        self.capacity, self.near, self.rank = capacity, near, rank
        self.points = np.zeros((0, n))
        self._values = np.zeros((0, n_outputs))
        self._slope = np.zeros((n_outputs, n))

    def add(self, x: Array, values: Array) -> None:
        """Store evaluated points; arrays, shapes (n_points, n), (n_points, n_outputs).

        Points with values that are not finite are left out.
        """
        finite = np.isfinite(values).all(axis=1)
        self.points = np.vstack([self.points, x[finite]])[-self.capacity :]
        self._values = np.vstack([self._values, values[finite]])[-self.capacity :]

    def __len__(self) -> int:
        return len(self.points)

    def around(self, whitened: Array, unwhiten: Array, whiten: Array) -> Local:
        """Fit linear models to the stored points.

        Parameters
        ----------
        whitened
            The stored points in units of the distribution; array, shape (n_points, n).
        unwhiten, whiten
            Matrices from these units to the space of x and back; arrays, shape (n, n).
        """
        z, values = whitened, self._values
        n = z.shape[1]
        weight = 1.0 / (1.0 + (z**2).sum(axis=1) / (self.near * n))
        share = weight / weight.sum()
        root = np.sqrt(weight)[:, None]
        slope = self._slope @ unwhiten
        residual = values - z @ slope.T
        mean, center = share @ residual, share @ z
        correction = np.linalg.lstsq(root * (z - center), root * (residual - mean), rcond=self.rank)[0]
        residual = residual - mean - (z - center) @ correction
        slope = slope + correction.T
        self._slope = slope @ whiten
        freedom = len(z) - n - 1
        inflation = np.sqrt(len(z) / freedom) if freedom > 0 else 3.0
        return Local(mean - center @ correction, slope, residual, inflation)

    def around_mean(self, es: CMAES) -> Local:
        """Fit linear models `around` the mean of a search with a `FullCovariance`."""
        shape, sigma = es.covariance, es.sigma
        assert isinstance(shape, FullCovariance)
        return self.around(es.whitened(self.points), sigma * shape.root, shape.inverse_root / sigma)


def bound_rows(root: Array, mean: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return finite bounds as constraints c + G z <= 0.

    x = mean + root z. The rows G have unit length; c holds the violations at the mean.
    """
    length = np.sqrt((root**2).sum(axis=1))
    unit = root / length[:, None]
    above, below = np.isfinite(upper), np.isfinite(lower)
    rows = np.vstack([unit[above], -unit[below]])
    return rows, np.concatenate([((mean - upper) / length)[above], ((lower - mean) / length)[below]])


@kernel
def nearest_feasible(rows: Array, missed: Array, free: NDArray[np.bool_]) -> Array:
    """Compute multipliers l of the shortest step d = -G^T l. The step leads onto {z : c + G z <= 0}.

    The dual of a least-distance programme is solved by the active-set method of Lawson and Hanson (1974), slightly
    regularised so that contradicting constraints give a compromise.

    Parameters
    ----------
    rows
        G, rows of unit length (or zero); array, shape (m, n).
    missed
        c, violation of each constraint at the start; array, shape (m,).
    free
        Which constraints are equalities, with multipliers of either sign; array, shape (m,).
    """
    m, n = rows.shape
    multipliers = np.zeros(m)
    active = free.copy()
    for _ in range(3 * m + 10):
        while True:
            chosen = np.nonzero(active)[0]
            p = len(chosen)
            if p == 0:
                break
            system, right = np.empty((p, p)), np.empty(p)
            for i in range(p):
                right[i] = missed[chosen[i]]
                for j in range(i + 1):
                    product = 0.0
                    for k in range(n):
                        product += rows[chosen[i], k] * rows[chosen[j], k]
                    system[i, j] = system[j, i] = product
                system[i, i] += 1e-10
            wanted = np.linalg.solve(system, right)
            step = 1.0
            for i in range(p):
                old = multipliers[chosen[i]]
                if not free[chosen[i]] and wanted[i] <= 0.0:
                    step = min(step, old / (old - wanted[i]) if old > wanted[i] else 0.0)
            for i in range(p):
                j = chosen[i]
                multipliers[j] += step * (wanted[i] - multipliers[j])
                if step < 1.0 and not free[j] and multipliers[j] <= 1e-15:
                    multipliers[j] = 0.0
                    active[j] = False
            if step >= 1.0:
                break
        worst, worst_left = -1, 1e-10
        moved = np.zeros(n)
        for j in range(m):
            if active[j]:
                for k in range(n):
                    moved[k] -= multipliers[j] * rows[j, k]
        for j in range(m):
            if not active[j]:
                left = missed[j]
                for k in range(n):
                    left += rows[j, k] * moved[k]
                if left > worst_left:
                    worst, worst_left = j, left
        if worst < 0:
            break
        active[worst] = True
    return multipliers

"""Estimation of a Gaussian over movements, from few of them.

Of n movements the sample covariance has rank n - 1 at most: it allows nothing but mixtures of the recordings, and
says that instants far apart hang together by chance. So it is tapered, as covariances of small ensembles are in
weather forecasts (Hamill, Whitaker and Snyder, 2001): the sample covariance of the positions at two instants is
multiplied by a correlation that falls with the time between them,

    C(s, s') = S(s, s') k(|s - s'| / length),   k(r) = (1 + r + r^2 / 3) exp(-r)   (Matern, 5/2).

What is known best stays as it was: the variances at every instant, and the covariances between coordinates and hands
at one instant. The product is positive (Schur). The length is the one under which movements that are left out in
turn are most likely. All variances are those of the next movement, given that mean and variance are known from n
movements only (the moments of Student's predictive distribution): S (1 + 1/n) (n - 1) / (n - 3).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from comove.primitives.alignment import WarpingSettings

Array = NDArray[np.float64]

RIDGE = 1e-9  # of a regression on contexts, relative


@dataclass(frozen=True)
class EstimationSettings:
    """Settings of how a distribution is learned from few movements.

    Attributes
    ----------
    lengths : lengths of the taper that are tried in turn [durations]
    usual_length : length of the taper where movements are too few to leave one out [durations]
    n_choosing : number of movements from which on the length is chosen
    n_folds : groups of movements that are left out in turn at most
    noise : least standard deviation of the noise in positions, as a share of the movement's extent
    warping : settings of the alignment by warping
    """

    lengths: tuple[float, ...] = (0.1, 0.17, 0.3, 0.5, 0.9, 1.6, 3.0, 6.0)
    usual_length: float = 0.3
    n_choosing: int = 4
    n_folds: int = 10
    noise: float = 1e-4
    warping: WarpingSettings = field(default_factory=WarpingSettings)


USUAL = EstimationSettings()
"""The settings unless others are given."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """A Gaussian over positions at even instants, whose mean is linear in a context.

    Attributes
    ----------
    mean : array, shape (n_values,), at the context 0
    covariance : array, shape (n_values, n_values)
    slopes : array, shape (n_context, n_values), change of the mean with the context
    length : length of the taper [durations]
    chosen : whether the length was chosen by leaving movements out
    """

    mean: Array
    covariance: Array
    slopes: Array
    length: float
    chosen: bool


def estimate(
    values: Array,
    contexts: Array,
    noise: Array,
    n_columns: int,
    settings: EstimationSettings = USUAL,
) -> Estimate:
    """Estimate a Gaussian over the positions of movements.

    Parameters
    ----------
    values : array, shape (n, n_columns * n_steps), positions of n movements at even instants, column after column
    contexts : array, shape (n, n_context), less their mean; n_context = 0 for none
    noise : array, shape (n_columns * n_steps,), standard deviation of the noise in the values
    n_columns : number of coordinates
    settings : how the length of the taper is chosen
    """
    n, n_steps = len(values), values.shape[1] // n_columns
    mean, slopes, sample = regression(values, contexts)
    length, chosen = settings.usual_length, n - contexts.shape[1] >= settings.n_choosing
    if chosen:
        tapers = [taper(n_steps, n_columns, length) for length in settings.lengths]
        scores = np.zeros(len(tapers))
        for fold in np.array_split(np.arange(n), min(n, settings.n_folds)):
            kept = np.setdiff1d(np.arange(n), fold)
            centre, slope, of_kept = regression(values[kept], contexts[kept])
            away = values[fold] - centre - contexts[fold] @ slope
            of_kept = of_kept * widening(len(kept), contexts.shape[1])
            scores += [_log_density(of_kept * tapered, noise, away) for tapered in tapers]
        length = settings.lengths[int(np.argmax(scores))]
    covariance = widening(n, contexts.shape[1]) * sample * taper(n_steps, n_columns, length)
    return Estimate(mean, covariance, slopes, length, chosen)


def regression(values: Array, contexts: Array) -> tuple[Array, Array, Array]:
    """Return mean at the context 0, slopes and residual covariance of a linear regression."""
    n, n_context = contexts.shape
    middle, centre = values.mean(axis=0), contexts.mean(axis=0)
    away = contexts - centre
    square = away.T @ away
    square[np.diag_indices(n_context)] += RIDGE * max(float(np.trace(square)), 1e-300)
    slopes = np.zeros((0, len(middle)))
    if n_context:
        slopes = np.linalg.solve(square, away.T @ (values - middle))
    left = values - middle - away @ slopes
    return middle - centre @ slopes, slopes, left.T @ left / max(n - 1 - n_context, 1)


def widening(n: int, n_context: int = 0) -> float:
    """Return the ratio of the variance of the next movement to the sample variance of n movements.

    Four degrees of freedom are assumed at least, as two would make the variance infinite.
    """
    freedom = max(n - 1 - n_context, 4)
    return (1.0 + 1.0 / n) * freedom / (freedom - 2)


def taper(n_steps: int, n_columns: int, length: float) -> Array:
    """Return the correlation k of even instants, for all pairs of columns; column after column."""
    s = np.linspace(0.0, 1.0, n_steps)
    r = np.abs(s[:, None] - s) / length
    return np.tile((1.0 + r + r**2 / 3.0) * np.exp(-r), (n_columns, n_columns))


def _log_density(covariance: Array, noise: Array, away: Array) -> float:
    """Return the log density, less a constant, of deviations from the mean that are seen with noise."""
    total = covariance + np.diag(noise**2)
    root = np.linalg.cholesky(total)
    white = np.linalg.solve(root, away.T)
    return float(-0.5 * (white**2).sum() - len(away) * np.log(np.diag(root)).sum())

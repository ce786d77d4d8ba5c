"""Estimation of a Gaussian over movements, from few of them.

Of n movements the sample covariance has rank n - 1 at most: it allows only mixtures of the recordings, and correlates
distant instants by chance. So it is tapered, as covariances of small ensembles are in weather forecasts (Hamill,
Whitaker and Snyder, 2001): the sample covariance of the positions at two instants is multiplied by a correlation that
falls with the time between them,

    C(s, s') = S(s, s') k(|s - s'| / length),   k(r) = (1 + r + r^2 / 3) exp(-r)   (Matern, 5/2).

The best-known values stay the same: the variances at every instant, and the covariances between coordinates and end
effectors at one instant. The product is positive (Schur). The length is the one under which movements that are left
out in turn are most likely. All variances are those of the next movement, given that mean and variance are known from
n movements only (the moments of Student's predictive distribution): S (1 + 1/n) (n - 1) / (n - 3).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.alignment import Alignment, WarpingSettings
from comove.dmp.arguments import numbers, require_numbers, require_positive
from comove.dmp.basis import MotionBasis
from comove.errors import OptionError

N_ENDS = 4  # parameters of a coordinate that are boundary values: start, start velocity, goal, goal velocity


@dataclass(frozen=True)
class EstimationSettings:
    """Settings of learning a distribution from few movements.

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

    def __post_init__(self) -> None:
        require_numbers(self)
        if self.n_folds < 2:
            raise OptionError(f"n_folds = {self.n_folds}", key="n_folds", way_out="give 2 or more")
        if not self.lengths:
            raise OptionError("there are no lengths", key="lengths", way_out="give one or more [durations]")
        for length in self.lengths:
            require_positive("lengths", length)


USUAL = EstimationSettings()
"""The settings unless others are given."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """A Gaussian over positions at even instants; linear in a context.

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


def regression(values: Array, contexts: Array, ridge: float = 1e-9) -> tuple[Array, Array, Array]:
    """Return mean, slopes and residual covariance of a ridge regression. The mean is that at context 0."""
    n, n_context = contexts.shape
    middle, centre = values.mean(axis=0), contexts.mean(axis=0)
    away = contexts - centre
    square = away.T @ away
    square[np.diag_indices(n_context)] += ridge * max(float(np.trace(square)), 1e-300)
    slopes = np.zeros((0, len(middle)))
    if n_context:
        slopes = np.linalg.solve(square, away.T @ (values - middle))
    left = values - middle - away @ slopes
    return middle - centre @ slopes, slopes, left.T @ left / max(n - 1 - n_context, 1)


def widening(n: int, n_context: int = 0) -> float:
    """Return the ratio of predictive to sample variance of n movements.

    Four degrees of freedom are assumed at least, as two would make the variance infinite.
    """
    freedom = max(n - 1 - n_context, 4)
    return (1.0 + 1.0 / n) * freedom / (freedom - 2)


def taper(n_steps: int, n_columns: int, length: float) -> Array:
    """Return the correlations k of even instants, column after column."""
    s = np.linspace(0.0, 1.0, n_steps)
    r = np.abs(s[:, None] - s) / length
    return np.tile((1.0 + r + r**2 / 3.0) * np.exp(-r), (n_columns, n_columns))


def _log_density(covariance: Array, noise: Array, away: Array) -> float:
    """Return the log density of noisy deviations, up to a constant."""
    total = covariance + np.diag(noise**2)
    root = np.linalg.cholesky(total)
    white = np.linalg.solve(root, away.T)
    return float(-0.5 * (white**2).sum() - len(away) * np.log(np.diag(root)).sum())


def features(basis: MotionBasis, s: Array) -> Array:
    """Return psi: position, velocity and acceleration by unit parameters. They are in unit duration.

    Returns
    -------
    array, shape (3, n_steps, 4 + n_basis)
    """
    return np.concatenate(basis.at(s), axis=2)


def fitted_parameters(basis: MotionBasis, s: Array, position: Array) -> tuple[Array, Array]:
    """Return a recording's parameters, shape (n_columns, 4 + n_basis), and errors."""
    parameters = (solver(basis, s) @ position).T
    error = np.sqrt(((position - features(basis, s)[0] @ parameters.T) ** 2).mean(axis=0))
    return parameters, error


def solver(basis: MotionBasis, s: Array, ridge: float = 1e-7) -> Array:
    """Return the matrix from positions at shares `s` to parameters.

    The parameters are those of the nearest movement. Both ends are those of the first and the last position exactly.
    `ridge` is that of the fit, relative to the share of the duration.

    Returns
    -------
    array, shape (4 + n_basis, n_steps)
    """
    psi, free = features(basis, s)[0], np.r_[1, 3 : N_ENDS + basis.n_basis]
    share = np.gradient(s)[:, None]  # of the course: uneven samples count by the time that they stand for
    weighted = psi[:, free] * share
    square = weighted.T @ psi[:, free]
    square[np.diag_indices(len(free))] += ridge * share.sum()
    solver, ends = np.zeros((psi.shape[1], len(s))), np.zeros((2, len(s)))
    ends[0, 0], ends[1, -1] = 1.0, 1.0
    solver[[0, 2]] = ends
    solver[free] = np.linalg.solve(square, weighted.T)
    solver[free] -= np.linalg.solve(square, weighted.T @ psi[:, [0, 2]]) @ ends
    return solver


def without_noise(covariance: Array, least: float) -> Array:
    """Return a covariance with zeros for standard deviations below `least`."""
    varies = np.diag(covariance) > least**2
    return np.where(np.outer(varies, varies), 0.5 * (covariance + covariance.T), 0.0)


def checked_contexts(contexts: ArrayLike | None, n: int) -> Array:
    """Return n recordings' contexts, shape (n, n_context), checked. None have n_context = 0."""
    if contexts is None:
        return np.zeros((n, 0))
    array = numbers(contexts)
    array = array[:, None] if array.ndim == 1 else array
    if array.ndim != 2 or len(array) != n or not np.isfinite(array).all():
        raise OptionError(
            f"contexts of shape {array.shape} for {n} recordings",
            way_out="give finite numbers for each of them",
        )
    if n < array.shape[1] + 2:
        raise OptionError(
            f"{array.shape[1]} task parameters of {n} recordings",
            key="contexts",
            way_out=f"give {array.shape[1] + 2} recordings or more",
        )
    still = np.flatnonzero(np.ptp(array, axis=0) == 0)
    if still.size:
        raise OptionError(
            f"the task parameter {still[0]} is the same in all recordings",
            key="contexts",
            way_out="leave it out",
        )
    return array


def notes_of(durations: Array, alignment: Alignment, gaussian: Estimate, wider: float) -> tuple[str, ...]:
    """Return in words how a distribution was learned."""
    times = f"{durations.min():.4g} to {durations.max():.4g} s"
    how = "equal shares of their durations" if alignment is Alignment.DURATION else "equal places, by warping"
    why = "chosen by leaving recordings out in turn"
    if not gaussian.chosen:
        why = "for there are too few recordings to choose"
    return (
        f"{len(durations)} recordings of {times}, aligned at {how}",
        f"correlations over time tapered over {gaussian.length:g} of the duration, {why}",
        f"variances widened by {wider:.3g}, for {len(durations)} recordings tell no more of the next one",
    )

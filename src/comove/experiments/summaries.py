"""Summaries of measured values: confidence intervals, by Wilson and by the bootstrap, and tables in Markdown."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.stats import norm

Array = NDArray[np.float64]

CONFIDENCE = 0.95
RESAMPLES = 2000
SEED = 0  # of all resamples


class Interval(NamedTuple):
    """An estimate with its confidence interval of level `CONFIDENCE`; NaN if there are no values."""

    value: float
    low: float
    high: float


NOTHING = Interval(np.nan, np.nan, np.nan)


def wilson(successes: int, n: int) -> Interval:
    """Return the share of successes, with Wilson's score interval (1927)."""
    if n == 0:
        return NOTHING
    z, p = float(norm.ppf(0.5 + CONFIDENCE / 2)), successes / n
    middle = (p + z * z / (2 * n)) / (1 + z * z / n)
    half = z / (1 + z * z / n) * sqrt(p * (1 - p) / n + z * z / (4 * n * n))
    return Interval(p, max(0.0, middle - half), min(1.0, middle + half))


def median(values: ArrayLike) -> float:
    """Return the median of values that may be infinite; array, shape (n,), n > 0."""
    return float(_medians(np.asarray(values, dtype=float)[None])[0])


def median_interval(values: ArrayLike) -> Interval:
    """Return the median, with a bootstrap interval; values may be infinite.

    Parameters
    ----------
    values : array, shape (n,), independent of each other: one per scene
    """
    return _bootstrapped(np.asarray(values, dtype=float), _medians)


def mean_interval(values: ArrayLike) -> Interval:
    """Return the mean, with a bootstrap interval; array, shape (n,)."""
    return _bootstrapped(np.asarray(values, dtype=float), lambda drawn: drawn.mean(axis=1))


def _bootstrapped(values: Array, of: Callable[[Array], Array]) -> Interval:
    values = values[~np.isnan(values)]
    if not len(values):
        return NOTHING
    rng = np.random.default_rng(SEED)
    drawn = values[rng.integers(len(values), size=(RESAMPLES, len(values)))]
    low, high = _tails(of(drawn))
    return Interval(float(of(values[None])[0]), low, high)


def _medians(rows: Array) -> Array:
    """Return the median of every row; infinite if one of the two middle values is."""
    rows = np.sort(rows, axis=1)
    n = rows.shape[1]
    low, high = rows[:, (n - 1) // 2], rows[:, n // 2]
    return np.where(np.isinf(high), high, 0.5 * (low + np.where(np.isinf(high), 0.0, high)))


def _tails(values: Array) -> tuple[float, float]:
    """Return the quantiles of resamples without interpolation, because the resamples may be infinite."""
    outside = 0.5 * (1 - CONFIDENCE)
    low, high = np.quantile(values, [outside, 1 - outside], method="inverted_cdf")
    return float(low), float(high)


def slope_interval(x: ArrayLike, times: ArrayLike) -> Interval:
    """Return the exponent e of ``time ~ x^e``: the slope of the line through the medians on logarithmic axes.

    Parameters
    ----------
    x : array, shape (n_points,), positive
    times : array, shape (n_points, n_repeats), positive
    """
    log_x, measured = np.log(np.asarray(x, dtype=float)), np.asarray(times, dtype=float)
    rng = np.random.default_rng(SEED)
    picked = rng.integers(measured.shape[1], size=(RESAMPLES, *measured.shape))
    drawn = np.median(np.take_along_axis(measured[None], picked, axis=2), axis=2)
    medians = np.concatenate([np.median(measured, axis=1)[None], drawn])
    centred = log_x - log_x.mean()
    slopes = np.log(medians) @ centred / (centred @ centred)
    low, high = _tails(slopes[1:])
    return Interval(float(slopes[0]), low, high)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table with one line per row.

    >>> print(table(["system", "runs"], [["comove", "50"]]))
    | system | runs |
    | --- | --- |
    | comove | 50 |
    """
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *rows))

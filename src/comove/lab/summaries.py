"""Summaries of measured values: confidence intervals and Markdown tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import binomtest

from comove.arrays import Array, Integers

CONFIDENCE = 0.95


class Interval(NamedTuple):
    """Estimate with its confidence interval of level `CONFIDENCE`. It is NaN if there are no values."""

    value: float
    low: float
    high: float


NOTHING = Interval(np.nan, np.nan, np.nan)


def wilson(successes: int, n: int) -> Interval:
    """Return the share of successes, with Wilson's score interval (1927)."""
    if n == 0:
        return NOTHING
    interval = binomtest(successes, n).proportion_ci(CONFIDENCE, "wilson")
    return Interval(successes / n, float(interval.low), float(interval.high))


def median_interval(values: ArrayLike) -> Interval:
    """Return the median, with a bootstrap interval; values may be infinite.

    Parameters
    ----------
    values : array, shape (n,), independent of each other: one per scene
    """
    return _bootstrapped(np.asarray(values, dtype=float), lambda drawn: np.median(drawn, axis=1))


def mean_interval(values: ArrayLike) -> Interval:
    """Return the mean, with a bootstrap interval; array, shape (n,)."""
    return _bootstrapped(np.asarray(values, dtype=float), lambda drawn: drawn.mean(axis=1))


def _bootstrapped(values: Array, of: Callable[[Array], Array]) -> Interval:
    values = values[~np.isnan(values)]
    if not len(values):
        return NOTHING
    low, high = _tails(of(values[_picked(len(values), values.shape)]))
    return Interval(float(of(values[None])[0]), low, high)


def _picked(count: int, shape: tuple[int, ...], resamples: int = 2000, seed: int = 0) -> Integers:
    """Return numbers below `count` for every resample; array, shape (resamples, *shape)."""
    rng = np.random.default_rng(seed)
    return rng.integers(count, size=(resamples, *shape))


def _tails(values: Array) -> tuple[float, float]:
    """Return quantiles of resamples, which may be infinite, without interpolation."""
    outside = 0.5 * (1 - CONFIDENCE)
    low, high = np.quantile(values, [outside, 1 - outside], method="inverted_cdf")
    return float(low), float(high)


def slope_interval(x: ArrayLike, times: ArrayLike) -> Interval:
    """Return the exponent e of ``time ~ x^e`` with its interval. It is the slope of the line through the medians on
    logarithmic axes.

    Parameters
    ----------
    x : array, shape (n_points,), positive
    times : array, shape (n_points, n_repeats), positive
    """
    log_x, measured = np.log(np.asarray(x, dtype=float)), np.asarray(times, dtype=float)
    picked = _picked(measured.shape[1], measured.shape)
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

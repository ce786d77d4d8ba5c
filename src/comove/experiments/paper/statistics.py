"""Medians with their intervals, and shares with theirs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

N_RESAMPLES = 10_000
LEVEL = 0.95
QUANTILE = 1.959963984540054  # of the normal distribution, for an interval of that level


class Interval(NamedTuple):
    """A value and the ends of its interval, all in the unit of what was given."""

    value: float
    low: float
    high: float


def median_interval(values: ArrayLike, *, seed: int = 0, level: float = LEVEL) -> Interval:
    """Median with its bootstrap interval (percentiles of the medians of resamples).

    Parameters
    ----------
    values : array, shape (n,), in any unit; nothing but numbers, at least one
    seed : of the resamples
    level : share of the resamples' medians that the interval holds
    """
    values = np.asarray(values, dtype=float)
    rng = np.random.default_rng(seed)
    drawn = rng.integers(0, len(values), (N_RESAMPLES, len(values)))
    low, high = np.quantile(np.median(values[drawn], axis=1), [0.5 - level / 2, 0.5 + level / 2])
    return Interval(float(np.median(values)), float(low), float(high))


def share_interval(successes: int, trials: int) -> Interval:
    """Share of successes with its 95 % interval after Wilson, which says something where all of few succeed, too."""
    share, z = successes / trials, QUANTILE
    middle = (share + z**2 / (2 * trials)) / (1 + z**2 / trials)
    reach = z / (1 + z**2 / trials) * np.sqrt(share * (1 - share) / trials + z**2 / (4 * trials**2))
    return Interval(share, min(share, float(middle - reach)), max(share, float(middle + reach)))

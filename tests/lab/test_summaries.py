"""Intervals hold what they should, by published values and by simulation."""

import numpy as np
import pytest

from comove.lab.summaries import mean_interval, median_interval, slope_interval, wilson


@pytest.mark.parametrize(
    ("successes", "n", "low", "high"),
    [(81, 263, 0.2553, 0.3662), (15, 148, 0.0624, 0.1605), (0, 20, 0.0, 0.1611), (1, 29, 0.0061, 0.1718)],
)
def test_wilson_values_of_newcombe(successes, n, low, high):
    """Newcombe, Statistics in Medicine 17 (1998), table I, method 3."""
    interval = wilson(successes, n)
    assert interval.value == successes / n
    assert interval.low == pytest.approx(low, abs=6e-5)
    assert interval.high == pytest.approx(high, abs=6e-5)


def test_wilson_of_nothing():
    assert np.isnan(wilson(0, 0)).all()
    assert wilson(50, 50).high == 1.0


def test_the_interval_covers_a_known_median():
    """In 200 samples of 40 from a skewed distribution, about 95 of 100 times."""
    rng, covered = np.random.default_rng(1), 0
    for _ in range(200):
        interval = median_interval(rng.lognormal(0.0, 1.0, 40))  # its median is 1
        covered += interval.low <= 1.0 <= interval.high
    assert 180 <= covered <= 199


def test_never_is_infinite():
    few = median_interval([1.0, 2.0, 3.0, np.inf])
    assert few.value == 2.5
    assert few.high == np.inf
    assert median_interval([1.0, np.inf]).value == np.inf
    assert median_interval([1.0, 2.0, np.inf]).value == 2.0
    assert median_interval([np.inf, np.inf]) == (np.inf, np.inf, np.inf)
    assert np.isnan(median_interval([])).all()
    assert median_interval([2.0]) == (2.0, 2.0, 2.0)


def test_means():
    interval = mean_interval([0.0, 1.0, 1.0, 1.0])
    assert interval.value == 0.75
    assert 0.0 <= interval.low < 0.75 < interval.high <= 1.0


def test_a_known_exponent():
    x, rng = np.array([1, 2, 4, 8, 16]), np.random.default_rng(0)
    times = 0.003 * x[:, None] ** 1.3 * rng.lognormal(0.0, 0.05, (5, 9))
    interval = slope_interval(x, times)
    assert interval.value == pytest.approx(1.3, abs=0.05)
    assert interval.low <= 1.3 <= interval.high
    exact = slope_interval(x, (x**0.5)[:, None])
    assert exact == pytest.approx((0.5, 0.5, 0.5))

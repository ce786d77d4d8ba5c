"""Intervals cover what they should."""

import numpy as np
import pytest

from comove.experiments.paper.statistics import median_interval, share_interval


def test_the_interval_of_a_median_covers_it_about_as_often_as_it_says():
    rng = np.random.default_rng(0)
    covered = [
        low <= 0.0 <= high
        for _, low, high in (median_interval(rng.standard_normal(50), seed=i) for i in range(80))
    ]
    assert 0.88 <= np.mean(covered) <= 1.0


def test_one_value_is_its_own_interval_and_the_median_lies_within():
    assert median_interval([3.0]) == (3.0, 3.0, 3.0)
    value, low, high = median_interval(np.arange(51.0))
    assert value == 25.0 and low < value < high
    assert median_interval(np.arange(51.0)) == (value, low, high), "no chance from run to run"


@pytest.mark.parametrize("trials", [1, 10, 50])
def test_the_interval_of_a_share(trials):
    all_of_them, none = share_interval(trials, trials), share_interval(0, trials)
    assert all_of_them.high == pytest.approx(1.0) and 0.0 < all_of_them.low < 1.0
    assert none.low == pytest.approx(0.0, abs=1e-12) and none.value == 0.0
    assert all_of_them.low == pytest.approx(1.0 - none.high)


def test_wilson_by_hand():
    share, low, high = share_interval(8, 10)
    assert (share, low, high) == pytest.approx((0.8, 0.4902, 0.9433), abs=1e-4)

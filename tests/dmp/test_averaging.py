"""Several demonstrations: their mean, their spread, and movements drawn from it."""

import numpy as np
import pytest

from comove.dmp import DMP
from comove.dmp.averaging import average
from comove.dmp.demonstrations import Demonstration
from comove.errors import DemonstrationError, OptionError

DEMOS = [Demonstration.from_lasa("Sine", k) for k in range(7)]


def test_the_mean_is_the_mean_of_the_movements_at_equal_phases():
    averaged = average(DEMOS, n_basis=30)
    s = np.linspace(0, 1, 101)
    singles = [DMP.fit(demo, n_basis=30) for demo in DEMOS]
    expected = np.mean([single.at(s * single.duration).position for single in singles], axis=0)
    assert np.abs(averaged.mean.at(s * averaged.mean.duration).position - expected).max() < 1e-9
    assert averaged.mean.duration == pytest.approx(np.mean([demo.duration for demo in DEMOS]))


def test_the_spread_is_that_of_the_recordings():
    averaged = average(DEMOS, n_basis=50)
    resampled = np.stack([demo.resampled(201).position for demo in DEMOS])
    assert np.abs(averaged.spread(201) - resampled.std(axis=0, ddof=1)).max() < 0.1


def test_samples_have_mean_and_spread_of_the_members():
    averaged, rng = average(DEMOS[:4]), np.random.default_rng(0)
    s = np.linspace(0, 1, 11)
    drawn = [averaged.sample(rng) for _ in range(4000)]
    positions = np.stack([one.at(s * one.duration).position for one in drawn])
    spread = averaged.spread(11)
    mean = averaged.mean.at(s * averaged.mean.duration).position
    assert np.abs(positions.mean(axis=0) - mean).max() < 5 * spread.max() / np.sqrt(4000)
    assert np.abs(positions.std(axis=0) - spread).max() < 0.06 * spread.max()
    assert np.abs(drawn[0].rollout().position[-1] - drawn[0].goal).max() < 1e-10


def test_equal_demonstrations_have_no_spread():
    averaged = average([DEMOS[0], DEMOS[0]])
    assert averaged.spread().max() < 1e-12
    assert np.abs(averaged.sample(np.random.default_rng(1)).weights - averaged.mean.weights).max() < 1e-9


def test_what_has_no_mean():
    with pytest.raises(DemonstrationError, match="two or more"):
        average(DEMOS[:1])
    other = Demonstration(DEMOS[0].time, np.zeros((1000, 3)) + 0.1 * DEMOS[0].time[:, None])
    pairs = [{"left": demo, "right": demo} for demo in DEMOS[:2]]
    with pytest.raises(DemonstrationError, match=r"left, right.*each manipulator by itself"):
        average(pairs)
    average([pair["left"] for pair in pairs])
    with pytest.raises(DemonstrationError, match="recording 1 has 3 coordinates, recording 0 has 2"):
        average([DEMOS[0], other])


def test_slips_are_told():
    with pytest.raises(OptionError, match="cycles"):
        average(DEMOS, variant="rhythmic")
    for wrong in (None, iter(DEMOS), [DMP.fit(DEMOS[0])] * 2):
        with pytest.raises(OptionError, match="demonstrations"):
            average(wrong)

"""Interpolation and smoothing as functions of arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.demonstrations import resampling

SEEDS = st.integers(0, 2**32 - 1)


@given(SEEDS)
def test_interpolation_stays_between_neighbours(seed):
    rng = np.random.default_rng(seed)
    time = np.cumsum(10.0 ** rng.uniform(-6, 0, size=20))
    position = rng.normal(size=(20, 2))
    at = rng.uniform(time[0], time[-1], size=200)
    after = np.searchsorted(time, at).clip(1, 19)
    between = resampling.resample(time, position, at)
    low = np.minimum(position[after - 1], position[after])
    high = np.maximum(position[after - 1], position[after])
    assert (between >= low - 1e-9).all()
    assert (between <= high + 1e-9).all()


def test_interpolation_is_exact_for_even_motion_at_uneven_steps():
    time = np.array([0.0, 0.1, 0.15, 0.7, 1.0])
    at = np.linspace(0.0, 1.0, 33)
    direction = np.array([0.5, -2.0])
    found = resampling.resample(time, np.outer(time, direction), at)
    np.testing.assert_allclose(found, np.outer(at, direction), atol=1e-15)


@given(SEEDS, st.integers(2, 60), st.floats(0.01, 0.9))
def test_smoothing_keeps_both_ends_exactly(seed, n_steps, share):
    rng = np.random.default_rng(seed)
    time = np.concatenate(([0.0], np.cumsum(rng.uniform(0.5, 2.0, n_steps - 1))))
    position = rng.normal(size=(n_steps, 3))
    nyquist = 0.5 * (n_steps - 1) / time[-1]
    smoothed = resampling.smooth(time, position, share * nyquist)
    np.testing.assert_array_equal(smoothed[[0, -1]], position[[0, -1]])
    assert np.isfinite(smoothed).all()


@pytest.mark.parametrize(("frequency", "kept"), [(0.5, 1.0), (5.0, 0.5), (40.0, 0.0)])
def test_smoothing_halves_the_cutoff_and_shifts_no_phase(frequency, kept):
    time = np.linspace(0.0, 4.0, 801)
    wave = np.sin(2.0 * np.pi * frequency * time)[:, None]
    smoothed = resampling.smooth(time, wave, 5.0)
    middle = slice(200, 601)
    np.testing.assert_allclose(smoothed[middle], kept * wave[middle], atol=2e-3)


def test_smoothing_leaves_a_straight_line_alone():
    time = np.linspace(0.0, 2.0, 50)
    line = np.outer(time, [1.0, -3.0]) + 0.2
    np.testing.assert_allclose(resampling.smooth(time, line, 3.0), line, atol=1e-14)


def test_no_step_is_left_beside_the_ends_that_are_kept():
    time = np.linspace(0.0, 2.0, 400)
    hand = np.column_stack((np.cos(3.0 * time), np.sin(2.0 * time)))
    rough = np.random.default_rng(1).normal(scale=1e-3, size=hand.shape)
    smoothed = resampling.smooth(time, hand + rough, 6.0)
    jump = np.abs(np.diff(smoothed, n=2, axis=0)).max()
    assert jump < 0.1 * np.abs(np.diff(hand + rough, n=2, axis=0)).max()


def test_uneven_stamps_are_smoothed_in_their_own_time():
    rng = np.random.default_rng(0)
    time = np.concatenate(([0.0], np.cumsum(rng.uniform(0.002, 0.018, 400))))
    hand = np.sin(2.0 * np.pi * 0.5 * time)[:, None]
    smoothed = resampling.smooth(time, hand + rng.normal(scale=0.01, size=hand.shape), 4.0)
    middle = slice(40, -40)
    assert np.sqrt(np.mean((smoothed - hand)[middle] ** 2)) < 0.006

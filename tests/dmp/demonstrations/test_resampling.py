"""Interpolation and smoothing as functions of arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp.demonstrations import resampling
from comove.errors import OptionError

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


def test_even_stamps_are_filtered_as_they_are():
    time = np.arange(200) / 100.0
    hand = np.sin(7.0 * time)[:, None] + np.random.default_rng(0).normal(scale=1e-3, size=(200, 1))
    nudged = time.copy()
    nudged[100] += 2e-8  # enough to take the way through interpolation
    assert resampling.is_even(time)
    assert not resampling.is_even(nudged)
    there, back = resampling.smooth(time, hand, 5.0), resampling.smooth(nudged, hand, 5.0)
    np.testing.assert_allclose(there, back, atol=1e-6)


@given(SEEDS)
def test_turns_are_interpolated_as_scipy_does_and_samples_are_met_exactly(seed):
    from scipy.spatial.transform import Rotation, Slerp

    rng = np.random.default_rng(seed)
    time = np.concatenate(([0.0], np.cumsum(rng.uniform(0.01, 1.0, 9))))
    turns = Rotation.from_rotvec(np.cumsum(rng.normal(scale=0.7, size=(10, 3)), axis=0))
    quaternions = turns.as_quat()[:, [3, 0, 1, 2]]
    for row in range(1, 10):
        quaternions[row] *= 1.0 if quaternions[row] @ quaternions[row - 1] >= 0.0 else -1.0
    at = np.concatenate((rng.uniform(0.0, time[-1], 50), time))
    found = resampling.slerp(time, quaternions, at)
    expected = Slerp(time, turns)(at.clip(0.0, time[-1]))
    apart = Rotation.from_quat(found[:, [1, 2, 3, 0]]) * expected.inv()
    np.testing.assert_allclose(apart.magnitude(), 0.0, atol=1e-7)
    assert found[50:].tobytes() == quaternions.tobytes()


def test_resting_orientations_stay_as_they_are():
    still = np.repeat([[0.5, 0.5, -0.5, 0.5]], 3, axis=0)
    found = resampling.slerp(np.array([0.0, 1.0, 2.0]), still, np.linspace(0.0, 2.0, 7))
    np.testing.assert_array_equal(found, np.repeat(still[:1], 7, axis=0))


def test_filtered_orientations_keep_their_norm_their_ends_and_a_steady_turn():
    time = np.linspace(0.0, 4.0, 401)
    angle = 0.8 * np.sin(time) + np.random.default_rng(0).normal(scale=0.02, size=401)
    quaternions = np.column_stack((np.cos(angle / 2), np.zeros((401, 2)), np.sin(angle / 2)))
    found = resampling.smooth_orientation(time, quaternions, 3.0)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-15)
    assert found[[0, -1]].tobytes() == quaternions[[0, -1]].tobytes()
    error = 2.0 * np.arcsin(found[:, 3]) - 0.8 * np.sin(time)
    assert np.abs(error[40:-40]).max() < 0.015


def test_a_hand_that_turns_faster_than_the_cutoff_is_refused():
    angle = 2.0 * np.pi * 10.0 * np.linspace(0.0, 2.0, 401)
    quaternions = np.column_stack((np.cos(angle / 2), np.zeros((401, 2)), np.sin(angle / 2)))
    with pytest.raises(OptionError, match=r"cutoff_hz: .*turns faster than 1\.0 Hz.*higher"):
        resampling.smooth_orientation(np.linspace(0.0, 2.0, 401), quaternions, 1.0)

"""A primitive meets both ends, keeps its shape, fits handwriting and runs online as it rolls out."""

import warnings
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.dmp import DMP, ExponentialPhase, LinearPhase, Variant
from comove.dmp.demonstrations import lasa_names
from comove.dmp.demonstrations.demonstration import Demonstration
from comove.errors import ComoveWarning, DemonstrationError, OptionError
from tests.cases import examples

from .movements import random_dmp

seeds = st.integers(0, 2**32 - 1)
phases = st.sampled_from([LinearPhase(), ExponentialPhase(), ExponentialPhase(alpha=3.0)])


@dataclass
class Recorded:
    """The least that a primitive is fitted to."""

    time: np.ndarray
    position: np.ndarray
    start_velocity: np.ndarray


def minimum_jerk(n_steps=201, duration=2.0):
    """A recording that starts and ends at rest, smooth all along."""
    s = np.linspace(0, 1, n_steps)
    bell = 10 * s**3 - 15 * s**4 + 6 * s**5
    return Recorded(duration * s, np.stack([0.4 * bell, bell * (1 - 0.5 * bell)], axis=1), np.zeros(2))


@examples(50)
@given(seeds, phases, st.integers(1, 40), st.integers(1, 4), st.floats(0, 100))
def test_both_ends_are_exact(seed, phase, n_basis, n_dims, size):
    dmp = random_dmp(seed, phase=phase, n_dims=n_dims, n_basis=n_basis)
    dmp = replace(dmp, weights=size * dmp.weights, goal_velocity=dmp.start_velocity[::-1].copy())
    path, tolerance = dmp.rollout(n_steps=7), 1e-12 * max(1.0, size)
    assert np.array_equal(path.position[0], dmp.start)
    assert np.abs(path.position[-1] - dmp.goal).max() <= tolerance
    assert np.allclose(path.velocity[0], dmp.start_velocity, rtol=1e-14, atol=0)
    assert (
        np.abs(path.velocity[-1] - dmp.goal_velocity).max() * dmp.duration <= tolerance * dmp.duration + 1e-11
    )


@examples(30)
@given(seeds, phases)
def test_at_rest_ever_after(seed, phase):
    dmp = random_dmp(seed, phase=phase)
    after = dmp.at(dmp.duration * np.array([1.0, 1.0001, 1.01, 1.5, 3.0, 1000.0]))
    assert np.abs(after.position - dmp.goal).max() < 1e-12
    assert np.abs(after.velocity).max() * dmp.duration < 1e-11


@examples(30)
@given(seeds, phases)
def test_linear_in_the_weights(seed, phase):
    one, other = random_dmp(seed, phase=phase), random_dmp(seed + 1, phase=phase)
    mixed = replace(one, weights=0.3 * one.weights + 0.7 * other.weights)
    paths = [replace(one, weights=w).rollout() for w in (one.weights, other.weights)]
    mean = 0.3 * paths[0].position + 0.7 * paths[1].position
    assert np.abs(mixed.rollout().position - mean).max() < 1e-12


@examples(30)
@given(seeds, phases, st.floats(0.1, 10))
def test_time_scaling(seed, phase, ratio):
    """At another pace the path is the same and every velocity smaller by the ratio."""
    dmp = random_dmp(seed, phase=phase)
    own, slow = dmp.rollout(), dmp.rollout(duration=ratio * dmp.duration)
    assert slow.time[-1] == pytest.approx(ratio * dmp.duration)
    assert np.abs(slow.position - own.position).max() < 1e-11
    assert np.abs(slow.velocity * ratio - own.velocity).max() < 1e-10 * np.abs(own.velocity).max()


@examples(30)
@given(seeds, phases)
def test_shifted_ends_shift_the_path(seed, phase):
    dmp, shift = random_dmp(seed, phase=phase), np.array([3.0, -2.0])
    moved = dmp.rollout(start=dmp.start + shift, goal=dmp.goal + shift)
    assert np.abs(moved.position - dmp.rollout().position - shift).max() < 1e-13 * 100


def test_goal_at_the_start():
    """The shape stays finite, keeps its size and comes back."""
    dmp = random_dmp(3)
    closed = dmp.rollout(goal=dmp.start)
    assert np.abs(closed.position[-1] - dmp.start).max() < 1e-12
    assert np.isfinite(closed.position).all()
    assert np.ptp(closed.position, axis=0).min() > 0.05
    circle = 2 * np.pi * np.linspace(0, 1, 300)
    closed = Recorded(circle, np.stack([np.cos(circle), np.sin(circle)], axis=1), np.array([0.0, 1.0]))
    fitted = DMP.fit(closed, n_basis=40).at(closed.time)
    assert np.abs(fitted.position - closed.position).max() < 0.02


def test_a_given_goal_velocity_is_met_at_that_instant():
    dmp = random_dmp(4)
    path = dmp.rollout(goal_velocity=[0.3, -0.2])
    assert np.abs(path.velocity[-1] - [0.3, -0.2]).max() < 1e-12
    assert np.abs(path.position[-1] - dmp.goal).max() < 1e-12


@examples(20)
@given(seeds, phases)
def test_a_fit_finds_the_weights_that_made_the_movement(seed, phase):
    """From uneven samples, and wherever the clock starts."""
    dmp = random_dmp(seed, phase=phase)
    time = dmp.duration * np.sort(np.append(np.random.default_rng(seed).uniform(0, 1, 200), [0.0, 1.0]))
    recorded = Recorded(time + 5.0, dmp.at(time).position, dmp.start_velocity)
    assert np.abs(DMP.fit(recorded, n_basis=12, phase=phase).weights - dmp.weights).max() < 1e-5


def test_a_fit_keeps_the_ends_of_the_recording():
    demo = Demonstration.from_lasa("JShape_2")  # starts in motion
    path = DMP.fit(demo).rollout()
    assert np.array_equal(path.position[0], demo.start)
    assert np.abs(path.position[-1] - demo.goal).max() < 1e-10
    assert np.allclose(path.velocity[0], demo.start_velocity)
    assert np.linalg.norm(path.velocity[0]) > 1.0
    assert np.abs(path.velocity[-1]).max() < 1e-10  # although the recording breaks off in motion
    assert path.time[-1] == demo.duration
    moving = DMP.fit(demo, at_rest=False).rollout()
    assert np.abs(moving.velocity[-1] - demo.goal_velocity).max() < 1e-9
    assert np.abs(moving.position[-1] - demo.goal).max() < 1e-10


ENDING = [variant for variant in Variant if variant is not Variant.RHYTHMIC]


@pytest.mark.parametrize("variant", ENDING)
@pytest.mark.parametrize("duration", [0.5, 2.0])
def test_a_recording_that_ends_in_motion_is_learned_with_its_final_velocity(variant, duration):
    """y = t^2: position and velocity are its own at the end, exactly, and between the ends nearly."""
    time = np.linspace(0, duration, 101)
    parabola = Demonstration(time, np.stack([time**2, -3 * time**2], axis=1))
    path = DMP.fit(parabola, n_basis=10, variant=variant, at_rest=False).rollout(n_steps=101)
    wanted = 2 * duration * np.array([1.0, -3.0])
    assert np.abs(path.position[-1] - parabola.goal).max() < 1e-9 * duration**2
    assert np.abs(path.velocity[-1] - wanted).max() < 1e-8 * duration
    assert np.abs(path.position - parabola.position).max() < 1e-2 * duration**2


def test_half_of_a_movement_is_learned_as_it_was():
    """Half of a minimum-jerk movement, cut off where it is fastest."""
    s = np.linspace(0, 0.5, 101)
    bell = 10 * s**3 - 15 * s**4 + 6 * s**5
    cut = Demonstration(2 * s, np.stack([bell, -bell], axis=1))
    fast = DMP.fit(cut, n_basis=12, at_rest=False)
    assert np.allclose(fast.goal_velocity, [0.9375, -0.9375], rtol=2e-3)
    assert np.abs(fast.at(cut.time).position - cut.position).max() < 1e-4
    resting = DMP.fit(cut, n_basis=12)
    assert np.abs(resting.rollout().velocity[-1]).max() < 1e-10
    assert np.abs(resting.at(cut.time).position - cut.position).max() > 1e-3
    with pytest.raises(OptionError, match="rhythmic"):
        DMP.fit(cut, variant="rhythmic", at_rest=False)
    with pytest.raises(OptionError, match="knows no velocity at its end"):
        DMP.fit(minimum_jerk(), at_rest=False)


@pytest.mark.parametrize("variant", list(Variant))
def test_more_weights_than_samples_are_told(variant):
    """With the way out, and without inventing anything at the samples."""
    time = np.linspace(0, 1, 9)
    few = Demonstration(time, np.stack([np.sin(1.7 * np.pi * time), time], axis=1))
    options = {"period": 1.0} if variant is Variant.RHYTHMIC else {}
    telling = 9 if variant is Variant.RHYTHMIC else 7
    with pytest.warns(ComoveWarning, match=f"9 samples for 30 weights .* give n_basis = {telling} or less"):
        dmp = DMP.fit(few, n_basis=30, variant=variant, **options)
    if variant is not Variant.RHYTHMIC:
        assert np.abs(dmp.at(time).position - few.position).max() < 1e-6
        assert np.abs(dmp.rollout().position).max() < 1.6  # smooth in between
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message=".* samples for .* weights")
        DMP.fit(few, n_basis=telling - 2, variant=variant, **options)


def test_the_fit_is_least_squares():
    """No other weights come nearer to the samples."""
    demo = Demonstration.from_lasa("Angle")
    dmp, rng = DMP.fit(demo), np.random.default_rng(0)
    squares = ((dmp.at(demo.time).position - demo.position) ** 2).sum()
    for _ in range(20):
        other = replace(dmp, weights=dmp.weights + 1e-2 * rng.standard_normal(dmp.weights.shape))
        assert ((other.at(demo.time).position - demo.position) ** 2).sum() > squares


@pytest.mark.parametrize("variant", ["closed-form", "rhythmic"])
def test_long_recordings_are_fitted_as_short_ones(variant):
    """Block by block the fit is the same as at once."""
    s = np.linspace(0, 1, 50_001)
    position = np.stack([np.sin(2 * np.pi * s), s * (1 - s) * np.cos(9 * s)], axis=1)
    options = {"variant": variant, "n_basis": 30} | ({"period": 1.0} if variant == "rhythmic" else {})
    long = DMP.fit(Recorded(s, position, np.zeros(2)), **options)
    short = DMP.fit(Recorded(s[::20], position[::20], np.zeros(2)), **options)
    assert np.abs(long.rollout().position - short.rollout().position).max() < 1e-4
    miss = long.at(s).position - position
    basis = long.basis.on_cycle(s)[0] if variant == "rhythmic" else long.basis.at(s)[1][0]
    size = np.linalg.norm(basis, axis=0)[:, None] * np.linalg.norm(miss, axis=0)
    # What is left lies across everything the weights can do.
    assert np.abs(basis.T @ miss / size).max() < 1e-6


@pytest.mark.parametrize(("n_basis", "most"), [(10, 0.25), (20, 0.060), (50, 0.010)])
def test_handwriting(n_basis, most):
    """Median error over the 30 LASA shapes, in their units."""
    errors = []
    for name in lasa_names():
        demo = Demonstration.from_lasa(name)
        miss = DMP.fit(demo, n_basis=n_basis).at(demo.time).position - demo.position
        errors.append(np.sqrt((miss**2).sum(axis=1).mean()))
    assert len(errors) == 30
    assert np.median(errors) <= most


@pytest.mark.parametrize("n_basis", [0, -3, 201, 2.5, True, "20", None])
def test_numbers_of_weights_that_are_refused(n_basis):
    with pytest.raises(OptionError, match="1 to 200"):
        DMP.fit(minimum_jerk(), n_basis=n_basis)


@pytest.mark.parametrize(
    "wrong",
    [
        {"n_steps": 1},
        {"duration": 0.0},
        {"duration": -1.0},
        {"duration": np.nan},
        {"duration": np.inf},
        {"start": [0.0]},
        {"goal": [0.0, 1.0, 2.0]},
        {"goal": 1.0},
        {"start": [np.nan, 0.0]},
        {"start_velocity": [[0.0, 0.0]]},
        {"goal_velocity": [np.inf, 0.0]},
    ],
    ids=str,
)
def test_bad_arguments_are_refused(wrong):
    with pytest.raises(OptionError) as caught:
        random_dmp(0).rollout(**wrong)
    assert next(iter(wrong)) in caught.value.message
    assert caught.value.way_out


@pytest.mark.parametrize(
    "wrong",
    [
        {"weights": np.zeros(5)},
        {"start": np.zeros(3)},
        {"goal_velocity": np.array([np.nan, 0])},
        {"weights": np.full((2, 3), np.inf)},
        {"duration": 0.0},
        {"duration": [1.0]},
        {"learned": 1.0},
        {"variant": "prodmp"},
    ],
    ids=lambda wrong: next(iter(wrong)),
)
def test_primitives_that_are_none(wrong):
    with pytest.raises(OptionError) as caught:
        replace(random_dmp(0), **wrong)
    assert caught.value.way_out
    with pytest.raises(OptionError, match="time"):
        random_dmp(0).at([0.1, np.nan])
    with pytest.raises(OptionError, match="time"):
        random_dmp(0).at(0.1)


def test_a_recording_without_a_movement_is_refused():
    for n_steps in (1, 2):
        with pytest.raises(DemonstrationError, match="lasts no time"):
            DMP.fit(Recorded(np.zeros(n_steps), np.zeros((n_steps, 2)), np.zeros(2)))

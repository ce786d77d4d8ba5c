"""Functions of the user: they decide, they hold, and what is wrong with them is told in one sentence."""

import numpy as np
import pytest

import comove
from comove import LeastJerk
from comove.errors import OptionError
from comove.lab.evolution import Projection
from comove.model import Scene
from comove.planning import Equality, Samples
from comove.verification import verify
from tests.solved import example
from tests.verification.test_bounds import lone_hand

MIDDLE = 100  # of the samples


def height(samples):
    """Mean height of all hands [m]."""
    return float(samples.position[..., 1].mean())


def rise(samples):
    """By how much the hand is not a decimetre up in the middle [m]."""
    return samples.position[MIDDLE, 0, 1] - 0.1


def fast(samples):
    """By how much hands are faster along x than they should be [m/s]."""
    return samples.velocity[..., 0].max() - 0.11


def test_samples_are_the_motion_in_plain_units():
    motion = comove.solve(example("narrow")).attempt
    samples, trajectory = Samples.of(motion, 1001), motion.trajectory(1001)
    np.testing.assert_allclose(samples.time, trajectory.time)
    np.testing.assert_allclose(samples.position, trajectory.position, atol=1e-12)
    np.testing.assert_allclose(samples.velocity, trajectory.velocity, atol=1e-12)
    rates = np.gradient(samples.velocity, samples.time, axis=0)[5:-5]
    np.testing.assert_allclose(samples.acceleration[5:-5], rates, atol=1e-4)
    assert samples.manipulators == ("left", "right")


def test_a_function_decides_what_is_best():
    smooth = comove.solve(example("narrow"))
    lower = comove.solve(example("narrow"), objective=height, budget=60.0)
    assert lower.verified
    assert height(Samples.of(lower.attempt)) < height(Samples.of(smooth.attempt)) - 0.05
    assert lower.report.clearance_min >= 0


@pytest.mark.parametrize(
    "scene",
    [
        pytest.param(example("narrow"), id="plane"),
        pytest.param(example("window"), id="space", marks=pytest.mark.slow),
    ],
)
def test_a_constraint_holds_beside_the_scene_s(scene):
    def bounded(samples):
        return samples.velocity[..., 0].max() - limit

    free = Samples.of(comove.solve(scene).attempt)
    limit = 0.9 * free.velocity[..., 0].max()
    solution = comove.solve(scene, constraints=[bounded], budget=60.0)
    assert solution.verified
    assert bounded(Samples.of(solution.attempt)) <= 0
    assert verify(solution.attempt).verified is not None


def test_the_least_jerk_through_a_point_is_found():
    """A hand that is to be a decimetre up half-way (Flash and Hogan, 1985), against a quadratic programme."""
    scene = Scene.from_dict(lone_hand(duration=2.0))
    solution = comove.solve(scene, constraints=[Equality(rise, 1e-3)], budget=20.0)
    assert solution.verified
    samples = Samples.of(solution.attempt)
    assert rise(samples) == pytest.approx(0.0, abs=1e-3)
    # The least jerk in unit duration of what rests at both ends and is there in the middle, in a basis of cosines.
    s = np.linspace(0, 1, 401)
    basis = np.stack([np.sin(np.pi * s) ** 3 * np.cos(2 * k * np.pi * s) for k in range(12)], axis=1)
    third = np.gradient(np.gradient(np.gradient(basis, s, axis=0), s, axis=0), s, axis=0)[4:-4]
    gram = third.T @ third / 400
    at = basis[200]
    best = 0.1**2 / (at @ np.linalg.solve(gram, at))
    rough = np.gradient(samples.acceleration[:, 0, 1], samples.time)
    jerk = (rough**2).mean() * 2.0**6
    assert jerk < 1.4 * best


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"objective": lambda m: m.missing}, "fails: AttributeError"),
        ({"objective": lambda m: np.nan}, "gives nan"),
        ({"objective": lambda m: m.position}, "an array of shape"),
        ({"objective": lambda m: "low"}, "fails: ValueError"),
        ({"objective": lambda: 1.0}, "fails: TypeError"),
        ({"constraints": [lambda m: 1 / 0]}, "fails: ZeroDivisionError"),
        ({"constraints": [lambda m: np.nan]}, "gives nan"),
        ({"constraints": [lambda m: m.position]}, "an array of shape"),
        ({"constraints": [3]}, "is no function"),
        ({"constraints": fast}, "give a list"),
        ({"objective": height, "planner": False}, "a planner"),
        ({"objective": "low"}, "or a function"),
        ({"constraints": [fast], "method": Projection()}, "comove's own method"),
    ],
)
def test_bad_functions_are_told(options, words):
    with pytest.raises(OptionError, match=words):
        comove.solve(example("wide"), **options)


def test_equalities_have_a_small_tolerance():
    for bad in (0, -1, np.inf, "small"):
        with pytest.raises(OptionError, match="tolerance"):
            Equality(rise, bad)
    with pytest.raises(OptionError, match="no function"):
        Equality(3)


@pytest.mark.slow
def test_what_cannot_be_met_is_not_verified():
    def impossible(samples):
        return samples.position[-1, 0, 0] - 0.5  # the goal lies at 0.85

    solution = comove.solve(example("wide"), constraints=[impossible], budget=3.0)
    assert not solution.verified
    assert any("'impossible' is missed by 0.35" in reason for reason in solution.reasons)


@pytest.mark.slow
def test_functions_go_with_other_objectives():
    solution = comove.solve(example("narrow"), objective=LeastJerk(room=0.0), constraints=[fast], budget=20.0)
    assert solution.verified
    assert fast(Samples.of(solution.attempt)) <= 0

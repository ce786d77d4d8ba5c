"""Speed-scaled primitives as a method."""

import numpy as np
import pytest

import comove
from comove.errors import OptionError
from comove.lab.compared import Human, SpeedScaled
from tests.model.examples import HANDS, SPATIAL_TRIANGLE
from tests.solved import example

ABSENT = Human(offset=0.0, spread=0.0, pace_offset=0.0, pace_spread=0.0)


@pytest.fixture(scope="module")
def moved():
    """The narrow example."""
    return comove.solve(example("narrow"), method=SpeedScaled(cycles=8))


def test_without_wishes_the_taught_movement_comes_back():
    scene = example("narrow")
    s = np.linspace(0.0, 1.0, 101)
    straight = scene.start + (s**3 * (10 - 15 * s + 6 * s**2))[:, None, None] * (scene.goal - scene.start)
    motion = comove.solve(scene, method=SpeedScaled(cycles=2, human=ABSENT)).attempt
    assert motion.hands(s)[0] == pytest.approx(straight, abs=1e-4)


def test_the_relative_motion_is_the_taught_one(moved):
    """Both hands are moved alike, so that lines that keep the distance go on keeping it."""
    assert moved.report.distance_error_max < 1e-9
    position = moved.trajectory.position
    straight = example("narrow").start
    assert np.abs(position[:, :, 1] - straight[:, 1]).max() > 0.002


def test_walls_are_not_seen(moved):
    assert not moved.verified
    assert moved.report.clearance_min < -0.02


def test_stiffness_rises_and_cycles_are_told(moved):
    log = moved.log
    assert len(log["cycle_duration_s"]) == len(log["cycle_deviation_rms_m"]) == 8 == moved.effort.generations
    for name in ("stiffness_tangent_N_per_m", "stiffness_normal_N_per_m"):
        assert (np.diff(log[name]) > 0).all()
    assert log["cycle_deviation_rms_m"][-1] < log["cycle_deviation_rms_m"][0]
    assert log["fit_error_max_m"] < 1e-5


def test_the_same_seed_is_the_same_human(moved):
    again = comove.solve(example("narrow"), method=SpeedScaled(cycles=8))
    other = comove.solve(example("narrow"), method=SpeedScaled(cycles=8), seed=1)
    assert np.array_equal(again.attempt.weights, moved.attempt.weights)
    assert not np.allclose(other.attempt.weights, moved.attempt.weights)


@pytest.mark.parametrize("scene", [HANDS, SPATIAL_TRIANGLE], ids=["free hands", "three hands in space"])
def test_any_number_of_hands(scene):
    solution = comove.solve(scene, method=SpeedScaled(cycles=2))
    assert solution.report.end_error < 1e-9
    assert solution.report.clearance_min > 0


@pytest.mark.parametrize("wrong", [{"cycles": 0}, {"period": -1.0}])
def test_slips_are_told(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        SpeedScaled(**wrong)
    with pytest.raises(OptionError, match="precise"):
        Human(precise=(0.6, 0.4))

"""Learned coupling as a method: epochs, the judge's view, and what it refuses."""

import numpy as np
import pytest

import comove
from comove.errors import OptionError
from comove.lab.compared import Gains, LeaderFollower
from comove.model import demonstration_of
from tests.model.examples import HANDS, MIXED, PLANAR_BAR, SPATIAL_TRIANGLE
from tests.solved import example

BAR = PLANAR_BAR  # turns by a quarter on its way, so that straight lines break its length


@pytest.fixture(scope="module")
def led():
    """A bar in the plane without obstacles."""
    return comove.solve(BAR, method=LeaderFollower())


def test_it_holds_the_distance_and_hits_the_wall():
    solution = comove.solve(example("narrow"), method=LeaderFollower())
    assert not solution.verified
    assert solution.report.distance_error_max < 0.005
    assert solution.report.clearance_min < -0.02
    assert any("reaches" in reason for reason in solution.reasons)


def test_the_error_falls_epoch_by_epoch_to_what_is_forgotten(led):
    errors = led.log["epoch_error_rms_m"]
    assert len(errors) == 20 == led.effort.generations
    assert errors[0] > 5 * errors[2] > 20 * errors[-1]
    assert led.report.distance_error_max == pytest.approx(led.log["epoch_error_max_m"][-1], rel=0.05)


def test_the_curve_is_what_was_integrated(led):
    assert led.log["fit_error_max_m"] < 1e-4
    assert led.report.end_error < 1e-12
    assert led.attempt.coordinates.kind == "arms"


def test_what_is_not_forgotten_is_verified():
    solution = comove.solve(BAR, method=LeaderFollower(gains=Gains(forgetting=1.0)))
    assert solution.verified
    assert solution.log["epoch_error_rms_m"][-1] < 1e-6


def test_the_leader_makes_the_taught_movement():
    s = np.linspace(0.0, 1.0, 101)
    straight = BAR.start + (s**3 * (10 - 15 * s + 6 * s**2))[:, None, None] * (BAR.goal - BAR.start)
    for leader, hand in ((None, 0), ("a", 0), ("b", 1)):
        motion = comove.solve(BAR, method=LeaderFollower(leader=leader)).attempt
        off = np.abs(motion.hands(s)[0] - straight).max(axis=(0, 2))
        assert off[hand] < 1e-4 < 0.01 < off[1 - hand]


def test_mutual_coupling_moves_both():
    s = np.linspace(0.0, 1.0, 101)
    motion = comove.solve(BAR, method=LeaderFollower(mutual=True)).attempt
    straight = BAR.start + (s**3 * (10 - 15 * s + 6 * s**2))[:, None, None] * (BAR.goal - BAR.start)
    off = np.abs(motion.hands(s)[0] - straight).max(axis=(0, 2))
    assert (off > 0.01).all()


@pytest.mark.parametrize("period", [0.001, 0.01])
def test_the_period_hardly_matters(period, led):
    errors = comove.solve(BAR, method=LeaderFollower(period=period)).log["epoch_error_rms_m"]
    assert errors[0] == pytest.approx(led.log["epoch_error_rms_m"][0], rel=0.05)


def test_several_pairs_in_one_scene():
    solution = comove.solve(MIXED, method=LeaderFollower(gains=Gains(forgetting=1.0)))
    assert solution.report.distance_error_max < 2e-5
    assert solution.verified


def test_in_space_with_a_demonstration():
    scene = example("window")
    solution = comove.solve(scene, demonstration=demonstration_of(scene), method=LeaderFollower(mutual=True))
    assert solution.report.distance_error_max < 5e-4
    assert solution.log["epoch_error_max_m"][0] > 0.005


@pytest.mark.parametrize(
    ("scene", "method", "message"),
    [
        (SPATIAL_TRIANGLE, LeaderFollower(), "'a' is tied to 2.*task-priority"),
        (HANDS, LeaderFollower(), "no distance ties"),
        (BAR, LeaderFollower(leader="c"), "no hand 'c'.*known: a, b"),
        (BAR, LeaderFollower(gains=Gains(coupling=5000.0)), "grows.*shorter period"),
    ],
)
def test_what_it_is_not_made_for_is_told(scene, method, message):
    with pytest.raises(OptionError, match=message):
        comove.solve(scene, method=method)


@pytest.mark.parametrize("wrong", [{"epochs": 0}, {"epochs": 2.5}, {"period": 0.0}, {"period": "1"}])
def test_slips_are_told(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        LeaderFollower(**wrong)

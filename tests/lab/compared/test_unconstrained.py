"""Optimising without coordination: hands get through, the distance does not hold."""

import numpy as np
import pytest

import comove
from comove.lab.compared import Unconstrained
from comove.lab.compared.unconstrained import without_load
from comove.model import demonstration_of
from comove.verification import verify
from tests.model.examples import HANDS
from tests.solved import example, random_scene


@pytest.fixture(scope="module")
def free():
    """The narrow example, from straight lines."""
    return comove.solve(example("narrow"), method=Unconstrained())


def test_the_distance_breaks(free):
    assert not free.verified
    assert free.report.distance_error_max > 0.01
    assert any("distance between" in reason for reason in free.reasons)
    assert free.report.end_error < 1e-9


@pytest.mark.parametrize("taught", [False, True])
def test_the_hands_themselves_touch_nothing(taught):
    """Judged as free hands without a load."""
    scene = example("narrow")
    motion = comove.solve(
        scene, demonstration=demonstration_of(scene) if taught else None, method=Unconstrained()
    ).attempt
    s = np.linspace(0.0, 1.0, 2001)
    nodes = np.zeros((len(s), 2, 3))
    nodes[:, :, :2] = motion.hands(s)[0]
    alone = without_load(scene)
    assert min(alone.clearance_at(n)[0] for n in nodes) > 0


def test_it_costs_less_than_what_coordination_allows(free):
    """Without a constraint the optimum is no worse (to 5 %, both are searches)."""
    assert free.cost.total < 1.05 * comove.solve(example("narrow")).cost.total


def test_the_same_seed_is_the_same_motion(free):
    again = comove.solve(example("narrow"), method=Unconstrained())
    assert np.array_equal(again.attempt.weights, free.attempt.weights)


def test_hands_that_nothing_ties_are_verified():
    assert comove.solve(HANDS, method=Unconstrained()).verified


def test_three_hands_in_space():
    solution = comove.solve(random_scene("triangle", 3), method=Unconstrained(restarts=2))
    assert solution.report.distance_error_max > 0.01
    assert not verify(solution.attempt).verified


def test_the_planner_is_never_asked(monkeypatch):
    def planned(*_, **__):
        raise AssertionError("planned")

    monkeypatch.setattr("comove.planning.kinematics.plan", planned)
    comove.solve(HANDS, method=Unconstrained(restarts=1))


def test_out_of_time_the_taught_movement_is_judged():
    solution = comove.solve(example("narrow"), method=Unconstrained(), budget=1e-6)
    assert not solution.verified
    assert solution.report.clearance_min < 0

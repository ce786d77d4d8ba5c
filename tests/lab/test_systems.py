"""What systems are asked, what they offer, and how it is measured."""

from dataclasses import dataclass

import numpy as np
import pytest

import comove
from comove.lab.examples import example
from comove.lab.systems import (
    N_SAMPLES,
    OwnSystem,
    System,
    SystemProblem,
    cost_of,
    measured,
    report_of,
)
from comove.planning import Comove
from comove.planning.objectives import PaperCost


@pytest.fixture(scope="module")
def narrow():
    return example("narrow")


@dataclass(frozen=True)
class Line(System):
    """Offers straight lines of minimum jerk: each that many times its own."""

    name: str = "line"
    times: int = 1

    def run(self, problem, offers):
        s = problem.instants
        share = (s**3 * (10 - 15 * s + 6 * s**2))[:, None, None]
        for _ in range(self.times):
            offers.take(problem.scene.start + share * (problem.scene.goal - problem.scene.start))


def free():
    """A bar of 0.2 m across an empty workspace."""
    return comove.Scene.from_dict(
        {
            "name": "free",
            "duration": 2.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": [
                {"name": n, "start": [0.2, y], "goal": [0.8, y]} for n, y in (("a", 0.4), ("b", 0.6))
            ],
        }
    )


def test_comove_offers_what_it_hands_out(narrow):
    """The last offer is the solution: same ends, same cost to what 8001 samples tell."""
    budget = 20.0
    outcome = measured(OwnSystem("comove", Comove()), SystemProblem(narrow, seed=3, budget=budget))
    solution = comove.solve(narrow, seed=3, budget=budget, objective=PaperCost())
    assert outcome.verified and solution.verified
    hands = solution.attempt.hands(SystemProblem(narrow).instants)[0]
    assert outcome.cost == pytest.approx(cost_of(narrow, hands), rel=1e-9)
    assert outcome.cost == pytest.approx(solution.cost.total, rel=0.02)  # which is of 201 samples
    assert outcome.first_verified <= outcome.seconds
    assert outcome.distance_error_max <= 1e-5
    assert outcome.clearance_min == pytest.approx(solution.report.clearance_min, abs=1e-3)


def test_history_falls(narrow):
    history = measured(OwnSystem("comove", Comove()), SystemProblem(narrow, budget=20.0)).history
    assert len(history) > 1
    assert (np.diff([seconds for seconds, _ in history]) >= 0).all()
    assert (np.diff([cost for _, cost in history]) < 0).all()


def test_cost_is_a_quadrature():
    """J of minimum jerk by hand: the integral of (1 - r(s))^2 is 181/462, that of r'(s)^2 is 10/7."""
    scene = free()
    problem = SystemProblem(scene)
    share = (problem.instants**3 * (10 - 15 * problem.instants + 6 * problem.instants**2))[:, None, None]
    hands = scene.start + share * (scene.goal - scene.start)
    expected = 2 * 0.6**2 * (181 / 462 + 0.01 * 10 / 7)
    assert cost_of(scene, hands) == pytest.approx(expected, rel=1e-3)


def test_a_straight_line_is_measured():
    outcome = measured(Line(times=3), SystemProblem(free()))
    assert outcome.verified and outcome.reasons == ()
    assert len(outcome.history) == 1  # the others are no better
    assert outcome.path_length == pytest.approx(1.2)
    assert outcome.acceleration_max == pytest.approx(10 / np.sqrt(3) * 0.6 / 4, rel=1e-3)
    assert outcome.jerk_max == pytest.approx(60 * 0.6 / 8, rel=1e-2)
    assert outcome.jerk_ratio == pytest.approx(1.0, rel=1e-2)
    assert outcome.duration == free().duration


def test_what_runs_into_a_wall_is_not_verified(narrow):
    outcome = measured(Line(), SystemProblem(narrow))
    assert not outcome.verified and outcome.first_verified is None and outcome.history == ()
    assert "obstacles[" in outcome.reasons[0]


def test_a_system_that_offers_nothing(narrow):
    assert measured(Line(times=0), SystemProblem(narrow)) is None


def test_samples_go_from_start_to_goal(narrow):
    problem = SystemProblem(narrow)
    assert len(problem.instants) == N_SAMPLES
    assert problem.instants[[0, -1]].tolist() == [0.0, 1.0]
    still = np.repeat(narrow.start[None], N_SAMPLES, axis=0)
    assert "the goal is missed" in " ".join(report_of(problem, still).reasons)

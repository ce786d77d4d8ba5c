"""How hard a search tries is said by a name or in numbers, and only where something can be bettered."""

from dataclasses import replace
from typing import get_args

import pytest

import comove
from comove.cli.options import EffortMode
from comove.errors import OptionError
from comove.planning import LeastJerk
from comove.planning.convex.costs import jerk_cost
from comove.planning.effort import EFFORTS, EffortLevel, EffortName
from tests.solved import scene_of


def test_more_effort_tries_more_and_ends_no_worse():
    """With the same seed the first path is the same, and the best of more paths is no worse."""
    scene = scene_of("planar 3")
    found = {ways: comove.solve(scene, seed=0, effort=EffortLevel(ways=ways)) for ways in (1, 3)}
    assert all(solution.verified for solution in found.values())
    assert found[1].effort.work < found[3].effort.work
    costs = {ways: jerk_cost(solution.attempt, LeastJerk(), None) for ways, solution in found.items()}
    assert costs[3] <= costs[1]


def test_of_one_path_the_demonstration_is_enough(monkeypatch):
    """Nothing is planned where the demonstration can be made smooth, and the motion is the best of both."""
    scene = scene_of("wide")
    taught = comove.DMP.fit(comove.Demonstration.from_lasa("Sine"))
    both = comove.solve(scene, demonstration=taught, effort=EffortLevel(ways=2, gain=0.01))

    def never(*_):
        raise AssertionError("something was planned")

    monkeypatch.setattr("comove.planning.kinematics.plan", never)
    one = comove.solve(scene, demonstration=taught, effort="quick")
    assert one.verified
    assert one.effort.work < both.effort.work
    costs = [jerk_cost(solution.attempt, LeastJerk(), None) for solution in (one, both)]
    assert costs[0] <= 1.05 * costs[1]


def test_the_command_and_studies_know_all_levels():
    assert [mode.value for mode in EffortMode] == list(get_args(EffortName)) == list(EFFORTS)


def test_normal_is_what_is_tried_unless_said():
    assert EffortLevel.of("normal") == EffortLevel() == EFFORTS["normal"]
    assert EFFORTS["quick"].ways == 1
    own = replace(EFFORTS["quick"], gain=0.5)
    assert EffortLevel.of(own) is own


@pytest.mark.parametrize(
    ("effort", "said"),
    [("qick", "quick"), (3, "quick, normal, thorough")],
)
def test_a_name_that_is_not_known_is_told(effort, said):
    with pytest.raises(OptionError, match=said):
        comove.solve(scene_of("wide"), effort=effort)


@pytest.mark.parametrize("wrong", [{"ways": 0}, {"ways": 1.5}, {"patience": 0}, {"gain": 0.0}, {"gain": 2}])
def test_numbers_out_of_range_are_told(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        EffortLevel(**wrong)


def test_where_nothing_is_bettered_no_effort_is_taken():
    with pytest.raises(OptionError, match="leave it out"):
        comove.solve(scene_of("wide"), planner=False, effort="quick")

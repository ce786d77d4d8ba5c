"""The same seed gives a robot the same joints however slow the machine is, or it is told that the budget ran out."""

import pytest

import comove
from comove.results.sealed import checksum
from comove.results.solution import motion_arrays
from tests.robots.small_robots import gantry_scene, robot
from tests.slow_clock import ticking

TICK = 1e-3  # s of a reading of the clock
SCENES = {
    "past a post": lambda: gantry_scene(),
    "too short": lambda: gantry_scene(duration=1.0),
    "hopeless": lambda: gantry_scene(duration=0.5, limits={"speed": 0.5, "acceleration": 1.0}),
    "open duration": lambda: gantry_scene(duration=None),
    "open grasp": lambda: gantry_scene(grasp={}),
}

LONG = ("too short", "open grasp")


def outcome(name, budget=6.0):
    """All of a carry that must not depend on the machine."""
    found = comove.solve(SCENES[name](), robot=robot("gantry"), budget=budget)
    solution = found
    told = (
        found.verified,
        solution.timed_out,
        solution.reasons,
        solution.effort.evaluations,
        solution.effort.work,
    )
    return checksum(motion_arrays(solution.attempt)), found.joints.attempt.position.tobytes(), *told


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=pytest.mark.slow) if n in LONG else n for n in SCENES]
)
def test_a_slower_machine_comes_to_the_same_joints(name, monkeypatch):
    ticking(monkeypatch, TICK)
    once = outcome(name)
    ticking(monkeypatch, 4.0 * TICK)
    assert outcome(name) == once


@pytest.mark.parametrize("name", SCENES)
def test_a_budget_that_runs_out_is_told_of(name, monkeypatch):
    ticking(monkeypatch, 40.0)
    found = comove.solve(SCENES[name](), robot=robot("gantry"), budget=30.0)
    assert not found.verified and found.timed_out
    told = "the time budget of 30 s ran out before a motion was verified: --budget 60 lets the search go on"
    assert found.reasons[0] == told and found.reasons.count(told) == 1
    assert not any("would do" in reason or "too short" in reason for reason in found.reasons)


@pytest.mark.slow
def test_advice_about_the_duration_comes_from_a_search_that_has_ended(monkeypatch):
    """In the time given the search uses up its share of the work; at leisure one ends long before."""
    ticking(monkeypatch, TICK)
    scene = SCENES["too short"]()
    (told,) = (
        text for text in comove.solve(scene, robot=robot("gantry"), budget=6.0).reasons if "would do" in text
    )
    advised = float(told.removeprefix("a duration of ").removesuffix(" s would do"))
    assert comove.solve(scene.timed(advised), robot=robot("gantry"), budget=6.0).verified

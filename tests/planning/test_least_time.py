"""Motions in least time: within limits at every instant, and near what is known to be possible."""

from dataclasses import replace

import numpy as np
import pytest

import comove
from comove import LeastJerk, LeastTime
from comove.errors import OptionError, SceneError
from comove.model import Scene, demonstration_of
from comove.planning import solver
from comove.planning.pace import LIMITS, in_least_time, least_possible
from comove.verification import verify
from tests.solved import EXAMPLES, example
from tests.verification.test_bounds import lone_hand

HARD = {"speed": 1.0, "acceleration": 1.0, "jerk": 5.0}


def hasty(name, duration=None, **more):
    """An example without a demonstration, under limits; without a duration unless one is given."""
    changes = {"duration": duration, "demonstration": None, "limits": HARD, **more}
    return Scene.load(str(EXAMPLES / f"{name}.yaml"), changes)


def s_curve(length, speed, acceleration, jerk):
    """Shortest time for a straight way from rest to rest by seven phases of constant jerk [s]."""

    def one_side(peak):
        if peak >= acceleration**2 / jerk:
            return peak / acceleration + acceleration / jerk
        return 2 * np.sqrt(peak / jerk)

    low, high = 0.0, speed
    if speed * one_side(speed) <= length:
        return one_side(speed) + length / speed
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if middle * one_side(middle) < length else (low, middle)
    return 2 * one_side(low)


@pytest.mark.parametrize(
    ("name", "known"),
    [("narrow", 2.2), ("complex", 3.45), pytest.param("window", 2.4, marks=pytest.mark.slow)],
)
@pytest.mark.few(1)
def test_durations_are_those_known(name, known):
    solution = comove.solve(hasty(name))
    assert solution.verified
    assert isinstance(solution.objective, LeastTime)
    assert solution.scene.duration <= known
    report = solution.report
    assert max(report.speed_max, report.acceleration_max, report.jerk_max / 5) <= 1.0


@pytest.mark.parametrize("limits", [HARD, {"speed": 0.3, "acceleration": 2.0, "jerk": 20.0}])
def test_a_free_hand_is_nearly_as_fast_as_possible(limits):
    solution = comove.solve(Scene.from_dict(lone_hand(limits=limits)))
    least = s_curve(1.0, **limits)
    assert least <= solution.scene.duration <= 1.03 * least


def test_time_scales_with_the_limits():
    """Half the speed, a quarter of the acceleration and an eighth of the jerk take twice as long."""
    slow = {"speed": 0.5, "acceleration": 0.25, "jerk": 0.625}
    times = [comove.solve(hasty("narrow", limits=limits)).scene.duration for limits in (HARD, slow)]
    assert times[1] == pytest.approx(2 * times[0], rel=0.01)


def test_it_rests_at_both_ends_without_a_jump():
    solution = comove.solve(hasty("narrow"))
    hands = solution.attempt.hands(np.array([0.0, 1.0]))
    np.testing.assert_allclose(hands[1:], 0.0, atol=1e-6)


def test_least_time_is_asked_for_whatever_the_scene_says():
    """The scene's own duration and demonstration do not count; limits that it leaves out are filled in and said."""
    scene = example("narrow")
    solution = comove.solve(scene, objective=LeastTime(), demonstration=demonstration_of(scene))
    assert solution.verified
    assert solution.scene.duration < 2.2
    assert solution.scene.jerk_limit == LIMITS["jerk"]
    assert solution.scene.file.limits.speed == example("narrow").speed_limit


def test_what_was_taught_is_made_as_fast_as_limits_allow():
    timed, scene = example("narrow"), hasty("narrow")
    solution = comove.solve(scene, demonstration=demonstration_of(timed))
    asked = comove.solve(timed, demonstration=demonstration_of(timed))
    assert isinstance(solution.objective, LeastJerk)
    s = np.linspace(0, 1, 101)
    assert np.abs(solution.attempt.hands(s)[0] - asked.attempt.hands(s)[0]).max() < 0.02
    duration = solution.scene.duration
    assert verify(solution.attempt).verified is not None
    assert verify(solution.attempt.on(solution.scene.timed(0.999 * duration))).verified is None


@pytest.mark.parametrize(
    ("name", "limits", "duration", "most"),
    [
        ("narrow", HARD, 0.3, 2.25),
        pytest.param("narrow", HARD, 2.1, 2.25, marks=pytest.mark.slow),
        pytest.param("window", {"speed": 1.0}, 0.2, 0.95, marks=pytest.mark.slow),
        pytest.param("window", {"speed": 1.0}, 0.86, 0.95, marks=pytest.mark.slow),
    ],
)
def test_a_duration_that_is_too_short_is_answered_by_one_that_does(name, limits, duration, most):
    solution = comove.solve(hasty(name, duration, limits=limits))
    assert not solution.verified
    (told,) = (reason for reason in solution.reasons if "would do" in reason)
    needed = float(told.split(": ")[1].split(" s")[0])
    assert duration < needed < most
    assert comove.solve(hasty(name, needed, limits=limits)).verified


@pytest.mark.parametrize("duration", [2.1, 2.4])
@pytest.mark.slow
def test_where_a_search_in_time_finds_nothing_the_fastest_motion_decides(monkeypatch, duration):
    """A search that fails although a longer duration is known is not the last word: a faster motion may do."""
    solution_of, fastest = solver._solution, comove.solve(hasty("narrow"))

    def failing(problem, search, timed_out):
        found = solution_of(problem, search, timed_out)
        if not problem.is_timed:
            return found
        search.found.needed = 9.0
        return replace(found, motion=None)

    monkeypatch.setattr(solver, "_solution", failing)
    solution = comove.solve(hasty("narrow", duration))
    assert solution.verified == (fastest.scene.duration < duration)
    assert solution.scene.duration == duration
    if not solution.verified:
        assert any("2.24 s would do" in reason for reason in solution.reasons)


@pytest.mark.slow
def test_a_duration_just_long_enough_is_kept():
    assert comove.solve(hasty("narrow", 2.2)).verified


def test_the_pace_is_the_least():
    """A motion is scaled to the shortest duration in which its bounds keep the limits."""
    motion = comove.solve(example("wide"), objective=LeastJerk(room=0.0)).attempt
    rng = np.random.default_rng(5)
    for _ in range(5):
        limits = dict(zip(HARD, rng.uniform(0.2, 5.0, 3), strict=True))
        fast = in_least_time(motion, example("wide").limited(**limits))
        assert verify(fast).verified is not None
        assert verify(fast.on(fast.scene.timed(0.999 * fast.scene.duration))).verified is None


def test_scenes_of_any_size_take_their_time():
    """A thousandth of the size under a thousandth of the limits takes as long."""
    small = hasty("narrow").timed(1.0).scaled(1e-3).timed(None)
    assert comove.solve(small).scene.duration == pytest.approx(2.194, rel=0.01)


def test_an_open_duration_is_told_by_what_needs_one():
    with pytest.raises(SceneError, match="leaves its duration out"):
        _ = hasty("narrow").duration


CORRIDOR = {"lower": [-0.5, -0.05], "upper": [1.5, 0.05]}


def gate(velocity):
    """A wall 10 cm thick across the way of a hand, with a gap 12 cm wide that comes along."""
    return [
        {"shape": "box", "center": [0.5, y], "size": [0.1, 2.0], "motion": {"velocity": velocity}}
        for y in (-1.5, 0.62)
    ]


@pytest.mark.slow
def test_it_waits_no_longer_than_a_gate_stays_shut():
    """The gap's upper edge reaches the corridor after 3.3 s; before that nothing passes."""
    scene = Scene.from_dict(lone_hand(limits=HARD, obstacles=gate([0.0, 0.1]), workspace=CORRIDOR))
    solution = comove.solve(scene)
    assert solution.verified and isinstance(solution.objective, LeastTime)
    assert 3.3 + 0.4 < solution.scene.duration < 5.5
    crossed = np.interp(0.45, solution.trajectory.position[:, 0, 0], solution.trajectory.time)
    assert crossed > 3.3
    assert verify(solution.attempt).verified is not None


def test_what_moves_out_of_the_way_costs_no_time():
    scene = Scene.from_dict(lone_hand(limits=HARD, obstacles=gate([0.0, 0.1])[:1], workspace=CORRIDOR))
    free = comove.solve(Scene.from_dict(lone_hand(limits=HARD, workspace=CORRIDOR)))
    assert comove.solve(scene).scene.duration < 1.2 * free.scene.duration


def test_functions_of_ones_own_need_a_duration_where_something_moves():
    scene = Scene.from_dict(lone_hand(limits=HARD, obstacles=gate([0.0, 0.1])))
    with pytest.raises(OptionError, match="need a duration"):
        comove.solve(scene, objective=lambda motion: 0.0)


def test_no_motion_undercuts_what_is_out_of_the_question():
    """The bound is below what a straight way needs, and says nothing of a motion that is under way already."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        limits = dict(zip(HARD, rng.uniform(0.2, 5.0, 3), strict=True))
        scene = Scene.from_dict(lone_hand(limits=limits, duration=9.0))
        assert 0.0 < least_possible(scene) <= s_curve(1.0, **limits) * (1 + 1e-9)
    starts, twists = tuple(group.start for group in scene.groups), np.array([[0.3, 0, 0, 0, 0, 0]])
    assert least_possible(scene.resumed(0.0, 5.0, starts, twists)) == 0.0


def test_limits_that_nothing_can_keep_end_with_an_answer():
    """Even where the first duration that is tried is the longest that there is."""
    slow = {"speed": 1e-6, "acceleration": 1e-6, "jerk": 1e-6}
    scene = Scene.from_dict(lone_hand(limits=slow, obstacles=gate([0.0, 0.1]), workspace=CORRIDOR))
    assert not comove.solve(scene, budget=2.0).verified

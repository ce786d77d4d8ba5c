"""Motions of least jerk: smooth, at rest at both ends, near to what was taught, and verified like any other."""

import numpy as np
import pytest

import comove
from comove import LeastJerk, PaperCost
from comove.errors import OptionError
from comove.model import Scene, demonstration_of, recording_of
from comove.planning import carried_demonstration
from comove.planning.convex.costs import jerk_cost
from tests.solved import example, scene_of

# The least known squared jerk over that of straight motions, by a solver of nonlinear programmes from many starts.
KNOWN = {"narrow": 2.15, "window": 1.68, "triangle": 1.64, "wide": 1.0}
S = np.linspace(0.0, 1.0, 801)


def accelerations(motion):
    """Of all hands [m/s^2]; array, shape (n_steps, n_hands)."""
    return np.linalg.norm(motion.hands(S)[2], axis=2) / motion.scene.duration**2


def nearness(motion, dmp):
    """Mean distance of hands from the demonstration at equal shares of time [m]."""
    taught = carried_demonstration(dmp, motion.scene)[..., : motion.scene.n_dims]
    return np.linalg.norm(motion.hands(np.linspace(0, 1, len(taught)))[0] - taught, axis=2).mean()


@pytest.mark.parametrize("name", KNOWN)
def test_jerk_is_near_the_least_known(name):
    solution = comove.solve(example(name), objective=LeastJerk(room=0.0))
    assert solution.verified
    assert jerk_cost(solution.attempt, LeastJerk(), None) <= 1.05 * KNOWN[name]
    assert accelerations(solution.attempt).max() < 0.08


@pytest.mark.parametrize("name", ["complex", "planar 0", "bar 1"])
def test_what_is_handed_out_is_verified_and_gentle(name):
    """At rest at both ends, without a jump of acceleration, and without the lunge of the paper's objective."""
    scene = scene_of(name)
    smooth, paper = (comove.solve(scene, objective=objective) for objective in (LeastJerk(), PaperCost()))
    assert smooth.verified
    assert smooth.report.clearance_min >= scene.clearance
    hands = smooth.attempt.hands(np.array([0.0, 1.0]))
    np.testing.assert_allclose(hands[1:], 0.0, atol=1e-7)
    assert accelerations(smooth.attempt).max() < 0.2 * accelerations(paper.attempt).max()
    assert jerk_cost(smooth.attempt, LeastJerk(), None) < 1e-2 * jerk_cost(paper.attempt, LeastJerk(), None)


def test_room_is_kept_where_it_costs_little():
    tight, roomy = (comove.solve(example("narrow"), objective=LeastJerk(room=room)) for room in (0.0, 0.01))
    assert tight.report.clearance_min < 3e-3 < 6e-3 < roomy.report.clearance_min
    assert jerk_cost(roomy.attempt, LeastJerk(), None) < 1.2 * jerk_cost(tight.attempt, LeastJerk(), None)


def test_what_was_taught_is_followed():
    """Through a passage in which the demonstration itself would hit the walls: as near as asked for, and calm."""
    scene = example("narrow")
    far, near, nearest = (
        comove.solve(scene, demonstration=demonstration_of(scene), objective=LeastJerk(r))
        for r in (0.0, None, 1.0)
    )
    assert far.verified and near.verified and nearest.verified
    distances = [nearness(solution.attempt, demonstration_of(scene)) for solution in (far, near, nearest)]
    assert distances[0] > 0.05 > 0.02 > distances[1] > distances[2]
    assert accelerations(near.attempt).max() < 0.5


def test_where_nothing_is_in_the_way_the_demonstration_is_carried_out():
    scene = example("narrow")
    free = Scene.from_dict(scene.file.model_dump(exclude={"obstacles", "demonstration"}))
    solution = comove.solve(free, demonstration=demonstration_of(scene), objective=LeastJerk(1.0))
    assert solution.verified
    assert nearness(solution.attempt, demonstration_of(scene)) < 2e-3


def test_another_demonstration_makes_another_motion():
    scene = example("narrow")
    mirrored = comove.DMP.fit(
        comove.Demonstration(recording_of(scene).time, recording_of(scene).position * [1.0, -1.0], "mirrored")
    )
    first, second = (
        comove.solve(scene, demonstration=dmp, objective=LeastJerk())
        for dmp in (demonstration_of(scene), mirrored)
    )
    hands = [solution.attempt.hands(S)[0] for solution in (first, second)]
    assert np.linalg.norm(hands[0] - hands[1], axis=2).mean() > 0.03


def test_moving_obstacles_are_dodged_smoothly():
    scene = Scene.from_dict(
        {
            "name": "crossing",
            "duration": 4.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "obstacles": [
                {"shape": "circle", "center": [0.5, 1.0], "radius": 0.06, "motion": {"velocity": [0, -0.25]}},
            ],
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": [
                {"name": "left", "start": [0.15, 0.4], "goal": [0.85, 0.4]},
                {"name": "right", "start": [0.15, 0.6], "goal": [0.85, 0.6]},
            ],
            "limits": {"speed": 0.6, "acceleration": 3.0},
        }
    )
    solution = comove.solve(scene, objective=LeastJerk())
    assert solution.verified
    assert accelerations(solution.attempt).max() < 0.6


def test_a_scene_a_hundred_times_as_large_is_solved_alike():
    scene = example("narrow")
    small, large = (comove.solve(s, objective=LeastJerk()) for s in (scene, scene.scaled(100.0)))
    assert large.verified
    values = [jerk_cost(solution.attempt, LeastJerk(), None) for solution in (small, large)]
    assert values[0] == pytest.approx(values[1], rel=0.1)


def test_the_same_seed_gives_the_same_motion():
    first, second = (comove.solve(example("window"), objective=LeastJerk(), seed=3) for _ in range(2))
    np.testing.assert_array_equal(first.attempt.weights, second.attempt.weights)


def test_the_first_verified_motion_is_told_at_once_and_then_better_ones():
    seen = []
    solution = comove.solve(example("narrow"), objective=LeastJerk(), progress=seen.append)
    best = [state.best for state in seen if state.best is not None]
    assert best == sorted(best, reverse=True)
    assert best[-1] < 0.1 * best[0]
    assert solution.effort.first_verified < solution.effort.seconds


@pytest.mark.parametrize("value", [-0.1, 1.01, float("nan"), "much", True])
def test_a_resemblance_is_a_share(value):
    with pytest.raises(OptionError, match=r"is not between 0 and 1; give 0"):
        LeastJerk(value)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf"), "wide"])
def test_a_wish_for_room_is_a_length(value):
    with pytest.raises(OptionError, match=r"give a number of metres"):
        LeastJerk(room=value)


def test_nothing_is_resembled_without_a_demonstration():
    with pytest.raises(OptionError, match=r"a resemblance of 0.5 without a demonstration"):
        comove.solve(example("window"), objective=LeastJerk(0.5))
    with pytest.raises(OptionError, match=r"here give LeastJerk\(\)"):
        comove.solve(example("window"), objective="least jerk")

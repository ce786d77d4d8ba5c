"""Task-priority control as a method: what it holds, in which order, and where it is stuck."""

import numpy as np
import pytest

import comove
from comove.errors import OptionError
from comove.lab.compared import Performance, TaskPriority
from comove.model import Scene, demonstration_of
from tests.meshes import ring, write_obj
from tests.model.examples import MIXED, PLANAR_BAR, PLANAR_LEVEL
from tests.solved import example
from tests.verification.random_motions import scene_data


@pytest.fixture(scope="module")
def stuck():
    """In front of the passage that is narrower than the bar."""
    return comove.solve(example("narrow"), method=TaskPriority())


@pytest.fixture(scope="module")
def through():
    """Both staggered gaps, by a demonstration that passes them."""
    scene = example("complex")
    return comove.solve(scene, demonstration=demonstration_of(scene), method=TaskPriority())


@pytest.mark.slow
def test_where_nothing_is_in_the_way_the_motion_is_verified():
    for scene in (example("wide"), PLANAR_BAR, MIXED, PLANAR_LEVEL):
        solution = comove.solve(scene, method=TaskPriority())
        assert solution.verified, scene.name
        assert solution.log["relative_beyond_bound"] == solution.log["absolute_beyond_bound"] == 0.0


@pytest.mark.slow
def test_clearance_comes_before_the_goal(stuck):
    """It stands before the wall, upright as it came: nothing in its tasks asks it to turn."""
    assert not stuck.verified
    assert stuck.report.clearance_min > 0
    assert stuck.report.distance_error_max < 1e-6
    assert stuck.report.end_error > 0.3
    assert any("an end is missed" in reason for reason in stuck.reasons)


@pytest.mark.slow
def test_a_demonstration_leads_through_and_clearance_turns_the_bar(through):
    log = through.log
    assert log["integration_end_miss_m"] < 5e-3
    assert log["carried_out_share"] == 1.0
    assert through.report.end_error < 1e-9
    assert through.report.clearance_min > 0
    hands = through.trajectory.position
    assert np.ptp(np.unwrap(np.arctan2(*(hands[:, 1] - hands[:, 0]).T))) > 0.3


@pytest.mark.slow
def test_relative_motion_comes_before_absolute(through):
    """The distance stays within its bound while the middle is pushed off its way."""
    log = through.log
    assert log["relative_beyond_bound"] == 0.0
    assert log["relative_error_max_m"] < 1e-3 < 0.01 < log["absolute_error_max_m"]


def test_limits_come_first():
    data = scene_data(example("wide")) | {
        "demonstration": None,
        "limits": {"speed": 0.11, "acceleration": 0.05},
    }
    solution = comove.solve(Scene.from_dict(data), method=TaskPriority(period=0.01))
    assert solution.report.speed_max <= 0.11 * 1.001
    assert solution.log["absolute_error_max_m"] > 0.001  # the taught movement is faster than that


def test_obstacles_that_move_are_given_way_to():
    scene = Scene.from_dict(
        {
            "name": "crossed",
            "duration": 4.0,
            "workspace": {"lower": [-2, -2], "upper": [2, 2]},
            "obstacles": [
                {
                    "shape": "circle",
                    "center": [0.1, 1.0],
                    "radius": 0.1,
                    "motion": {"velocity": [0.0, -0.5]},
                }
            ],
            "manipulators": [{"name": "a", "start": [-0.5, 0.0], "goal": [0.5, 0.0]}],
        }
    )
    t = np.linspace(0.0, 1.0, 401)
    straight = np.stack([-0.5 + t**3 * (10 - 15 * t + 6 * t**2), 0 * t], axis=1)
    disc = np.stack([0.1 + 0 * t, 1.0 - 0.5 * 4.0 * t], axis=1)
    assert np.linalg.norm(straight - disc, axis=1).min() < 0.1  # who does not look runs into it
    solution = comove.solve(scene, method=TaskPriority())
    assert solution.verified


def test_three_hands_in_space_hold_their_frame():
    solution = comove.solve(example("triangle"), method=TaskPriority(period=0.01))
    assert solution.report.clearance_min > 0
    assert solution.log["relative_error_max_m"] < 1e-3


def test_when_time_runs_out_the_rest_is_not_moved(monkeypatch):
    from comove.planning.search import Search

    monkeypatch.setattr(Search, "over", lambda search: True)
    solution = comove.solve(example("wide"), method=TaskPriority())
    assert not solution.verified
    assert 0 < solution.log["carried_out_share"] < 0.01


@pytest.mark.parametrize("wrong", [{"period": 0.0}, {"posture": -1.0}, {"acceleration": None}])
def test_slips_are_told(wrong):
    with pytest.raises(OptionError, match=next(iter(wrong))):
        TaskPriority(**wrong)


@pytest.mark.slow
def test_a_tighter_bound_holds_the_middle_closer():
    """Where nothing is in the way, the error of what is held is as many times smaller as the gain is larger."""
    scene = example("wide")
    tight = Performance(first=0.05, last=0.02, decay=2.0, gain=20.0)
    loose = Performance(first=0.05, last=0.02, decay=2.0, gain=2.0)
    errors = [
        comove.solve(
            scene, demonstration=demonstration_of(scene), method=TaskPriority(absolute=p, period=0.01)
        ).log["absolute_error_max_m"]
        for p in (tight, loose)
    ]
    assert 5 < errors[1] / errors[0] < 20


@pytest.mark.slow
def test_a_mesh_of_many_rows_leaves_what_comes_after_it_where_it_is(tmp_path):
    """A ball crosses the way. A tube that stands in the far corner, and comes first in the file, changes nothing."""
    write_obj(tmp_path / "tube.obj", *ring(n=10))
    tube = {"shape": "mesh", "file": "tube.obj", "center": [1.8, 1.8, 0.9]}
    ball = {
        "shape": "sphere",
        "center": [0.5, 0.9, 0.5],
        "radius": 0.06,
        "motion": {"velocity": [0, -0.15, 0]},
    }

    def hands(*obstacles):
        data = {
            "name": "crossed",
            "duration": 4.0,
            "workspace": {"lower": [0, 0, 0], "upper": [2, 2, 1]},
            "obstacles": list(obstacles),
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": [
                {"name": n, "start": [0.15, y, 0.5], "goal": [0.85, y, 0.5]}
                for n, y in (("a", 0.4), ("b", 0.6))
            ],
        }
        scene = Scene.from_dict(data, folder=tmp_path)
        assert len(scene.obstacles) > len(obstacles) or tube not in obstacles
        return comove.solve(scene, method=TaskPriority(period=0.02)).trajectory.position

    alone, both = hands(ball), hands(tube, ball)
    assert np.abs(alone - hands()).max() > 0.005, "the ball matters"
    np.testing.assert_allclose(both, alone, atol=1e-9)

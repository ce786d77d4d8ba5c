"""Plans in space and time, and what comes of them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.random_scenes import moving_scene
from comove.model import Scene, load_coordinates
from comove.planning import solve
from comove.planning.configurations import configuration_space, span
from comove.planning.spacetime import _eased, plan_in_time, spacetime, targets_in_time
from tests.cases import examples


def corridor(**disc):
    """A corridor as wide as the bar is long, and a disc that moves in it."""
    walls = [{"shape": "box", "center": [0.5, y], "size": [0.6, 0.3]} for y in (0.15, 0.85)]
    hands = [{"name": n, "start": [0.1, y], "goal": [0.9, y]} for n, y in (("a", 0.4), ("b", 0.6))]
    return Scene.from_dict(
        {
            "name": "corridor",
            "duration": 6.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "obstacles": [*walls, {"shape": "circle", "radius": 0.195, **disc}],
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": hands,
            "limits": {"speed": 0.6, "acceleration": 2.0},
        }
    )


@examples(15)
@given(seed=st.integers(0, 200))
def test_a_plan_keeps_its_margin_and_its_speed(seed):
    scene, speed = moving_scene(seed), 2.0
    coordinates = load_coordinates(scene)
    space, ends = configuration_space(scene, coordinates), coordinates.boundary()
    world = spacetime(scene, space)
    found = plan_in_time(world, ends[0], ends[2], speed, 0.01, np.random.default_rng(seed), max_nodes=2000)
    if found is None:
        return
    path, times = found
    assert (times[0], times[-1]) == (0.0, 1.0)
    assert (np.diff(times) > 0).all()
    for p, q, wait in zip(path[:-1], path[1:], np.diff(times), strict=True):
        assert span(space, p, q) <= speed * wait * (1 + 1e-9)
    for p, q, s, t in zip(path[:-1], path[1:], times[:-1], times[1:], strict=True):
        (between,) = np.array([[p, q]])
        row = targets_in_time(space, between, np.array([0.0, 1.0]), 3)[0, 1]  # half-way, both evenly turned
        nodes = coordinates.nodes(np.ascontiguousarray(row[None, :, None]))[0, 0]
        assert scene.clearance_at(nodes, 0.5 * (s + t) * scene.duration)[0] > -1e-3


def test_what_was_planned_before_is_found_again_sooner():
    scene = moving_scene(24)
    coordinates = load_coordinates(scene)
    space, ends = configuration_space(scene, coordinates), coordinates.boundary()
    world = spacetime(scene, space)

    def plans(max_nodes, before=None):
        for seed in range(20):
            yield plan_in_time(
                world,
                ends[0],
                ends[2],
                2.0,
                0.01,
                np.random.default_rng(seed),
                max_nodes=max_nodes,
                before=before,
            )

    (path, times), *_ = (found for found in plans(3000) if found is not None)
    before = targets_in_time(space, path, times, 20)[0]
    few = 100
    again = sum(found is not None for found in plans(few, before))
    anew = sum(found is not None for found in plans(few))
    assert again >= anew + 10


@pytest.mark.parametrize("ease", [0.06, 0.5, 1.0])
def test_eased_times_begin_and_end_at_rest_and_never_go_back(ease):
    s = np.linspace(0.0, 1.0, 2001)
    t = _eased(s, ease)
    assert (t[0], t[-1]) == (0.0, 1.0)
    assert (np.diff(t) >= 0).all()
    assert t[1] < 1e-4 and 1 - t[-2] < 1e-4
    np.testing.assert_allclose(t + t[::-1], 1.0, atol=1e-12)


def test_the_load_waits_until_the_way_is_free():
    """A disc stands in the corridor, which nothing can pass beside it, and leaves it after 2.5 s."""
    up = {"waypoints": [[0.5, 0.5], [0.5, 2.5]], "times": [2.5, 3.5]}  # through the wall, as obstacles may
    found = solve(corridor(center=[0.5, 0.5], motion=up), seed=0, budget=10.0)
    assert found.verified
    assert found.report.distance_error_max < 1e-9
    halfway = found.motion.motion.hands(np.array([2.5 / 6.0]))[0, 0, :, 0]
    assert halfway.max() < 0.5, "no earlier"


def test_a_goal_that_is_taken_when_the_load_comes_is_told_at_once():
    visitor = {"center": [0.9, 0.0], "motion": {"waypoints": [[0.9, 0.0], [0.9, 0.5]], "times": [0, 5]}}
    found = solve(corridor(**visitor), seed=0, budget=30.0)
    assert not found.verified
    assert found.effort.seconds < 3.0
    assert "obstacles[2] (sphere)" in found.reasons[0]


@pytest.mark.parametrize("seed", [0, 1, 2, 3])
@pytest.mark.few(2)
def test_random_scenes(seed):
    found = solve(moving_scene(seed), seed=0, budget=20.0)
    assert found.verified, found.reasons
    assert found.report.distance_error_max <= 1e-9


def test_a_plan_is_the_same_for_the_same_seed():
    first, second = (solve(moving_scene(0), seed=3, budget=60.0) for _ in range(2))
    np.testing.assert_array_equal(first.attempt.weights, second.attempt.weights)

"""A deadline holds inside compiled loops, and changes nothing before it has come."""

import time

import numpy as np
import pytest

from comove.model.coordinates import load_coordinates
from comove.model.scene import Scene
from comove.planning.clock import LOOKS, STRIDE, UP, WORK, Budget, clock_until, now, wind, worked
from comove.planning.configurations import clearance_of, configuration_space, edge_is_free
from comove.planning.planner import plan
from comove.planning.spacetime import plan_in_time, spacetime

NODES = 10_000


def closed(n_dims, n_walls=60):
    """A bar before a closed wall, made of many boxes: there is no way, and it takes long to be sure."""
    gap = [0.5] * n_dims
    walls = [
        {
            "shape": "box",
            "center": [0.5, *((k + 0.5) / n_walls, 0.5)[: n_dims - 1]],
            "size": [0.02, 0.1, 1.0][:n_dims],
        }
        for k in range(n_walls)
    ]
    return Scene.from_dict(
        {
            "name": "closed",
            "duration": 5.0,
            "workspace": {"lower": [0.0] * n_dims, "upper": [1.0] * n_dims},
            "obstacles": walls,
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": [
                {"name": "a", "start": [0.2, 0.4, *gap[2:]], "goal": [0.8, 0.4, *gap[2:]]},
                {"name": "b", "start": [0.2, 0.6, *gap[2:]], "goal": [0.8, 0.6, *gap[2:]]},
            ],
        }
    )


def space_of(scene, deadline=np.inf):
    coordinates = load_coordinates(scene)
    ends = coordinates.boundary()
    space = configuration_space(scene, coordinates)
    wind(space.clock, deadline)
    return space, ends[0], ends[2]


def test_the_time_is_looked_at_after_some_work_only():
    clock = clock_until(-np.inf)
    assert not worked(clock, STRIDE // 2)
    assert clock[LOOKS] == 0
    assert worked(clock, STRIDE)
    assert clock[LOOKS] == 1 and clock[UP] == 1


def test_time_that_is_not_up_changes_nothing():
    clock = clock_until(now() + 1e6)
    for _ in range(10):
        assert not worked(clock, STRIDE + 1)
    assert clock[LOOKS] == 10


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_planner_ends_with_the_first_look_after_the_deadline(n_dims):
    space, start, goal = space_of(closed(n_dims), -np.inf)
    assert plan(space, start, goal, 0.002, np.random.default_rng(0), max_nodes=NODES) is None
    assert space.clock[LOOKS] == 1


@pytest.mark.parametrize("n_dims", [2, 3])
def test_a_planner_looks_at_the_time_again_and_again(n_dims):
    """However many obstacles there are: what lies between two looks is some milliseconds' work."""
    for n_walls in (20, 60):
        space, start, goal = space_of(closed(n_dims, n_walls))
        plan(space, start, goal, 0.002, np.random.default_rng(0), max_nodes=400 if n_dims == 2 else 30)
        looks, work = space.clock[LOOKS], space.clock[WORK]
        assert looks > 5
        assert looks * STRIDE < work < (looks + 1) * 1.1 * STRIDE


def test_nothing_is_free_after_the_deadline():
    space, start, _ = space_of(closed(2), -np.inf)
    scratch, nodes = np.empty_like(start), np.empty((space.blocks.node.shape[0], 3))
    assert clearance_of(space, start, nodes, 0.0) > 0
    worked(space.clock, 2 * STRIDE)
    assert clearance_of(space, start, nodes, 0.0) == -np.inf
    assert not edge_is_free(space, start, start, 0.0, scratch, nodes)


def test_a_clock_that_is_up_can_be_wound_up_again():
    space, start, goal = space_of(closed(2, 2), -np.inf)
    worked(space.clock, 2 * STRIDE)
    assert plan(space, start, goal, 0.002, np.random.default_rng(0)) is None
    wind(space.clock, np.inf)
    assert plan(space, start, goal, 0.002, np.random.default_rng(0)) is not None


def test_a_planner_in_time_ends_as_well():
    scene = closed(2)
    space, start, goal = space_of(scene, -np.inf)
    world, rng = spacetime(scene, space), np.random.default_rng(0)
    assert plan_in_time(world, start, goal, 5.0, 0.01, rng, max_nodes=NODES) is None
    assert space.clock[LOOKS] == 1


def test_an_obstacle_as_fast_as_a_bullet_does_not_hold_a_planner_up():
    """What travels kilometres takes millions of steps of an advance along a single edge."""
    data = closed(2, 2).file.model_dump(exclude_none=True)
    data["obstacles"] = [
        {"shape": "circle", "center": [9e3, 0.5], "radius": 0.05, "motion": {"velocity": [-9e2, 0.0]}}
    ]
    scene = Scene.from_dict(data)
    space, start, goal = space_of(scene, -np.inf)
    world, rng = spacetime(scene, space), np.random.default_rng(0)
    assert plan_in_time(world, start, goal, 5.0, 0.01, rng, max_nodes=NODES) is None
    assert space.clock[LOOKS] == 1


@pytest.mark.parametrize(("spare", "free"), [(1e-3, True), (1e-5, False)])
def test_an_edge_along_which_one_can_only_creep_is_not_free(spare, free):
    """A bar that slides along the border, hardly farther away than the margin."""
    space, start, _ = space_of(closed(2, 2))
    scratch, nodes = np.empty_like(start), np.empty((space.blocks.node.shape[0], 3))
    start[0] = 0.05
    along = start + np.array([0.0, 0.2, 0.0])
    assert edge_is_free(space, start, along, 0.05 - spare, scratch, nodes) == free


def test_an_end_that_is_hardly_free_can_be_left():
    space, start, _ = space_of(closed(2, 2))
    scratch, nodes = np.empty_like(start), np.empty((space.blocks.node.shape[0], 3))
    start[0] = 0.05
    away = start + np.array([0.1, 0.0, 0.0])
    assert edge_is_free(space, start, away, 0.05 - 1e-5, scratch, nodes)
    assert edge_is_free(space, away, start, 0.05 - 1e-5, scratch, nodes)


def test_a_budget_is_not_spent_while_others_work():
    """A sleep costs no processor time, and nothing of the budget."""
    clock, begun = clock_until(now() + 0.5), now()
    time.sleep(0.6)
    assert not worked(clock, 2 * STRIDE) and now() - begun < 0.5
    while now() - begun < 0.5:
        pass
    assert worked(clock, 2 * STRIDE)


def test_a_count_of_work_ends_a_search_at_the_same_step_on_every_machine():
    clock = clock_until(work=10.0)
    assert [worked(clock, 4.0) for _ in range(4)] == [False, False, True, True]
    assert clock[LOOKS] == 0 and clock[WORK] == 16.0
    wind(clock, np.inf)  # a postponed deadline does not give more work
    assert worked(clock, 0.0)


def test_shares_of_a_budget_do_not_depend_on_how_long_anything_took():
    whole = Budget.of(30.0)
    quick, slow = whole.after(1.0, 5.0), whole.after(29.0, 5.0)
    assert quick.size == slow.size == 25.0
    assert quick.within(0.5 * quick.size).work == slow.within(0.5 * slow.size).work == 12.5
    assert not slow.is_spent and slow.after(2.0).is_spent
    assert Budget(work=3.0).size == 3.0 and Budget.of(Budget(work=3.0)) == Budget(work=3.0)

"""Where to go without a plan."""

from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.random_scenes import moving_scene
from comove.control.dynamic_window import DynamicWindow, WindowStart
from comove.control.safety.twists import advanced, hand_velocities, nodes_of, poses_of
from comove.coordination import load_coordinates
from comove.planning.objective import Objective
from tests.control.test_executor import crossing, disc

WINDOW = DynamicWindow()
FEW = SimpleNamespace(  # draws nothing but standing still
    standard_normal=np.zeros,
    uniform=lambda low, high, n: np.full(n, high),
    integers=lambda low, high, n: np.ones(n),
    permutation=lambda a: a,
)


def evaded(scene, rng, before=None):
    """The course of a load that stands at the start."""
    start, goal = poses_of(scene, "start"), poses_of(scene, "goal")
    still = np.zeros((len(scene.groups), 6))
    objective = Objective(scene, load_coordinates(scene))
    here = WindowStart(scene, start, still)
    return WINDOW.best_course(here, objective, goal, scene.offsets(WINDOW.instants), rng, before)


def test_with_nothing_in_the_way_it_is_that_to_the_goal():
    assert evaded(crossing(), np.random.default_rng(0)) is None


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.few(2)
def test_what_comes_is_avoided_by_going_aside(seed):
    """A disc comes along the bar's line; to stand still, as to go to the goal, is to be hit within the second."""
    scene = crossing(disc([0.5, 0.5], {"velocity": [-0.3, 0.0]}, radius=0.1))
    course = evaded(scene, np.random.default_rng(seed))
    assert course is not None
    for twists in course:
        speeds = np.linalg.norm(hand_velocities(scene, poses_of(scene, "start"), twists), axis=1)
        assert speeds.max() <= scene.speed_limit * (1 + 1e-9)
    assert least(scene, course) > least(scene, np.zeros_like(course))
    assert least(scene, course) > 0


def test_what_moves_gets_more_room_than_what_stands():
    """A disc 4 cm beside the way: what stands is passed as the straight way does, what creeps in a bow, if known."""
    bow = np.zeros((WINDOW.n_moments, 1, 6))
    bow[:, 0, :2] = np.repeat([[0.4, -0.3], [0.49, 0.0], [0.4, 0.3]], [3, 9, 3], axis=0)
    known = np.concatenate([bow[:1], bow[:-1]])
    stands, creeps = (crossing(disc([0.4, 0.71], m)) for m in (None, {"velocity": [1e-3, 0.0]}))
    assert evaded(stands, FEW, known) is None
    assert least(creeps, evaded(creeps, FEW, known)) > 0.08


def least(scene, course):
    """Clearance at the ends of the moments of a load that changes its twist as fast as it may, step by step."""
    poses, twists, found, dt = poses_of(scene, "start"), np.zeros((1, 6)), [], 1e-3
    for k in range(round(WINDOW.instants[-1] / dt)):
        change = course[int(k * dt / WINDOW.moment + 1e-9)] - twists
        hands = np.linalg.norm(hand_velocities(scene, poses, change), axis=1).max()
        twists = twists + change * min(1.0, scene.acceleration_limit * dt / max(hands, 1e-12))
        poses = advanced(poses, twists, dt)
        found.append(scene.clearance_at(nodes_of(scene, poses), (k + 1) * dt)[0])
    return min(found[round(WINDOW.moment / dt) - 1 :: round(WINDOW.moment / dt)])


def test_a_course_is_followed_as_small_steps_say():
    """Velocities grow at the limit of accelerations; hands' directions hardly turn within a moment."""
    scene = crossing(disc([0.5, 0.5], {"velocity": [-0.3, 0.0]}, radius=0.1))
    poses, still = poses_of(scene, "start"), np.zeros((1, 6))
    course = np.zeros((WINDOW.n_moments, 1, 6))
    course[:, 0, 1], course[7:, 0, 0] = 0.4, 0.3
    nodes = WindowStart(scene, poses, still).nodes_along(course[None], WINDOW.moment)[0]
    clearances = [scene.clearance_at(n, t)[0] for n, t in zip(nodes, WINDOW.instants, strict=True)]
    assert min(clearances) == pytest.approx(least(scene, course), abs=2e-3)


def test_what_was_found_a_moment_ago_is_not_forgotten():
    """Nothing is drawn but standing still and what is already known: the known way out is taken, a moment later."""
    scene = crossing(disc([0.5, 0.5], {"velocity": [-0.3, 0.0]}, radius=0.1))
    before = evaded(scene, np.random.default_rng(3))
    course = evaded(scene, FEW, before)
    np.testing.assert_array_equal(course[:-1], before[1:])


@pytest.mark.parametrize("seed", range(8))
def test_candidates_are_what_the_load_can_do(seed):
    scene = moving_scene(seed)
    course = evaded(scene, np.random.default_rng(seed))
    if course is None:
        return
    if scene.n_dims == 2:
        assert not course[:, :, 2:5].any()
    assert np.isfinite(course).all()

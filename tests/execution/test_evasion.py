"""Where to go without a plan."""

import numpy as np
import pytest

from comove.coordination import load_coordinates
from comove.execution.evasion import evasive_twists, prospect
from comove.experiments.random_scenes import moving_scene
from comove.planning.objective import Objective
from comove.reaction.twists import advanced, hand_velocities, nodes_of, poses_of
from tests.execution.test_executor import crossing, disc


def evaded(scene, seed=0):
    """Twists of a load that stands at the start."""
    start, goal = poses_of(scene, "start"), poses_of(scene, "goal")
    still = np.zeros((len(scene.groups), 6))
    objective = Objective(scene, load_coordinates(scene))
    return evasive_twists(
        objective, start, still, goal, scene.offsets(prospect()), np.random.default_rng(seed)
    )


def test_with_nothing_in_the_way_it_is_that_to_the_goal():
    assert evaded(crossing()) is None


@pytest.mark.parametrize("seed", range(5))
def test_what_comes_is_avoided_by_going_aside(seed):
    """A disc comes along the bar's line; to stand still, as to go to the goal, is to be hit within the second."""
    scene = crossing(disc([0.5, 0.5], {"velocity": [-0.3, 0.0]}, radius=0.1))
    twists = evaded(scene, seed)
    assert twists is not None
    speeds = np.linalg.norm(hand_velocities(scene, poses_of(scene, "start"), twists), axis=1)
    assert speeds.max() <= scene.speed_limit * (1 + 1e-9)

    def least(followed):
        poses = [advanced(poses_of(scene, "start"), followed, t) for t in prospect()]
        return min(
            scene.clearance_at(nodes_of(scene, p), t)[0] for p, t in zip(poses, prospect(), strict=True)
        )

    assert least(twists) > least(np.zeros((1, 6)))


@pytest.mark.parametrize("seed", range(8))
def test_candidates_are_what_the_load_can_do(seed):
    scene = moving_scene(seed)
    twists = evaded(scene, seed)
    if twists is None:
        return
    if scene.n_dims == 2:
        assert not twists[:, 2:5].any()
    assert np.isfinite(twists).all()

"""A coordinated movement executed step by step: the load stays rigid whatever happens."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from comove.errors import OptionError
from comove.model.constraints import SameHeightConstraint
from comove.model.online_motion import OnlineMotion
from tests.cases import examples
from tests.model.examples import PLANAR_BAR, SCENES, random_motion

seeds = st.integers(0, 2**32 - 1)
each = pytest.mark.parametrize("name", SCENES)


def broken(scene, coordinates, hands):
    """By how much hands break what the coordinates hold: distances in every group, and common heights."""
    worst = 0.0
    for group in coordinates.groups:
        held = hands[list(group.members)]
        apart = np.linalg.norm(held[:, None] - held[None], axis=2)
        grasps = np.linalg.norm(group.grasps[:, None] - group.grasps[None], axis=2)
        worst = max(worst, np.abs(apart - grasps).max())
    for constraint in scene.constraints:
        if isinstance(constraint, SameHeightConstraint):
            worst = max(worst, abs(hands[constraint.first, -1] - hands[constraint.second, -1]))
    return worst


@each
@examples(10)
@given(seeds, st.integers(1, 30))
@pytest.mark.few(6)
def test_steps_of_any_length_are_exact(name, seed, n_steps):
    motion = random_motion(name, seed, 0.2)
    online = OnlineMotion(motion)
    scene = motion.scene
    state = online.initial_state()
    times = np.sort(np.random.default_rng(seed).uniform(0, scene.duration, n_steps))
    for time in times:
        state = online.step(state, time - state.time) if time > state.time else state
        position, velocity, _ = motion.hands([time / scene.duration])
        at, speed = online.hands_at(state)
        assert np.abs(at - position[0]).max() < 1e-10
        assert np.abs(speed - velocity[0] / scene.duration).max() < 1e-8


@each
@pytest.mark.few(6)
def test_what_the_coordinates_hold_holds_whatever_happens(name):
    """Double and half speed, a stop, backwards, a push that tears at the load, and a goal that jumps."""
    motion = random_motion(name, 3, 0.2)
    online = OnlineMotion(motion)
    scene = motion.scene
    state = online.initial_state()
    for k, rate in enumerate(np.repeat([1.0, 2.0, 0.0, -1.0, 0.5, 1.0, 1.0], 40)):
        state = online.step(state, scene.duration / 150, rate=rate)
        hands, _ = online.hands_at(state)
        if k == 60:
            state = online.displaced(
                state, hands + 0.01 * np.random.default_rng(0).standard_normal(hands.shape)
            )
        if k == 170:
            moved = scene.goal + 0.1 * np.arange(1, scene.n_dims + 1)
            state = online.redirected(state, moved)
        assert broken(scene, motion.coordinates, online.hands_at(state)[0]) < 1e-9
    state = online.step(state, 2 * scene.duration)
    hands, speed = online.hands_at(state)
    assert np.abs(hands - moved).max() < 1e-9 and np.abs(speed).max() < 1e-9


@each
def test_a_push_moves_the_load_to_the_nearest_place(name):
    """Where the hands are measured on a rigid place of the load, the load is there."""
    motion = random_motion(name, 4, 0.2)
    online = OnlineMotion(motion)
    scene = motion.scene
    state = online.step(online.initial_state(), 0.4 * scene.duration)
    elsewhere, _ = online.hands_at(online.step(state, 0.05 * scene.duration))
    pushed = online.displaced(state, elsewhere)
    assert np.abs(online.hands_at(pushed)[0] - elsewhere).max() < 1e-9
    assert pushed.progress == state.progress
    later = online.step(pushed, 3 * scene.duration)
    assert np.abs(online.hands_at(later)[0] - scene.goal).max() < 1e-9


def test_goals_that_break_the_load_are_refused():
    motion = random_motion("angle", 5, 0.2)
    online = OnlineMotion(motion)
    state = online.initial_state()
    with pytest.raises(OptionError, match="breaks a constraint"):
        online.redirected(state, PLANAR_BAR.goal + [[0.1, 0], [0, 0]])
    for wrong in (PLANAR_BAR.goal[:1], np.full((2, 2), np.nan)):
        with pytest.raises(OptionError, match="2 points of 2 finite numbers"):
            online.redirected(state, wrong)


def test_a_goal_may_be_replaced_in_the_state():
    """As configuration, as `DMP.step` has it."""
    motion = random_motion("angle", 6, 0.2)
    online = OnlineMotion(motion)
    state = online.step(online.initial_state(), 0.3 * motion.scene.duration)
    state = replace(state, goal=state.goal + [0.1, 0.1, 0.0])
    hands, _ = online.hands_at(online.step(state, motion.scene.duration))
    assert np.abs(hands - motion.scene.goal - 0.1).max() < 1e-9


def test_the_roll_of_two_hands_stays_when_they_are_pushed():
    """Their positions say nothing of it: measured where they are, the configuration does not change."""
    motion = random_motion("relative pose", 7, 0.2)
    online = OnlineMotion(motion)
    state = online.step(online.initial_state(), 0.4 * motion.scene.duration)
    same = online.displaced(state, online.hands_at(state)[0])
    assert np.abs(same.position - state.position).max() < 1e-9


def test_what_is_none_of_this_motion():
    motion, other = random_motion("angle", 8, 0.2), random_motion("quaternion", 8, 0.2)
    online = OnlineMotion(motion)
    for doing in (
        lambda s: online.redirected(s, motion.scene.goal),
        lambda s: online.displaced(s, motion.scene.goal),
    ):
        with pytest.raises(OptionError, match="none of this motion"):
            doing(OnlineMotion(other).initial_state())
    for wrong in ("a", [[1, 2], [3]]):
        with pytest.raises(OptionError, match="points of"):
            online.displaced(online.initial_state(), wrong)
    for n_steps in (0, -5, 2.5, "a"):
        with pytest.raises(OptionError, match="n_steps"):
            motion.trajectory(n_steps)

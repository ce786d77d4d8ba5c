"""Hands with orientations on one phase: relative poses hold whatever happens, prescribed ones are followed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from comove.dmp.cooperative import CooperativeDMP
from comove.dmp.demonstrations import Demonstration
from comove.dmp.poses import VERTICAL, Pose, PoseDMP
from comove.errors import DemonstrationError, OptionError
from tests.cases import examples

from .movements import recording

seeds = st.integers(0, 2**32 - 1)


def random_pose(rng, reach=0.4):
    return Pose.of(rng.uniform(-reach, reach, 3), Rotation.random(random_state=rng.integers(2**31)))


def carried(n_hands, seed=0):
    rng = np.random.default_rng(seed)
    grasps = {f"hand{i}": random_pose(rng) for i in range(n_hands)}
    return CooperativeDMP(PoseDMP.fit(recording(seed)), grasps)


def relative_error(poses, grasps):
    """Largest error of a relative pose, [m] or [rad]: hands against the first one, by scipy."""
    first, worst = next(iter(grasps)), 0.0
    for name, grasp in grasps.items():
        seen = poses[first].rotation.inv()
        held = grasps[first].rotation.inv()
        away = seen.apply(poses[name].position - poses[first].position)
        wanted = held.apply(grasp.position - grasps[first].position)
        turn = (seen * poses[name].rotation) * (held * grasp.rotation).inv()
        worst = max(worst, np.linalg.norm(away - wanted), turn.magnitude())
    return worst


@pytest.mark.parametrize("n_hands", [2, 3, 4, 5, 6])
@pytest.mark.few(1)
def test_a_rigid_load_whatever_happens(n_hands):
    """Double and half speed, a stop, backwards, a goal that jumps, a push of the load."""
    dmp = carried(n_hands)
    goal = random_pose(np.random.default_rng(99), reach=1.0)
    state, rates = dmp.initial_state(), [1.0, 2.0, 0.5, 0.0, -1.0, 1.0, 1.0]
    for k in range(700):
        state = dmp.step(state, 0.01, rate=rates[k // 100])
        if k == 150:
            state = dmp.redirected(state, goal)
        if k == 520:
            load = dmp.load.pose(state.parts[""])
            pushed = Pose.of(load.position + 0.05, load.rotation * Rotation.from_rotvec([0.1, 0, 0]))
            state = dmp.displaced(state, pushed)
        if k % 7 == 0 or k in (150, 151, 520, 521):
            assert relative_error(dmp.poses(state), dmp.hands) < 1e-12
    state = dmp.step(state, 10.0)
    load = dmp.load.pose(state.parts[""])
    assert np.abs(load.position - goal.position).max() < 1e-9
    assert (load.rotation * goal.rotation.inv()).magnitude() < 1e-9


@examples(15)
@given(seeds, st.integers(1, 6))
def test_rollouts_hold_the_load_too(seed, n_hands):
    dmp = carried(n_hands, seed)
    path = dmp.rollout(goal=random_pose(np.random.default_rng(seed + 1)), duration=1.5, n_steps=23)
    assert path.position.shape == (23, n_hands, 3) and path.manipulators == dmp.manipulators
    for k in range(23):
        poses = {
            name: Pose(path.position[k, i], path.orientation[k, i])
            for i, name in enumerate(path.manipulators)
        }
        assert relative_error(poses, dmp.hands) < 1e-12
    assert np.abs(path.velocity[-1]).max() < 1e-9 and np.abs(path.angular_velocity[-1]).max() < 1e-9


def test_steps_equal_the_rollout():
    dmp = carried(3)
    state = dmp.step(dmp.step(dmp.initial_state(), 0.7), 0.6)
    path = dmp.at([1.3])
    for i, pose in enumerate(dmp.poses(state).values()):
        assert np.abs(pose.position - path.position[0, i]).max() < 1e-12
        assert (
            pose.rotation * Rotation.from_quat(path.orientation[0, i], scalar_first=True).inv()
        ).magnitude() < 1e-9


def differences(dmp, time, h=1e-5):
    """Velocities and angular velocities of all hands by differences."""
    ahead, behind = dmp.at(time + h), dmp.at(time - h)
    turns = (ahead.rotation * behind.rotation.inv()).as_rotvec() / (2 * h)
    return (ahead.position - behind.position) / (2 * h), turns.reshape(ahead.position.shape)


def test_one_hand_turns_the_lid_while_both_move():
    """Seen from the holder, the turner does what its own movement says; velocities are those of the path."""
    s = np.linspace(0, 1, 301)
    turns = Rotation.from_rotvec(np.outer(7 * s**3 * (10 - 15 * s + 6 * s**2), VERTICAL))
    lid = Demonstration(3 * s, np.tile([0, 0, 0.1], (301, 1)), orientation=turns.as_quat(scalar_first=True))
    turner = PoseDMP.fit(lid, n_basis=25)
    dmp = CooperativeDMP(PoseDMP.fit(recording(1)), {"holder": Pose([0, 0, -0.1]), "turner": turner})
    time = np.linspace(0.1, 2.9, 29)
    path, own = dmp.at(time), turner.at(time)
    holder, hand = (Rotation.from_quat(path.orientation[:, i], scalar_first=True) for i in (0, 1))
    assert (holder.inv() * hand * own.rotation.inv()).magnitude().max() < 1e-12
    assert np.abs(holder.inv().apply(path.position[:, 1] - path.position[:, 0]) - [0, 0, 0.2]).max() < 1e-9
    velocity, spin = differences(dmp, time)
    assert np.abs(velocity - path.velocity).max() < 1e-6 and np.abs(spin - path.angular_velocity).max() < 1e-5


def test_from_the_demonstration_of_one_hand():
    """The hand that was shown does what was shown; the others hold on."""
    shown, rng = recording(2), np.random.default_rng(3)
    grasps = {"left": random_pose(rng), "right": random_pose(rng)}
    dmp = CooperativeDMP.from_hand(shown, "left", grasps, n_basis=50)
    path = dmp.at(shown.time)
    assert np.abs(path.position[:, 0] - shown.position).max() < 2e-3
    left = Rotation.from_quat(path.orientation[:, 0], scalar_first=True)
    assert (left * shown.rotation.inv()).magnitude().max() < 2e-3
    with pytest.raises(OptionError, match="did you mean 'left'"):
        CooperativeDMP.from_hand(shown, "lefft", grasps)


def test_hands_that_move_for_themselves_share_the_phase():
    """Online, at any pace, each hand does what its own movement says; one is redirected, the other not."""
    one = PoseDMP.fit(recording(4))
    other = one.towards(start=Pose.of(one.start.position + [0.1, 0.5, 0.05], one.start.rotation))
    dmp = CooperativeDMP(None, {"left": one, "right": other})
    path = dmp.rollout(n_steps=41)
    for i, hand in enumerate((one, other)):
        own = hand.rollout(n_steps=41)
        assert np.array_equal(path.position[:, i], own.position)
        assert np.array_equal(path.orientation[:, i], own.orientation)
    goal = random_pose(np.random.default_rng(5))
    state = dmp.redirected(dmp.step(dmp.initial_state(), 0.7, rate=2.0), goal, "left")
    ends = dmp.poses(dmp.step(state, 30.0))
    assert np.abs(ends["left"].position - goal.position).max() < 1e-9
    assert np.abs(ends["right"].position - other.goal.position).max() < 1e-9
    with pytest.raises(OptionError, match="no common start or goal"):
        dmp.towards(goal_velocity=np.ones(6))


def test_slips_are_told():
    load, grasp = PoseDMP.fit(recording(0)), Pose([0, 0, 0.1])
    shown = recording(0)
    with pytest.raises(DemonstrationError, match="orientation"):
        CooperativeDMP.from_hand(Demonstration(shown.time, shown.position), "a", {"a": grasp})
    for grasps in ([grasp], None, {"a": Pose([0.0, 1.0])}, {"a": [0, 0, 0]}):
        with pytest.raises(OptionError, match="grasps"):
            CooperativeDMP.from_hand(shown, "a", grasps)
    with pytest.raises(OptionError, match="mapping of names"):
        CooperativeDMP(load, [grasp])
    assert len(CooperativeDMP(load, {"a": grasp}).at([]).time) == 0


def test_what_is_refused():
    load, grasp = PoseDMP.fit(recording(0)), Pose([0, 0, 0.1])
    for hands, message in [
        ({}, "names"),
        ({"": grasp}, "names"),
        ({"a": Pose([0.0, 1.0])}, "planar"),
        ({"a": load.towards(duration=9.0)}, "3, 9 s"),
        ({"a": np.zeros(3)}, "'a' is ndarray"),
    ]:
        with pytest.raises(OptionError, match=message):
            CooperativeDMP(load, hands)
    with pytest.raises(OptionError, match="nothing moves"):
        CooperativeDMP(None, {"a": grasp})
    with pytest.raises(OptionError, match="'b' does not move"):
        CooperativeDMP(None, {"a": load, "b": grasp})
    dmp = CooperativeDMP(None, {"a": load, "b": load})
    with pytest.raises(OptionError, match="no common start or goal"):
        dmp.rollout(goal=grasp)
    with pytest.raises(OptionError, match="the load has no movement"):
        dmp.redirected(dmp.initial_state(), grasp)
    with pytest.raises(OptionError, match="n_steps"):
        dmp.rollout(n_steps=0)


@pytest.mark.parametrize("time", [1.0, "x", ["x"], [[0.0], [1.0]], [0.0, np.nan], None])
def test_times_that_are_none(time):
    load = PoseDMP.fit(recording(0))
    for movement in (load, CooperativeDMP(load, {"a": Pose([0, 0, 0.1])})):
        with pytest.raises(OptionError, match="give an array of finite numbers"):
            movement.at(time)


def test_the_load_is_pushed_and_the_grasps_hold():
    """A coupling of the load acts on the load alone; that of a carried hand in the load's frame."""
    dmp = carried(3)
    pushed, free = dmp.initial_state(), dmp.initial_state()
    push, drift = np.array([0.5, 0, 0, 0, 0, 1.0]), np.array([0, 0.1, 0, 0.2, 0, 0])
    for _ in range(20):
        pushed = dmp.step(pushed, 0.02, coupling={"": push}, velocity_coupling={"": drift})
        free = dmp.step(free, 0.02)
    load = [dmp.load.pose(state.parts[""]) for state in (pushed, free)]
    assert np.linalg.norm(load[0].position - load[1].position) > 0.01
    assert (load[0].rotation * load[1].rotation.inv()).magnitude() > 0.01
    assert relative_error(dmp.poses(pushed), dmp.hands) < 1e-12
    with pytest.raises(OptionError, match="has no movement of its own"):
        dmp.step(free, 0.1, coupling={"hand0": push})
    with pytest.raises(OptionError, match="coupling"):
        dmp.step(free, 0.1, coupling=push)


def test_a_load_may_be_caught_and_handed_on_in_motion():
    twist = np.array([0.2, -0.1, 0.05, 0.3, 0.1, -0.4])
    dmp = carried(2).towards(start_velocity=twist, goal_velocity=-twist)
    path = dmp.load.rollout()
    for k, wanted in ((0, twist), (-1, -twist)):
        assert np.abs(path.velocity[k] - wanted[:3]).max() < 1e-9
        assert np.abs(path.angular_velocity[k] - wanted[3:]).max() < 1e-9
    assert np.abs(path.position[-1] - carried(2).load.goal.position).max() < 1e-10
    velocity, spin = differences(dmp, np.array([0.1, 2.9]))
    played = dmp.at([0.1, 2.9])
    assert np.abs(velocity - played.velocity).max() < 1e-6
    assert np.abs(spin - played.angular_velocity).max() < 1e-5

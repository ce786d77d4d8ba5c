"""Kinematics, dynamics and inverse kinematics of the kernels, against Pinocchio."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from comove.robots.effort import loaded_model
from comove.robots.search.chains import (
    TURN,
    Iteration,
    chains_of,
    jacobian,
    place_arm,
    pose_error,
    reach_pose,
    torques,
    turned_towards,
)
from tests.cases import examples
from tests.robots.small_robots import BUNDLED, RANDOM, columns, robot

EXACT = Iteration(gain=0.0, keep=0.0, tolerance=1e-9, steady=1e-6, most=100)
NEAR = 0.05  # rad or m
ALL = (*BUNDLED, *RANDOM, "gantry")
SHARES = arrays(float, 16 + 8, elements=st.floats(0, 1))  # of joints' ranges; no robot has more joints
SIGNED = arrays(float, 16 + 8, elements=st.floats(-1, 1))
UNIT = st.floats(-1, 1)


def within(chains, share):
    """Joints at given shares of their ranges."""
    q = chains.lower + share[: len(chains.lower)] * (chains.upper - chains.lower)
    return np.minimum(q, chains.upper)


def placed(chains, arm, q):
    """Frames of an arm by the kernel under test."""
    n = chains.first[arm + 1] - chains.first[arm]
    rotations, points = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    place_arm(chains, arm, q, rotations, points)
    return rotations, points


def with_tools(robot):
    """Pinocchio's model with the grasps as frames."""
    model, frames = robot.model.copy(), []
    for arm in robot.arms:
        tip = model.frames[model.getFrameId(arm.tip)]
        tool = pin.Frame(
            f"{arm.name} tool", tip.parentJoint, tip.placement * pin.SE3(arm.tool), pin.FrameType.OP_FRAME
        )
        frames.append(model.addFrame(tool))
    return model, frames


def grasp(robot, arm, q):
    """The grasp frame by Pinocchio, q in the order of the chains."""
    whole = np.zeros(len(robot.lower))
    whole[columns(robot.arms)] = q
    return robot.tool_pose(whole, robot.arms[arm])


def distance(pose, rotation, point):
    """How far a pose is from another one [m], a radian counted as `TURN`, by Pinocchio's logarithm."""
    turn = np.linalg.norm(pin.log3(rotation @ pose[:3, :3].T))
    return np.hypot(np.linalg.norm(point - pose[:3, 3]), TURN * turn)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.few(4)
def test_frames_and_jacobians_are_those_of_pinocchio(name):
    machine, rng = robot(name), np.random.default_rng(1)
    chains, (model, frames) = chains_of(machine, machine.arms), with_tools(machine)
    data = model.createData()
    for _ in range(20):
        q = rng.uniform(machine.lower, machine.upper)
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        for i, arm in enumerate(machine.arms):
            rotations, points = placed(chains, i, q[columns(machine.arms)])
            pose = data.oMf[frames[i]]
            np.testing.assert_allclose(rotations[-1], pose.rotation, atol=1e-14)
            np.testing.assert_allclose(points[-1], pose.translation, atol=1e-14)
            out = np.empty((6, len(arm.columns)))
            jacobian(chains, i, rotations, points, out)
            wanted = pin.getFrameJacobian(model, data, frames[i], pin.LOCAL_WORLD_ALIGNED)
            np.testing.assert_allclose(out, wanted[:, arm.columns], atol=1e-13)


def test_random_robots_have_joints_that_slide_and_joints_that_turn():
    slides = np.concatenate([chains_of(robot(name), robot(name).arms).slides for name in RANDOM])
    assert 5 < slides.sum() < len(slides) - 20


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("load", [0.0, 1.3])
@pytest.mark.few(4)
def test_torques_are_those_of_pinocchio_less_what_springs_hold_of_the_own_weight(name, load):
    machine, rng = robot(name), np.random.default_rng(2)
    chains, (model, frames) = chains_of(machine, machine.arms), with_tools(machine)
    loaded = loaded_model(machine, machine.arms, np.full(len(machine.arms), load))
    data, own, order = model.createData(), machine.model.createData(), columns(machine.arms)
    for _ in range(20):
        q = rng.uniform(machine.lower, machine.upper)
        v, a = rng.normal(size=(2, len(q)))
        weight = pin.computeGeneralizedGravity(machine.model, own, q)
        wanted = pin.rnea(loaded, loaded.createData(), q, v, a) - machine.relief * weight
        pin.forwardKinematics(model, data, q, v, a)
        pin.updateFramePlacements(model, data)
        out = np.full(len(q), np.nan)
        for i, frame in enumerate(frames):
            moves = pin.getFrameClassicalAcceleration(model, data, frame, pin.LOCAL_WORLD_ALIGNED).linear
            torques(chains, i, q[order], v[order], a[order], load, moves, out)
        np.testing.assert_allclose(out, wanted[order], atol=1e-11)


def test_a_spring_that_holds_all_of_the_weight_leaves_nothing_for_the_motor():
    machine = robot("random 0")
    chains = chains_of(machine, machine.arms)
    full = np.flatnonzero(chains.relief == 1.0)
    assert len(full) == 1
    still, out = np.zeros(len(chains.lower)), np.zeros(len(chains.lower))
    for q in np.random.default_rng(3).uniform(chains.lower, chains.upper, (10, len(chains.lower))):
        torques(chains, 0, q, still, still, 0.0, np.zeros(3), out)
        assert abs(out[full[0]]) < 1e-12
        assert np.abs(out[:6]).max() > 1.0


@given(SHARES, SHARES)
def test_the_residual_is_position_and_angle_to_the_target(one, other):
    machine = robot("random 1")
    chains = chains_of(machine, machine.arms)
    q, target = within(chains, one), within(chains, other)
    rotations, points = placed(chains, 0, q)
    goal = grasp(machine, 0, target)
    error = np.empty(6)
    left = pose_error(rotations[-1], points[-1], goal[:3, :3], goal[:3, 3], error)
    here = grasp(machine, 0, q)
    assert left == pytest.approx(distance(here, goal[:3, :3], goal[:3, 3]), abs=1e-7)
    np.testing.assert_allclose(error[:3], goal[:3, 3] - here[:3, 3], atol=1e-13)
    turned = pin.exp3(error[3:]) @ here[:3, :3]  # the error, carried out, ends at the target
    np.testing.assert_allclose(turned, goal[:3, :3], atol=1e-6)


def test_half_a_turn_has_a_way_out():
    error = np.empty(6)
    for axis in np.eye(3):
        target = pin.exp3(np.pi * axis)
        assert pose_error(np.eye(3), np.zeros(3), target, np.zeros(3), error) == pytest.approx(TURN * np.pi)
        assert np.linalg.norm(error[3:]) == pytest.approx(np.pi)


@pytest.mark.parametrize("name", ALL)
@examples(40)
@given(goal=SHARES, away=SIGNED, arm=st.integers(0, 2))
@pytest.mark.few(4)
def test_poses_near_a_configuration_are_reached(name, goal, away, arm):
    machine = robot(name)
    chains, arm = chains_of(machine, machine.arms), arm % len(machine.arms)
    goal = within(chains, goal)
    q = np.clip(goal + NEAR * away[: len(goal)], chains.lower, chains.upper)
    own = slice(chains.first[arm], chains.first[arm + 1])
    for joints in (goal, q):
        held = np.minimum(joints - chains.lower, chains.upper - joints)[own] < NEAR
        assume(
            held.sum() < 4
        )  # near a corner of the limits, joints that are held may leave too few to get out
    pose = grasp(machine, arm, goal)
    left = reach_pose(chains, arm, pose[:3, :3].copy(), pose[:3, 3].copy(), q.copy(), EXACT, q)
    assert left < 1e-9
    assert distance(grasp(machine, arm, q), pose[:3, :3], pose[:3, 3]) < 1e-7  # of the logarithm near 0


def test_a_pose_with_all_joints_at_their_limits_is_reached():
    """Joints are held at their limits, not before: a long arm makes much of a nanoradian."""
    machine = robot("random 2")
    chains = chains_of(machine, machine.arms)
    goal = within(chains, np.ones(24))
    q = np.where(np.arange(len(goal)) % 7 == 6, goal, goal - 0.02)
    q[8:13] = goal[8:13]
    pose = grasp(machine, 1, goal)
    target = pose[:3, :3].copy(), pose[:3, 3].copy()
    assert reach_pose(chains, 1, *target, q.copy(), EXACT, q) < 1e-9


@pytest.mark.parametrize("name", ALL)
@examples(40)
@given(
    seed=SHARES,
    pull=SHARES,
    rotation=st.tuples(UNIT, UNIT, UNIT),
    point=st.tuples(UNIT, UNIT, UNIT),
    keep=st.floats(0, 0.5),
    most=st.integers(0, 30),
)
@pytest.mark.few(4)
def test_limits_are_never_left_and_the_residual_is_true_whatever_is_asked_for(
    name, seed, pull, rotation, point, keep, most
):
    machine = robot(name)
    chains = chains_of(machine, machine.arms)
    q, pull = within(chains, seed), within(chains, pull)
    before, width = q.copy(), chains.upper - chains.lower
    rotation, point = pin.exp3(3.0 * np.array(rotation)), 3.0 * np.array(point)
    left = reach_pose(chains, 1, rotation, point, pull, EXACT._replace(gain=0.5, keep=keep, most=most), q)
    mine = slice(chains.first[1], chains.first[2])
    assert (q >= chains.lower).all()
    assert (q <= chains.upper).all()
    np.testing.assert_array_equal(np.delete(q, np.r_[mine]), np.delete(before, np.r_[mine]))
    assert left == pytest.approx(distance(grasp(machine, 1, q), rotation, point), abs=1e-7)
    if most > 0 and left > 1e-9:
        inside = np.minimum(keep, 0.5 * width)[mine]
        assert (q[mine] >= chains.lower[mine] + inside - 1e-12).all()
        assert (q[mine] <= chains.upper[mine] - inside + 1e-12).all()


@given(st.tuples(UNIT, UNIT, UNIT), st.floats(-2.9, 2.9))
def test_what_is_left_of_a_pose_out_of_reach_is_the_distance_missing(point, yaw):
    """A gantry reaches a box: what it misses is the distance from it."""
    machine = robot("gantry")
    chains = chains_of(machine, machine.arms)
    low, high = np.array([-0.6, -0.4, 0.0]), np.array([0.6, 1.2, 1.0])
    point = 0.5 * (low + high) + 1.5 * np.array(point)
    target = pin.exp3(np.array([0.0, 0.0, yaw])) @ np.diag([-1.0, 1.0, -1.0])
    q = 0.5 * (chains.lower + chains.upper)
    left = reach_pose(chains, 0, target, point, q.copy(), EXACT, q)
    assert left == pytest.approx(np.linalg.norm(point - np.clip(point, low, high)), abs=1e-6)


@pytest.mark.parametrize("name", ["ur5_and_panda", "gantry"])
def test_joints_turn_towards_others_by_whole_turns_within_their_limits(name):
    own = robot(name)
    chains, rng = chains_of(own, own.arms), np.random.default_rng(3)
    order, turn = columns(own.arms), 2 * np.pi
    data = own.model.createData()
    for _ in range(50):
        start, goal = rng.uniform(chains.lower, chains.upper), rng.uniform(chains.lower, chains.upper)
        turned = turned_towards(chains, start, goal)
        assert ((turned >= chains.lower) & (turned <= chains.upper)).all()
        for other in (turned - turn, turned + turn):
            allowed = (other >= chains.lower) & (other <= chains.upper) & ~chains.slides
            assert (np.abs(turned - start) <= np.abs(other - start) + 1e-9)[allowed].all()
        poses = []
        for joints in (goal, turned):
            q = own.home
            q[order] = joints
            pin.forwardKinematics(own.model, data, q)
            poses.append([placed.homogeneous for placed in data.oMi])
        assert np.allclose(*poses, atol=1e-9)


def test_redundancy_is_drawn_where_it_is_pulled_without_moving_the_hand():
    machine = robot("two_pandas")
    chains = chains_of(machine, machine.arms)
    q = np.concatenate([arm.home for arm in machine.arms])
    pose = grasp(machine, 0, q)
    pull, moved = q.copy(), q.copy()
    pull[0] += 0.5
    args = pose[:3, :3].copy(), pose[:3, 3].copy(), pull, EXACT._replace(gain=0.5, most=300)
    assert reach_pose(chains, 0, *args, moved) < 1e-9
    assert moved[0] - q[0] > 0.05
    assert distance(grasp(machine, 0, moved), pose[:3, :3], pose[:3, 3]) < 1e-7

"""What arms have to spare: distances are those of other code, and their slopes say how they change."""

import numpy as np
import pinocchio as pin
import pytest

import comove
from comove.model import Scene
from comove.model.coordinates import load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.planning import smooth
from comove.planning.convex.costs import Anchored
from comove.planning.objective import N_STEPS
from comove.robots import Robot
from comove.robots.carrying import RobotCarrier
from comove.robots.search import spare
from comove.robots.search.following import MET
from comove.robots.search.links import ENOUGH
from comove.robots.search.spare import N_KEPT_MOTIONS, SETTINGS, ArmsFollower, spare_along
from tests.robots.known_carry import grasp_frames
from tests.robots.small_robots import EXAMPLES, grasp_errors, movement, robot, task, whole

NAMES = ["gantry", "gap_30", "two_pandas", "ur5_and_panda"]


def along(motion, carrying, n_steps=51):
    """Configurations of the load along a motion, and what follows them."""
    q = np.ascontiguousarray(motion.at(np.linspace(0.0, 1.0, n_steps))[0])
    return q, carrying.along(motion.nodes(N_STEPS))


def nodes_of(motion, q):
    return motion.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]


def within_reach(carrying, arm, q):
    """The square of the least singular value of Pinocchio's Jacobian over `lever`; `ENOUGH` for few joints."""
    robot, data = carrying.robot, carrying.robot.model.createData()
    tip = robot.model.frames[robot.model.getFrameId(arm.tip)]
    grasp = tip.placement * pin.SE3(arm.tool)
    pin.computeJointJacobians(robot.model, data, q)
    whole = pin.getJointJacobian(robot.model, data, tip.parentJoint, pin.LOCAL_WORLD_ALIGNED)[:, arm.columns]
    at = data.oMi[tip.parentJoint].rotation @ grasp.translation
    moves = np.vstack([whole[:3] + np.cross(whole[3:].T, at).T, whole[3:]])
    return (
        np.linalg.svd(moves, compute_uv=False)[5] ** 2 / SETTINGS.lever if len(arm.columns) >= 6 else ENOUGH
    )


@pytest.mark.parametrize("name", NAMES)
def test_distances_are_those_of_the_links_and_of_the_hands_poses(name):
    carrying = task(name)
    motion = movement(carrying.scene)
    q, follower = along(motion, carrying)
    nodes = nodes_of(motion, q)
    joints, distances = follower.follow(nodes)
    time = np.linspace(0.0, carrying.scene.duration, len(q))
    missed = grasp_errors(
        carrying.robot, carrying.holders, whole(carrying, joints), grasp_frames(motion, time)
    )
    within = [[within_reach(carrying, arm, q) for arm in carrying.holders] for q in whole(carrying, joints)]
    np.testing.assert_allclose(
        distances[:, :-2], np.where(missed <= MET, np.minimum(within, ENOUGH), -missed), rtol=0.01, atol=1e-7
    )
    clearance = [carrying.ends.clearances(q[None], place)[0] for q, place in zip(joints, nodes, strict=True)]
    np.testing.assert_allclose(distances[:, -2:].min(axis=1), clearance, atol=1e-12)


@pytest.mark.parametrize("name", ["baxter/box_flat", "baxter/gap_20", "robots/ur5_and_panda"])
def test_slopes_say_how_distances_change(name):
    """To first order, with joints that follow by the least motion; the nearest pair of links may be another then."""
    scene, move = Scene.load(EXAMPLES / f"{name}.yaml"), 1e-3
    carrying = RobotCarrier(Robot.load(scene.file.robot), scene)
    motion = CoordinatedMotion.straight(scene, load_coordinates(scene))
    q, follower = along(motion, carrying, 101)
    joints, distances = follower.follow(nodes_of(motion, q))
    slopes = follower.slopes(motion.coordinates.blocks, q, joints, distances)[:, -2]
    counts = slopes.any(axis=1)
    beyond = distances[:, -2] - scene.clearance
    assert counts[beyond < 0.01].all() and not counts[beyond > 0.015].any()
    off = []
    for c in range(q.shape[1]):
        _, other = follower.follow(nodes_of(motion, q - move * (np.arange(q.shape[1]) == c)))
        off.extend((other - distances)[counts, -2] + move * slopes[counts, c])
    assert len(off) > 60 and np.mean(np.abs(off) < 0.2 * move) > 0.9


def test_where_a_pose_is_out_of_reach_its_slope_leads_back():
    """The distance from all that an arm reaches grows as fast as the hand goes away from it."""
    carrying = task("ur5_and_panda")
    motion = movement(carrying.scene)
    q, follower = along(motion, carrying)
    far = q.copy()
    far[:, 0] += np.linspace(0.0, 1.2, len(q))  # away from both bases
    joints, distances = follower.follow(nodes_of(motion, far))
    slopes = follower.slopes(motion.coordinates.blocks, far, joints, distances)
    for arm in range(2):
        out = (distances[:, arm] < -0.02) & (distances[:, arm] > -0.3)
        assert out.sum() > 3
        back = slopes[out, arm, :3]
        size = np.linalg.norm(back, axis=1)
        assert (size > 0.4).all() and (size < 1.1).all()
        nearer = far.copy()
        nearer[out, :3] += 0.01 * back / size[:, None]
        _, left = follower.follow(nodes_of(motion, nearer))
        assert (left[out, arm] > distances[out, arm] + 0.003).mean() > 0.9


@pytest.mark.parametrize(("name", "axis"), [("gap_30", 0), ("two_fr3", 1), ("two_ur10", 2)])
def test_the_end_of_reach_is_told_before_a_hand_is_there(name, axis):
    """Each arm is led away until it is stretched and its hand is left behind."""
    carrying, away = task(name), np.linspace(0.0, 1.5, 376)
    motion = movement(carrying.scene)
    q, follower = along(motion, carrying)
    far = np.repeat(q[:1], len(away), axis=0)
    far[:, axis] += away
    _, distances = follower.follow(nodes_of(motion, far))
    for told in distances[:, :2].T:
        end = np.argmax(told < 0)
        left = away[end] - away[:end]
        near = (left > 0.01) & (left < 0.03)
        ratio = told[:end][near] / left[near]
        assert end > 0 and near.sum() >= 4 and (ratio > 0.5).all() and (ratio < 2.0).all()


def test_what_is_near_at_the_ends_may_be_near_everywhere():
    """Otherwise nothing could be found; elsewhere the clearance of the scene is asked for, and more each time."""
    carrying = task("gap_30")
    motion, clearance = movement(carrying.scene), carrying.scene.clearance
    follower = along(motion, carrying)[1]
    np.testing.assert_allclose(follower.required(0.002)[-2:], clearance + 0.003)
    np.testing.assert_allclose(follower.stricter().required(0.002)[-2:], clearance + 0.004)
    tight = ArmsFollower(follower.arms, follower.course, np.array([0.001, 1.0, 0.004, 1.0]))
    np.testing.assert_allclose(
        tight.stricter().required(0.002), [0.001, SETTINGS.within, 0.004, clearance + 0.004]
    )


def test_two_pandas_find_the_smoothest_motion_that_keeps_their_links_apart():
    """The smoothest of all would not; that comes of the programme, not of what is drawn to the plan."""
    scene, costs = Scene.load(EXAMPLES / "robots" / "two_pandas.yaml"), []

    def noted(programme, cost, *rest):
        costs.append(cost.pull if isinstance(cost, Anchored) else 0.0)
        return optimise(programme, cost, *rest)

    optimise = smooth.optimise
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(smooth, "optimise", noted)
        found = comove.solve(scene.timed(None), robot=robot("two_pandas"), seed=0, budget=600)
    assert found.verified and set(costs) == {0.0}


def test_a_motion_asked_for_again_is_not_followed_again(monkeypatch):
    carrying, followed = task("gantry"), []

    def counted(arms, nodes, *rest):
        followed.append(nodes)
        return spare_along(arms, nodes, *rest)

    q, follower = along(movement(carrying.scene), carrying, n_steps=11)
    monkeypatch.setattr(spare, "spare_along", counted)
    nodes = nodes_of(movement(carrying.scene), q)
    others = [nodes + 1e-4 * k for k in range(N_KEPT_MOTIONS + 1)]
    for asked, n in ((others[0], 1), (others[0], 1), (others[1], 2), (others[0].copy(), 2)):
        found = follower.follow(asked)
        assert len(followed) == n
        for known, anew in zip(
            found, spare_along(follower.arms, asked, follower.course, SETTINGS.lever), strict=True
        ):
            np.testing.assert_array_equal(known, anew)
    follower.stricter().follow(others[1])
    assert len(followed) == 2
    for asked in others[2:]:
        follower.follow(asked)
    assert len(followed) == len(follower.known) + 1 == N_KEPT_MOTIONS + 1, "the oldest is forgotten"
    follower.follow(others[0])
    assert len(followed) == N_KEPT_MOTIONS + 2

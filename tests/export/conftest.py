"""Verified motions of Baxter, for all tests of this room."""

import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from comove import Scene
from comove.coordination.coordinates import load_coordinates
from comove.coordination.motion import CoordinatedDMP, CoordinatedMotion
from comove.errors import ComoveWarning
from comove.primitives.basis import motion_basis
from comove.robots import JointMotion, Robot
from comove.robots.verify import verify_joints
from tests.robots.known_path import START, hands

SCENE = Path(__file__).parents[2] / "examples" / "baxter" / "gap_30.yaml"


def along_the_known_path(scene):
    """A candidate near the path that is known to be good."""
    coordinates, basis = load_coordinates(scene), motion_basis(20, "velocity")
    empty = CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), np.zeros(0))
    s = np.linspace(0.0, 1.0, 201)
    return empty.fitted(s, coordinates.from_hands(hands(10.0 * s)[:, :, :3, 3])).rollout()


def joints_of(robot, motion):
    """Joints that hold the load, by Newton's method from sample to sample."""
    time = np.linspace(0.0, motion.scene.duration, round(200 * motion.scene.duration) + 1)
    places = motion.hands(time / time[-1])[0]
    turns = motion.scene.grasp.hand_rotations(places)
    data, q, rows = robot.model.createData(), START.copy(), []
    for rotations, points in zip(turns, places, strict=True):
        for _ in range(50):
            pin.computeJointJacobians(robot.model, data, q)
            pin.updateFramePlacements(robot.model, data)
            errors, jacobians = [], []
            for arm, rotation, point in zip(robot.arms, rotations, points, strict=True):
                frame = robot.model.getFrameId(arm.tip)
                errors.append(pin.log6(data.oMf[frame].inverse() * pin.SE3(rotation, point)).vector)
                jacobians.append(pin.getFrameJacobian(robot.model, data, frame, pin.ReferenceFrame.LOCAL))
            error = np.concatenate(errors)
            if np.abs(error).max() < 1e-12:
                break
            q = q + np.linalg.pinv(np.vstack(jacobians)) @ error
        rows.append(q)
    return JointMotion(time, robot.joint_names, np.array(rows))


@pytest.fixture(scope="session")
def verified():
    """Ten seconds through the wide gap."""
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", ComoveWarning
        )  # ten digits of a start miss the stick's length by 1e-10 m
        robot, scene = Robot.load("baxter"), Scene.load(SCENE)
    motion = along_the_known_path(scene)
    verdict = verify_joints(robot, motion, joints_of(robot, motion))
    assert verdict.verified is not None, verdict.reasons
    return verdict.verified


@pytest.fixture(scope="session")
def brief(verified):
    """Two seconds without posts."""
    file = verified.scene.file
    ends = hands(np.array([0.0, 3.5]))[:, :, :3, 3]
    moved = [
        hand.model_copy(update={"start": tuple(start.tolist()), "goal": tuple(goal.tolist())})
        for hand, start, goal in zip(file.manipulators, *ends, strict=True)
    ]
    data = file.model_copy(
        update={"name": "brief", "duration": 2.0, "manipulators": tuple(moved)}
    ).model_dump()
    scene = Scene.from_dict(data | {"demonstration": None, "obstacles": ()})
    coordinates, basis = load_coordinates(scene), motion_basis(20, "velocity")
    straight = CoordinatedMotion(
        scene, coordinates, basis, coordinates.boundary(), np.zeros((coordinates.n_columns, 20))
    )
    verdict = verify_joints(verified.robot, straight, joints_of(verified.robot, straight))
    assert verdict.verified is not None, verdict.reasons
    return verdict.verified

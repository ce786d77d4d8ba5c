"""A joint motion in MuJoCo does what mechanics says."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest

from comove.simulators import Connect, Friction, Weld, simulate
from tests.robots.known_path import known_motion
from tests.simulators.benchmark import posts, standing

G = 9.81  # m/s^2


@lru_cache(maxsize=8)
def carried(grasp):
    """The known good motion."""
    robot, motion = known_motion()
    return simulate(motion, posts(), robot, grasp)


@lru_cache(maxsize=8)
def held(grasp=None, mass=0.25):
    """Standing still with the stick in the hands."""
    robot, motion = standing()
    return simulate(motion, posts(mass=mass), robot, grasp)


@pytest.mark.parametrize(("grasp", "end_error"), [(Weld(), 1e-3), (Connect(), 1e-3), (Friction(), 3e-3)])
def test_the_known_motion_delivers_the_stick(grasp, end_error):
    execution = carried(grasp)
    assert execution.delivered, execution.reasons
    assert execution.measures["distance_error_max"] <= 5e-4
    assert execution.end_error <= end_error
    assert execution.measures["slip_max"] <= 2e-3
    assert not execution.contacts


def test_hands_at_rest_bear_the_weight_of_the_stick():
    force = held().wrench[-1, :, :3].sum(axis=0)
    assert np.allclose(force, [0, 0, 0.25 * G], atol=2e-3)


def test_motors_at_rest_bear_the_weight_of_robot_and_stick():
    """tau = g(q) + J' f, by Pinocchio's recursion and the forces on the load."""
    execution = held(Connect())
    robot, q = execution.robot, execution.joints[-1]
    data = robot.model.createData()
    tau = pin.rnea(robot.model, data, q, 0 * q, 0 * q)
    pin.computeJointJacobians(robot.model, data, q)
    pin.updateFramePlacements(robot.model, data)
    for i, arm in enumerate(robot.arms):
        jacobian = pin.getFrameJacobian(
            robot.model, data, robot.model.getFrameId(arm.tip), pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        )
        tau += jacobian.T @ execution.wrench[-1, i]
    assert np.abs(execution.torque[-1] - tau).max() < 0.02


def test_a_heavier_stick_sags_more():
    heights = [held(mass=mass).load_pose[-1, 2, 3] for mass in (0.25, 1.0, 2.0)]
    assert heights[0] > heights[1] > heights[2]

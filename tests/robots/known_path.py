"""A movement of Baxter's arms with a stick that is known to be good, made without comove's own kinematics."""

from functools import lru_cache

import numpy as np
import pinocchio as pin
from scipy.interpolate import CubicSpline

from comove.robots import JointMotion, Robot

DISTANCE = 0.6  # m between the hands
HEIGHT = 0.05  # m of the stick
DURATION = 10.0  # s
# time [s], x [m], y [m], yaw [deg] of the stick
PATH = np.array(
    [
        [0, 0.56, 0.34, 45],
        [2, 0.599, 0.352, 51],
        [3, 0.651, 0.313, 65],
        [4, 0.652, 0.176, 70],
        [5, 0.588, 0.021, 70],
        [6, 0.525, -0.135, 70],
        [7, 0.501, -0.272, 67],
        [8, 0.528, -0.327, 54],
        [10, 0.56, -0.32, 45],
    ]
)
START = np.array(
    [-0.0788, -0.4694, -0.7461, 0.8507, 0.665, 1.3756, -0.6258]
    + [0.8481, -0.8395, 1.1966, 2.0468, -0.8467, 0.9788, 0.9256]
)


def stick(time):
    """Centre x, y [m] and yaw [rad] of the stick; array, shape (n_steps, 3)."""
    path = CubicSpline(PATH[:, 0], PATH[:, 1:], bc_type="clamped")(time)
    path[:, 2] = np.deg2rad(path[:, 2])
    return path


def hands(time):
    """Grasp frames of left and right; array, shape (n_steps, 2, 4, 4)."""
    x, y, yaw = stick(np.asarray(time, dtype=float)).T
    poses = np.zeros((len(x), 2, 4, 4))
    poses[:, :, 3, 3] = 1.0
    for i, side in enumerate((0.5, -0.5)):
        poses[:, i, 0, 3] = x + side * DISTANCE * np.cos(yaw)
        poses[:, i, 1, 3] = y + side * DISTANCE * np.sin(yaw)
        poses[:, i, 2, 3] = HEIGHT
        poses[:, i, 0, 0], poses[:, i, 0, 1] = -np.cos(yaw), -np.sin(yaw)
        poses[:, i, 1, 0], poses[:, i, 1, 1] = -np.sin(yaw), np.cos(yaw)
        poses[:, i, 2, 2] = -1.0
    return poses


@lru_cache(maxsize=1)
def known_motion() -> tuple[Robot, JointMotion]:
    """Baxter and the joint motion along the path, by Newton's method from sample to sample."""
    robot = Robot.load("baxter")
    time = np.linspace(0.0, DURATION, round(100 * DURATION) + 1)
    data, q, rows = robot.model.createData(), START.copy(), []
    frames = [robot.model.getFrameId(arm.tip) for arm in robot.arms]
    for targets in hands(time):
        for _ in range(50):
            pin.computeJointJacobians(robot.model, data, q)
            pin.updateFramePlacements(robot.model, data)
            errors, jacobians = [], []
            for frame, target in zip(frames, targets, strict=True):
                errors.append(pin.log6(data.oMf[frame].inverse() * pin.SE3(target)).vector)
                jacobians.append(pin.getFrameJacobian(robot.model, data, frame, pin.ReferenceFrame.LOCAL))
            error = np.concatenate(errors)
            if np.abs(error).max() < 1e-12:
                break
            q = q + np.linalg.pinv(np.vstack(jacobians)) @ error
        rows.append(q)
    return robot, JointMotion(time, robot.joint_names, np.array(rows))

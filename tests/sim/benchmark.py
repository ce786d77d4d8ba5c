"""Baxter carries a stick between two posts that are nearer to each other than the stick is long."""

from functools import lru_cache

import numpy as np
import pinocchio as pin

from comove.model import Scene
from comove.robots import JointMotion
from tests.robots import known_path
from tests.robots.known_path import DISTANCE, DURATION, START, hands, known_motion

GAP = 0.30  # m between the posts
OVERHANG = 0.03  # m
RADIUS = 0.012  # m


@lru_cache(maxsize=4)
def posts(gap: float = GAP, mass: float | None = None) -> Scene:
    """Two posts on a table, the stick to be carried between them."""
    start, goal = hands([0.0])[0, :, :3, 3], hands([DURATION])[0, :, :3, 3]
    load = {"shape": "bar", "length": DISTANCE, "radius": RADIUS, "overhang": OVERHANG}
    return Scene.from_dict(
        {
            "name": "posts",
            "duration": DURATION,
            "workspace": {"lower": [0.0, -1.0, -0.15], "upper": [1.2, 1.0, 0.8]},
            "obstacles": [
                {"shape": "box", "center": [0.68, 0.0, -0.17], "size": [0.7, 1.6, 0.04]},
                *(
                    {
                        "shape": "cylinder",
                        "center": [0.58 + side * (gap / 2 + 0.03), 0.0, 0.0],
                        "radius": 0.03,
                        "height": 0.3,
                    }
                    for side in (-1, 1)
                ),
            ],
            "load": load if mass is None else {**load, "mass": mass},
            "manipulators": [
                {"name": name, "start": start[i].tolist(), "goal": goal[i].tolist()}
                for i, name in enumerate(("left", "right"))
            ],
            "constraints": [{"type": "same_height", "between": ["left", "right"]}],
            "grasp": {"orientation": "down", "yaw": "load"},
            "robot": "baxter",
        }
    )


def standing(duration: float = 0.5):
    """Baxter holding still at the start."""
    robot, motion = known_motion()
    time = np.linspace(0.0, duration, 11)
    return robot, JointMotion(time, motion.joint_names, np.repeat(motion.position[:1], 11, axis=0))


def joints_straight() -> JointMotion:
    """Every joint on the shortest way from start to goal, by a polynomial of least jerk."""
    _, motion = known_motion()
    s = motion.time[:, None] / motion.duration
    s = s**3 * (10 - 15 * s + 6 * s**2)
    first, last = motion.position[[0, -1]]
    return JointMotion(motion.time, motion.joint_names, first + s * (last - first))


@lru_cache(maxsize=1)
def load_straight() -> JointMotion:
    """The stick on the shortest way from start to goal, right through a post."""
    robot, motion = known_motion()
    ends = known_path.stick(np.array([0.0, DURATION]))
    time = np.linspace(0.0, DURATION, 201)
    s = time[:, None] / DURATION
    x, y, yaw = (ends[0] + s**3 * (10 - 15 * s + 6 * s**2) * (ends[1] - ends[0])).T
    q, data, rows = START.copy(), robot.model.createData(), []
    frames = [robot.model.getFrameId(arm.tip) for arm in robot.arms]
    for i in range(len(time)):
        along = DISTANCE / 2 * np.array([np.cos(yaw[i]), np.sin(yaw[i]), 0.0])
        turned = pin.utils.rotate("z", yaw[i]) @ np.diag([-1.0, 1.0, -1.0])
        targets = [
            pin.SE3(turned, np.array([x[i], y[i], known_path.HEIGHT]) + side * along) for side in (1, -1)
        ]
        for _ in range(20):
            pin.computeJointJacobians(robot.model, data, q)
            pin.updateFramePlacements(robot.model, data)
            error = np.concatenate(
                [
                    pin.log6(data.oMf[f].inverse() * goal).vector
                    for f, goal in zip(frames, targets, strict=True)
                ]
            )
            jacobian = np.vstack(
                [pin.getFrameJacobian(robot.model, data, f, pin.ReferenceFrame.LOCAL) for f in frames]
            )
            q = q + np.linalg.pinv(jacobian) @ error
        rows.append(q)
    return JointMotion(time, motion.joint_names, np.array(rows))

"""The movement of `known_path` as scenes, motions of the hands and joints that follow these, all known to be good.

Joints come from Newton's method in Pinocchio, without comove's own kinematics.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin

from comove.dmp.basis import motion_basis
from comove.model import CoordinatedDMP, CoordinatedMotion, Scene
from comove.model.coordinates import load_coordinates
from comove.robots import JointMotion, Robot
from comove.robots.description import Uncertainty
from tests.robots.known_path import DISTANCE, DURATION, START, hands

TABLE = {"shape": "box", "center": [0.68, 0, -0.175], "size": [0.7, 1.6, 0.05]}


def posts(gap: float) -> list[dict]:
    """The benchmark's posts."""
    away = gap / 2 + 0.03
    return [
        {"shape": "cylinder", "center": [x, 0, 0], "radius": 0.03, "height": 0.3}
        for x in (0.58 - away, 0.58 + away)
    ]


def scene_data(duration: float = DURATION, obstacles: tuple[dict, ...] | None = None, **more: object) -> dict:
    """The contents of the benchmark's scene file; `more` replaces keys."""
    start, goal = hands([0.0, DURATION])[:, :, :3, 3].tolist()
    ends = zip(("left", "right"), start, goal, strict=True)
    return {
        "name": "posts",
        "duration": duration,
        "workspace": {"lower": [0.1, -1.2, -0.15], "upper": [1.3, 1.2, 1.0]},
        "obstacles": [TABLE, *posts(0.30)] if obstacles is None else list(obstacles),
        "load": {"shape": "bar", "length": DISTANCE, "radius": 0.012, "overhang": 0.03},
        "manipulators": [{"name": name, "start": a, "goal": b} for name, a, b in ends],
        "robot": "baxter",
        "grasp": {"orientation": "down"},
        **more,
    }


def hands_motion(scene: Scene) -> CoordinatedMotion:
    """The known path as a primitive on a scene that has its ends."""
    coordinates, basis = load_coordinates(scene), motion_basis(40)
    s = np.linspace(0.0, 1.0, 401)
    primitive = CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), np.zeros(0))
    return primitive.fitted(s, coordinates.from_hands(hands(s * DURATION)[:, :, :3, 3])).rollout()


def grasp_frames(motion: CoordinatedMotion, time: np.ndarray) -> np.ndarray:
    """Where the hands are meant to be; array, shape (n_steps, 2, 4, 4)."""
    places = motion.hands(time / motion.scene.duration)[0]
    frames = np.zeros((*places.shape[:2], 4, 4))
    frames[..., :3, 3], frames[..., 3, 3] = places, 1.0
    frames[..., :3, :3] = motion.scene.grasp.hand_rotations(places)
    return frames


def followed(robot: Robot, frames: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Joints that bring the grasp frames there; array, shape (n_steps, n_joints)."""
    data, q, rows = robot.model.createData(), start.copy(), []
    tips = [robot.model.getFrameId(arm.tip) for arm in robot.arms]
    for targets in frames:
        for _ in range(50):
            pin.computeJointJacobians(robot.model, data, q)
            pin.updateFramePlacements(robot.model, data)
            placed = zip(tips, targets, strict=True)
            error = np.concatenate(
                [pin.log6(data.oMf[tip].inverse() * pin.SE3(x)).vector for tip, x in placed]
            )
            if np.abs(error).max() < 1e-13:
                break
            jacobian = [
                pin.getFrameJacobian(robot.model, data, tip, pin.ReferenceFrame.LOCAL) for tip in tips
            ]
            q = q + np.linalg.pinv(np.vstack(jacobian)) @ error
        rows.append(q)
    return np.array(rows)


@lru_cache(maxsize=1)
def baxter() -> Robot:
    """Loaded once."""
    return Robot.load("baxter")


def uncertain_baxter(**tolerances: float) -> Robot:
    """Baxter on bases that nobody knows exactly; `tolerances` are those of `Uncertainty`."""
    description = baxter().description.model_copy(update={"uncertainty": Uncertainty(**tolerances)})
    return replace(baxter(), description=description)


@lru_cache(maxsize=8)
def known_carry(duration: float = DURATION, rate: float = 100.0) -> tuple[CoordinatedMotion, JointMotion]:
    """Hands and joints of the known movement through the posts, sampled at `rate` [Hz]."""
    motion = hands_motion(Scene.from_dict(scene_data(duration)))
    time = np.linspace(0.0, duration, round(rate * duration) + 1)
    robot = baxter()
    return motion, JointMotion(time, robot.joint_names, followed(robot, grasp_frames(motion, time), START))


def on_scene(motion: CoordinatedMotion, scene: Scene) -> CoordinatedMotion:
    """The same movement of the hands on another scene with the same ends."""
    return CoordinatedMotion(scene, load_coordinates(scene), motion.basis, motion.boundary, motion.weights)

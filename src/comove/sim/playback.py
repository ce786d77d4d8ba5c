"""Geometric playback: all joints exactly at their planned positions, by Pinocchio.

The payload moves with the end effectors. Its holders share its weight and inertial force equally; torques are those
of `comove.robots.effort`, as in the verification. There is no lag, slip or compliance.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.model.scene import Scene
from comove.robots.effort import loaded_model, torques
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.sim.execution import Conditions, Execution, contacts_between
from comove.sim.grasps import Weld
from comove.sim.loads import (
    Load,
    carried,
    hand_poses,
    load_of,
    require_fit,
)
from comove.sim.settings import USUAL, Settings

GRAVITY = np.array([0.0, 0.0, -9.81])  # m/s^2


def play(motion: JointMotion, robot: Robot, scene: Scene, *, settings: Settings = USUAL) -> Execution:
    """Play a joint motion without physics.

    Raises
    ------
    RobotError, SceneError
        If robot, scene and motion do not match.
    """
    require_fit(motion, robot, scene)
    began = perf_counter()
    n_steps = int(np.ceil(motion.duration * settings.log_rate)) + 1
    time = np.linspace(0.0, motion.duration, n_steps)
    joints, velocity, acceleration = motion.at(time)
    hands = hand_poses(robot, scene, joints)
    load = load_of(scene, hands[0])
    poses, wrench = _with_load(load, hands, time)
    return Execution(
        robot=robot,
        scene=scene,
        motion=motion,
        conditions=Conditions("geometric", Weld(), settings),
        load=load,
        time=time,
        joints=joints,
        torque=torques(robot, _loaded(robot, scene, load), joints, velocity, acceleration),
        hands=hands,
        load_pose=poses,
        wrench=wrench,
        fingers=np.empty((n_steps, 0)),
        contacts=contacts_between(robot, motion, scene, load, time, joints, poses),
        steps_per_second=n_steps / (perf_counter() - began),
    )


def _with_load(load: Load | None, hands: Array, time: Array) -> tuple[Array, Array]:
    """Compute the payload's poses and the holders' forces on it. Arrays, shape (n_steps, 4, 4) and (n_steps,
    n_holders, 6)."""
    if load is None:
        return np.full((len(time), 4, 4), np.nan), np.zeros((len(time), 0, 6))
    held = hands[:, list(load.holders)]
    poses = carried(held, np.linalg.inv(held[0]) @ load.pose)
    speed = np.gradient(poses[:, :3, 3], time, axis=0)
    force = load.mass * (np.gradient(speed, time, axis=0) - GRAVITY)
    wrench = np.zeros((len(time), len(load.holders), 6))
    wrench[..., :3] = force[:, None] / len(load.holders)
    return poses, wrench


def _loaded(robot: Robot, scene: Scene, load: Load | None) -> Any:
    if load is None:
        return robot.model
    arms = tuple(robot.arm(scene.manipulators[i]) for i in load.holders)
    return loaded_model(robot, arms, np.full(len(arms), load.mass / len(arms)))

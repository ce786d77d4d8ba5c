"""Position servos of a robot's joints, within their motors' limits.

A servo gives the torque k (q_ref - q) + c (v_ref - v): the reference velocity is added to its reference position as
c/k v_ref. The weights of robot and payload are compensated, as by controllers that are given both: each holder's
share of the payload's mass in the scene is added as torques. Springs hold a share of the robot's weight, and the
motors the rest, w, and the payload's torques, p; so a servo whose motor has the effort limit E may give torques from
-E - w - p to E - w - p.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import OptionError, RobotError
from comove.model.scene import Scene
from comove.robots.effort import carried_masses, loaded_model, torques
from comove.robots.model import Robot
from comove.robots.verification.kinematics import joint_axes
from comove.sim.engine import add_servo
from comove.sim.world import SimulatedWorld

FULL_EFFORT = (0.025, 0.001)  # error at which a servo gives all it can where nothing is said [rad; m]
INERTIA = (0.3, 3.0)  # of what a servo is damped for [kg m^2; kg]


def servo_gains(robot: Robot) -> tuple[Array, Array]:
    """Compute stiffness k and damping c = 2 sqrt(I k). Arrays, shape (n_joints,) [N m/rad, N m s/rad].

    Raises
    ------
    RobotError
        If the description does not give one stiffness a joint.
    """
    sliding = joint_axes(robot.model)[1].astype(int)
    stiffness = robot.effort / np.array(FULL_EFFORT)[sliding]
    servo = robot.description.servo
    given = () if servo is None else servo.stiffness
    for arm in robot.arms if servo is not None else ():
        if len(given) != len(arm.columns) or min(given) <= 0:
            raise RobotError(
                f"it has {len(given)} values, the arm '{arm.name}' {len(arm.columns)} joints",
                key="servo.stiffness",
                way_out="give one positive value a joint, from the base to the tip",
            )
        stiffness[arm.columns] = given
    return stiffness, 2 * np.sqrt(np.array(INERTIA)[sliding] * stiffness)


def add_servos(spec: Any, robot: Robot, factors: tuple[float, ...]) -> Array:
    """Add servos to a world; return the leads of their velocities.

    The lead is c/k of a reference velocity, array of shape (n_joints,) [s].

    Parameters
    ----------
    factors : factors on stiffness and damping, one for all joints or one for each

    Raises
    ------
    OptionError
        If the number of factors does not fit.
    """
    stiffness, damping = servo_gains(robot)
    if len(factors) not in (1, len(stiffness)):
        raise OptionError(
            f"there are {len(factors)}, and the robot '{robot.name}' has {len(stiffness)} joints",
            key="gains",
            way_out="give one for all joints or one each",
        )
    for i, (name, factor) in enumerate(
        zip(robot.joint_names, np.broadcast_to(factors, stiffness.shape), strict=True)
    ):
        add_servo(spec, name, stiffness[i] * factor, damping[i] * factor, robot.effort[i])
        spec.joint(name).actfrclimited = False  # the limit is the motor's, see `limit_servos`
    return damping / stiffness


def limit_servos(world: SimulatedWorld, data: Any) -> None:
    """Set the servos' limits to the motors' limits less present weights."""
    weight, limit = motor_weight(world, data), world.robot.effort
    world.model.actuator_forcerange[world.servos] = np.stack([-limit - weight, limit - weight], axis=1)


def motor_weight(world: SimulatedWorld, data: Any) -> Array:
    """Return the motors' torques that compensate robot and payload [N m]. Of the robot's weight it is the motors'
    share; array, shape (n_joints,)."""
    return (1 - world.robot.relief) * data.qfrc_gravcomp[world.dofs] + data.qfrc_applied[world.dofs]


def carry_payload(world: SimulatedWorld, data: Any, torque: Array) -> None:
    """Apply the torques that compensate the payload from now on. Array, shape (n_joints,) [N m]."""
    data.qfrc_applied[world.dofs] = torque


class PayloadTorques:
    """Torques of a payload's mass, by inverse dynamics with and without it."""

    def __init__(self, robot: Robot, scene: Scene):
        arms = tuple(robot.arm(name) for name in scene.manipulators)
        self.robot = robot
        self.loaded = None if scene.file.load is None else loaded_model(robot, arms, carried_masses(scene))

    def at(self, position: Array, velocity: Array, acceleration: Array) -> Array:
        """Compute the torques along a motion.

        Parameters
        ----------
        position, velocity, acceleration : arrays, shape (n_steps, n_joints) [rad, s, m for prismatic joints]

        Returns
        -------
        array, shape (n_steps, n_joints) [N m, N for prismatic joints]
        """
        if self.loaded is None:
            return np.zeros_like(position)
        motion = position, velocity, acceleration
        return torques(self.robot, self.loaded, *motion) - torques(self.robot, self.robot.model, *motion)

    def at_rest(self, position: Array) -> Array:
        """Compute the torques at resting joints; arrays, shape (n_joints,)."""
        still = np.zeros((1, len(position)))
        return self.at(position[None], still, still)[0]

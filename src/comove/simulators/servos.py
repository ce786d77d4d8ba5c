"""Position servos of a robot's joints, and what their motors can give.

A servo gives k (q_ref - q) + c (v_ref - v): the reference velocity is added to its reference position as c/k v_ref.
The robot's own weight is compensated. Springs hold their share of it and the motors the rest, so that of a motor's
effort limit E a servo may use what is left of it: from -E - w to E - w, w being the motor's share of the weight.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import OptionError, RobotError
from comove.robots.model import Robot
from comove.simulators.engine import engine
from comove.simulators.world import World

Array = NDArray[np.float64]

FULL_EFFORT = (0.025, 0.001)  # error at which a servo gives all it can where nothing is said [rad; m]
INERTIA = (0.3, 3.0)  # of what a servo is damped for [kg m^2; kg]


def servo_gains(robot: Robot) -> tuple[Array, Array]:
    """Stiffness k and damping c = 2 sqrt(I k) of the joints; arrays, shape (n_joints,) [N m/rad, N m s/rad].

    Raises
    ------
    RobotError
        If the description does not give one stiffness a joint.
    """
    sliding = np.array([_slides(robot, i) for i in range(len(robot.joint_names))], dtype=int)
    stiffness = robot.effort / np.array(FULL_EFFORT)[sliding]
    given = robot.description.servo
    for arm in robot.arms if given is not None else ():
        if len(given.stiffness) != len(arm.columns) or min(given.stiffness) <= 0:
            raise RobotError(
                f"it has {len(given.stiffness)} values, the arm '{arm.name}' {len(arm.columns)} joints",
                key="servo.stiffness",
                way_out="give one positive value a joint, from the base to the tip",
            )
        stiffness[arm.columns] = given.stiffness
    return stiffness, 2 * np.sqrt(np.array(INERTIA)[sliding] * stiffness)


def _slides(robot: Robot, joint: int) -> bool:
    """Whether a joint is one of Pinocchio's PX, PY, PZ, PrismaticUnaligned."""
    return robot.model.joints[joint + 1].shortname().startswith("JointModelP")


def add_servos(spec: Any, robot: Robot, factors: tuple[float, ...]) -> Array:
    """Put servos into a world; how far a reference velocity leads, c/k, array of shape (n_joints,) [s].

    Parameters
    ----------
    factors : on stiffness and damping, one for all joints or one each

    Raises
    ------
    OptionError
        If there are not as many.
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


def add_servo(spec: Any, joint: str, stiffness: float, damping: float, force: float) -> None:
    """A servo of one joint, of the joint's name; its control is the reference position."""
    mj = engine()
    servo = spec.add_actuator(name=joint, target=joint, trntype=mj.mjtTrn.mjTRN_JOINT)
    servo.gaintype, servo.biastype = mj.mjtGain.mjGAIN_FIXED, mj.mjtBias.mjBIAS_AFFINE
    servo.gainprm[0] = stiffness
    servo.biasprm[:3] = 0.0, -stiffness, -damping
    servo.forcelimited, servo.forcerange = True, (-force, force)


def limit_servos(world: World, data: Any) -> None:
    """Leave the servos what the robot's weight, where it stands now, leaves of the motors' limits."""
    weight, limit = motor_weight(world, data), world.robot.effort
    world.model.actuator_forcerange[world.servos] = np.stack([-limit - weight, limit - weight], axis=1)


def motor_weight(world: World, data: Any) -> Array:
    """The motors' share of the robot's own weight; array, shape (n_joints,) [N m]."""
    return (1 - world.robot.relief) * data.qfrc_gravcomp[world.dofs]

"""Motor torques of a joint motion: inverse dynamics with the load's mass at the hands, by Pinocchio.

Torques are *sampled*, at 100 Hz or finer and in the middle between two samples; between these instants there is no
rigorous bound. The largest deviation of a middle value from the mean of its neighbours is added to every sample: a
torque that is a quadratic in time between two samples exceeds them and the middle value by at most a quarter of it.

The load is modelled as point masses at its holders' grasps, which share its mass equally unless other shares are
given. Friction is neglected; rotor inertias count where the model has them. Springs hold their share of the arms'
own weight.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from comove.robots.extremes import Extreme, subdivided
from comove.robots.model import Arm, Robot
from comove.ties import first_largest

Array = NDArray[np.float64]

DEFAULT_MASS = 0.25  # kg, of a load that states none
STEP = 0.01  # s, between samples at most


def loaded_model(robot: Robot, arms: tuple[Arm, ...], masses: Array) -> Any:
    """Return a copy of the robot's model with point masses at the arms' grasps, array of shape (n_arms,) [kg]."""
    model = robot.model.copy()
    for arm, mass in zip(arms, masses, strict=True):
        tip = model.frames[model.getFrameId(arm.tip)]
        point = pin.Inertia(float(mass), np.zeros(3), np.zeros((3, 3)))
        model.appendBodyToJoint(tip.parentJoint, point, tip.placement * pin.SE3(arm.tool))
    return model


def largest_torque(robot: Robot, arms: tuple[Arm, ...], masses: Array, curve: PPoly) -> Extreme:
    """Compute the largest share of its effort limit that a joint uses, with the margin for instants between samples.

    Parameters
    ----------
    arms : the arms that carry
    masses : array, shape (n_arms,), mass that each arm carries [kg]
    curve : joint positions by time [s], cubic between samples
    """
    time = sampling(curve.x)
    return worst(
        robot,
        time,
        torques(robot, loaded_model(robot, arms, masses), curve(time), curve(time, 1), curve(time, 2)),
    )


def sampling(samples: Array) -> Array:
    """Return the instants at which torques are computed, every second one in the middle of its neighbours [s]."""
    parts = np.ceil(np.diff(samples) / STEP - 1e-9).astype(int)
    return subdivided(samples, 2 * parts)[0]


def worst(robot: Robot, time: Array, torque: Array) -> Extreme:
    """Find the largest share of an effort limit, given torques of shape (n_steps, n_joints) at the times of
    `sampling`.
    """
    bulge = np.abs(torque[1::2] - 0.5 * (torque[:-1:2] + torque[2::2])).max(axis=0)
    share = (np.abs(torque) + bulge) / robot.effort
    place = np.unravel_index(first_largest(share), share.shape)
    return Extreme(float(share.max()), int(place[1]), float(time[place[0]]))


def torques(robot: Robot, loaded: Any, position: Array, velocity: Array, acceleration: Array) -> Array:
    """Compute the motors' torques; all arrays of shape (n_steps, n_joints) [N m, N for prismatic joints].

    Parameters
    ----------
    loaded : the robot's model with the load
    """
    data = loaded.createData()
    motion = zip(position, velocity, acceleration, strict=True)
    torque = np.array([pin.rnea(loaded, data, q, v, a) for q, v, a in motion])
    if robot.relief.any():
        data = robot.model.createData()
        weight = np.array([pin.computeGeneralizedGravity(robot.model, data, q) for q in position])
        torque -= robot.relief * weight
    return torque

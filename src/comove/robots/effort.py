"""Torques of a joint motion, and its least duration by the motors.

Torques are inverse dynamics with the payload's mass at the end effectors.

Torques are *sampled*, at 100 Hz or finer and in the middle between two samples; between these instants there is no
rigorous bound. The largest deviation of a middle value from the mean of its neighbours is added to every sample: a
torque that is a quadratic in time between two samples exceeds them and the middle value by at most a quarter of it.

The payload is modelled as point masses at its holders' grasps, which share its mass as they balance it: the shares'
mean place lies below its centre of mass (the rule of the lever), and of all such shares they are the most equal ones,
those of equally stiff arms. Friction is neglected; rotor inertias count where the model has them. Springs hold their
share of the arms' own weight.

An arm's rated payload covers its end effector's mass and its share of the payload's, at least an equal one.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
import pinocchio as pin

from comove.arrays import ROUNDING, Array
from comove.compiled import kernel
from comove.geometry.solids import N_CORNERS
from comove.model.files.keys import DEFAULT_MASS
from comove.model.scene import Scene, of_geometry
from comove.robots.model import Arm, Robot
from comove.robots.motion import (
    Extreme,
    JointCurve,
    JointMotion,
    largest_acceleration,
    largest_approach,
    largest_jerk,
    largest_velocity,
    subdivided,
)
from comove.robots.verification.kinematics import Inertias, inverse_dynamics


def load_mass(scene: Scene) -> float:
    """Return the mass of a scene's payload, `DEFAULT_MASS` by default [kg]."""
    return DEFAULT_MASS if scene.load_mass is None else scene.load_mass


def carried_masses(scene: Scene) -> Array:
    """Return the mass that every end effector holds; array, shape (n_hands,) [kg].

    An end effector beyond the others, seen from the centre of mass, holds the payload down: its mass is negative.
    """
    return load_mass(scene) * _shares(scene)


def payloads(scene: Scene, arms: tuple[Arm, ...]) -> Array:
    """Return every arm's used share of its rated payload; array, shape (n_hands,). End effectors count."""
    return (_counted_masses(scene) + [arm.hand for arm in arms]) / [arm.payload for arm in arms]


@of_geometry
def _counted_masses(scene: Scene) -> Array:
    """Return the mass that counts as every hand's share; array, shape (n_hands,), not to be changed [kg].

    A share that is less than an equal one counts as that: a load that leans or lags is not held in balance.
    """
    share = np.abs(_shares(scene))
    least = 1.0 / max(len(scene.file.holder_numbers), 1)
    return load_mass(scene) * np.where(share > 0.0, np.maximum(share, least), 0.0)


def overburdened(scene: Scene, arms: tuple[Arm, ...]) -> Iterator[str]:
    """Yield messages of arms overloaded by a scene's payload. The mass that they advise suits all arms."""
    carried, masses, ratios = load_mass(scene), _counted_masses(scene).tolist(), payloads(scene, arms)
    own = [(arm.payload - arm.hand) / mass for arm, mass in zip(arms, masses, strict=True) if mass > 0.0]
    most = carried * min((ratio for ratio in own if ratio > 0.0), default=np.inf)
    for arm, ratio, mass in zip(arms, ratios, masses, strict=True):
        if ratio > 1.0 + ROUNDING:
            hand = f" and its hand {arm.hand:.3g} kg" if arm.hand else ""
            yield (
                f"the arm '{arm.name}' is rated for {arm.payload:g} kg, and of the load of {carried:g} kg it holds "
                f"{mass:.3g} kg{hand}; "
                + (
                    f"let the load weigh {_rounded_down(most)} kg at most"
                    if arm.hand < arm.payload
                    else "correct `payload` in the robot's description, or the masses of its hand"
                )
            )


def _rounded_down(value: float, digits: int = 3) -> str:
    """Return a positive number, rounded down to some digits, as text."""
    step = 10.0 ** (np.floor(np.log10(value)) - digits + 1)
    return f"{np.floor(value / step) * step:.{digits}g}"


@of_geometry
def _shares(scene: Scene) -> Array:
    """Return every end effector's share of the payload's mass; read-only array, shape (n_hands,)."""
    shares, holders = np.zeros(len(scene.manipulators)), list(scene.file.holder_numbers)
    if not holders:
        return shares
    shares[holders] = 1.0 / len(holders)
    seen = (
        slice(None) if scene.grasp is not None and scene.grasp.keypoints else slice(2)
    )  # tilted: along its own axes
    hands = scene.nodes_at("start")[holders, seen]
    middle = hands.mean(axis=0)
    # the smallest change of equal shares that moves their mean place there; symmetric loads get equal ones exactly
    away, arms = _center_of_mass(scene)[seen] - middle, hands - middle
    if len(arms) == 2:  # of rank 1
        change = arms @ away / max(float((arms * arms).sum()), 1e-300)
    else:
        change = np.linalg.pinv(arms.T, rcond=1e-6) @ away
    shares[holders] += change.round(12)
    return shares


def _center_of_mass(scene: Scene) -> Array:
    """Return a uniform payload's centre of mass at the start; array, shape (3,) [m].

    A mesh has that of its polytopes, whose overlaps count as often as in simulations; sheets have a thickness there.
    """
    nodes, body = scene.nodes_at("start"), scene.body
    if len(body.solids) and body.solids.shape[1] == N_CORNERS:
        corners = nodes[body.solids]
        volumes = np.abs(np.linalg.det(corners[:, [1, 2, 4]] - corners[:, :1]))
        return np.asarray(np.average(corners.mean(axis=1), axis=0, weights=volumes))
    if len(body.solids):
        volumes, centers = zip(*(_volume(nodes[np.unique(solid)]) for solid in body.solids), strict=True)
        return np.asarray(np.average(centers, axis=0, weights=volumes))
    rods = body.edges[:, 0] != body.edges[:, 1]
    first, second = nodes[body.edges[rods]].transpose(1, 0, 2)
    along, radius = np.linalg.norm(second - first, axis=1), body.radii[rods]
    volume = np.where(radius > 0.0, radius**2 * (along + 4.0 / 3.0 * radius), along)
    return np.asarray(np.average(0.5 * (first + second), axis=0, weights=volume))


def _volume(corners: Array) -> tuple[float, Array]:
    """Return a convex hull's volume, times 6 [m^3], and centre; array, shape (3,) [m]."""
    from scipy.spatial import ConvexHull

    middle, faces = corners.mean(axis=0), corners[ConvexHull(corners).simplices]
    parts = np.abs(np.linalg.det(faces - middle))  # of tetrahedra over the faces
    return float(parts.sum()), np.average(0.25 * (faces.sum(axis=1) + middle), axis=0, weights=parts)


def loaded_model(robot: Robot, arms: tuple[Arm, ...], masses: Array) -> Any:
    """Return the robot's model with masses [kg] at the arms' grasps; `masses` has the shape (n_arms,)."""
    model = robot.model.copy()
    for arm, mass in zip(arms, masses, strict=True):
        point = pin.Inertia(float(mass), np.zeros(3), np.zeros((3, 3)))
        joint, grasp = robot.grasp_frame(arm)
        model.appendBodyToJoint(joint, point, grasp)
    return model


def largest_torque(robot: Robot, arms: tuple[Arm, ...], masses: Array, curve: JointCurve) -> Extreme:
    """Compute the largest share of a joint's effort limit. A margin for instants between samples is included.

    Parameters
    ----------
    arms : the arms that hold the payload
    masses : array, shape (n_arms,), mass that each arm holds [kg]
    curve : joint positions by time [s], cubic between samples
    """
    time, inertias = _sampling(curve.x), _loaded(robot, arms, tuple(masses.tolist()))
    q, rates, bends = curve.orders(time, 2)
    torque = inverse_dynamics(robot, inertias, q, rates, bends, _loaded(robot, (), ()))
    return _largest_share(robot, time, torque)


def still_torque(robot: Robot, arms: tuple[Arm, ...], masses: Array, curve: JointCurve) -> Extreme:
    """Compute the largest share of effort limits while still along a motion. Arguments as in `largest_torque`."""
    time = _sampling(curve.x)
    position = curve(time)
    still = np.zeros_like(position)
    return Extreme.largest(
        np.abs(torques(robot, loaded_model(robot, arms, masses), position, still, still)) / robot.effort, time
    )


def shortest_duration(robot: Robot, joints: JointMotion, arms: tuple[Arm, ...], masses: Array) -> float:
    """Compute the least duration [s] in which a scaled motion keeps limits.

    For a time scaling r, velocities are r times and accelerations r^2 times as large, and a torque is s + r^2 d,
    where s holds the weight and d accelerates the masses: both are computed once.

    Returns
    -------
    The duration; 0 if the joints do not move, inf if the motors cannot even hold the robot still along the path.
    """
    curve = joints.curve
    speed = largest_velocity(curve, robot.velocity).value
    if speed < 1e-12:
        return 0.0
    approach = largest_approach(curve, robot.approach, robot.lower, robot.upper).value
    jerk = largest_jerk(curve, robot.jerk).value
    pace = min(
        1.0 / max(speed, approach),
        1.0 / np.sqrt(largest_acceleration(curve, robot.acceleration).value),
        1.0 / np.cbrt(jerk) if jerk > 0.0 else np.inf,
        _pace_of_torques(robot, joints, loaded_model(robot, arms, masses)),
    )
    if pace == 0.0:
        return np.inf
    timed = joints.stretched(joints.duration / pace)
    for _ in range(100):  # torques are sampled anew at another pace
        if largest_torque(robot, arms, masses, timed.curve).value <= 1.0:
            return timed.duration
        timed = timed.stretched(1.0001 * timed.duration)
    return np.inf


def _pace_of_torques(robot: Robot, joints: JointMotion, model: Any, fastest: float = 1e4) -> float:
    """Compute the largest time scaling that the motors allow. It is 0 if they cannot hold the robot still."""
    time = _sampling(joints.time)
    position, velocity, acceleration = joints.at(time)
    still = np.zeros_like(position)
    holding = torques(robot, model, position, still, still)
    moving = torques(robot, model, position, velocity, acceleration) - holding

    def possible(square: float) -> bool:
        return _largest_share(robot, time, holding + square * moving).value <= 1.0

    if _largest_share(robot, time, holding).value >= 1.0:
        return 0.0
    low, high = 0.0, 1.0  # squares of the factor; all from 0 to the largest one are possible
    while possible(high) and high < fastest**2:
        low, high = high, 4 * high
    for _ in range(50):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if possible(middle) else (low, middle)
    return float(np.sqrt(low))


def _sampling(samples: Array, step: float = 0.01) -> Array:
    """Return instants at most `step` apart [s]. Every second one is in the middle of its neighbours."""
    return subdivided(samples, 2 * np.ceil(np.diff(samples) / step - 1e-9).astype(int))[0]


def _largest_share(robot: Robot, time: Array, torque: Array) -> Extreme:
    """Find the largest share of effort limits, with a margin between samples. Torques are those at `_sampling`."""
    return Extreme.largest(_shares_of_effort(torque, robot.effort), time)


@kernel
def _shares_of_effort(torque: Array, effort: Array) -> Array:
    """Return the shares for `_largest_share`; array, shape (n_steps, n_joints)."""
    share = np.empty(torque.shape)
    for j in range(torque.shape[1]):
        bulge = 0.0
        for t in range(1, torque.shape[0] - 1, 2):
            off = abs(torque[t, j] - 0.5 * (torque[t - 1, j] + torque[t + 1, j]))
            if bulge < off or np.isnan(off):
                bulge = off
        for t in range(torque.shape[0]):
            share[t, j] = (abs(torque[t, j]) + bulge) / effort[j]
    return share


def torques(robot: Robot, loaded: Any, position: Array, velocity: Array, acceleration: Array) -> Array:
    """Compute the motors' torques; arrays, shape (n_steps, n_joints) [N m, N for prismatic joints].

    Parameters
    ----------
    loaded : the robot's model with the payload
    """
    own = _loaded(robot, (), ())
    return inverse_dynamics(robot, Inertias.of(loaded), position, velocity, acceleration, own)


@lru_cache(maxsize=8)
def _loaded(robot: Robot, arms: tuple[Arm, ...], masses: tuple[float, ...]) -> Inertias:
    return Inertias.of(loaded_model(robot, arms, np.array(masses)))

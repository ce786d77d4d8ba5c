"""Time scaling of joint paths: the shortest durations that keep velocity, acceleration and torque limits.

`shortest_duration` scales the pace of the whole motion by one factor: hands and load keep their law of motion, so the
result carries out the motion of the hands on a scene of the new duration. `fastest_timing` chooses the pace at every
place (TOPP-RA; Pham and Pham, 2018): its duration is a lower bound for the path, and its motion is one of the robot
alone.

At r = T/T' times the pace, velocities are r times and accelerations r^2 times as large, and a torque is

    tau(r) = s + r^2 d,

where s holds the weight and d accelerates the masses: both are computed once.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_simpson
from scipy.interpolate import CubicHermiteSpline

from comove.errors import ExtraError, OptionError, RobotError
from comove.robots.effort import largest_torque, loaded_model, sampling, torques, worst
from comove.robots.extremes import Extreme, largest_acceleration, largest_velocity, subdivided
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.ties import first_least

Array = NDArray[np.float64]

GRID = 1000  # points of the path; with fewer than 500, TOPP-RA exceeds acceleration limits
RATE = 200.0  # Hz, of the samples of a new timing
STILL = 1e-12  # share of a velocity limit, below which a robot counts as standing still
PATIENCE = 1e-4  # by which a motion is stretched at a time until its torques keep their limits
TRIES = 100
HALVINGS = 50
FASTEST = 1e8  # square of the largest pace that is looked at
ROUNDS = 4  # in which limits are drawn in by what the spline through the samples exceeds them


@dataclass(frozen=True, eq=False)
class Timing:
    """A joint motion at its limits.

    Attributes
    ----------
    joints : the joint motion
    limit : the limit that prevents a faster motion, in words
    """

    joints: JointMotion
    limit: str

    @property
    def duration(self) -> float:
        """Return the duration [s]."""
        return self.joints.duration


def shortest_duration(
    robot: Robot, joints: JointMotion, *, carried: Mapping[str, float] | None = None, share: float = 1.0
) -> Timing:
    """Stretch or shorten a motion evenly until it uses a share of its limits.

    Parameters
    ----------
    carried
        Masses at the grasps, by arm [kg]; none unless given.
    share
        Share of velocity, acceleration and effort limits that may be used.

    Raises
    ------
    RobotError
        If the motors cannot even hold the robot still along the path.
    """
    _require_share(share)
    masses, curve = _masses(robot, carried), joints.curve
    speed = largest_velocity(curve, robot.velocity)
    if speed.value < STILL:
        raise OptionError("the joints do not move", key="joints", way_out="give a motion")
    acceleration = largest_acceleration(curve, robot.acceleration)
    paces = [
        (share / speed.value, "velocity", speed),
        (np.sqrt(share / acceleration.value), "acceleration", acceleration),
        _pace_of_torques(robot, joints, masses, share),
    ]
    _, what, extreme = paces[first_least([pace for pace, *_ in paces])]
    pace = min(pace for pace, *_ in paces)
    timed = joints.stretched(joints.duration / pace)
    for _ in range(TRIES):  # torques are sampled anew at another pace
        strongest = largest_torque(robot, robot.arms, masses, timed.curve)
        if strongest.value <= share:
            break
        timed = timed.stretched(timed.duration * (1 + PATIENCE))
    else:
        raise _too_weak(robot, strongest, share)
    when = extreme.time * timed.duration / joints.duration
    return Timing(timed, f"{what} of {robot.joint_names[extreme.joint]} at {when:.2f} s")


def fastest_timing(
    robot: Robot,
    joints: JointMotion,
    *,
    carried: Mapping[str, float] | None = None,
    share: float = 1.0,
    grid_points: int = GRID,
) -> Timing:
    """Compute the fastest motion along the same path that keeps the limits at every place.

    The acceleration of the optimal law jumps, that of a smooth curve cannot: where the cubic spline through the
    samples exceeds limits, these are tightened, and what still exceeds them is removed by stretching the motion.

    Parameters
    ----------
    carried, share
        As for `shortest_duration`.
    grid_points
        Number of grid points of the path.

    Raises
    ------
    RobotError
        If no timing keeps the limits.
    OptionError
        If there are less than 500 points.
    """
    if grid_points < 500:
        raise OptionError(
            f"grid_points is {grid_points}",
            key="grid_points",
            way_out="give 500 or more: with less, limits are exceeded in between",
        )
    _require_share(share)
    masses, drawn = _masses(robot, carried), np.full(3, share)
    best = shortest_duration(robot, joints, carried=carried, share=share)  # never slower than that
    for _ in range(ROUNDS):
        law = _optimal(robot, joints, masses, drawn, grid_points)
        n_steps = max(2, int(np.ceil(law.duration * RATE)) + 1)
        time = np.linspace(0.0, law.duration, n_steps)
        raw = JointMotion(time, joints.joint_names, law(time))
        timing = shortest_duration(robot, raw, carried=carried, share=share)
        if timing.duration < best.duration:
            best = timing
        exceeded = _shares(robot, raw, masses) / share
        if (exceeded <= 1.0).all():
            break
        drawn = drawn / np.maximum(exceeded, 1.0)
    return best


def _optimal(robot: Robot, joints: JointMotion, masses: Array, shares: Array, grid_points: int) -> Any:
    """Compute TOPP-RA's trajectory within shares of velocity, acceleration and effort limits."""
    try:
        import toppra
        from toppra import algorithm, constraint
    except ImportError as error:
        raise ExtraError("a new timing", "robot") from error
    model = loaded_model(robot, robot.arms, masses)

    def inverse_dynamics(q: Array, v: Array, a: Array) -> Array:
        return torques(robot, model, q[None], v[None], a[None])[0]

    velocity, acceleration, effort = (
        np.stack([-share * limit, share * limit], axis=1)
        for share, limit in zip(shares, (robot.velocity, robot.acceleration, robot.effort), strict=True)
    )
    constraints = [
        constraint.JointVelocityConstraint(velocity),
        constraint.JointAccelerationConstraint(acceleration),
        constraint.JointTorqueConstraint(inverse_dynamics, effort, np.zeros(len(robot.effort))),
    ]
    places, positions = _by_length(joints, grid_points)
    path = toppra.SplineInterpolator(places, positions)
    solver = algorithm.TOPPRA(constraints, path, gridpoints=places, parametrizer="ParametrizeConstAccel")
    law = solver.compute_trajectory(0.0, 0.0)
    if law is None:
        raise RobotError(
            "no timing of this path keeps the limits of the joints",
            key="carried",
            way_out="carry less, or find a path nearer to the robot",
        )
    return law


def _by_length(joints: JointMotion, count: int) -> tuple[Array, Array]:
    """Sample the path by the length that joints have gone, in which gentle starts and ends are not singular.

    Returns
    -------
    length : array, shape (count + 1,), path length, nearly evenly spaced
    position : array, shape (count + 1, n_joints), joint positions
    """
    time, _ = subdivided(joints.time, np.full(len(joints.time) - 1, 4))
    speed = np.linalg.norm(joints.curve(time, 1), axis=1)
    gone = CubicHermiteSpline(time, cumulative_simpson(speed, x=time, initial=0.0), speed)
    even = np.interp(np.linspace(0.0, gone(time[-1]), count + 1), gone(time), time)
    even[[0, -1]] = time[[0, -1]]
    return gone(even), joints.curve(even)


def _pace_of_torques(
    robot: Robot, joints: JointMotion, masses: Array, share: float
) -> tuple[float, str, Extreme]:
    """Compute the largest factor of the pace that the motors allow; all squares from 0 to its square are possible."""
    time, model = sampling(joints.time), loaded_model(robot, robot.arms, masses)
    position, velocity, acceleration = joints.at(time)
    still = np.zeros_like(position)
    holding = torques(robot, model, position, still, still)
    moving = torques(robot, model, position, velocity, acceleration) - holding
    if (weight := worst(robot, time, holding)).value >= share:
        raise _too_weak(robot, weight, share)
    low, high = 0.0, 1.0
    while worst(robot, time, holding + high * moving).value <= share and high < FASTEST:
        low, high = high, 4 * high
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        possible = worst(robot, time, holding + middle * moving).value <= share
        low, high = (middle, high) if possible else (low, middle)
    return float(np.sqrt(low)), "torque", worst(robot, time, holding + low * moving)


def _too_weak(robot: Robot, weight: Extreme, share: float) -> RobotError:
    name, effort = robot.joint_names[weight.joint], robot.effort[weight.joint]
    return RobotError(
        f"{name} needs {weight.value * effort:.4g} N m only to hold still what is {weight.time:.2f} s along the "
        f"path, and {share * effort:.4g} N m may be used",
        key="carried",
        way_out="carry less, or find a path nearer to the robot",
    )


def _shares(robot: Robot, joints: JointMotion, masses: Array) -> Array:
    """Compute the largest shares of velocity, acceleration and effort limits; array, shape (3,)."""
    curve = joints.curve
    return np.array(
        [
            largest_velocity(curve, robot.velocity).value,
            largest_acceleration(curve, robot.acceleration).value,
            largest_torque(robot, robot.arms, masses, curve).value,
        ]
    )


def _masses(robot: Robot, carried: Mapping[str, float] | None) -> Array:
    """Return the mass that each arm carries; array, shape (n_arms,) [kg]."""
    masses = np.zeros(len(robot.arms))
    for name, mass in (carried or {}).items():
        if not 0 <= mass < np.inf:
            raise OptionError(
                f"'{name}' carries {mass:g} kg", key="carried", way_out="give masses of 0 or more"
            )
        masses[robot.arms.index(robot.arm(name))] = mass
    return masses


def _require_share(share: float) -> None:
    if not 0 < share <= 1:
        raise OptionError(
            f"the share of the limits is {share:g}", key="share", way_out="give more than 0, at most 1"
        )

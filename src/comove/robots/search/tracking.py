"""Joint motions that track a motion of end effectors exactly."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.interpolate import BSpline, CubicSpline, make_lsq_spline

from comove.arrays import Array, first_largest
from comove.compiled import kernel
from comove.model.motion import SAMPLE_RATE, CoordinatedMotion
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointMotion
from comove.robots.search.chains import Iteration, inside, reach_pose
from comove.robots.search.following import Arms, follow_one, hand_rotation

DEGREE = 5  # of the spline that smooths them
N_COARSE = 201  # even samples of a motion that arms follow first
EXACT = Iteration(gain=1.0, keep=0.0, tolerance=1e-10, steady=1e-5, most=60)
"""Iteration for samples that begin near to their joints: after a last step of 1e-5 rad these are off by 1e-8 rad."""


@dataclass(frozen=True)
class Miss:
    """An arm out of reach at `time` [s], by `distance` [m]. A radian counts `chains.TURN`."""

    arm: str
    time: float
    distance: float

    def __str__(self) -> str:
        where = f"the arm '{self.arm}' does not reach its hand's pose at {self.time:.2f} s"
        return f"{where}: {self.distance:.3g} m are missing"


def track(
    robot: Robot,
    holders: tuple[Arm, ...],
    arms: Arms,
    motion: CoordinatedMotion,
    course: Array,
    *,
    haste: int = 1,
) -> tuple[JointMotion, Miss | None]:
    """Compute the joints along a motion, and their largest miss, if any.

    The arms first follow the motion coarsely, as in a search. These joints, smoothed, are the posture to which
    redundant joints are drawn when every sample is solved exactly. So the joints are as smooth as the end effectors.

    Parameters
    ----------
    holders, arms : the arms in the order of the end effectors, and as arrays
    course : array, shape (2, n_joints), joints of these arms at start and goal; the first pose is solved from the
        former
    haste : stride of samples that are solved first; if one of those is missed, the others are not solved
    """
    duration, n_joints = motion.scene.duration, course.shape[1]
    coarse = motion.nodes(N_COARSE)
    led, missing = np.empty((len(coarse), n_joints)), np.empty((len(coarse), len(holders)))
    follow_one(arms, coarse, course, led, missing)
    time = _sample_times(duration)
    posture = _smooth(led, time / duration)
    return _solved(robot, holders, arms, motion, time, posture, haste)


def track_near(
    robot: Robot, holders: tuple[Arm, ...], arms: Arms, motion: CoordinatedMotion, led: Array
) -> tuple[JointMotion, Miss | None]:
    """Compute the joints along a motion nearest to given ones. See `track`.

    Parameters
    ----------
    led : array, shape (n_steps, n_joints), joints of the arms at even times [rad]
    """
    time = _sample_times(motion.scene.duration)
    posture = CubicSpline(np.linspace(0.0, time[-1], len(led)), led)(time)
    return _solved(robot, holders, arms, motion, time, posture)


def _sample_times(duration: float) -> Array:
    return np.linspace(0.0, duration, int(np.ceil(SAMPLE_RATE * duration - 1e-9)) + 1)


def _solved(
    robot: Robot,
    holders: tuple[Arm, ...],
    arms: Arms,
    motion: CoordinatedMotion,
    time: Array,
    posture: Array,
    haste: int = 1,
) -> tuple[JointMotion, Miss | None]:
    """Solve every sample, redundant joints near a posture; array, shape (n_steps, n_joints) [rad]."""
    n_steps, columns = len(time), np.concatenate([arm.columns for arm in holders])
    nodes = motion.nodes(n_steps)
    when, joints, residual = time, posture, np.zeros((0, len(holders)))
    if haste > 1:
        few = np.append(np.arange(0, n_steps - 1, haste), n_steps - 1)
        when, residual = time[few], tracked(arms, np.ascontiguousarray(nodes[few]), posture[few], EXACT)[1]
    if residual.max(initial=0.0) <= EXACT.tolerance:
        when, (joints, residual) = time, tracked(arms, nodes, posture, EXACT)
    position = np.repeat(robot.home[None], n_steps, axis=0)
    position[:, columns] = joints
    worst, arm = np.unravel_index(first_largest(residual), residual.shape)
    miss = None
    if residual.max() > EXACT.tolerance:
        miss = Miss(holders[arm].name, float(when[worst]), float(residual[worst, arm]))
    return JointMotion(time, robot.joint_names, position), miss


def _smooth(joints: Array, at: Array) -> Array:
    """Fit a least-squares spline to joints at even times; evaluate it.

    It is quintic, and at rest at both ends.

    Parameters
    ----------
    joints : array, shape (n_steps, n_joints) [rad]
    at : array, shape (n_at,), times as shares of the duration

    Returns
    -------
    array, shape (n_at, n_joints)
    """
    knots, of_samples = _smoothing(len(joints))
    return BSpline(knots, of_samples @ joints, DEGREE)(at)


@lru_cache(maxsize=8)
def _smoothing(n_steps: int, pieces: int = 24) -> tuple[Array, Array]:
    """Return the knots of `_smooth`, and the map from samples to coefficients; (n_coefficients, n_steps).

    The spline has `pieces` polynomials within the duration. The data are mirrored in time at both ends, as a motion
    from rest to rest continues smoothly that way.
    """
    time, unit = np.linspace(0.0, 1.0, n_steps), np.eye(n_steps)
    times = np.concatenate([-time[:0:-1], time, 2.0 - time[-2::-1]])
    mirrored = np.concatenate([unit[:0:-1], unit, unit[-2::-1]])
    inner = np.linspace(-1.0, 2.0, 3 * pieces + 1)
    knots = np.concatenate([[inner[0]] * DEGREE, inner, [inner[-1]] * DEGREE])
    return knots, make_lsq_spline(times, mirrored, knots, k=DEGREE).c


@kernel
def tracked(arms: Arms, nodes: Array, posture: Array, how: Iteration) -> tuple[Array, Array]:
    """Solve joints at samples, (n_steps, n_joints); return residuals, (n_steps, n_arms) [m], too.

    Parameters
    ----------
    nodes : array, shape (n_steps, n_nodes, 3), end effectors first [m]
    posture : array, shape (n_steps, n_joints), to which redundant joints are drawn, and near which all begin [rad]
    """
    chains, n_steps = arms.chains, nodes.shape[0]
    joints, residual = posture.copy(), np.zeros((n_steps, chains.first.shape[0] - 1))
    rotation = np.empty((3, 3))
    for t in range(n_steps):
        for j in range(joints.shape[1]):  # as far from the posture as the samples before tell
            off = 0.0 if t == 0 else joints[t - 1, j] - posture[t - 1, j]
            if t > 2:
                before, first = joints[t - 2, j] - posture[t - 2, j], joints[t - 3, j] - posture[t - 3, j]
                off += 2.0 * (off - before) - (before - first)
            joints[t, j] = inside(chains, j, posture[t, j] + off, 0.0)
        for i in range(chains.first.shape[0] - 1):
            hand_rotation(arms.around, nodes[t], i, rotation)
            residual[t, i] = reach_pose(chains, i, rotation, nodes[t, i], posture[t], how, joints[t])
    return joints, residual

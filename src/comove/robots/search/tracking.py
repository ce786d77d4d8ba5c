"""Joint motions that track a motion of the hands exactly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import make_lsq_spline

from comove.coordination.motion import CoordinatedMotion
from comove.robots.model import Arm, Robot
from comove.robots.motion import SAMPLE_RATE, JointMotion
from comove.robots.search.chains import inside, reach_pose
from comove.robots.search.following import Arms, follow_one, hand_rotation
from comove.ties import first_largest

Array = NDArray[np.float64]

COARSE = 201  # samples at which the arms are led through the movement once
PIECES = 24  # polynomial pieces of the smooth posture that redundancy follows
EXACT, STEADY = 1e-10, 1e-9  # residual [m] and last step [rad] at the samples
MOST = 60  # iterations a sample
DRAWN = 1.0  # share of the way to the smooth posture that redundancy goes an iteration


@dataclass(frozen=True)
class Miss:
    """An arm that does not reach its hand's pose at `time` [s], by `distance` [m] (a radian counts `chains.TURN`)."""

    arm: str
    time: float
    distance: float


class TrackingTask(Protocol):
    """A robot whose arms hold a load, as tracking needs it (see `carrying.Carrying`)."""

    robot: Robot

    @property
    def holders(self) -> tuple[Arm, ...]:
        """Return the arms in the order of the scene's manipulators."""

    @property
    def columns(self) -> NDArray[np.int64]:
        """Return the indices of the arms' joints in the robot's joint vector."""

    @property
    def arms(self) -> Arms:
        """Return the arms as arrays, for kernels."""

    def best_start(self, nodes: Array) -> Array:
        """Return the joints from which the arms follow a motion best."""


def track(task: TrackingTask, motion: CoordinatedMotion) -> tuple[JointMotion, Miss | None]:
    """Compute the joints along a motion of the hands, and where they miss it most, if they do.

    The arms first follow the motion coarsely, as in a search. These joints, smoothed, are the posture to which
    redundant joints are drawn when every sample is solved to `EXACT`. So the joints are as smooth as the hands are.
    """
    duration = motion.scene.duration
    coarse = _nodes(motion, COARSE)
    led, missing = np.empty((COARSE, len(task.columns))), np.zeros((2, len(task.holders)))
    follow_one(task.arms, coarse, task.best_start(coarse), led, *missing)
    n_steps = int(np.ceil(SAMPLE_RATE * duration - 1e-9)) + 1
    time = np.linspace(0.0, duration, n_steps)
    posture = _smooth(np.linspace(0.0, duration, COARSE), led, time)
    joints, residual = _tracked(task.arms, _nodes(motion, n_steps), posture)
    position = np.repeat(task.robot.home[None], n_steps, axis=0)
    position[:, task.columns] = joints
    worst, arm = np.unravel_index(first_largest(residual), residual.shape)
    miss = None
    if residual.max() > EXACT:
        miss = Miss(task.holders[arm].name, float(time[worst]), float(residual[worst, arm]))
    return JointMotion(time, task.robot.joint_names, position), miss


def _nodes(motion: CoordinatedMotion, n_steps: int) -> Array:
    """Compute hands and corners of the load at even times; array, shape (n_steps, n_nodes, 3) [m]."""
    q = motion.at(np.linspace(0.0, 1.0, n_steps))[0]
    return np.ascontiguousarray(motion.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0])


def _smooth(time: Array, joints: Array, at: Array) -> Array:
    """Fit a least-squares spline of degree 5 to `joints` at `time`, at rest at both ends, and evaluate it at the
    times `at`.

    The data are mirrored in time at both ends, as a motion from rest to rest continues smoothly that way.

    Returns
    -------
    array, shape (n_at, n_joints)
    """
    end = time[-1]
    times = np.concatenate([-time[:0:-1], time, 2 * end - time[-2::-1]])
    mirrored = np.concatenate([joints[:0:-1], joints, joints[-2::-1]])
    inner = np.linspace(-end, 2 * end, 3 * PIECES + 1)
    knots = np.concatenate([[inner[0]] * 5, inner, [inner[-1]] * 5])
    return make_lsq_spline(times, mirrored, knots, k=5)(at)


@numba.njit(cache=True, error_model="numpy")
def _tracked(arms, nodes, posture):
    """Solve the joints at every sample, shape (n_steps, n_joints), and their residuals, shape (n_steps, n_arms)
    [m].
    """
    chains, n_steps = arms.chains, nodes.shape[0]
    joints, residual = posture.copy(), np.zeros((n_steps, chains.first.shape[0] - 1))
    rotation = np.empty((3, 3))
    for t in range(n_steps):
        for j in range(joints.shape[1]):
            joints[t, j] = inside(chains, j, joints[t, j], 0.0)
        for i in range(chains.first.shape[0] - 1):
            hand_rotation(arms.around, nodes[t], i, rotation)
            residual[t, i] = reach_pose(
                chains, i, rotation, nodes[t, i], posture[t], DRAWN, 0.0, EXACT, STEADY, MOST, joints[t]
            )
    return joints, residual

"""A home for every arm: hands down and in front, joints away from their limits, nothing that touches."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.robots.model import Arm, Robot

Array = NDArray[np.float64]

N_DRAWN, N_TRIED = 3000, 150  # configurations drawn, and those that are turned and tested for contact
N_TURNS, GAIN, DAMPING = 60, 0.5, 1e-3  # of the iteration that turns a hand down
DOWN = np.array([0.0, 0.0, -1.0])
NEAR_DOWN = np.deg2rad(5.0)
FREE = 0.01  # m, of clearance at home


@dataclass(frozen=True)
class Homes:
    """The homes of all arms.

    Attributes
    ----------
    joints : joint positions by arm; arrays, shape (n_joints,) [rad, m]
    notes : what they lack, in words
    """

    joints: tuple[Array, ...]
    notes: tuple[str, ...]


def homes_of(robot: Robot, seed: int = 0) -> Homes:
    """Find a home for every arm: of random configurations the best one that is free once its hand is turned down."""
    q, notes = robot.home, []
    rng = np.random.default_rng(seed)
    for k, arm in enumerate(robot.arms):
        later = {int(column) + 1 for other in robot.arms[k + 1 :] for column in other.columns}
        drawn = [*_as_before(robot, q, k), *_drawn(robot, arm, q, rng)[:N_TRIED]]
        best = [_turned_down(robot, arm, each) for each in drawn]
        near = (each for margin in (FREE, 0.0) for each in best if _is_free(robot, each, margin, later))
        found = next(near, None)
        q = best[0] if found is None else found
        if found is None:
            notes.append(
                f"no home of '{arm.name}' was found at which nothing touches: draw one, and write it there"
            )
        tilt = float(np.arccos(np.clip(DOWN @ robot.tool_pose(q, arm)[:3, 2], -1.0, 1.0)))
        if tilt > NEAR_DOWN:
            notes.append(
                f"the hand of '{arm.name}' at home is {np.rad2deg(tilt):.0f} degrees from pointing down, as near as "
                f"its {len(arm.columns)} joints were seen to come"
            )
    return Homes(tuple(q[arm.columns] for arm in robot.arms), tuple(notes))


def _as_before(robot: Robot, q: Array, k: int) -> list[Array]:
    """Return the configurations in which arm k is at home as an earlier arm of its kind is."""
    found, columns = [], robot.arms[k].columns
    for other in robot.arms[:k]:
        if len(other.columns) == len(columns) and all(
            np.array_equal(limit[other.columns], limit[columns]) for limit in (robot.lower, robot.upper)
        ):
            found.append(q.copy())
            found[-1][columns] = q[other.columns]
    return found


def _drawn(robot: Robot, arm: Arm, q: Array, rng: np.random.Generator) -> Array:
    """Return random configurations of the robot with one arm moved, the best first; array, shape (n, n_joints)."""
    lower, upper = robot.lower[arm.columns], robot.upper[arm.columns]
    low, high = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
    drawn = np.repeat(q[None], N_DRAWN, axis=0)
    joints = drawn[:, arm.columns] = rng.uniform(low, high, (N_DRAWN, len(low)))
    poses = robot.tool_poses(drawn, (arm,))[:, 0]
    base = base_of(robot, arm)
    reach = np.linalg.norm(poses[:, :3, 3] - base, axis=1).max()
    comfort = (np.minimum(joints - lower, upper - joints) / (upper - lower)).min(axis=1)
    worth = comfort + [_score(pose, base, reach) for pose in poses]
    return drawn[np.argsort(-worth, kind="stable")]


def _score(pose: Array, base: Array, reach: float) -> float:
    """Return how good a pose of a hand is for a home: it points down, in front of its base and below its shoulder."""
    place = (pose[:3, 3] - base) / reach
    wanted = np.array([0.55, 0.0, -0.15])
    return float(2.0 * (DOWN @ pose[:3, 2]) - 2.0 * np.linalg.norm(place - wanted))


def base_of(robot: Robot, arm: Arm) -> Array:
    """Return the place of the first joint of an arm; array, shape (3,) [m]."""
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, robot.home)
    return np.array(data.oMi[int(arm.columns[0]) + 1].translation)


def _turned_down(robot: Robot, arm: Arm, q: Array) -> Array:
    """Return a configuration near to q whose hand points down, or as nearly so as the joints allow."""
    model, q = robot.model, q.copy()
    data, frame = model.createData(), model.getFrameId(arm.tip)
    for _ in range(N_TURNS):
        error = np.cross(robot.tool_pose(q, arm)[:3, 2], DOWN)
        if np.linalg.norm(error) < 1e-4:
            break
        turning = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)[3:, arm.columns]
        square = turning @ turning.T + DAMPING * np.eye(3)
        q[arm.columns] += GAIN * turning.T @ np.linalg.solve(square, error)
        q = np.clip(q, robot.lower, robot.upper)
    return q


def _is_free(robot: Robot, q: Array, margin: float, later: set[int]) -> bool:
    """Return whether links that can collide keep a margin [m], without those of joints whose turn comes later."""
    geometry = robot.collision
    data, of_geometry = robot.model.createData(), geometry.createData()
    for k, pair in enumerate(geometry.collisionPairs):
        joints = {geometry.geometryObjects[i].parentJoint for i in (pair.first, pair.second)}
        if joints & later:
            of_geometry.deactivateCollisionPair(k)
    for request in of_geometry.collisionRequests:
        request.security_margin = margin
    return not pin.computeCollisions(robot.model, data, geometry, of_geometry, q, True)

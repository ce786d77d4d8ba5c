"""Displacements of links and payload by joints that deviate from their commands.

Where q was commanded, let joints be at q + d with |d_j| <= e_j, each joint by itself, at any instant. By the product
of exponentials (Brockett, 1984) about the axes at q, from the base on, a point x of a body is then at

    T_1(d_1) T_2(d_2) ... T_n(d_n) x,

where T_j turns about axis j, or shifts along it, by d_j: a joint moves rigidly all that is beyond it. Rigid motions
keep distances, so |T_1 T_2 x - x| <= |T_1 T_2 x - T_1 x| + |T_1 x - x| = |T_2 x - x| + |T_1 x - x|, and

    |T_1 ... T_n x - x| <= sum_j |T_j(d_j) x - x| <= sum_j e_j r_j(q),

with r_j the distance of x from axis j (1 for a joint that slides), as a chord is no longer than its arc. This holds
for deviations of any size: no term of second order is neglected, though each joint displaces the axes beyond it.
Joints that move both bodies of a pair keep their distance, so it is less by no more than the sum over all others.

A base displaced by its tolerance is one more rigid motion, so its effect adds up with that of the joints.

Of a motion, lever arms L_j >= r_j(q(t)) are needed at all instants. Between two of them, t_i, joints beyond j move
the body in the same way: with w_k the largest way of joint k from the nearest t_i and R_j the bound for all positions
(`Reaches`),

    L_j = min(R_j, max_i r_j(q(t_i)) + sum_k w_k max_i r_k(q(t_i))),    k beyond j.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.robots.model import Arm, Robot
from comove.robots.motion import JointCurve, subdivided
from comove.robots.verification.kinematics import joint_placements, moved_by, reaches_of, tree_of

N_INSTANTS = 200  # of a motion at least, at which lever arms are computed


class Balls(NamedTuple):
    """Balls about bodies that joints move.

    Attributes
    ----------
    joint : array, shape (n,), numbers of the joints that move them
    center : array, shape (n, 3), centres in the joints' frames [m]
    radius : array, shape (n,) [m]
    reach : array, shape (n, n_joints), see `Reaches.of_ball`
    """

    joint: Integers
    center: Array
    radius: Array
    reach: Array


def lever_arms(robot: Robot, balls: Balls, curve: JointCurve | None) -> Array:
    """Bound the distances of balls' points from joint axes during a motion. See the module.

    Parameters
    ----------
    curve : joint positions by time [s]; any positions within the limits if None

    Returns
    -------
    array, shape (n, n_joints) [m]; 1 for joints that slide, 0 for joints that do not move a ball
    """
    if curve is None:
        return balls.reach
    parts = np.ceil(np.diff(curve.x) * N_INSTANTS / (curve.x[-1] - curve.x[0]))
    time, pieces = subdivided(curve.x, np.maximum(parts, 1.0).astype(np.int64))
    ways = (0.5 * np.diff(time)[:, None] * curve.fastest[0][pieces]).max(axis=0)
    nearby = np.minimum(balls.reach, _largest(robot, balls, curve(time)))
    return np.minimum(balls.reach, nearby + (ways * nearby) @ _beyond(robot))


@lru_cache(maxsize=8)
def _beyond(robot: Robot) -> NDArray[np.bool_]:
    """Return whether joint k is beyond joint j; array, by k and j."""
    return moved_by(robot)[_joints(robot)] & ~np.eye(robot.model.nv, dtype=bool)


@lru_cache(maxsize=8)
def _joints(robot: Robot) -> Integers:
    """Return the joint of each column; array, shape (n_joints,)."""
    return np.argsort(tree_of(robot).columns[1:], kind="stable") + 1


def _largest(robot: Robot, balls: Balls, q: Array) -> Array:
    """Compute balls' largest distances from joint axes; array, shape (n, n_joints).

    Parameters
    ----------
    q : array, shape (n_steps, n_joints) [rad, m for joints that slide]
    """
    tree, found = tree_of(robot), balls.reach.copy()
    turns, places = joint_placements(robot, q)
    centers = places[:, balls.joint] + np.einsum("tbij,bj->tbi", turns[:, balls.joint], balls.center)
    for column, joint in enumerate(_joints(robot).tolist()):
        moved = np.flatnonzero(balls.reach[:, column] > 0.0)
        if tree.slides[joint] or not len(moved):
            continue
        axis = turns[:, joint] @ tree.own[joint]
        away = centers[:, moved] - places[:, joint, None]
        along = np.einsum("tbi,ti->tb", away, axis)
        square = np.einsum("tbi,tbi->tb", away, away) - along**2
        found[moved, column] = np.sqrt(np.maximum(square, 0.0).max(axis=0)) + balls.radius[moved]
    return found


class HandShift(NamedTuple):
    """Largest displacement [m] and rotation [rad] of end effectors; arrays, shape (n_arms,)."""

    off: Array
    turn: Array


def shifts_of_hands(
    robot: Robot, arms: tuple[Arm, ...], deviations: Array, curve: JointCurve | None
) -> HandShift:
    """Bound how end effectors are displaced and turned by joints that deviate.

    A frame turns at most by the sum of the angles by which its joints do.

    Parameters
    ----------
    deviations : array, shape (n_joints,), largest deviations [rad, m for joints that slide]
    curve : as in `lever_arms`
    """
    reaches, frames = reaches_of(robot), [robot.grasp_frame(arm) for arm in arms]
    balls = Balls(
        np.array([joint for joint, _ in frames], dtype=np.int64),
        np.array([grasp.translation for _, grasp in frames]),
        np.zeros(len(arms)),
        np.array([reaches.of_hand(arm)[0] for arm in arms]),
    )
    turning = np.where(moved_by(robot)[balls.joint] & ~reaches.slides, deviations, 0.0)
    return HandShift(lever_arms(robot, balls, curve) @ deviations, turning.sum(axis=1))

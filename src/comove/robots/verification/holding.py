"""Bounds of the errors of the hands, relative to their poses on the load, at every instant.

Let e be the difference between a grasp frame's position and its position in the motion of the hands. At instants t_i
of a grid, e and e' are computed. Between two of them, h apart, e' stays within h^2/8 max|e'''| of its chord, so that

    |e(t)| <= max |e(t_i)| + h/2 (max |e'(t_i)| + h^2/8 max|e'''|),

and the angle between the orientations grows no faster than the difference of the angular velocities, to which the
same applies. The third derivatives are bounded by those of the hands' motion plus those of the arm: every derivative
of m-th order of a serial chain's position by its joints is a product z1 x (z2 x ... (zm x r)) of unit axes and a
vector to the hand no longer than its reach L (1 where joints slide); with S1, S2, S3 the sums of the joints' |q'|,
|q''|, |q'''|,

    |p'''| <= L (S3 + 3 S1 S2 + S1^3),     |omega''| <= S3 + 3 S1 S2 + S1^3.

The grid is that of the samples, made finer where this is not tight enough. Kinematics are Pinocchio's.
"""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import PPoly

from comove.geometry.rotations import cross
from comove.robots.model import Arm, Robot
from comove.robots.motion import fastest, subdivided
from comove.robots.verification.carried import Carried
from comove.robots.verification.kinematics import joint_placements, joint_twists, moved_by
from comove.robots.verification.reach import reaches_of

Array = NDArray[np.float64]


class Errors(NamedTuple):
    """Errors of the hands relative to the places where they hold the load; lengths [m], angles [rad].

    Attributes
    ----------
    time : array, shape (n_steps,), the grid [s]
    is_sample : array, shape (n_steps,), whether an instant is a sample of the joint motion
    position, turn : arrays, shape (n_steps, n_hands), errors on the grid; turn is 0 if no orientation is required
    position_bound, turn_bound : arrays, shape (n_steps - 1, n_hands), bounds between neighbouring instants
    apart_bound : bound of the difference of two hands' position errors
    hands : array, shape (n_steps, n_hands, 3), positions of the grasp frames
    """

    time: Array
    is_sample: NDArray[np.bool_]
    position: Array
    turn: Array
    position_bound: Array
    turn_bound: Array
    apart_bound: float
    hands: Array


def holding_errors(
    robot: Robot,
    arms: tuple[Arm, ...],
    carried: Carried,
    curve: PPoly,
    *,
    tight: float = 3e-6,
    finest: int = 100,
) -> Errors:
    """Compare the grasp frames of `arms`, in the order of the hands, with the hands' motion.

    Parameters
    ----------
    curve : joint positions by time [s], cubic between samples
    tight : by which bounds between samples may exceed the errors [m and rad]
    finest : parts, at most, into which the time between two samples is divided for that
    """
    jerk, turn_jerk = _third_derivatives(robot, arms, carried, curve)
    time, pieces = _grid(curve.x, np.maximum(jerk, turn_jerk).max(axis=1), tight, finest)
    jerk, turn_jerk = jerk[pieces], turn_jerk[pieces]
    places, rotations, velocities, spins = _grasp_frames(robot, arms, curve(time), curve(time, 1))
    wanted, wanted_velocity = carried.hands(time)
    error, drift = places - wanted, velocities - wanted_velocity
    turn, turning = np.zeros(error.shape[:2]), np.zeros_like(error)
    if (held := carried.rotations(time)) is not None:
        chord = np.linalg.norm(rotations - held[0], axis=(2, 3)) / np.sqrt(8.0)  # sine of half the angle
        turn, turning = 2 * np.arcsin(np.minimum(chord, 1.0)), spins - held[1]
    else:
        turn_jerk = np.zeros_like(turn_jerk)
    half = 0.5 * np.diff(time)
    apart = [
        _between(
            _sizes(error[:, i] - error[:, j]),
            _sizes(drift[:, i] - drift[:, j]),
            jerk[:, i] + jerk[:, j],
            half,
        ).max()
        for i, j in combinations(range(len(arms)), 2)
    ]
    return Errors(
        time,
        np.append(np.diff(pieces, prepend=-1) > 0, True),
        _sizes(error),
        turn,
        _between(_sizes(error), _sizes(drift), jerk, half[:, None]),
        _between(turn, _sizes(turning), turn_jerk, half[:, None]),
        float(max(apart, default=0.0)),
        places,
    )


def _between(error: Array, rate: Array, jerk: Array, half: Array) -> Array:
    """Bound an error between instants 2 `half` apart, by its values and rates there and its third derivative."""
    rate = np.maximum(rate[1:], rate[:-1]) + 0.5 * half**2 * jerk
    return np.maximum(error[1:], error[:-1]) + half * rate


def _third_derivatives(
    robot: Robot, arms: tuple[Arm, ...], carried: Carried, curve: PPoly
) -> tuple[Array, Array]:
    """Bound |e'''| and the third derivative of the angle error between samples; arrays, shape (n_intervals,
    n_hands).
    """
    rate, _ = fastest(curve)
    bend = np.abs(curve(curve.x, 2))
    bend, jerk = np.maximum(bend[1:], bend[:-1]), 6 * np.abs(curve.c[0])
    reaches = reaches_of(robot)
    of_all, of_turning = np.empty((2, len(rate), len(arms)))
    for i, arm in enumerate(arms):
        turning = arm.columns[~reaches.slides[arm.columns]]
        for bound, columns in ((of_all, arm.columns), (of_turning, turning)):
            s1, s2, s3 = (x[:, columns].sum(axis=1) for x in (rate, bend, jerk))
            bound[:, i] = s3 + 3 * s1 * s2 + s1**3
    lengths = np.array([reaches.of_hand(arm)[0].max() for arm in arms])  # 1 at least where a joint slides
    begin, end = curve.x[:-1], curve.x[1:]
    swing = np.zeros((len(begin), len(arms)))
    if (grasp := carried.motion.scene.grasp) is not None:
        swing[:, grasp.turning] = carried.swing.over(begin, end)
    return lengths * of_all + carried.jerk.over(begin, end), of_turning + swing


def _grid(samples: Array, jerk: Array, tight: float, finest: int) -> tuple[Array, NDArray[np.int64]]:
    """Compute instants fine enough for bounds as `tight`, and the index of the sample interval of each piece."""
    parts = np.ceil(np.diff(samples) * np.cbrt(jerk / (16 * tight)))
    parts = np.clip(np.nan_to_num(parts, nan=finest, posinf=finest), 1, finest)
    return subdivided(samples, parts.astype(int))


def _grasp_frames(
    robot: Robot, arms: tuple[Arm, ...], positions: Array, rates: Array
) -> tuple[Array, Array, Array, Array]:
    """Compute positions, orientations, velocities and angular velocities of the grasp frames, in the scene's
    frame.
    """
    turns, origins = joint_placements(robot, positions)
    twists, moves = joint_twists(robot, turns, origins, rates), moved_by(robot)
    places, rotations, velocities, spins = [], [], [], []
    for arm in arms:
        joint, grasp = robot.grasp_frame(arm)
        twist = twists[:, moves[joint]].sum(axis=1)
        places.append(origins[joint] + turns[joint] @ grasp.translation)
        rotations.append(turns[joint] @ grasp.rotation)
        velocities.append(twist[:, :3] + cross(twist[:, 3:], places[-1]))
        spins.append(twist[:, 3:])
    return np.stack(places, 1), np.stack(rotations, 1), np.stack(velocities, 1), np.stack(spins, 1)


def _sizes(vectors: Array) -> Array:
    return np.linalg.norm(vectors, axis=-1)

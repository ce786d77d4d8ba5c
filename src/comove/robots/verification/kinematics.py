"""Placements and twists of all joints at many configurations at once, from Pinocchio's model.

Pinocchio places one configuration a call, and reading a result costs more than computing it. Where thousands are
needed, the same product of placements is taken here for all of them; the tests compare both.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.geometry.rotations import cross
from comove.robots.model import Robot
from comove.robots.verification.reach import reaches_of

Array = NDArray[np.float64]


class _Tree(NamedTuple):
    """Placements, axes and kinds of the joints of a model, the universe first.

    Attributes
    ----------
    parents : array, shape (n_joints + 1,)
    turn, shift : arrays, shape (n_joints + 1, 3, 3) and (n_joints + 1, 3), of each joint in the one before it [m]
    cross, square : arrays, shape (n_joints + 1, 3, 3), the axis k as k x and k x (k x)
    axis, slides : arrays, shape (n_joints + 1, 3) and (n_joints + 1,)
    columns : array, shape (n_joints,), column of each joint but the universe
    moves : array, shape (n_joints + 1, n_joints), whether the joint of a column moves what is on a joint
    """

    parents: NDArray[np.int64]
    turn: Array
    shift: Array
    cross: Array
    square: Array
    axis: Array
    slides: NDArray[np.bool_]
    columns: NDArray[np.int64]
    moves: NDArray[np.bool_]


@lru_cache(maxsize=8)
def _tree(robot: Robot) -> _Tree:
    model: Any = robot.model
    reaches = reaches_of(robot)
    columns = np.array([model.idx_vs[joint] for joint in range(1, model.njoints)], dtype=np.int64)
    axis = np.concatenate([np.zeros((1, 3)), reaches.axes[columns]])
    moves = np.zeros((model.njoints, model.nv), dtype=bool)
    for joint in range(1, model.njoints):
        moves[joint] = moves[model.parents[joint]]
        moves[joint, columns[joint - 1]] = True
    cross = np.zeros((len(axis), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]], cross[:, [1, 2, 0], [2, 0, 1]] = axis, -axis
    return _Tree(
        np.array(model.parents, dtype=np.int64),
        np.array([placement.rotation for placement in model.jointPlacements]),
        np.array([placement.translation for placement in model.jointPlacements]),
        cross,
        cross @ cross,
        axis,
        np.concatenate([[False], reaches.slides[columns]]),
        columns,
        moves,
    )


def moved_by(robot: Robot) -> NDArray[np.bool_]:
    """Return whether the joint of a column moves what is on a joint; array, shape (n_joints + 1, n_joints), the
    universe first.
    """
    return _tree(robot).moves


def joint_placements(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Compute the orientations and the places of all joints, the universe first.

    Parameters
    ----------
    q : array, shape (n_steps, n_joints) [rad, m for joints that slide]

    Returns
    -------
    arrays, shape (n_joints + 1, n_steps, 3, 3) and (n_joints + 1, n_steps, 3) [m]
    """
    tree, model = _tree(robot), robot.model
    turns, places = np.empty((model.njoints, len(q), 3, 3)), np.empty((model.njoints, len(q), 3))
    turns[0], places[0] = np.eye(3), 0.0
    shape = len(q), 3, 3
    for joint in range(1, model.njoints):
        parent, value = tree.parents[joint], q[:, model.idx_qs[joint]]
        before = turns[parent].reshape(-1, 3)  # one large product is faster than many small ones
        places[joint] = places[parent] + (before @ tree.shift[joint]).reshape(-1, 3)
        turn = before @ tree.turn[joint]
        turns[joint] = turn.reshape(shape)
        if tree.slides[joint]:
            places[joint] += (turn @ tree.axis[joint]).reshape(-1, 3) * value[:, None]
            continue
        sine, versine = np.sin(value)[:, None, None], (1.0 - np.cos(value))[:, None, None]
        turns[joint] += sine * (turn @ tree.cross[joint]).reshape(shape)
        turns[joint] += versine * (turn @ tree.square[joint]).reshape(shape)
    return turns, places


def joint_twists(robot: Robot, turns: Array, places: Array, rates: Array) -> Array:
    """Compute the twists that the joints give to what they move, at the scene's origin.

    Parameters
    ----------
    turns, places : the joints' placements, as `joint_placements` returns them
    rates : array, shape (n_steps, n_joints), rates of the joints [rad/s, m/s]

    Returns
    -------
    array, shape (n_steps, n_joints, 6), linear velocities [m/s], then angular ones [rad/s]
    """
    tree = _tree(robot)
    axes = np.einsum("jnik,jk->jni", turns[1:], tree.axis[1:])
    slides = tree.slides[1:, None, None]
    linear, angular = np.where(slides, axes, cross(places[1:], axes)), np.where(slides, 0.0, axes)
    twists = np.empty((*rates.shape, 6))
    twists[:, tree.columns] = np.concatenate([linear, angular], axis=2).swapaxes(0, 1)
    return twists * rates[:, :, None]

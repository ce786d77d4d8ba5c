"""Placements and twists of all joints at many configurations at once, and bounds of how far joints move a robot.

Pinocchio places one configuration a call, and reading a result costs more than computing it. Where thousands are
needed, the same product of placements is taken here for all of them; the tests compare both.

The distance of a part from an axis turns rates of joints into speeds. Its bounds add up lengths along the chain, so
they hold for all joint positions within the limits. So do the tolerances of
the places of the bases. Axes and placements are Pinocchio's.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.geometry.rotations import cross
from comove.robots.description import Uncertainty
from comove.robots.model import Arm, Robot


def joint_axes(model: Any) -> tuple[Array, NDArray[np.bool_]]:
    """Return the joints' axes in their own frames, shape (n_joints, 3), and whether joints are prismatic, shape
    (n_joints,).
    """
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    columns = [
        pin.getJointJacobian(model, data, joint, pin.LOCAL)[:, model.idx_vs[joint]]
        for joint in range(1, model.njoints)
    ]
    linear, angular = np.array(columns).reshape(-1, 2, 3).swapaxes(0, 1)
    slides = np.linalg.norm(angular, axis=1) < 0.5
    return np.where(slides[:, None], linear, angular), slides


class Reaches:
    """Computes bounds of the distances between the axes of a robot's joints and the bodies that they move."""

    def __init__(self, robot: Robot):
        self.robot = robot
        self.axes, self.slides = joint_axes(robot.model)
        self._furthest = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
        self._known: dict[tuple[int, bytes, float], tuple[Array, Array, float]] = {}

    def of_ball(self, joint: int, point: Array, radius: float) -> tuple[Array, Array, float]:
        """Bound the distances of a ball from the axes of all joints that move it.

        Parameters
        ----------
        joint : number of the joint that carries the ball, 0 if no joint moves it
        point : array, shape (3,), centre of the ball in the joint's frame (for joint 0 in the scene's) [m]
        radius : radius of the ball [m]

        Returns
        -------
        reach : array, shape (n_joints,), the largest distance of the ball's points from the axis of each joint that
            moves it [m]; 1 for a prismatic joint (metres per metre), 0 for one that does not move the ball
        root : array, shape (3,), a point that does not move, in the scene's frame [m]
        length : largest distance of the ball's points from `root` [m]
        """
        if joint == 0:
            return np.zeros(self.robot.model.nv), point, radius
        key = joint, point.tobytes(), radius  # a robot's bodies are always the same
        if key not in self._known:
            self._known[key] = self._along(joint, point, radius)
        return self._known[key]

    def _along(self, joint: int, point: Array, radius: float) -> tuple[Array, Array, float]:
        """Compute `of_ball` from joint to joint."""
        model, length = self.robot.model, radius
        reach = np.zeros(model.nv)
        while joint > 0:
            column = model.idx_vs[joint]
            away = float(np.linalg.norm(point))
            if self.slides[column]:
                reach[column] = 1.0
                away += self._furthest[column]
            else:
                along = float(self.axes[column] @ point)
                reach[column] = np.sqrt(max(float(point @ point) - along**2, 0.0)) + length
            length += away
            point, joint = model.jointPlacements[joint].translation, model.parents[joint]
        reach.setflags(write=False)
        return reach, point, length

    def of_hand(self, arm: Arm) -> tuple[Array, Array, float]:
        """Bound the distances of an arm's grasp from the axes, as `of_ball` does."""
        joint, grasp = self.robot.grasp_frame(arm)
        return self.of_ball(joint, grasp.translation, 0.0)


@lru_cache(maxsize=8)
def reaches_of(robot: Robot) -> Reaches:
    """Return the reaches of a robot's joints, which all verifications share."""
    return Reaches(robot)


@lru_cache(maxsize=8)
def _bases_by_name(robot: Robot) -> dict[str, int]:
    """Return the numbers of the models by the names of their links and joints; empty where there is one model."""
    if len(robot.sources) == 1:
        return {}
    return {
        part.get("name", ""): number
        for number, source in enumerate(robot.sources)
        for part in ET.fromstring(source.urdf)
        if part.tag in ("link", "joint")
    }


@dataclass(frozen=True, eq=False)
class Bases:
    """The bases of a robot, with the tolerances of their places."""

    robot: Robot
    uncertainty: Uncertainty

    @property
    def reaches(self) -> Reaches:
        """Return the reaches of the robot's joints."""
        return reaches_of(self.robot)

    @property
    def numbers(self) -> dict[str, int]:
        """Return, by name of link or joint, the number of the model whose base it is on; empty where there is one
        base only.
        """
        return _bases_by_name(self.robot)

    def pull(self, base: int, root: Array, length: float) -> float:
        """Bound the displacement, by the tolerance of a base, of points at most `length` from a point `root` [m].

        Turning about its origin by an angle a moves a point at the distance r by at most a r.

        Parameters
        ----------
        root : array, shape (..., 3); the furthest of several points counts
        """
        origin = np.array(self.robot.description.models[base].base.position)
        turn = np.deg2rad(self.uncertainty.rotation_deg)
        away = np.linalg.norm(root - origin, axis=-1)
        return float(self.uncertainty.position + turn * (away.max() + length))

    def of_hand(self, arm: Arm, places: Array) -> tuple[int, float]:
        """Return the base of an arm, and the largest error of its hand due to that base [m].

        Parameters
        ----------
        places : array, shape (n_steps, 3), positions of the hand [m]
        """
        joint, _ = self.robot.grasp_frame(arm)
        base = self.numbers.get(self.robot.model.names[joint], 0)
        return base, self.pull(base, places, 0.0)


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

    parents: Integers
    turn: Array
    shift: Array
    cross: Array
    square: Array
    axis: Array
    slides: NDArray[np.bool_]
    columns: Integers
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

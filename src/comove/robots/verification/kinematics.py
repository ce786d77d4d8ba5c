"""Kinematics and dynamics of a robot at many configurations at once, and bounds of how far its joints move it.

Pinocchio computes one configuration a call, and reading a result costs more than computing it. The kernels here take
thousands a call, with the axes and placements of Pinocchio's model; tests compare both.

A joint moves a point at most at its rate times the point's distance from its axis. Bounds of this distance are sums
of lengths along the chain, so they hold for all joint positions within the limits. So do bounds of how far the
tolerance of a base's place moves a point.
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
from comove.compiled import kernel
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

    def pulls(self, base: Integers, root: Array, length: Array | float) -> Array:
        """Bound the displacements, by the tolerance of a base, of points at most `length` from a point `root` [m].

        Turning about its origin by an angle a moves a point at the distance r by at most a r.

        Parameters
        ----------
        base : array, shape (n,), numbers of bases
        root : array, shape (n, 3)
        """
        origin = np.array([model.base.position for model in self.robot.description.models])[base]
        turn = np.deg2rad(self.uncertainty.rotation_deg)
        return np.asarray(
            self.uncertainty.position + turn * (np.linalg.norm(root - origin, axis=-1) + length)
        )

    def of_hand(self, arm: Arm, places: Array) -> tuple[int, float]:
        """Return the base of an arm, and the largest error of its hand due to that base [m].

        Parameters
        ----------
        places : array, shape (n_steps, 3), positions of the hand [m]
        """
        joint, _ = self.robot.grasp_frame(arm)
        base = self.numbers.get(self.robot.model.names[joint], 0)
        return base, float(self.pulls(np.full(len(places), base), places, 0.0).max())


class JointTree(NamedTuple):
    """Joints of a model as kernels take them, the universe first.

    Attributes
    ----------
    parents : array, shape (n_joints + 1,)
    columns : array, shape (n_joints + 1,), column of each joint, -1 for the universe
    turn, shift : arrays, shape (n_joints + 1, 3, 3) and (n_joints + 1, 3), of each joint in the one before it [m]
    sine, versine : arrays, shape (n_joints + 1, 3, 3), what the sine, and one less the cosine, of a joint add to
        `turn`; zeros for joints that slide
    axis : array, shape (n_joints + 1, 3), axes in the frames before the joints
    slides : array, shape (n_joints + 1,)
    """

    parents: Integers
    columns: Integers
    turn: Array
    shift: Array
    sine: Array
    versine: Array
    axis: Array
    slides: NDArray[np.bool_]


@lru_cache(maxsize=8)
def tree_of(robot: Robot) -> JointTree:
    """Return the joints of a robot as kernels take them."""
    model: Any = robot.model
    reaches = reaches_of(robot)
    columns = np.array([-1, *model.idx_vs[1:]], dtype=np.int64)
    axis = np.concatenate([np.zeros((1, 3)), reaches.axes[columns[1:]]])
    slides = np.concatenate([[False], reaches.slides[columns[1:]]])
    turn = np.array([placement.rotation for placement in model.jointPlacements])
    cross = np.zeros((len(axis), 3, 3))
    cross[:, [2, 0, 1], [1, 2, 0]], cross[:, [1, 2, 0], [2, 0, 1]] = axis, -axis
    cross[slides] = 0.0
    return JointTree(
        np.array(model.parents, dtype=np.int64),
        columns,
        turn,
        np.array([placement.translation for placement in model.jointPlacements]),
        turn @ cross,
        turn @ cross @ cross,
        np.einsum("jab,jb->ja", turn, axis),
        slides,
    )


@lru_cache(maxsize=8)
def moved_by(robot: Robot) -> NDArray[np.bool_]:
    """Return whether the joint of a column moves what is on a joint; array, shape (n_joints + 1, n_joints), the
    universe first.
    """
    tree = tree_of(robot)
    moves = np.zeros((len(tree.parents), robot.model.nv), dtype=bool)
    for joint in range(1, len(moves)):
        moves[joint] = moves[tree.parents[joint]]
        moves[joint, tree.columns[joint]] = True
    return moves


def common_joints(robot: Robot, first: Integers, second: Integers) -> Integers:
    """Return the last joints that move what is on either of two joints, 0 where none does; arrays, shape (n,)."""
    moves, supports = moved_by(robot), robot.model.supports
    depth = max(map(len, supports))
    above = np.array(
        [[*joints, *([0] * (depth - len(joints)))] for joints in map(list, supports)], dtype=np.int64
    )
    return above[first, (moves[first] & moves[second]).sum(axis=1)]


def joint_placements(robot: Robot, q: Array) -> tuple[Array, Array]:
    """Compute the orientations and the places of all joints, the universe first.

    Parameters
    ----------
    q : array, shape (n_steps, n_joints) [rad, m for joints that slide]

    Returns
    -------
    arrays, shape (n_steps, n_joints + 1, 3, 3) and (n_steps, n_joints + 1, 3) [m]
    """
    return joint_motions(robot, q, np.empty((0, q.shape[1])))[:2]


def joint_motions(robot: Robot, q: Array, rates: Array) -> tuple[Array, Array, Array, Array]:
    """Compute placements and velocities of all joints, the universe first, in the scene's frame.

    Parameters
    ----------
    q, rates : arrays, shape (n_steps, n_joints), positions and rates of the joints [rad, rad/s; m for joints that
        slide]; with no rates, no velocities are computed

    Returns
    -------
    turns, places : arrays, shape (n_steps, n_joints + 1, 3, 3) and (n_steps, n_joints + 1, 3) [m]
    velocities, spins : arrays, shape (n_steps, n_joints + 1, 3), of the joints' origins [m/s] and frames [rad/s]
    """
    return _moved(tree_of(robot), np.ascontiguousarray(q), np.ascontiguousarray(rates))


@kernel
def _place_joint(tree: JointTree, j: int, value: float, turn: Array, arm: Array) -> None:
    """Write the orientation and the place, arrays of shape (3, 3) and (3,), of a joint in the frame before it."""
    sine, versine = np.sin(value), 1.0 - np.cos(value)
    slid = value if tree.slides[j] else 0.0
    for a in range(3):
        arm[a] = tree.shift[j, a] + slid * tree.axis[j, a]
        for b in range(3):
            turn[a, b] = tree.turn[j, a, b] + sine * tree.sine[j, a, b] + versine * tree.versine[j, a, b]


@kernel
def _moved(tree: JointTree, q: Array, rates: Array) -> tuple[Array, Array, Array, Array]:
    """Return what `joint_motions` does."""
    n_steps, n_rates, n_frames = q.shape[0], rates.shape[0], tree.parents.shape[0]
    turns, places = np.empty((n_steps, n_frames, 3, 3)), np.zeros((n_steps, n_frames, 3))
    velocities, spins = np.zeros((n_rates, n_frames, 3)), np.zeros((n_rates, n_frames, 3))
    own, axis, arm, local = np.empty((3, 3)), np.empty(3), np.empty(3), np.empty(3)
    for t in range(n_steps):
        for a in range(3):
            for b in range(3):
                turns[t, 0, a, b] = 1.0 if a == b else 0.0
        for j in range(1, n_frames):
            before, value = turns[t, tree.parents[j]], q[t, tree.columns[j]]
            _place_joint(tree, j, value, own, local)
            for a in range(3):
                axis[a] = arm[a] = 0.0
                for c in range(3):
                    axis[a] += before[a, c] * tree.axis[j, c]
                    arm[a] += before[a, c] * local[c]
                places[t, j, a] = places[t, tree.parents[j], a] + arm[a]
                for b in range(3):
                    turns[t, j, a, b] = (
                        before[a, 0] * own[0, b] + before[a, 1] * own[1, b] + before[a, 2] * own[2, b]
                    )
            if n_rates == 0:
                continue
            rate, spin = rates[t, tree.columns[j]], spins[t, tree.parents[j]]
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                velocities[t, j, a] = velocities[t, tree.parents[j], a] + spin[b] * arm[c] - spin[c] * arm[b]
                if tree.slides[j]:
                    velocities[t, j, a] += rate * axis[a]
                    spins[t, j, a] = spin[a]
                else:
                    spins[t, j, a] = spin[a] + rate * axis[a]
    return turns, places, velocities, spins


class Inertias(NamedTuple):
    """Masses that joints move, as kernels take them, and gravity.

    Attributes
    ----------
    mass : array, shape (n_joints + 1,) [kg]
    center : array, shape (n_joints + 1, 3), centres of mass in the joints' frames [m]
    tensor : array, shape (n_joints + 1, 3, 3), about the centres of mass [kg m^2]
    armature : array, shape (n_joints,), inertias of the rotors [kg m^2]
    gravity : array, shape (3,) [m/s^2]
    """

    mass: Array
    center: Array
    tensor: Array
    armature: Array
    gravity: Array

    @classmethod
    def of(cls, model: Any) -> Inertias:
        """Return those of a pinocchio.Model."""
        parts = list(model.inertias)
        return cls(
            np.array([part.mass for part in parts]),
            np.array([part.lever for part in parts]),
            np.array([part.inertia for part in parts]),
            np.array(model.armature),
            np.array(model.gravity.linear),
        )


def inverse_dynamics(robot: Robot, inertias: Inertias, q: Array, rates: Array, bends: Array) -> Array:
    """Compute what moves the joints, by recursive Newton-Euler (Luh, Walker & Paul, 1980).

    Parameters
    ----------
    q, rates, bends : arrays, shape (n_steps, n_joints), positions, rates and second derivatives of the joints

    Returns
    -------
    array, shape (n_steps, n_joints) [N m, N for joints that slide]
    """
    return _driven(tree_of(robot), inertias, *map(np.ascontiguousarray, (q, rates, bends)))


@kernel
def _driven(tree: JointTree, inertias: Inertias, q: Array, rates: Array, bends: Array) -> Array:
    """Return what `inverse_dynamics` does; all vectors are in the frames of their joints."""
    n_frames, result = tree.parents.shape[0], np.empty(q.shape)
    turn, arm, axis = np.empty((n_frames, 3, 3)), np.empty((n_frames, 3)), np.empty((n_frames, 3))
    spin, swing, pull = np.zeros((n_frames, 3)), np.zeros((n_frames, 3)), np.zeros((n_frames, 3))
    force, moment = np.empty((n_frames, 3)), np.empty((n_frames, 3))
    felt, along, tilted = np.empty(3), np.empty(3), np.empty(3)
    for a in range(3):
        pull[0, a] = -inertias.gravity[a]
    for t in range(q.shape[0]):
        for j in range(1, n_frames):
            i, k = tree.parents[j], tree.columns[j]
            value, rate, bend = q[t, k], rates[t, k], bends[t, k]
            _place_joint(tree, j, value, turn[j], arm[j])
            for a in range(3):  # how the frame before accelerates where this one is
                b, c = (a + 1) % 3, (a + 2) % 3
                along[a] = spin[i, b] * arm[j, c] - spin[i, c] * arm[j, b]
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                felt[a] = (
                    pull[i, a]
                    + swing[i, b] * arm[j, c]
                    - swing[i, c] * arm[j, b]
                    + spin[i, b] * along[c]
                    - spin[i, c] * along[b]
                )
            for a in range(3):
                spin[j, a] = (
                    turn[j, 0, a] * spin[i, 0] + turn[j, 1, a] * spin[i, 1] + turn[j, 2, a] * spin[i, 2]
                )
                swing[j, a] = (
                    turn[j, 0, a] * swing[i, 0] + turn[j, 1, a] * swing[i, 1] + turn[j, 2, a] * swing[i, 2]
                )
                pull[j, a] = turn[j, 0, a] * felt[0] + turn[j, 1, a] * felt[1] + turn[j, 2, a] * felt[2]
                axis[j, a] = (
                    turn[j, 0, a] * tree.axis[j, 0]
                    + turn[j, 1, a] * tree.axis[j, 1]
                    + turn[j, 2, a] * tree.axis[j, 2]
                )
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                turning = rate * (spin[j, b] * axis[j, c] - spin[j, c] * axis[j, b])
                if tree.slides[j]:
                    pull[j, a] += bend * axis[j, a] + 2.0 * turning
                else:
                    swing[j, a] += bend * axis[j, a] + turning
            if not tree.slides[j]:
                for a in range(3):
                    spin[j, a] += rate * axis[j, a]
            _pushed(inertias, j, spin[j], swing[j], pull[j], force[j], moment[j], along, tilted)
        for j in range(n_frames - 1, 0, -1):
            i, k = tree.parents[j], tree.columns[j]
            carried = force[j] if tree.slides[j] else moment[j]
            result[t, k] = inertias.armature[k] * bends[t, k]
            for a in range(3):
                result[t, k] += axis[j, a] * carried[a]
            if i == 0:
                continue
            for a in range(3):
                felt[a] = (
                    turn[j, a, 0] * force[j, 0] + turn[j, a, 1] * force[j, 1] + turn[j, a, 2] * force[j, 2]
                )
                force[i, a] += felt[a]
                moment[i, a] += (
                    turn[j, a, 0] * moment[j, 0] + turn[j, a, 1] * moment[j, 1] + turn[j, a, 2] * moment[j, 2]
                )
            for a in range(3):
                b, c = (a + 1) % 3, (a + 2) % 3
                moment[i, a] += arm[j, b] * felt[c] - arm[j, c] * felt[b]
    return result


@kernel
def _pushed(
    inertias: Inertias,
    j: int,
    spin: Array,
    swing: Array,
    pull: Array,
    force: Array,
    moment: Array,
    along: Array,
    tilted: Array,
) -> None:
    """Write the force and the moment about a joint's origin that accelerate its mass; the last two are scratch."""
    center = inertias.center[j]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        along[a] = spin[b] * center[c] - spin[c] * center[b]
        tensor = inertias.tensor[j, a]
        tilted[a] = tensor[0] * spin[0] + tensor[1] * spin[1] + tensor[2] * spin[2]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        felt = swing[b] * center[c] - swing[c] * center[b] + spin[b] * along[c] - spin[c] * along[b]
        force[a] = inertias.mass[j] * (pull[a] + felt)
        tensor = inertias.tensor[j, a]
        moment[a] = tensor[0] * swing[0] + tensor[1] * swing[1] + tensor[2] * swing[2]
        moment[a] += spin[b] * tilted[c] - spin[c] * tilted[b]
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        moment[a] += center[b] * force[c] - center[c] * force[b]

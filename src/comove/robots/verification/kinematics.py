"""Batched kinematics and dynamics of a robot, and bounds of its reach.

Pinocchio computes one configuration a call, and reading a result costs more than computing it. The kernels here take
thousands a call, with the axes and placements of Pinocchio's model; tests compare both.

A joint moves a point at most at its rate times the point's distance from its axis. Bounds of this distance are sums
of lengths along the chain, so they hold for all joint positions within the limits. So do bounds of a point's
displacement by the tolerance of a base's place.
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
    """Return joints' own axes, (n_joints, 3), and whether joints are prismatic, (n_joints,)."""
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
    """Bounds of the distances between joint axes and moved bodies."""

    def __init__(self, robot: Robot):
        self.robot = robot
        self.axes, self.slides = joint_axes(robot.model)
        self._furthest = np.maximum(np.abs(robot.lower), np.abs(robot.upper))
        self._known: dict[tuple[int, bytes, float], tuple[Array, Array, float]] = {}

    def of_ball(self, joint: int, point: Array, radius: float) -> tuple[Array, Array, float]:
        """Bound the distances of a ball from its joints' axes.

        Parameters
        ----------
        joint : number of the joint that moves the ball, 0 if no joint moves it
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
        """Bound the distances of an arm's grasp from its joints' axes. See `of_ball`."""
        joint, grasp = self.robot.grasp_frame(arm)
        return self.of_ball(joint, grasp.translation, 0.0)


@lru_cache(maxsize=8)
def reaches_of(robot: Robot) -> Reaches:
    """Return the reaches of a robot's joints, shared by all verifications."""
    return Reaches(robot)


@lru_cache(maxsize=8)
def _bases_by_name(robot: Robot) -> dict[str, int]:
    """Return models' numbers by link and joint names, empty for one model."""
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
    """The bases of a robot, with their tolerances and the joints'."""

    robot: Robot
    uncertainty: Uncertainty

    @property
    def reaches(self) -> Reaches:
        """Return the reaches of the robot's joints."""
        return reaches_of(self.robot)

    @property
    def numbers(self) -> dict[str, int]:
        """Return bases' numbers by link or joint name, empty for one base."""
        return _bases_by_name(self.robot)

    @property
    def deviations(self) -> Array | None:
        """Return the joints' largest deviations [rad, m], None where none are stated."""
        if self.uncertainty.joints is None:
            return None
        return self.uncertainty.deviations(self.robot.joint_names)

    @property
    def turn(self) -> float:
        """Return the tolerance of the bases' orientation [rad]."""
        return float(np.deg2rad(self.uncertainty.rotation_deg))

    def pulls(self, base: Integers, root: Array, length: Array | float) -> Array:
        """Bound the displacements of points due to a base's tolerance [m].

        Points are at most `length` from a point `root`. Turning about its origin by an angle a moves a point at the
        distance r by at most a r.

        Parameters
        ----------
        base : array, shape (n,), numbers of bases
        root : array, shape (n, 3)
        """
        if self.turn == 0.0 == self.uncertainty.position:
            return np.zeros(len(base))
        origin = np.array([model.base.position for model in self.robot.description.models])[base]
        return np.asarray(
            self.uncertainty.position + self.turn * (np.linalg.norm(root - origin, axis=-1) + length)
        )

    def of_hand(self, arm: Arm, places: Array) -> tuple[int, float]:
        """Return an arm's base, and its effect on the end effector [m].

        Parameters
        ----------
        places : array, shape (n_steps, 3), positions of the end effector [m]
        """
        joint, _ = self.robot.grasp_frame(arm)
        base = self.numbers.get(self.robot.model.names[joint], 0)
        return base, float(self.pulls(np.full(len(places), base), places, 0.0).max())


class JointTree(NamedTuple):
    """Joints of a model for kernels, the universe first.

    Attributes
    ----------
    parents : array, shape (n_joints + 1,)
    columns : array, shape (n_joints + 1,), column of each joint, -1 for the universe
    turn, shift : arrays, shape (n_joints + 1, 3, 3) and (n_joints + 1, 3), of each joint in the one before it [m]
    sine, versine : arrays, shape (n_joints + 1, 3, 3), additions of the sine, and one less the cosine, of a joint to
        `turn`; zeros for joints that slide
    axis, own : arrays, shape (n_joints + 1, 3), axes in the frames before the joints, and in the joints' own
    slides : array, shape (n_joints + 1,)
    """

    parents: Integers
    columns: Integers
    turn: Array
    shift: Array
    sine: Array
    versine: Array
    axis: Array
    own: Array
    slides: NDArray[np.bool_]


@lru_cache(maxsize=8)
def tree_of(robot: Robot) -> JointTree:
    """Return the joints of a robot for kernels."""
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
        axis,
        slides,
    )


@lru_cache(maxsize=8)
def moved_by(robot: Robot) -> NDArray[np.bool_]:
    """Return whether joints move bodies on joints; array, shape (n_joints + 1, n_joints), the universe first."""
    tree = tree_of(robot)
    moves = np.zeros((len(tree.parents), robot.model.nv), dtype=bool)
    for joint in range(1, len(moves)):
        moves[joint] = moves[tree.parents[joint]]
        moves[joint, tree.columns[joint]] = True
    return moves


def common_joints(robot: Robot, first: Integers, second: Integers) -> Integers:
    """Return the last joints that move bodies of both joints, 0 without; arrays, shape (n,)."""
    moves = moved_by(robot)
    return _chains(robot)[first, (moves[first] & moves[second]).sum(axis=1)]


@lru_cache(maxsize=8)
def _chains(robot: Robot) -> Integers:
    """Return the chain of joints above each, then zeros; array, shape (n_joints + 1, depth)."""
    supports = [list(joints) for joints in robot.model.supports]
    depth = max(map(len, supports))
    return np.array([[*joints, *([0] * (depth - len(joints)))] for joints in supports], dtype=np.int64)


@lru_cache(maxsize=8)
def supports_of(robot: Robot) -> tuple[frozenset[int], ...]:
    """Return the joints that move what is on each joint; none for the universe."""
    return tuple(frozenset(joints) - {0} for joints in map(list, robot.model.supports))


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
    """Compute placements and velocities of all joints in the scene's frame. The universe is first.

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
    """Write a joint's orientation and place in the frame before. Arrays, shapes (3, 3) and (3,)."""
    sine, versine = np.sin(value), 1.0 - np.cos(value)
    slid, rest, by_sine, by_versine = (
        value if tree.slides[j] else 0.0,
        tree.turn[j],
        tree.sine[j],
        tree.versine[j],
    )
    for a in range(3):
        arm[a] = tree.shift[j, a] + slid * tree.axis[j, a]
        for b in range(3):
            turn[a, b] = rest[a, b] + sine * by_sine[a, b] + versine * by_versine[a, b]


@kernel
def _moved(tree: JointTree, q: Array, rates: Array) -> tuple[Array, Array, Array, Array]:
    """Compute `joint_motions` in a kernel."""
    n_steps, n_rates, n_frames = q.shape[0], rates.shape[0], tree.parents.shape[0]
    turns, places = np.empty((n_steps, n_frames, 3, 3)), np.zeros((n_steps, n_frames, 3))
    velocities, spins = np.zeros((n_rates, n_frames, 3)), np.zeros((n_rates, n_frames, 3))
    own, local = np.empty((3, 3)), np.empty(3)
    for t in range(n_steps):
        for a in range(3):
            for b in range(3):
                turns[t, 0, a, b] = 1.0 if a == b else 0.0
        for j in range(1, n_frames):
            i, k, after, along = tree.parents[j], tree.columns[j], turns[t, j], tree.axis[j]
            before = turns[t, i]
            _place_joint(tree, j, q[t, k], own, local)
            ax, ay, az = _turned(before, local[0], local[1], local[2])
            places[t, j, 0] = places[t, i, 0] + ax
            places[t, j, 1] = places[t, i, 1] + ay
            places[t, j, 2] = places[t, i, 2] + az
            for b in range(3):
                after[0, b], after[1, b], after[2, b] = _turned(before, own[0, b], own[1, b], own[2, b])
            if n_rates == 0:
                continue
            ux, uy, uz = _turned(before, along[0], along[1], along[2])
            rate, slid = (0.0, rates[t, k]) if tree.slides[j] else (rates[t, k], 0.0)
            sx, sy, sz = spins[t, i, 0], spins[t, i, 1], spins[t, i, 2]
            velocities[t, j, 0] = velocities[t, i, 0] + sy * az - sz * ay + slid * ux
            velocities[t, j, 1] = velocities[t, i, 1] + sz * ax - sx * az + slid * uy
            velocities[t, j, 2] = velocities[t, i, 2] + sx * ay - sy * ax + slid * uz
            spins[t, j, 0], spins[t, j, 1], spins[t, j, 2] = sx + rate * ux, sy + rate * uy, sz + rate * uz
    return turns, places, velocities, spins


@kernel
def _turned(turn: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return R v."""
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z,
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z,
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z,
    )


@kernel
def on_joints(
    motions: tuple[Array, Array, Array, Array], joint: Integers, turn: Array, shift: Array
) -> tuple[Array, Array, Array, Array]:
    """Compute the motions of frames fixed to joints, in the scene's frame.

    Parameters
    ----------
    motions : of all joints, as `joint_motions` returns them
    joint : array, shape (n,), number of the joint that moves each frame
    turn, shift : arrays, shape (n, 3, 3) and (n, 3), placements of the frames in those of the joints [m]

    Returns
    -------
    places, turns, velocities, spins : arrays, shape (n_steps, n, 3), and (n_steps, n, 3, 3) of turns
    """
    turns, origins, speeds, turnings = motions
    n_steps, n = turns.shape[0], joint.shape[0]
    places, rotations = np.empty((n_steps, n, 3)), np.empty((n_steps, n, 3, 3))
    velocities, spins = np.empty((n_steps, n, 3)), np.empty((n_steps, n, 3))
    for t in range(n_steps):
        for i in range(n):
            j = joint[i]
            r, s = turns[t, j], turnings[t, j]
            x, y, z = _turned(r, shift[i, 0], shift[i, 1], shift[i, 2])
            for b in range(3):
                out = rotations[t, i]
                out[0, b], out[1, b], out[2, b] = _turned(r, turn[i, 0, b], turn[i, 1, b], turn[i, 2, b])
            for a in range(3):
                spins[t, i, a] = s[a]
                places[t, i, a], velocities[t, i, a] = origins[t, j, a], speeds[t, j, a]
            places[t, i, 0] += x
            places[t, i, 1] += y
            places[t, i, 2] += z
            velocities[t, i, 0] += s[1] * z - s[2] * y
            velocities[t, i, 1] += s[2] * x - s[0] * z
            velocities[t, i, 2] += s[0] * y - s[1] * x
    return places, rotations, velocities, spins


class Inertias(NamedTuple):
    """Masses that joints move, for kernels, and gravity.

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


def inverse_dynamics(
    robot: Robot, inertias: Inertias, q: Array, rates: Array, bends: Array, own: Inertias
) -> Array:
    """Compute the motors' torques by recursive Newton-Euler (Luh, Walker & Paul, 1980).

    Parameters
    ----------
    q, rates, bends : arrays, shape (n_steps, n_joints), positions, rates and second derivatives of the joints
    own : masses of the robot alone; springs hold the share `robot.relief` of their weight

    Returns
    -------
    array, shape (n_steps, n_joints) [N m, N for joints that slide]
    """
    motion = map(np.ascontiguousarray, (q, rates, bends))
    return _driven(tree_of(robot), inertias, own, robot.relief, *motion)


@kernel
def _driven(
    tree: JointTree, inertias: Inertias, own: Inertias, relief: Array, q: Array, rates: Array, bends: Array
) -> Array:
    """Compute `inverse_dynamics` in a kernel. All vectors are in the frames of their joints."""
    n_frames, result, springs = tree.parents.shape[0], np.empty(q.shape), relief.any()
    turn, arm = np.empty((n_frames, 3, 3)), np.empty((n_frames, 3))
    spin, swing, pull = np.zeros((n_frames, 3)), np.zeros((n_frames, 3)), np.zeros((n_frames, 3))
    force, moment = np.zeros((n_frames, 3)), np.zeros((n_frames, 3))
    fall, weight, tilt = np.zeros((n_frames, 3)), np.zeros((n_frames, 3)), np.zeros((n_frames, 3))
    for a in range(3):
        pull[0, a] = fall[0, a] = -inertias.gravity[a]
    for t in range(q.shape[0]):
        for j in range(1, n_frames):
            i, k, r, u = tree.parents[j], tree.columns[j], turn[j], tree.own[j]
            _place_joint(tree, j, q[t, k], r, arm[j])
            if springs:  # which hold what the robot weighs at rest
                px, py, pz = _seen(r, fall[i, 0], fall[i, 1], fall[i, 2])
                mass, x, y, z = own.mass[j], own.center[j, 0], own.center[j, 1], own.center[j, 2]
                fx, fy, fz = mass * px, mass * py, mass * pz
                fall[j, 0], fall[j, 1], fall[j, 2] = px, py, pz
                weight[j, 0], weight[j, 1], weight[j, 2] = fx, fy, fz
                tilt[j, 0], tilt[j, 1], tilt[j, 2] = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
            rate, bend, slides = rates[t, k], bends[t, k], tree.slides[j]
            # how the frame before accelerates where this one is
            sx, sy, sz, wx, wy, wz = spin[i, 0], spin[i, 1], spin[i, 2], swing[i, 0], swing[i, 1], swing[i, 2]
            x, y, z = arm[j, 0], arm[j, 1], arm[j, 2]
            ax, ay, az = sy * z - sz * y, sz * x - sx * z, sx * y - sy * x
            fx = pull[i, 0] + wy * z - wz * y + sy * az - sz * ay
            fy = pull[i, 1] + wz * x - wx * z + sz * ax - sx * az
            fz = pull[i, 2] + wx * y - wy * x + sx * ay - sy * ax
            sx, sy, sz = _seen(r, sx, sy, sz)
            wx, wy, wz = _seen(r, wx, wy, wz)
            px, py, pz = _seen(r, fx, fy, fz)
            ux, uy, uz = u[0], u[1], u[2]
            tx, ty, tz = rate * (sy * uz - sz * uy), rate * (sz * ux - sx * uz), rate * (sx * uy - sy * ux)
            if slides:
                px, py, pz = px + bend * ux + 2.0 * tx, py + bend * uy + 2.0 * ty, pz + bend * uz + 2.0 * tz
            else:
                wx, wy, wz = wx + bend * ux + tx, wy + bend * uy + ty, wz + bend * uz + tz
                sx, sy, sz = sx + rate * ux, sy + rate * uy, sz + rate * uz
            spin[j, 0], spin[j, 1], spin[j, 2] = sx, sy, sz
            swing[j, 0], swing[j, 1], swing[j, 2] = wx, wy, wz
            pull[j, 0], pull[j, 1], pull[j, 2] = px, py, pz
            # the force, and the moment about the joint's origin, that accelerate its mass
            mass, center, tensor = inertias.mass[j], inertias.center[j], inertias.tensor[j]
            x, y, z = center[0], center[1], center[2]
            ax, ay, az = sy * z - sz * y, sz * x - sx * z, sx * y - sy * x
            fx = mass * (px + wy * z - wz * y + sy * az - sz * ay)
            fy = mass * (py + wz * x - wx * z + sz * ax - sx * az)
            fz = mass * (pz + wx * y - wy * x + sx * ay - sy * ax)
            lx, ly, lz = _seen(tensor, sx, sy, sz)  # it is symmetric
            mx, my, mz = _seen(tensor, wx, wy, wz)
            force[j, 0], force[j, 1], force[j, 2] = fx, fy, fz
            moment[j, 0] = mx + sy * lz - sz * ly + y * fz - z * fy
            moment[j, 1] = my + sz * lx - sx * lz + z * fx - x * fz
            moment[j, 2] = mz + sx * ly - sy * lx + x * fy - y * fx
        for j in range(n_frames - 1, 0, -1):
            k, u, slides = tree.columns[j], tree.own[j], tree.slides[j]
            carried = force[j] if slides else moment[j]
            held = u[0] * carried[0] + u[1] * carried[1] + u[2] * carried[2]
            result[t, k] = inertias.armature[k] * bends[t, k] + held
            _passed_on(tree.parents[j], j, turn[j], arm[j], force, moment)
            if springs:
                carried = weight[j] if slides else tilt[j]
                result[t, k] -= relief[k] * (u[0] * carried[0] + u[1] * carried[1] + u[2] * carried[2])
                _passed_on(tree.parents[j], j, turn[j], arm[j], weight, tilt)
    return result


@kernel
def _passed_on(i: int, j: int, r: Array, arm: Array, force: Array, moment: Array) -> None:
    """Add a joint's force and moment to those of the joint before."""
    if i == 0:
        return
    x, y, z, mx, my, mz = arm[0], arm[1], arm[2], moment[j, 0], moment[j, 1], moment[j, 2]
    fx = r[0, 0] * force[j, 0] + r[0, 1] * force[j, 1] + r[0, 2] * force[j, 2]
    fy = r[1, 0] * force[j, 0] + r[1, 1] * force[j, 1] + r[1, 2] * force[j, 2]
    fz = r[2, 0] * force[j, 0] + r[2, 1] * force[j, 1] + r[2, 2] * force[j, 2]
    force[i, 0], force[i, 1], force[i, 2] = force[i, 0] + fx, force[i, 1] + fy, force[i, 2] + fz
    moment[i, 0] += r[0, 0] * mx + r[0, 1] * my + r[0, 2] * mz + y * fz - z * fy
    moment[i, 1] += r[1, 0] * mx + r[1, 1] * my + r[1, 2] * mz + z * fx - x * fz
    moment[i, 2] += r[2, 0] * mx + r[2, 1] * my + r[2, 2] * mz + x * fy - y * fx


@kernel
def _seen(turn: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return R^T v."""
    return (
        turn[0, 0] * x + turn[1, 0] * y + turn[2, 0] * z,
        turn[0, 1] * x + turn[1, 1] * y + turn[2, 1] * z,
        turn[0, 2] * x + turn[1, 2] * y + turn[2, 2] * z,
    )

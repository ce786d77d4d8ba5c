"""Loads as bodies: simple shapes in a frame of their own, and where a movement of the hands carries that frame.

The frame stands in the middle between the holders, x from the second of them to the first, z as upright as it can be.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.errors import RobotError, SceneError
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.scenes.model import BarLoad, BoxLoad, FrameLoad
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

DEFAULT_MASS = 0.25  # kg, of a load that states none
THINNEST = 0.004  # m, radius of rods that state none


@dataclass(frozen=True, eq=False)
class Part:
    """A piece of a load: a box, or a capsule along its z.

    Attributes
    ----------
    kind : "box" or "capsule"
    position : array, shape (3,), in the load's frame [m]
    rotation : array, shape (3, 3), in the load's frame
    size : half edges of a box; radius and half the length between the centres of a capsule's caps [m]
    """

    kind: str
    position: Array
    rotation: Array
    size: tuple[float, ...]

    @property
    def volume(self) -> float:
        """[m^3]"""
        if self.kind == "box":
            return 8.0 * float(np.prod(self.size))
        radius, half = self.size
        return float(np.pi * radius**2 * (2 * half + 4 / 3 * radius))


@dataclass(frozen=True, eq=False)
class Load:
    """What is carried.

    Attributes
    ----------
    holders : the hands that hold it, by number in the scene
    grasps : array, shape (n_holders, 3), where they hold it, in its frame [m]
    pose : array, shape (4, 4), at the start
    parts : its pieces
    mass : [kg]
    """

    holders: tuple[int, ...]
    grasps: Array
    pose: Array
    parts: tuple[Part, ...]
    mass: float


def holders_of(scene: Scene) -> tuple[int, ...]:
    """The hands, by number, that hold the scene's load."""
    return tuple(scene.manipulators.index(name) for name in scene.file.holders)


def load_of(scene: Scene, hands: Array, section: tuple[float, float] | None = None) -> Load | None:
    """The scene's load, None where it has none.

    Parameters
    ----------
    hands : array, shape (n_manipulators, 4, 4), grasp frames at the start
    section : width and height [m] of a bar that is no capsule but a box
    """
    load = scene.file.load
    if load is None:
        return None
    holders = holders_of(scene)
    points = hands[list(holders)][:, :3, 3]
    pose = np.eye(4)
    pose[:3, :3] = _frame(points)
    if isinstance(load, BoxLoad):
        grasps = np.array(
            [(load.grasps or {}).get(n, (0.0, 0.0, 0.0)) for n in scene.file.holders], dtype=float
        )
        pose[:3, 3] = (points - grasps @ pose[:3, :3].T).mean(axis=0)
    else:
        pose[:3, 3] = points.mean(axis=0)
        grasps = (points - pose[:3, 3]) @ pose[:3, :3]
    mass = DEFAULT_MASS if scene.load_mass is None else scene.load_mass
    return Load(holders, grasps, pose, _parts(scene, load, grasps, section), mass)


def _parts(
    scene: Scene, load: object, grasps: Array, section: tuple[float, float] | None
) -> tuple[Part, ...]:
    if isinstance(load, BoxLoad):
        return (Part("box", np.zeros(3), np.eye(3), tuple(edge / 2 for edge in load.size)),)
    if isinstance(load, BarLoad):
        half = load.length / 2 + load.overhang
        if section is not None:
            return (Part("box", np.zeros(3), np.eye(3), (half, section[0] / 2, section[1] / 2)),)
        along = np.array([half, 0.0, 0.0])
        return (_rod(along, -along, load.radius),)
    if isinstance(load, FrameLoad):
        where = dict(zip(scene.file.holders, grasps, strict=True))
        return tuple(_rod(where[a], where[b], load.radius) for a, b in load.edges)
    raise SceneError(
        f"loads of shape '{load.shape}' cannot be simulated",
        key="load.shape",
        way_out="use bar, frame or box",
    )


def _rod(a: Array, b: Array, radius: float) -> Part:
    along = np.linalg.norm(a - b)
    z = (a - b) / along
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return Part(
        "capsule", (a + b) / 2, np.stack([x, np.cross(z, x), z], axis=1), (max(radius, THINNEST), along / 2)
    )


def _frame(points: Array) -> Array:
    """Axes of a load held at `points`, array of shape (n_holders, 3); array, shape (3, 3)."""
    x = points[0] - points[1] if len(points) > 1 else np.array([1.0, 0.0, 0.0])
    x = x / np.linalg.norm(x)
    up = np.array([0.0, 0.0, 1.0]) if abs(x[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    y = np.cross(up, x)
    y /= np.linalg.norm(y)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def require_fit(motion: JointMotion, robot: Robot, scene: Scene) -> None:
    """Refuse a motion of other joints than the robot's, and a scene that is not its own.

    Raises
    ------
    RobotError, SceneError
        Which says what does not fit.
    """
    if scene.n_dims != 3:
        raise SceneError("robots live in space", key="workspace", way_out="write three numbers a point")
    for name in scene.manipulators:
        robot.arm(name)
    if tuple(motion.joint_names) != robot.joint_names:
        raise RobotError(
            f"the motion moves {', '.join(motion.joint_names)}, the robot '{robot.name}' has "
            f"{', '.join(robot.joint_names)}",
            key="joint_names",
            way_out="play it on the robot that it was made for",
        )


def hand_poses(robot: Robot, scene: Scene, joints: Array) -> Array:
    """Grasp frames of the scene's manipulators; array, shape (n_steps, n_manipulators, 4, 4)."""
    arms = [robot.arm(name) for name in scene.manipulators]
    frames = [robot.model.getFrameId(arm.tip) for arm in arms]
    tools, data = np.stack([arm.tool for arm in arms]), robot.model.createData()
    poses = np.empty((len(joints), len(arms), 4, 4))
    for step, q in enumerate(joints):
        pin.framesForwardKinematics(robot.model, data, q)
        for i, frame in enumerate(frames):
            poses[step, i] = data.oMf[frame].homogeneous
    return poses @ tools


def carried(hands: Array, held: Array) -> Array:
    """Poses of a load that hands carry; array, shape (n_steps, 4, 4).

    The middle of what the single hands say, positions by their mean, rotations by the polar factor of theirs.

    Parameters
    ----------
    hands : array, shape (n_steps, n_holders, 4, 4), their grasp frames
    held : array, shape (n_holders, 4, 4), the load's pose in each of these frames
    """
    said = (hands @ held).mean(axis=1)
    left, _, right = np.linalg.svd(said[:, :3, :3])
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    said[:, :3, :3] = left @ right
    return said


def points_of(poses: Array, points: Array) -> Array:
    """World positions of points of a body; (..., 4, 4) and (n_points, 3) -> (..., n_points, 3) [m]."""
    return poses[..., None, :3, 3] + np.einsum("...ij,nj->...ni", poses[..., :3, :3], points)


def inverse(poses: Array) -> Array:
    """Of rigid transforms; arrays, shape (..., 4, 4)."""
    turned = np.swapaxes(poses[..., :3, :3], -1, -2)
    result = np.zeros_like(poses)
    result[..., :3, :3] = turned
    result[..., :3, 3] = -np.einsum("...ij,...j->...i", turned, poses[..., :3, 3])
    result[..., 3, 3] = 1.0
    return result

"""Payloads as bodies of simple shapes, and their poses. The origin of a payload's frame is the mean of the holders'
positions; x points from the second holder to the first, and z is as upright as possible."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from comove.arrays import Array, first_largest
from comove.errors import RobotError, SceneError
from comove.geometry.rotations import facing
from comove.geometry.solids import N_CORNERS
from comove.model.files.keys import BarLoad, PartsLoad
from comove.model.scene import Scene
from comove.robots.effort import load_mass
from comove.robots.model import Robot
from comove.robots.motion import JointMotion
from comove.robots.verification.carried import hull_shape

THINNEST = 0.004  # m, radius of rods that state none
SETTLED = 1e-3  # m, by which a payload may be in its support: servos give way, and so do contacts


@dataclass(frozen=True, eq=False)
class LoadPart:
    """Part of a payload: box, capsule along z, or hull of points.

    Attributes
    ----------
    kind : "box", "capsule" or "hull"
    position : array, shape (3,), centre in the payload's frame [m]
    rotation : array, shape (3, 3), orientation in the payload's frame
    size : half edges of a box; radius and half the length between the centres of a capsule's caps [m]
    points : array, shape (n, 3), of a hull, about its centre [m]
    """

    kind: str
    position: Array
    rotation: Array
    size: tuple[float, ...] = ()
    points: Array = field(default_factory=lambda: np.zeros((0, 3)))

    @property
    def placement(self) -> Any:
        """Return the pose in the payload's frame, as Pinocchio's SE3."""
        return pin.SE3(self.rotation, self.position)

    @property
    def shape(self) -> Any:
        """Return the part as a shape of coal."""
        if self.kind == "box":
            return coal.Box(*(2 * x for x in self.size))
        return (
            hull_shape(self.points) if self.kind == "hull" else coal.Capsule(self.size[0], 2 * self.size[1])
        )

    @property
    def volume(self) -> float:
        """Return the volume [m^3]."""
        if self.kind == "box":
            return 8.0 * float(np.prod(self.size))
        if self.kind == "hull":
            return float(ConvexHull(self.points).volume)
        radius, half = self.size
        return float(np.pi * radius**2 * (2 * half + 4 / 3 * radius))


@dataclass(frozen=True, eq=False)
class Load:
    """Payload as a rigid body: its parts, mass and grasps.

    Attributes
    ----------
    holders : numbers, in the scene, of the end effectors that hold it
    grasps : array, shape (n_holders, 3), positions of the grasps in its frame [m]
    pose : array, shape (4, 4), pose at the start
    parts : parts of the payload
    mass : mass [kg]
    """

    holders: tuple[int, ...]
    grasps: Array
    pose: Array
    parts: tuple[LoadPart, ...]
    mass: float


Section = Callable[[float], tuple[float, float] | None]


def _round(radius: float) -> None:
    """Return None, as bars are round."""


def load_of(scene: Scene, hands: Array, section: Section = _round) -> Load | None:
    """Build the scene's payload; None where it has none.

    Parameters
    ----------
    hands : array, shape (n_manipulators, 4, 4), grasp frames at the start
    section : function that returns width and height [m] of a bar by its radius, None where it is round; if it returns
        a size, boxes get lugs at grasps away from them
    """
    load = scene.file.load
    if load is None:
        return None
    holders = scene.file.holder_numbers
    points = hands[list(holders)][:, :3, 3]
    pose = np.eye(4)
    pose[:3, :3] = _frame(points)
    pose[:3, 3] = points.mean(axis=0)
    nodes = (scene.nodes_at("start") - pose[:3, 3]) @ pose[:3, :3]
    mass = load_mass(scene)
    grasps = (points - pose[:3, 3]) @ pose[:3, :3]
    return Load(holders, grasps, pose, tuple(_parts(scene, nodes, section)), mass)


def _parts(scene: Scene, nodes: Array, section: Section) -> Iterator[LoadPart]:
    """Yield the parts of the scene's body. `nodes` are those of the body in the payload's frame."""
    lug = 0.012  # m, radius of a bar as thick as a box's lugs
    body = scene.body
    for (a, b), radius in zip(body.edges, body.radii, strict=True):
        sides = section(float(radius)) if isinstance(scene.file.load, BarLoad | PartsLoad) else None
        if a == b:
            continue  # a hand that holds something else than its end
        if sides is None:
            yield _rod(nodes[a], nodes[b], float(radius))
        else:
            half = float(np.linalg.norm(nodes[a] - nodes[b])) / 2 + float(radius)  # as far as its round ends
            yield LoadPart("box", (nodes[a] + nodes[b]) / 2, np.eye(3), (half, sides[0] / 2, sides[1] / 2))
    boxes = body.solids if body.solids.shape[1] == N_CORNERS else body.solids[:0]
    for corners in body.solids[len(boxes) :]:
        points = nodes[np.unique(corners)]
        middle = points.mean(axis=0)
        yield LoadPart("hull", middle, np.eye(3), points=points - middle)
    for corners in boxes:  # numbered in binary by the sides they are on
        first, *along, last = (nodes[corners[i]] for i in (0, 1, 2, 4, 7))
        edges = np.array(along) - first
        size = np.linalg.norm(edges, axis=1)
        box = LoadPart("box", (first + last) / 2, (edges / size[:, None]).T, tuple(size / 2))
        yield box
        if sides := section(lug):
            grasps = nodes[list(scene.file.holder_numbers)]
            yield from filter(None, (_lug(box, grasp, sides) for grasp in grasps))


def _lug(box: LoadPart, grasp: Array, sides: tuple[float, float]) -> LoadPart | None:
    """Return the lug by which fingers hold a box. Return None where the grasp is at the box itself."""
    beyond = 0.015  # m, by which it reaches past the hand
    inside = (grasp - box.position) @ box.rotation
    nearest = np.clip(inside, -np.array(box.size), box.size)
    off = float(np.linalg.norm(inside - nearest))
    if off < beyond:
        return None
    x = (grasp - box.position - box.rotation @ nearest) / off
    half = (off + beyond) / 2
    middle = box.position + box.rotation @ nearest + half * x
    return LoadPart("box", middle, facing(x), (half, sides[0] / 2, sides[1] / 2))


def _rod(a: Array, b: Array, radius: float) -> LoadPart:
    along = float(np.linalg.norm(a - b))
    turned = np.roll(facing((a - b) / along), -1, axis=1)  # along its z
    return LoadPart("capsule", (a + b) / 2, turned, (max(radius, THINNEST), along / 2))


def _frame(points: Array) -> Array:
    """Compute the axes of a payload's frame; array, shape (3, 3). `points` are the grasps, array of shape
    (n_holders, 3)."""
    x = points[0] - points[1] if len(points) > 1 else np.array([1.0, 0.0, 0.0])
    return facing(x / np.linalg.norm(x))


def require_fit(motion: JointMotion, robot: Robot, scene: Scene, *, near: float = 0.01) -> None:
    """Check that motion, robot and spatial scene match.

    Parameters
    ----------
    near : allowed distance of the motion's first end effectors from the scene's start [m]

    Raises
    ------
    RobotError, SceneError
        If something does not fit; the message says what.
    """
    if scene.n_dims != 3:
        raise SceneError("robots live in space", key="workspace", way_out="write three numbers a point")
    if tuple(motion.joint_names) != robot.joint_names:
        raise RobotError(
            f"the motion moves {', '.join(motion.joint_names)}, the robot '{robot.name}' has "
            f"{', '.join(robot.joint_names)}",
            key="joint_names",
            way_out="play it on the robot that it was made for",
        )
    apart = hand_poses(robot, scene, motion.position[:1])[0, :, :3, 3] - scene.start
    missed = np.linalg.norm(apart, axis=1)
    if missed.max() > near:
        hand = first_largest(missed)
        raise SceneError(
            f"the motion begins with the hand '{scene.manipulators[hand]}' {missed[hand]:.3g} m from its start",
            key=scene.words.key(f"manipulators[{hand}].start"),
            way_out="play the motion in the scene that it was made for",
        )


def hand_poses(robot: Robot, scene: Scene, joints: Array) -> Array:
    """Compute grasp frames of the scene's manipulators. Array, shape (n_steps, n_manipulators, 4, 4)."""
    return robot.tool_poses(joints, [robot.arm(name) for name in scene.manipulators])


def carried(hands: Array, held: Array) -> Array:
    """Compute poses of a grasped payload; array, shape (n_steps, 4, 4).

    Each end effector gives a pose of the payload; the result is their mean, for rotations the polar factor of the
    mean.

    Parameters
    ----------
    hands : array, shape (n_steps, n_holders, 4, 4), their grasp frames
    held : array, shape (n_holders, 4, 4), the payload's pose in each of these frames
    """
    said = (hands @ held).mean(axis=1)
    left, _, right = np.linalg.svd(said[:, :3, :3])
    left[:, :, 2] *= np.sign(np.linalg.det(left @ right))[:, None]
    said[:, :3, :3] = left @ right
    return said


def points_of(poses: Array, points: Array) -> Array:
    """Compute world positions of points of a body [m]. The shapes are (..., 4, 4) and (n_points, 3) -> (...,
    n_points, 3)."""
    return poses[..., None, :3, 3] + np.einsum("...ij,nj->...ni", poses[..., :3, :3], points)


def are_poses(poses: Array) -> bool:
    """Return whether all matrices, shape (n_steps, 4, 4), have rotations, to 1e-6."""
    turn = poses[:, :3, :3]
    off = np.abs(turn @ turn.transpose(0, 2, 1) - np.eye(3)).max()
    return bool(off <= 1e-6 and np.linalg.det(turn).min() > 0)


def supports_under(scene: Scene, load: Load | None, pose: Array) -> set[str]:
    """Return the supports on which a payload may rest. `pose` is that of the payload, array of shape (4, 4). It may
    rest within the displacement from start or goal for which the scene requires less than the full clearance."""
    if load is None or not scene.rests:
        return set()
    grasps, holders = points_of(pose[None], load.grasps)[0], list(load.holders)
    return {
        scene.name_of(rest.obstacle)
        for rest in scene.rests
        if np.linalg.norm(grasps - rest.nodes[holders], axis=1).max() <= rest.reach(scene.clearance)
    }

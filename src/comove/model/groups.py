"""Rigid groups: manipulators with fixed mutual distances, and their payload."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np

from comove.arrays import Array
from comove.geometry.rotations import (
    fit_angle,
    fit_direction,
    fit_quaternion,
    matrices,
    rotation_in_plane,
    similarity,
)

Orientation = Literal["none", "fixed", "plane", "vertical", "axis", "space"]


@dataclass(frozen=True)
class GroupPose:
    """The pose of a group's frame: ``point_world = center + rotation @ point_group``.

    Attributes
    ----------
    center : array, shape (3,), [m]
    rotation : array, shape (3, 3)
    """

    center: Array
    rotation: Array

    def place(self, points: Array) -> Array:
        """Return the world positions of `points`, array of shape (n_points, 3), [m]."""
        return self.center + points @ self.rotation.T


class Mask(NamedTuple):
    """Fixed parts of a rigid body's pose, besides its `orientation`.

    Attributes
    ----------
    axis : array, shape (3,), unit vector in the world about which alone it turns; None for all
    normal : array, shape (3,), unit normal in the world of the plane in which its centre stays; None for none
    up : array, shape (3,), unit vector in the body that stays near the vertical; None for none
    tilt : angle that `up` and the vertical may enclose [rad]
    """

    axis: Array | None = None
    normal: Array | None = None
    up: Array | None = None
    tilt: float = np.pi


@dataclass(frozen=True)
class RigidGroup:
    """A group of manipulators that move as one rigid body. A single free manipulator is a group of one.

    Its frame is that of the payload, where the payload has one.

    Attributes
    ----------
    members : indices of the manipulators
    grasps : array, shape (n_members, 3), positions of the end effectors in the group's frame [m]
    corners : array, shape (n_corners, 3), further points of the payload in the group's frame [m]; where all others
        are on one line, keypoints beside it that belong to no part of it
    orientation : how the group may turn: "none" (a single end effector) and "fixed", not at all; "plane", by an angle
        in the plane; "vertical", by an angle about the vertical in space; "axis", by the direction of an axis in
        space (end effectors on one line, the roll about which does not matter); "space", in any way
    start, goal : poses at start and goal
    unturned : array, shape (3, 3), rotation of the frame where coordinates turn nothing: that of a group that does
        not turn; of one that turns by an angle, that at the angle 0; of an axis, a roll about it
    start_twist : array, shape (6,), velocity of the frame's centre [m per duration] and angular velocity [rad per
        duration] at the start, along the axes of the world; zero unless the movement continues another one
    mask : further fixed parts of its pose
    """

    members: tuple[int, ...]
    grasps: Array
    corners: Array
    orientation: Orientation
    start: GroupPose
    goal: GroupPose
    unturned: Array = field(default_factory=lambda: np.eye(3))
    start_twist: Array = field(default_factory=lambda: np.zeros(6))
    mask: Mask = field(default_factory=lambda: Mask())

    @property
    def points(self) -> Array:
        """Return grasps and corners, shape (n_members + n_corners, 3), [m]."""
        return np.concatenate([self.grasps, self.corners])

    @property
    def reach(self) -> float:
        """Return the points' largest distance [m] from the centre, or vertical axis."""
        points = self.aligned(self.points)
        return float(
            np.linalg.norm(points[:, :2] if self.orientation == "vertical" else points, axis=1).max()
        )

    def aligned(self, points: Array) -> Array:
        """Return points (n_points, 3) turned as by zero coordinates [m]."""
        return points @ self.unturned.T

    def turn(self, pose: GroupPose) -> GroupPose:
        """Return the pose of aligned points at a pose of the frame."""
        return GroupPose(pose.center, pose.rotation @ self.unturned.T)


def orientation_of(grasps: Array, n_dims: int) -> Orientation:
    """Return which orientation end effectors at `grasps` (n_members, 3) determine."""
    if len(grasps) == 1:
        return "none"
    if n_dims == 2:
        return "plane"
    spread = np.linalg.svd(grasps - grasps.mean(axis=0), compute_uv=False)
    return "axis" if spread[1] < 1e-9 * spread[0] else "space"


def fit_pose(
    grasps: Array, hands: Array, orientation: Orientation, unturned: Array | None = None
) -> GroupPose:
    """Return the pose that fits `grasps` to end effectors by least squares. There is no mirroring.

    Parameters
    ----------
    grasps, hands : arrays, shape (n_members, 3), [m]
    unturned : array, shape (3, 3), as of `RigidGroup`; the identity unless given
    """
    unturned = np.eye(3) if unturned is None else unturned
    if orientation in ("none", "fixed"):
        rotation = unturned
    elif orientation in ("plane", "vertical"):
        rotation = rotation_in_plane(fit_angle(grasps @ unturned.T, hands)) @ unturned
    elif orientation == "axis":
        rotation = similarity(np.array([1.0, 0.0, 0.0]), fit_direction(grasps, hands))
    else:
        rotation = matrices(fit_quaternion(grasps, hands))
    return GroupPose(hands.mean(axis=0) - rotation @ grasps.mean(axis=0), rotation)


def tilt_between(orientation: Orientation, a: Array, b: Array) -> float:
    """Return the difference in tilt of two rotations (3, 3) [rad].

    Rotations about z do not count. In the plane this is the angle between them; for an axis in space the difference
    of its inclinations.
    """
    if orientation == "plane":
        return float(abs(np.arctan2(*(a @ b.T)[[1, 0], 0])))
    if orientation == "axis":
        first, second = (np.arctan2(r[2, 0], np.hypot(r[0, 0], r[1, 0])) for r in (a, b))
        return float(abs(first - second))
    return float(np.arctan2(np.linalg.norm(np.cross(a[2], b[2])), a[2] @ b[2]))


def nearest_distances(points: Array, pairs: list[tuple[int, int]], distances: Array) -> Array:
    """Move points (n_points, 3) least, so that pairs have given distances.

    Gauss-Newton on the constraints with least-norm steps; exact for one pair after the first step.
    """
    points = points.copy()
    for _ in range(50):
        jacobian = np.zeros((len(pairs), *points.shape))
        residual = np.empty(len(pairs))
        for row, (i, j) in enumerate(pairs):
            apart = points[i] - points[j]
            length = np.linalg.norm(apart)
            jacobian[row, i], jacobian[row, j] = apart / length, -apart / length
            residual[row] = length - distances[row]
        if np.abs(residual).max() < 1e-15:
            break
        flat = jacobian.reshape(len(pairs), -1)
        points -= np.linalg.lstsq(flat, residual, rcond=1e-9)[0].reshape(points.shape)
    return points


def connected(n: int, pairs: Sequence[tuple[int, ...]]) -> list[int]:
    """Return the component of n nodes, as its least number."""
    component = list(range(n))
    for a, b in pairs:
        new, old = sorted((component[a], component[b]))
        component = [new if c == old else c for c in component]
    return component

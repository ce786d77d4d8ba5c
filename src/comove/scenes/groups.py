"""Rigid groups: sets of manipulators whose mutual distances are fixed, and the load that they carry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from comove.geometry.rotations import matrices, similarity
from comove.ties import first_largest

Array = NDArray[np.float64]

ROUNDING = 1e-12  # of the numbers of a unit quaternion

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


@dataclass(frozen=True)
class RigidGroup:
    """A group of manipulators that move as one rigid body; a single free manipulator is a group of one.

    Attributes
    ----------
    members : indices of the manipulators
    grasps : array, shape (n_members, 3), positions of the hands in the group's frame [m]
    corners : array, shape (n_corners, 3), further points of the load in the group's frame [m]
    orientation : how the group may turn: "none" (a single hand) and "fixed", not at all; "plane", by an angle in the
        plane; "vertical", by an angle about the vertical in space; "axis", by the direction of an axis in space
        (hands on one line, the roll about which does not matter); "space", in any way
    start, goal : poses at start and goal
    start_twist : array, shape (6,), velocity of the frame's centre [m per duration] and angular velocity [rad per
        duration] at the start, along the axes of the world; zero unless the movement continues another one
    """

    members: tuple[int, ...]
    grasps: Array
    corners: Array
    orientation: Orientation
    start: GroupPose
    goal: GroupPose
    start_twist: Array = field(default_factory=lambda: np.zeros(6))

    @property
    def points(self) -> Array:
        """Return grasps and corners, array of shape (n_members + n_corners, 3), [m]."""
        return np.concatenate([self.grasps, self.corners])

    @property
    def reach(self) -> float:
        """Return the largest distance of the group's points from its centre or, if vertical, its axis of rotation
        [m].
        """
        points = self.points[:, :2] if self.orientation == "vertical" else self.points
        return float(np.linalg.norm(points, axis=1).max())


def orientation_of(grasps: Array, n_dims: int) -> Orientation:
    """Return which part of a body's orientation is determined by hands at `grasps`, array of shape (n_members, 3)."""
    if len(grasps) == 1:
        return "none"
    if n_dims == 2:
        return "plane"
    spread = np.linalg.svd(grasps - grasps.mean(axis=0), compute_uv=False)
    return "axis" if spread[1] < 1e-9 * spread[0] else "space"


def fit_pose(grasps: Array, hands: Array, orientation: Orientation) -> GroupPose:
    """Return the pose that brings `grasps` nearest to `hands` in least squares, without mirroring.

    Parameters
    ----------
    grasps, hands : arrays, shape (n_members, 3), [m]
    """
    if orientation in ("none", "fixed"):
        rotation = np.eye(3)
    elif orientation in ("plane", "vertical"):
        rotation = rotation_in_plane(fit_angle(grasps, hands))
    elif orientation == "axis":
        rotation = similarity(np.array([1.0, 0.0, 0.0]), fit_direction(grasps, hands))
    else:
        rotation = matrices(fit_quaternion(grasps, hands))
    return GroupPose(hands.mean(axis=0) - rotation @ grasps.mean(axis=0), rotation)


def fit_angle(grasps: Array, hands: Array) -> Array:
    """Return the angles [rad] that turn `grasps` (n, 3) about z nearest to `hands` (..., n, 3); shape (...)."""
    held, wanted = _about_middle(grasps), _about_middle(hands)
    cosine = (held[:, 0] * wanted[..., 0] + held[:, 1] * wanted[..., 1]).sum(axis=-1)
    sine = (held[:, 0] * wanted[..., 1] - held[:, 1] * wanted[..., 0]).sum(axis=-1)
    return np.arctan2(sine, cosine)


def fit_direction(grasps: Array, hands: Array) -> Array:
    """Return unit vectors (..., 3) along which `grasps` (n, 3), on the x axis, are nearest to `hands` (..., n, 3)."""
    direction = (_about_middle(grasps)[:, :1] * _about_middle(hands)).sum(axis=-2)
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def fit_quaternion(grasps: Array, hands: Array) -> Array:
    """Return unit quaternions (..., 4), w x y z, that turn `grasps` (n, 3) nearest to `hands` (..., n, 3).

    The method is Horn's (1987).
    """
    s = np.einsum("ni,...nj->...ij", _about_middle(grasps), _about_middle(hands))
    cross = [s[..., 1, 2] - s[..., 2, 1], s[..., 2, 0] - s[..., 0, 2], s[..., 0, 1] - s[..., 1, 0]]
    trace = np.trace(s, axis1=-2, axis2=-1)
    matrix = np.empty((*s.shape[:-2], 4, 4))
    matrix[..., 0, 0] = trace
    matrix[..., 1:, 1:] = s + np.swapaxes(s, -1, -2) - trace[..., None, None] * np.eye(3)
    for i in range(3):
        matrix[..., 0, i + 1] = matrix[..., i + 1, 0] = cross[i]
    return np.linalg.eigh(matrix)[1][..., -1]


def tilt_between(orientation: Orientation, a: Array, b: Array) -> float:
    """Return by how much the tilts of two rotations, arrays of shape (3, 3), differ [rad].

    Rotations about z do not count.

    In the plane this is the angle between them; for an axis in space the difference of its inclinations.
    """
    if orientation == "plane":
        return float(abs(np.arctan2(*(a @ b.T)[[1, 0], 0])))
    if orientation == "axis":
        first, second = (np.arctan2(r[2, 0], np.hypot(r[0, 0], r[1, 0])) for r in (a, b))
        return float(abs(first - second))
    return float(np.arctan2(np.linalg.norm(np.cross(a[2], b[2])), a[2] @ b[2]))


def levelling(along: Array, up: Array) -> Array:
    """Return the smallest rotation, shape (3, 3), that makes all vectors `along` (n, 3) perpendicular to the unit
    vector `up`.

    Where they would have to turn so far that `up` lies almost in their span, it is the identity.
    """
    _, spread, axes = np.linalg.svd(along, full_matrices=False)
    axes = axes[spread > 1e-6 * spread[0]]
    across = up - axes.T @ (axes @ up)
    size = np.linalg.norm(across)
    return similarity(across / size, up) if size > 0.1 else np.eye(3)


def standing(x: Array) -> Array:
    """Return the rotation whose x axis is `x` and whose z axis leans least; array, shape (3, 3).

    `x` is a unit vector that is not vertical.
    """
    z = np.array([0.0, 0.0, 1.0]) - x[2] * x
    z /= np.linalg.norm(z)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _about_middle(points: Array) -> Array:
    return points - points.mean(axis=-2, keepdims=True)


def rotation_in_plane(angle: Array | float) -> Array:
    """Return the rotation about z by `angle` [rad]; array, shape (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def quaternion_of_rotation(rotation: Array) -> Array:
    """Return the unit quaternion (w, x, y, z) of a rotation matrix (Shepperd, 1978).

    Its sign makes the first number that is not 0 positive.
    """
    m = rotation
    trace = np.trace(m)
    candidates = np.array([trace, m[0, 0], m[1, 1], m[2, 2]])
    i = first_largest(candidates)
    if i == 0:
        q = np.array([1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]])
    else:
        a, b, c = i - 1, i % 3, (i + 1) % 3
        q = np.empty(4)
        q[0] = m[c, b] - m[b, c]
        q[1 + a] = 1 + m[a, a] - m[b, b] - m[c, c]
        q[1 + b] = m[b, a] + m[a, b]
        q[1 + c] = m[c, a] + m[a, c]
    q /= np.linalg.norm(q)
    first = q[np.argmax(np.abs(q) > ROUNDING)]  # of a half turn w is 0 but for rounding
    return q if first > 0 else -q


def nearest_distances(points: Array, pairs: list[tuple[int, int]], distances: Array) -> Array:
    """Move `points`, array of shape (n_points, 3), as little as possible so that the pairs have the given distances.

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
    """Return the connected component of each of n nodes, as the least number of its nodes."""
    component = list(range(n))
    for a, b in pairs:
        new, old = sorted((component[a], component[b]))
        component = [new if c == old else c for c in component]
    return component

"""Poses and twists of rigid groups, and the exact step between poses.

A twist is (v, w): velocity of the group's centre and angular velocity, both along the axes of the world. Held over
a time t it moves a body exactly by ``c(t) = c + v t``, ``R(t) = exp([w] t) R`` (Lynch & Park, Modern Robotics, 2017,
3.2.3): every point of the body is placed from one unit quaternion, so distances within the body are kept to rounding,
however many steps are taken. In the plane this is SE(2), with w about z alone.
"""

from __future__ import annotations

from functools import lru_cache
from math import atan2, cos, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.geometry.rotations import quaternion_of_rotation, similarity
from comove.model.coordinates import HandPoses
from comove.model.groups import RigidGroup, fit_pose, orientation_of
from comove.model.scene import Scene

STAYS, POINTS, TURNS = range(3)
"""How a group turns about its centre: not at all; as an axis whose roll is left open; in any way."""


class Nodes(NamedTuple):
    """The keypoints of a scene: end effectors in order, then payload corners. Each has a group and a position in it.

    Attributes
    ----------
    group : array of int, shape (n_nodes,)
    point : array, shape (n_nodes, 3), positions in the group's frame [m]
    """

    group: Integers
    point: Array


@lru_cache(maxsize=16)
def group_nodes(scene: Scene) -> Nodes:
    """Return the keypoints of a scene as parts of its groups."""
    group, point = np.zeros(scene.body.n_nodes, dtype=np.int64), np.zeros((scene.body.n_nodes, 3))
    for g, own in enumerate(scene.nodes_of_groups):
        group[own], point[own] = g, scene.groups[g].points
    for array in (group, point):
        array.setflags(write=False)
    return Nodes(group, point)


def poses_of(scene: Scene, hands_or_end: ArrayLike | str) -> HandPoses:
    """Return the groups' poses at an end, or nearest to end effectors.

    Parameters
    ----------
    hands_or_end : "start", "goal", or array, shape (n_manipulators, n_dims), end effectors [m]. Where end effectors
        on one line do not determine the roll about it, the roll is that of the smallest rotation from the start.
    """
    if isinstance(hands_or_end, str):
        found = [(p.center, p.rotation) for p in (getattr(g, hands_or_end) for g in scene.groups)]
    else:
        hands = np.asarray(hands_or_end, dtype=float)
        hands = np.concatenate([hands, np.zeros((len(hands), 3 - scene.n_dims))], axis=1)
        found = [_fitted(group, hands[list(group.members)]) for group in scene.groups]
    return HandPoses(
        np.array([center for center, _ in found]),
        np.array([quaternion_of_rotation(rotation) for _, rotation in found]),
    )


def _fitted(group: RigidGroup, hands: Array) -> tuple[Array, Array]:
    """Return a group's centre and rotation from end effectors; array, shape (n_members, 3) [m]."""
    if group.orientation == "space" and orientation_of(group.grasps, 3) == "axis":
        before = group.start.place(group.grasps)
        lines = [points[-1] - points[0] for points in (before, hands)]
        rotation = similarity(*(line / np.linalg.norm(line) for line in lines)) @ group.start.rotation
        return hands.mean(axis=0) - rotation @ group.grasps.mean(axis=0), rotation
    pose = fit_pose(group.grasps, hands, group.orientation, group.unturned)
    return pose.center, pose.rotation


def nodes_of(scene: Scene, poses: HandPoses) -> Array:
    """Return the keypoints at given poses; array, shape (n_nodes, 3) [m], end effectors first."""
    nodes = group_nodes(scene)
    placed = np.empty_like(nodes.point)
    place(nodes.group, nodes.point, poses.center, turns(poses.quaternion), placed)
    return placed


def advanced(poses: HandPoses, twists: Array, dt: float) -> HandPoses:
    """Return the exact poses after `dt` [s] of constant twists.

    Parameters
    ----------
    twists : array, shape (n_groups, 6): velocity of the centre [m/s], angular velocity [rad/s]
    """
    center, quaternion = np.empty_like(poses.center), np.empty_like(poses.quaternion)
    step(poses.center, poses.quaternion, np.ascontiguousarray(twists), dt, center, quaternion)
    return HandPoses(center, quaternion)


def hand_velocities(scene: Scene, poses: HandPoses, twists: Array) -> Array:
    """Return the velocities of the end effectors; array, shape (n_manipulators, 3), [m/s].

    Parameters
    ----------
    twists : array, shape (n_groups, 6)
    """
    nodes, velocities = group_nodes(scene), np.empty((len(scene.manipulators), 3))
    velocities_into(
        nodes.group, nodes.point, turns(poses.quaternion), np.asarray(twists, dtype=float), velocities
    )
    return velocities


def twists_between(scene: Scene, here: HandPoses, there: HandPoses, duration: float) -> Array:
    """Return the constant twists that lead from some poses to others; array, shape (n_groups, 6) [m/s, rad/s].

    A body whose roll about the line of its end effectors is free does not roll.

    Parameters
    ----------
    duration : [s]
    """
    twists = np.empty((len(scene.groups), 6))
    twists_into(_turning(scene), *here, *there, float(duration), twists)
    return twists


@lru_cache(maxsize=16)
def _turning(scene: Scene) -> Integers:
    """Return how groups turn, `STAYS`, `POINTS` or `TURNS`; array of int, shape (n_groups,)."""
    how = {"none": STAYS, "fixed": STAYS, "axis": POINTS}
    return np.array([how.get(group.orientation, TURNS) for group in scene.groups])


@kernel
def exponential_at(x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Return a rotation vector's [rad] unit quaternion (w, x, y, z)."""
    angle = 0.5 * sqrt(x * x + y * y + z * z)
    factor = 0.5 * (sin(angle) / angle if angle > 1e-4 else 1.0 - angle * angle / 6.0)
    return cos(angle), factor * x, factor * y, factor * z


@kernel
def step(
    center: Array, quaternion: Array, twists: Array, dt: float, next_center: Array, next_quaternion: Array
) -> None:
    """Write the poses after `dt` [s] of constant twists."""
    for g in range(center.shape[0]):
        for axis in range(3):
            next_center[g, axis] = center[g, axis] + dt * twists[g, axis]
        a, b, c, d = exponential_at(dt * twists[g, 3], dt * twists[g, 4], dt * twists[g, 5])
        w, x, y, z = quaternion[g, 0], quaternion[g, 1], quaternion[g, 2], quaternion[g, 3]
        p, q = a * w - b * x - c * y - d * z, a * x + b * w + c * z - d * y
        r, s = a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w
        scale = 1.0 / sqrt(p * p + q * q + r * r + s * s)  # rounding does not add up
        next_quaternion[g, 0], next_quaternion[g, 1] = p * scale, q * scale
        next_quaternion[g, 2], next_quaternion[g, 3] = r * scale, s * scale


@kernel
def turn_into(w: float, x: float, y: float, z: float, rotation: Array) -> None:
    """Write the matrix of a unit quaternion in `rotation`, shape (3, 3)."""
    rotation[0, 0], rotation[0, 1], rotation[0, 2] = (
        1 - 2 * (y * y + z * z),
        2 * (x * y - w * z),
        2 * (x * z + w * y),
    )
    rotation[1, 0], rotation[1, 1], rotation[1, 2] = (
        2 * (x * y + w * z),
        1 - 2 * (x * x + z * z),
        2 * (y * z - w * x),
    )
    rotation[2, 0], rotation[2, 1], rotation[2, 2] = (
        2 * (x * z - w * y),
        2 * (y * z + w * x),
        1 - 2 * (x * x + y * y),
    )


@kernel
def turns(quaternion: Array) -> Array:
    """Return the matrices (n, 3, 3) of unit quaternions (n, 4)."""
    rotation = np.empty((quaternion.shape[0], 3, 3))
    for g in range(quaternion.shape[0]):
        turn_into(quaternion[g, 0], quaternion[g, 1], quaternion[g, 2], quaternion[g, 3], rotation[g])
    return rotation


@kernel
def place(group: Integers, point: Array, center: Array, rotation: Array, placed: Array) -> None:
    """Write the world positions of points (n, 3) in groups' frames [m]."""
    for i in range(point.shape[0]):
        turn, x, y, z = rotation[group[i]], point[i, 0], point[i, 1], point[i, 2]
        for axis in range(3):
            placed[i, axis] = (
                center[group[i], axis] + turn[axis, 0] * x + turn[axis, 1] * y + turn[axis, 2] * z
            )


@kernel
def velocities_into(group: Integers, point: Array, rotation: Array, twists: Array, velocities: Array) -> None:
    """Write the velocities of the first points in groups' frames [m/s]. The points have the shape (n, 3)."""
    for i in range(velocities.shape[0]):
        turn, twist = rotation[group[i]], twists[group[i]]
        x = turn[0, 0] * point[i, 0] + turn[0, 1] * point[i, 1] + turn[0, 2] * point[i, 2]
        y = turn[1, 0] * point[i, 0] + turn[1, 1] * point[i, 1] + turn[1, 2] * point[i, 2]
        z = turn[2, 0] * point[i, 0] + turn[2, 1] * point[i, 1] + turn[2, 2] * point[i, 2]
        velocities[i, 0] = twist[0] + twist[4] * z - twist[5] * y
        velocities[i, 1] = twist[1] + twist[5] * x - twist[3] * z
        velocities[i, 2] = twist[2] + twist[3] * y - twist[4] * x


@kernel
def _first_axis(q: Array) -> tuple[float, float, float]:
    """Return the first column of a unit quaternion's matrix."""
    return (
        1 - 2 * (q[2] * q[2] + q[3] * q[3]),
        2 * (q[1] * q[2] + q[0] * q[3]),
        2 * (q[1] * q[3] - q[0] * q[2]),
    )


@kernel
def twists_into(
    turning: Integers,
    center: Array,
    quaternion: Array,
    next_center: Array,
    next_quaternion: Array,
    duration: float,
    twists: Array,
) -> None:
    """Write the constant twists that lead from some poses to others."""
    for g in range(center.shape[0]):
        for axis in range(3):
            twists[g, axis] = (next_center[g, axis] - center[g, axis]) / duration
        x, y, z, along = 0.0, 0.0, 0.0, 1.0  # sine of the angle by the axis, and cosine
        p, q = quaternion[g], next_quaternion[g]
        if turning[g] == POINTS:
            a, b = _first_axis(p), _first_axis(q)
            x, y, z = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
            along = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
        elif turning[g] == TURNS:  # q conj(p), of half the angle
            along = q[0] * p[0] + q[1] * p[1] + q[2] * p[2] + q[3] * p[3]
            sign = 1.0 if along >= 0.0 else -1.0
            x = sign * (-q[0] * p[1] + q[1] * p[0] - q[2] * p[3] + q[3] * p[2])
            y = sign * (-q[0] * p[2] + q[1] * p[3] + q[2] * p[0] - q[3] * p[1])
            z = sign * (-q[0] * p[3] - q[1] * p[2] + q[2] * p[1] + q[3] * p[0])
            along *= sign
        sine = sqrt(x * x + y * y + z * z)
        angle = atan2(sine, along) * (2.0 if turning[g] == TURNS else 1.0)
        scale = angle / max(sine, 1e-300) / duration
        twists[g, 3], twists[g, 4], twists[g, 5] = x * scale, y * scale, z * scale

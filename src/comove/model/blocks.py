"""The blocks of the coordinates, one per rigid group: positions and velocities."""

from __future__ import annotations

from math import atan2, cos, sin, sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers, inner
from comove.compiled import kernel
from comove.geometry.rotations import quaternion_of_rotation, quaternion_product
from comove.model.groups import GroupPose

POINT, ANGLE, DIRECTION, QUATERNION = range(4)


class Blocks(NamedTuple):
    """The blocks of the coordinates as arrays for kernels.

    Attributes
    ----------
    kind, first : arrays of int, shape (n_blocks,) and (n_blocks + 1,): POINT, ANGLE, DIRECTION or QUATERNION; index
        of the block's first entry in `node` and `point`
    center : array of int, shape (n_blocks, 3), columns of q that hold the centre, the third unused in the plane
    turn : array of int, shape (n_blocks,), first column of the orientation
    node : array of int, shape (n_nodes,), number of the node that an entry describes
    point : array, shape (n_nodes, 3), position of this node about the group's centre, unturned [m]
    n_dims : 2 or 3
    mask, held : arrays, shapes (n_columns, n_columns) and (n_columns,): ``mask @ q + held`` is a configuration that
        satisfies the masks of the bodies; where all columns are free, mask has the shape (0, 0) and held is 0
    up, level, tilt : arrays, shapes (n_blocks, 3), (n_blocks, 4) and (n_blocks,): unit vector in the group's frame
        that stays near the vertical, a quaternion that makes it vertical, and the angle that they may enclose [rad];
        pi for any
    """

    kind: Integers
    center: Integers
    turn: Integers
    first: Integers
    node: Integers
    point: Array
    n_dims: int
    mask: Array
    held: Array
    up: Array
    level: Array
    tilt: Array


class Unmasked(NamedTuple):
    """The last fields of `Blocks` where all columns are free. Shapes are as there."""

    mask: Array
    held: Array
    up: Array
    level: Array
    tilt: Array

    @classmethod
    def of(cls, n_columns: int, n_blocks: int) -> Unmasked:
        """Return these fields for numbers of columns and blocks."""
        level = np.tile([1.0, 0.0, 0.0, 0.0], (n_blocks, 1))
        up = np.zeros((n_blocks, 3))
        return cls(np.zeros((0, 0)), np.zeros(n_columns), up, level, np.full(n_blocks, np.pi))


class Block(NamedTuple):
    """One block of the coordinates, which describes one rigid group.

    Attributes
    ----------
    kind : POINT, ANGLE, DIRECTION or QUATERNION
    columns : columns of q, those of the centre and then those of the orientation; a slice where they are contiguous
    nodes : array of int, shape (n,), numbers of the nodes in the block
    points : array, shape (n, 3), positions of these nodes about the group's centre, unturned [m]
    """

    kind: int
    columns: slice | Integers
    nodes: Integers
    points: Array


def width_of(kind: int, n_dims: int) -> int:
    """Return the number of columns of an orientation."""
    return {POINT: 0, ANGLE: 1, DIRECTION: n_dims, QUATERNION: 4}[int(kind)]


def contiguous(indices: Integers) -> slice | Integers:
    """Return indices, as a slice where each follows the last: views are much faster than copies."""
    return slice(int(indices[0]), int(indices[-1]) + 1) if (np.diff(indices) == 1).all() else indices


@kernel
def keep_mask(blocks: Blocks, q: Array) -> None:
    """Move a configuration, in place, onto masks and unit quaternions.

    The nearest one is chosen. Columns beyond those of the blocks, such as joints or a time, stay as they are; so does
    how far bodies lean.

    Parameters
    ----------
    q : array, shape (n_columns or more,)
    """
    n = blocks.mask.shape[0]
    if n == 0:
        return
    given = q[:n].copy()
    for c in range(n):
        q[c] = blocks.held[c]
        for k in range(n):
            q[c] += blocks.mask[c, k] * given[k]
    for b in range(blocks.kind.shape[0]):
        if blocks.kind[b] == QUATERNION:
            o = blocks.turn[b]
            length = sqrt(q[o] ** 2 + q[o + 1] ** 2 + q[o + 2] ** 2 + q[o + 3] ** 2)
            for c in range(o, o + 4):
                q[c] /= max(length, 1e-300)


@kernel
def lean(blocks: Blocks, b: int, q: Array, up: Array) -> float:
    """Return a block's angle between `up` and vertical [rad]; write `up`.

    Parameters
    ----------
    b : number of a block whose kind is QUATERNION
    q : array, shape (n_columns or more,), a quaternion of any length
    up : result, array, shape (3,), unit vector in the world
    """
    o = blocks.turn[b]
    w, x, y, z = q[o], q[o + 1], q[o + 2], q[o + 3]
    f = 2.0 / (w * w + x * x + y * y + z * z)
    a, b1, c = blocks.up[b]
    tx, ty, tz = y * c - z * b1, z * a - x * c, x * b1 - y * a
    up[0] = a + f * (w * tx + y * tz - z * ty)
    up[1] = b1 + f * (w * ty + z * tx - x * tz)
    up[2] = c + f * (w * tz + x * ty - y * tx)
    return atan2(sqrt(up[0] ** 2 + up[1] ** 2), up[2])


@kernel
def place(blocks: Blocks, q: Array, size: float) -> Array:
    """Return the nodes of many rollouts. Array, shape (n_rollouts, n_steps, n_nodes, 3) [m].

    Parameters
    ----------
    q : array, shape (n_rollouts, n_columns, n_steps)
    size : factor on the size of the groups
    """
    n_rollouts, n_columns, n_steps = q.shape
    nodes = np.zeros((n_rollouts, n_steps, blocks.node.shape[0], 3))
    row = np.empty(n_columns)
    for k in range(n_rollouts):
        for t in range(n_steps):
            for c in range(n_columns):
                row[c] = q[k, c, t]
            place_one(blocks, row, size, nodes[k, t])
    return nodes


@kernel
def place_one(blocks: Blocks, q: Array, size: float, nodes: Array) -> None:
    """Write the nodes of one configuration, with groups of a size.

    Parameters
    ----------
    q : array, shape (n_columns or more,); directions and quaternions may have any length
    size : factor on the size of the groups
    nodes : result, array, shape (n_nodes, 3) [m]
    """
    n_dims = blocks.n_dims
    for b in range(blocks.kind.shape[0]):
        kind, o = blocks.kind[b], blocks.turn[b]
        cx, cy = q[blocks.center[b, 0]], q[blocks.center[b, 1]]
        cz = q[blocks.center[b, 2]] if n_dims == 3 else 0.0
        c, s = (cos(q[o]), sin(q[o])) if kind == ANGLE else (1.0, 0.0)
        for e in range(blocks.first[b], blocks.first[b + 1]):
            x, y, z = blocks.point[e, 0] * size, blocks.point[e, 1] * size, blocks.point[e, 2] * size
            node = nodes[blocks.node[e]]
            if kind == ANGLE:
                x, y = c * x - s * y, s * x + c * y
            elif kind == DIRECTION and n_dims == 2:
                n = 1.0 / sqrt(q[o] ** 2 + q[o + 1] ** 2)
                x, y = (q[o] * x - q[o + 1] * y) * n, (q[o + 1] * x + q[o] * y) * n
            elif kind == DIRECTION:
                n = x / sqrt(q[o] ** 2 + q[o + 1] ** 2 + q[o + 2] ** 2)
                x, y, z = q[o] * n, q[o + 1] * n, q[o + 2] * n
            elif kind == QUATERNION:
                w, qx, qy, qz = q[o], q[o + 1], q[o + 2], q[o + 3]
                n = 2.0 / (w * w + qx * qx + qy * qy + qz * qz)
                tx, ty, tz = qy * z - qz * y, qz * x - qx * z, qx * y - qy * x
                x, y, z = (
                    x + n * (w * tx + qy * tz - qz * ty),
                    y + n * (w * ty + qz * tx - qx * tz),
                    z + n * (w * tz + qx * ty - qy * tx),
                )
            node[0] = cx + x
            node[1] = cy + y
            node[2] = cz + z


def write_pose(kind: int, pose: GroupPose, n_dims: int) -> Array:
    """Return a pose's block of q; array, shape (n_block_columns,)."""
    center, rotation = pose.center[:n_dims], pose.rotation
    if kind == POINT:
        return center.copy()
    if kind == ANGLE:
        turn = np.arctan2(rotation[1, 0] - rotation[0, 1], rotation[0, 0] + rotation[1, 1])
        return np.append(center, turn)
    if kind == DIRECTION:
        return np.concatenate([center, rotation[:n_dims, 0]])
    return np.concatenate([center, quaternion_of_rotation(rotation)])


def write_twist(kind: int, block: Array, twist: Array, n_dims: int) -> Array:
    """Return a block's rate of change; array, shape (n_block_columns,).

    Parameters
    ----------
    block : array, shape (n_block_columns,), as of `write_pose`
    twist : array, shape (6,), velocity of the centre [m per duration], angular velocity [rad per duration]
    """
    turn, (x, y, z) = block[n_dims:], twist[3:]
    if kind == ANGLE:
        change = np.array([z])
    elif kind == DIRECTION:
        change = np.array([-z * turn[1], z * turn[0]]) if n_dims == 2 else np.cross(twist[3:], turn)
    else:
        change = 0.5 * quaternion_product(np.array([0.0, x, y, z]), turn) if kind == QUATERNION else turn
    return np.concatenate([twist[:n_dims], change])


def turned(kind: int, part: Array, points: Array) -> Array:
    """Return rotated points and two derivatives; array, shape (3, n_steps, n_points, 3) [m].

    Parameters
    ----------
    part : array, shape (3, n_steps, width), columns of the orientation and their first two derivatives
    points : array, shape (n_points, 3), unturned [m]
    """
    result = np.zeros((3, part.shape[1], len(points), 3))
    if kind == POINT:
        result[0] = points
        return result
    if kind == ANGLE:
        angle, rate, change = (x[:, 0, None] for x in part)
        c, s = np.cos(angle), np.sin(angle)
        x, y = c * points[:, 0] - s * points[:, 1], s * points[:, 0] + c * points[:, 1]
        result[0, ..., 0], result[0, ..., 1], result[0, ..., 2] = x, y, points[:, 2]
        result[1, ..., 0], result[1, ..., 1] = -rate * y, rate * x
        result[2, ..., 0], result[2, ..., 1] = -change * y - rate**2 * x, change * x - rate**2 * y
        return result
    u = unit_motion(part)
    if kind == DIRECTION and part.shape[2] == 2:
        result[..., 0] = u[..., None, 0] * points[:, 0] - u[..., None, 1] * points[:, 1]
        result[..., 1] = u[..., None, 1] * points[:, 0] + u[..., None, 0] * points[:, 1]
        return result
    if kind == DIRECTION:
        return u[:, :, None, :] * points[:, 0, None]
    conjugate = u[0] * np.array([1.0, -1, -1, -1])
    spin = 2 * quaternion_product(u[1], conjugate)[:, 1:]
    twist = 2 * quaternion_product(u[2], conjugate)[:, 1:]
    _turned_in_space(points, u[0], spin, twist, result)
    return result


@kernel
def _turned_in_space(points: Array, unit: Array, spin: Array, twist: Array, out: Array) -> None:
    """Write points turned by unit quaternions, and two derivatives.

    Parameters
    ----------
    points : array, shape (n_points, 3)
    unit : array, shape (n_steps, 4)
    spin, twist : arrays, shape (n_steps, 3), angular velocity and its derivative
    out : array, shape (3, n_steps, n_points, 3)
    """
    for t in range(unit.shape[0]):
        w, a, b, c = unit[t, 0], unit[t, 1], unit[t, 2], unit[t, 3]
        for k in range(points.shape[0]):
            x, y, z = points[k, 0], points[k, 1], points[k, 2]
            u, v, s = b * z - c * y, c * x - a * z, a * y - b * x
            x, y, z = (
                x + 2 * (w * u + (b * s - c * v)),
                y + 2 * (w * v + (c * u - a * s)),
                z + 2 * (w * s + (a * v - b * u)),
            )
            u, v, s = _crossed(spin[t], x, y, z)
            out[0, t, k, 0], out[0, t, k, 1], out[0, t, k, 2] = x, y, z
            out[1, t, k, 0], out[1, t, k, 1], out[1, t, k, 2] = u, v, s
            x, y, z = _crossed(twist[t], x, y, z)
            u, v, s = _crossed(spin[t], u, v, s)
            out[2, t, k, 0], out[2, t, k, 1], out[2, t, k, 2] = x + u, y + v, z + s


@kernel
def _crossed(a: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    return a[1] * z - a[2] * y, a[2] * x - a[0] * z, a[0] * y - a[1] * x


def unit_motion(part: Array) -> Array:
    """Return v/|v| and two derivatives from those of v; arrays, shape (3, n_steps, width)."""
    length = np.sqrt(inner(part[0], part[0]))[..., None]
    u = part[0] / length
    grow = inner(u, part[1])[..., None]
    rate = (part[1] - u * grow) / length
    across = part[2] - u * inner(u, part[2])[..., None]
    change = (across - 2 * grow * rate) / length - u * inner(rate, rate)[..., None]
    return np.stack([u, rate, change])

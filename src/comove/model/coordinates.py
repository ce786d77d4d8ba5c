"""Coordinates in which rigid constraints hold by construction.

The configuration q of a scene is the concatenation of one block per rigid group:

============ ============================== ====================================================
block        q                              position of a point r of the group
============ ============================== ====================================================
point        c (D)                          c + r: an end effector, or a payload that does not turn
angle        c (D), theta                   c + R(theta) r, in space a turn about the vertical
direction    c (D), v (D)                   c + R(v/|v|) r, in space only for r along the axis
quaternion   c (3), p (4), w x y z          c + R(p/|p|) r
============ ============================== ====================================================

A direction and a quaternion need no unwrapping and no charts; normalising them keeps every distance exact. End
effectors that must be at one height share the column of their heights, as do free ones that keep a payload level. The
projection of two free end effectors onto their distance constraint (middle -/+ half the distance along the unit
vector between them) is equal to direction coordinates driven by ``c = (y1 + y2)/2, v = y2 - y1``:
`projected_coordinates` holds that linear map. `arms_coordinates` describe every end effector independently, as the
paper does: one point block per end effector, in which only the search keeps the constraints.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array, Integers
from comove.dmp.arguments import numbers
from comove.errors import OptionError
from comove.geometry.rotations import (
    UP,
    fit_angle,
    fit_direction,
    fit_quaternion,
    quaternion_of_rotation,
    quaternion_product,
    similarity,
)
from comove.model.blocks import (
    ANGLE,
    DIRECTION,
    POINT,
    QUATERNION,
    Block,
    Blocks,
    Unmasked,
    contiguous,
    place,
    turned,
    width_of,
    write_pose,
    write_twist,
)
from comove.model.groups import GroupPose, RigidGroup, orientation_of
from comove.model.scene import Scene, of_geometry

UNDRIVEN = {
    "space": "projection in space serves loads held by two hands, and no relative poses",
    "vertical": "projection in space does not keep a load upright or level",
}
KINDS = {
    "none": POINT,
    "fixed": POINT,
    "plane": ANGLE,
    "vertical": ANGLE,
    "axis": DIRECTION,
    "space": QUATERNION,
}
Kind = Literal["load", "projected", "arms"]


@dataclass(frozen=True, eq=False)
class Coordinates:
    """The coordinates of a scene's configurations, vectors q.

    Attributes
    ----------
    kind : "load" (angle, direction or quaternion about the payload's centre), "projected" (free end effectors,
        projected onto the constraints) or "arms" (free end effectors)
    blocks : the blocks as arrays
    groups : the rigid groups that the blocks describe
    n_columns : length of q
    search : array, shape (n_columns, n_search), linear map from the variables of a search to q: a scale for each
        column, or the map from free end effectors for "projected"
    together : groups of free end effectors with one payload, contracted about their centre while it is small
    free : array, shape (n_columns, n_free), orthonormal directions in which q may differ from a configuration that
        satisfies the masks of the bodies; None for all
    """

    kind: Kind
    blocks: Blocks
    groups: tuple[RigidGroup, ...]
    n_columns: int
    search: Array
    together: tuple[tuple[int, ...], ...] = ()
    free: Array | None = None

    @property
    def n_dims(self) -> int:
        """Return 2 in the plane, 3 in space."""
        return self.blocks.n_dims

    @cached_property
    def unturned(self) -> Array:
        """Return the groups' unturned orientations as quaternions; array, shape (n_groups, 4), w x y z."""
        return np.array([quaternion_of_rotation(group.unturned) for group in self.groups])

    def nodes(self, q: Array, size: float = 1.0) -> Array:
        """Return the nodes of many rollouts.

        Parameters
        ----------
        q : array, shape (n_rollouts, n_columns, n_steps)
        size : factor on the size of the groups, 1 for the real payload; smaller during payload-size continuation

        Returns
        -------
        array, shape (n_rollouts, n_steps, n_nodes, 3), [m]
        """
        nodes = place(self.blocks, q, size)
        for hands in self.together if size != 1.0 else ():
            held = nodes[:, :, list(hands)]
            center = held.mean(axis=2, keepdims=True)
            nodes[:, :, list(hands)] = center + size * (held - center)
        return nodes

    def motion(self, q: Array) -> Array:
        """Return positions, velocities and accelerations of the nodes along one movement.

        Parameters
        ----------
        q : array, shape (3, n_steps, n_columns): configuration and its first two derivatives

        Returns
        -------
        array, shape (3, n_steps, n_nodes, 3)
        """
        result = np.zeros((3, q.shape[1], len(self.blocks.node), 3))
        for part in self.parts:
            center, turn = np.split(q[:, :, part.columns], [self.n_dims], axis=2)
            points = turned(part.kind, turn, part.points)
            for axis in range(self.n_dims):  # all at once would be six times slower
                points[..., axis] += center[:, :, None, axis]
            result[:, :, contiguous(part.nodes)] = points
        return result

    def boundary(self, turn: int = 0) -> Array:
        """Return start, start velocity, goal, goal velocity of q; shape (4, n_columns).

        The goal velocity is 0. `turn` selects another rotation: additional whole turns for an angle, the other sign
        for a quaternion.
        """
        values = np.zeros((4, self.n_columns))
        for group, (kind, columns, _, _) in zip(self.groups, self.parts, strict=True):
            start, goal = (write_pose(kind, group.turn(p), self.n_dims) for p in (group.start, group.goal))
            if kind == ANGLE:
                goal[-1] += 2 * np.pi * (turn - np.round((goal[-1] - start[-1]) / (2 * np.pi)))
            if kind == QUATERNION and (start[3:] @ goal[3:] < 0) != (turn % 2 == 1):
                goal[3:] *= -1
            values[0, columns], values[2, columns] = start, goal
            values[1, columns] = write_twist(kind, start, group.start_twist, self.n_dims)
        return values

    def from_hands(self, hands: Array) -> Array:
        """Return the configurations nearest to end effectors, continuous in time.

        Parameters
        ----------
        hands : array, shape (n_steps, n_manipulators, n_dims), [m]

        Returns
        -------
        array, shape (n_steps, n_columns)
        """
        hands = np.concatenate([hands, np.zeros((*hands.shape[:2], 3 - self.n_dims))], axis=2)
        q, shared = np.zeros((len(hands), self.n_columns)), np.zeros(self.n_columns)
        for group, (kind, columns, _, _) in zip(self.groups, self.parts, strict=True):
            held, grasps = hands[:, list(group.members)], group.aligned(group.grasps)
            center, turn = held.mean(axis=1), np.zeros((len(hands), 0))
            offset = grasps.mean(axis=0)
            if kind == ANGLE:
                turn = np.unwrap(fit_angle(grasps, held))[:, None]
            elif kind == DIRECTION and self.n_dims == 2:
                angle = fit_angle(grasps, held)
                turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
            elif kind == DIRECTION:
                turn = fit_direction(grasps, held)
            elif kind == QUATERNION:
                if orientation_of(grasps, 3) == "axis":
                    ends = (quaternion_of_rotation(pose.rotation) for pose in (group.start, group.goal))
                    turn = _least_roll(fit_direction(grasps, held), *ends)
                else:
                    turn = fit_quaternion(grasps, held)
                signs = np.where((turn[1:] * turn[:-1]).sum(axis=1) < 0, -1.0, 1.0)
                turn[1:] *= np.cumprod(signs)[:, None]
            if offset.any():
                center = center - turned(kind, np.stack([turn] * 3), offset[None])[0, :, 0]
            q[:, columns] += np.concatenate([center[:, : self.n_dims], turn], axis=1)
            shared[columns] += 1.0
        return self.kept(q / shared)

    def kept(self, q: Array) -> Array:
        """Return configurations on the blocks' mask; arrays, shape (n_steps, n_columns).

        Unit quaternions and bounds of the tilt are not kept thereby.
        """
        return q if self.free is None else q @ self.blocks.mask + self.blocks.held

    def centers(self, q: Array) -> Array:
        """Return the blocks' centres in order, shared columns repeated.

        Parameters
        ----------
        q : array, shape (n_rollouts, n_columns, n_steps)

        Returns
        -------
        array, shape (n_rollouts, n_blocks * n_dims, n_steps), [m]
        """
        columns = self.blocks.center[:, : self.n_dims].ravel()
        return q if np.array_equal(columns, np.arange(self.n_columns)) else q[:, columns]

    def same_as(self, other: Coordinates) -> bool:
        """Return whether both describe the same groups in one way."""
        ours, theirs = self.blocks._asdict(), other.blocks._asdict()
        return all(np.array_equal(ours[name], theirs[name]) for name in ours)

    def from_load(self, q: Array, load: Coordinates) -> Array:
        """Return configurations in `load_coordinates` rewritten in these. Arrays, shape (..., n_columns)."""
        result = np.empty((*q.shape[:-1], self.n_columns))
        for own, theirs in zip(self.parts, load.parts, strict=True):
            part = q[..., theirs.columns]
            if own.kind == DIRECTION and theirs.kind == ANGLE:
                part = np.concatenate([part[..., :2], np.cos(part[..., 2:]), np.sin(part[..., 2:])], axis=-1)
            result[..., own.columns] = part
        return result

    @cached_property
    def parts(self) -> tuple[Block, ...]:
        """Return the blocks one by one."""
        blocks = self.blocks
        return tuple(
            Block(
                int(kind),
                contiguous(
                    np.append(
                        blocks.center[b, : self.n_dims],
                        blocks.turn[b] + np.arange(width_of(kind, self.n_dims)),
                    )
                ),
                blocks.node[blocks.first[b] : blocks.first[b + 1]],
                blocks.point[blocks.first[b] : blocks.first[b + 1]],
            )
            for b, kind in enumerate(blocks.kind)
        )


@of_geometry  # a search asks for them everywhere
def load_coordinates(scene: Scene) -> Coordinates:
    """Return the fewest coordinates, about the payload's centre."""
    return _load_coordinates(scene)


def _load_coordinates(scene: Scene) -> Coordinates:
    return _coordinates(scene, "load", [KINDS[g.orientation] for g in scene.groups])


def projected_coordinates(scene: Scene) -> Coordinates:
    """Return coordinates of free end effectors, projected onto the constraints.

    Raises
    ------
    OptionError
        Where the projection is not driven by a linear map: in space with three end effectors or more on one payload,
        with a relative pose, and with a payload that stays upright.
    """
    kinds = []
    for group in scene.groups:
        if group.orientation in UNDRIVEN:
            raise OptionError(UNDRIVEN[group.orientation], key="method", way_out="use the method 'comove'")
        kinds.append(POINT if group.orientation in ("none", "fixed") else DIRECTION)
    coordinates = _coordinates(scene, "projected", kinds)
    n_dims, n_hands = scene.n_dims, len(scene.manipulators)
    matrix = np.zeros((coordinates.n_columns, n_hands, n_dims))
    sharing = np.zeros(coordinates.n_columns)
    for group, (kind, columns, *_) in zip(scene.groups, coordinates.parts, strict=True):
        members, rows = list(group.members), np.arange(coordinates.n_columns)[columns]
        sharing[rows] += 1.0
        middle = group.grasps.mean(axis=0)
        held = group.grasps - middle
        for member, r in zip(members, held, strict=True):
            matrix[rows[:n_dims], member] = np.eye(n_dims) / len(members)
            if kind == DIRECTION:
                turn = np.eye(n_dims) * r[0] if n_dims == 3 else np.array([[r[0], r[1]], [-r[1], r[0]]])
                matrix[rows[n_dims:], member] = turn / (held**2).sum()
        if np.linalg.norm(middle) > 1e-9:
            raise OptionError(
                "projection needs grasps centred about the load's origin",
                key="method",
                way_out="use the method 'comove'",
            )
    matrix /= sharing[:, None, None]
    driven = matrix.reshape(coordinates.n_columns, -1)
    return replace(
        coordinates, search=driven if coordinates.free is None else coordinates.blocks.mask @ driven
    )


def arms_coordinates(scene: Scene) -> Coordinates:
    """Return coordinates of independent end effectors. No constraint holds by construction.

    Raises
    ------
    OptionError
        If the payload has points besides the end effectors, which free ones do not determine; if it must stay upright
        in the plane, or between end effectors at different heights; and if these must keep their relative pose in
        space.
    """
    unheld = next((c for c in scene.constraints if c.needs_body(scene.ends)), None)
    if unheld is not None:
        raise OptionError(
            f"free hands do not hold the constraint '{unheld.kind.replace('_', ' ')}'",
            key="method",
            way_out="use the method 'comove'",
        )
    if any(len(group.corners) for group in scene.groups):
        raise OptionError(
            "free hands do not say where the rest of the load is",
            key="method",
            way_out="use the method 'comove' for loads that reach beyond the hands",
        )
    alone = tuple(
        RigidGroup((i,), np.zeros((1, 3)), np.zeros((0, 3)), "none", _pose_at(start), _pose_at(goal))
        for i, (start, goal) in enumerate(zip(scene.start, scene.goal, strict=True))
    )
    together = tuple(group.members for group in scene.groups if len(group.members) > 1)
    return replace(_coordinates(scene, "arms", [POINT] * len(alone), alone), together=together)


COORDINATES: dict[Kind, Callable[[Scene], Coordinates]] = {
    "load": _load_coordinates,
    "projected": projected_coordinates,
    "arms": arms_coordinates,
}


def coordinates_for(scene: Scene, kind: Kind) -> Coordinates:
    """Build the coordinates of a scene by kind, not cached. The verification of a motion relies on them."""
    return COORDINATES[kind](scene)


def _pose_at(y: Array) -> GroupPose:
    return GroupPose(np.concatenate([y, np.zeros(3 - len(y))]), np.eye(3))


def _coordinates(
    scene: Scene, name: Kind, kinds: list[int], groups: tuple[RigidGroup, ...] | None = None
) -> Coordinates:
    groups = scene.groups if groups is None else groups
    n_dims, corner, n_columns = scene.n_dims, len(scene.manipulators), 0
    center, turn = np.zeros((len(groups), 3), dtype=np.int64), []
    scale, first, node, point = [], [0], [], []
    for b, (group, kind, level) in enumerate(zip(groups, kinds, scene.level_with(groups), strict=True)):
        own = n_dims if level == b else n_dims - 1  # the height is the last coordinate
        center[b, :own] = range(n_columns, n_columns + own)
        if level != b:
            center[b, own] = center[level, own]
        turn.append(n_columns + own)
        n_columns = turn[-1] + width_of(kind, n_dims)
        scale += [1.0] * own + [3.0 if kind == ANGLE else 1.5] * width_of(kind, n_dims)
        node += [*group.members, *range(corner, corner + len(group.corners))]
        corner += len(group.corners)
        point.append(group.aligned(group.points))
        first.append(len(node))
    blocks = Blocks(
        np.array(kinds, dtype=np.int64),
        center,
        np.array(turn, dtype=np.int64),
        np.array(first, dtype=np.int64),
        np.array(node, dtype=np.int64),
        np.concatenate(point),
        n_dims,
        *Unmasked.of(n_columns, len(groups)),
    )
    return _masked(Coordinates(name, blocks, groups, n_columns, np.diag(scale)))


def _masked(coordinates: Coordinates) -> Coordinates:
    """Return coordinates with the masks of their bodies."""
    blocks = coordinates.blocks
    for b, group in enumerate(coordinates.groups):
        if group.mask.up is not None and blocks.kind[b] == QUATERNION:
            blocks.up[b], blocks.tilt[b] = group.mask.up, group.mask.tilt
            blocks.level[b] = quaternion_of_rotation(similarity(group.mask.up, UP))
    if all(group.mask.axis is None and group.mask.normal is None for group in coordinates.groups):
        return coordinates
    n_columns, n_dims, directions = coordinates.n_columns, coordinates.n_dims, list[Array]()
    base = np.zeros(n_columns)
    for group, (kind, columns, _, _) in zip(coordinates.groups, coordinates.parts, strict=True):
        own = np.arange(n_columns)[columns]
        block = write_pose(kind, group.turn(group.start), n_dims)
        base[own] = block
        ways = [np.eye(n_dims), np.eye(len(own) - n_dims)]
        if group.mask.normal is not None:
            ways[0] = np.linalg.svd(group.mask.normal[None])[2][1:]
        if group.mask.axis is not None and kind == QUATERNION:
            ways[1] = np.stack(
                [block[n_dims:], quaternion_product(np.append(0.0, group.mask.axis), block[n_dims:])]
            )
        for way, at in zip(ways, (own[:n_dims], own[n_dims:]), strict=True):
            directions += [_placed(row, at, n_columns) for row in way]
    once = {row.tobytes(): row for row in directions}  # a height that bodies share is one direction
    free = np.array([*once.values()]).T
    mask = free @ free.T
    blocks = blocks._replace(mask=mask, held=base - mask @ base)
    return replace(coordinates, blocks=blocks, free=free, search=coordinates.search @ free)


def _least_roll(directions: Array, start: Array, goal: Array) -> Array:
    """Return quaternions (n, 4) along `directions` (n, 3) with least roll.

    They turn the x axis. The roll begins at the quaternion `start`; the difference of the roll at the end from that
    of `goal` is spread evenly.
    """
    x, y, z = directions.T
    none = np.zeros_like(x)
    turns = np.where(x > 0, [1 + x, none, -z, y], [y, z, none, 1 - x]).T  # a half turn where x points back
    turns = np.stack([start, *turns / np.linalg.norm(turns, axis=1, keepdims=True), goal])
    between = quaternion_product(turns[:-1] * [1.0, -1.0, -1.0, -1.0], turns[1:])
    roll = -np.cumsum(np.arctan(between[:, 1] / np.where(between[:, 0] == 0, 1e-300, between[:, 0])))
    roll = roll[:-1] - (roll[-1] - np.pi * np.round(roll[-1] / np.pi)) * np.linspace(0.0, 1.0, len(x))
    rolls = np.stack([np.cos(roll), np.sin(roll), none, none], axis=1)
    return quaternion_product(turns[1:-1], rolls)


def _placed(values: Array, at: Integers, n: int) -> Array:
    """Return zeros (n,) with values at some places."""
    found = np.zeros(n)
    found[at] = values
    return found


class HandPoses(NamedTuple):
    """The poses of a scene's rigid groups, in order.

    Attributes
    ----------
    center : array, shape (n_groups, 3), origins of the groups' frames [m]
    quaternion : array, shape (n_groups, 4), orientations of these frames, w x y z, of unit length; in the plane turns
        about z
    """

    center: Array
    quaternion: Array

    def each(self) -> Iterator[HandPoses]:
        """Yield the poses at each instant, the first axis of the arrays."""
        return map(HandPoses, *self)


def poses_at(coordinates: Coordinates, q: ArrayLike) -> HandPoses:
    """Return the poses of the groups in configurations.

    Parameters
    ----------
    q : array, shape (..., n_columns), one configuration or many

    Returns
    -------
    HandPoses, whose arrays have the same leading axes

    Raises
    ------
    OptionError
        If `q` is not a configuration in these coordinates, or they are those of free end effectors.
    """
    q = numbers(q)
    if q.shape[-1:] != (coordinates.n_columns,) or not np.isfinite(q).all():
        raise OptionError(
            f"a configuration of shape {q.shape}", way_out=f"give {coordinates.n_columns} finite numbers"
        )
    if coordinates.kind == "arms":
        raise OptionError("free hands have no poses", way_out="use the load's coordinates, or poses_of")
    n, n_groups = coordinates.n_dims, len(coordinates.parts)
    center, quaternion = np.zeros((*q.shape[:-1], n_groups, 3)), np.zeros((*q.shape[:-1], n_groups, 4))
    quaternion[..., 0] = 1.0
    for g, (kind, columns, _, _) in enumerate(coordinates.parts):
        center[..., g, :n], turn = q[..., columns][..., :n], q[..., columns][..., n:]
        if kind == ANGLE:
            quaternion[..., g, 0], quaternion[..., g, 3] = np.cos(turn[..., 0] / 2), np.sin(turn[..., 0] / 2)
        elif kind == QUATERNION:
            quaternion[..., g, :] = turn / np.linalg.norm(turn, axis=-1, keepdims=True)
        elif kind == DIRECTION:
            quaternion[..., g, :] = _pointing(turn / np.linalg.norm(turn, axis=-1, keepdims=True))
        quaternion[..., g, :] = quaternion_product(quaternion[..., g, :], coordinates.unturned[g])
    return HandPoses(center, quaternion)


def _pointing(direction: Array) -> Array:
    """Return the smallest rotations from x to unit vectors, as quaternions. For the opposite vector it is about z.

    Parameters
    ----------
    direction : array, shape (..., 2 or 3)

    Returns
    -------
    array, shape (..., 4), w x y z
    """
    y, z = (
        direction[..., 1],
        direction[..., 2] if direction.shape[-1] == 3 else np.zeros(direction.shape[:-1]),
    )
    sine = np.hypot(y, z)
    half, known = 0.5 * np.arctan2(sine, direction[..., 0]), sine > 0.0
    scale = np.sin(half) / np.where(known, sine, 1.0)
    about_z = np.where(known, y * scale, np.sin(half))
    return np.stack([np.cos(half), np.zeros_like(half), -z * scale, about_z], axis=-1)

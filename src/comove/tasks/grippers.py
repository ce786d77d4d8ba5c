"""Grippers in a compiled MuJoCo model: their commands, widths and grasp frames.

Equalities, tendons and springs decide where the joints of a linkage go, so MuJoCo itself moves the fingers: every
combination of the ends of the actuators' ranges is tried in a copy of the model, in which nothing else moves or
touches anything, without gravity. The combination that leaves the widest gap between the pads opens the gripper, and
the one with the least gap closes it.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from comove.arrays import Array
from comove.sim.engine import without_log
from comove.sim.mjcf_actuators import driven


@dataclass(frozen=True)
class GripperSettings:
    """Settings of the search for open and closed fingers.

    Attributes
    ----------
    most : actuators of a gripper, at most
    longest : time in which fingers come to rest [s]
    still : speed of the fingers below which they rest [rad/s, m/s]
    resting : time for which they do so [s]
    left : share of their way that is left when they count as settled
    near : difference of two gaps that counts as none, and of two pads' faces [m]
    tips : share of the fingers' reach from which on they have pads
    pad : largest depth of the grasp frame behind the fingertips [m]
    aligned : angle up to which a direction is that of an axis of the palm [deg]
    """

    most: int = 4
    longest: float = 2.0
    still: float = 1e-3
    resting: float = 0.1
    left: float = 0.05
    near: float = 3e-3
    tips: float = 0.7
    pad: float = 0.015
    aligned: float = 10.0


SETTINGS = GripperSettings()


@dataclass(frozen=True)
class Gripper:
    """A gripper and its commands.

    Attributes
    ----------
    actuators : numbers of its actuators in the model
    open, closed : commands of these actuators
    width_open, width_closed : gap between the pads [m]
    settling_time : time that the fingers take to close in free air [s]
    posture : joint positions of the open fingers [rad, m]
    """

    actuators: tuple[int, ...]
    open: tuple[float, ...]
    closed: tuple[float, ...]
    width_open: float
    width_closed: float
    settling_time: float
    posture: Mapping[str, float]


class Hand(NamedTuple):
    """The bodies of a hand in the model: its palm, and its fingers' joints."""

    palm: int
    joints: tuple[int, ...]


class _Pose(NamedTuple):
    """Fingers that have come to rest for some commands."""

    commands: tuple[float, ...]
    data: Any
    time: float


def gripper_of(mj: Any, model: Any, now: Array, hand: Hand) -> tuple[Gripper, Array] | None:
    """Return a hand's gripper, and its grasp frame in the palm; array, shape (4, 4).

    z of the frame is the direction of approach, and fingers open along y. It is None where the hand has no actuator,
    more than a gripper's, or fingers on one side only.

    Parameters
    ----------
    now : array, shape (nq,), a state of the model from which its fingers move freely
    """
    moved = set(hand.joints)
    actuators = [k for k in range(model.nu) if moved & {joint for joint, _ in driven(mj, model, k)}]
    roots = [
        body
        for body in sorted({int(model.jnt_bodyid[joint]) for joint in hand.joints})
        if not any(int(model.jnt_bodyid[joint]) in _above(model, body) for joint in hand.joints)
    ]
    if not 0 < len(actuators) <= SETTINGS.most or len(roots) < 2:
        return None
    stage = _Stage(mj, model, now, hand, actuators)
    sides = _sides(model, stage.start(), roots)
    if not all(sides):
        return None
    ranges = [
        model.actuator_ctrlrange[k].tolist() if model.actuator_ctrllimited[k] else [-1.0, 1.0]
        for k in actuators
    ]
    poses = [stage.settled(commands) for commands in product(*ranges)]
    shape = _Shape.of(mj, model, hand, sides, roots, poses)
    gaps = [shape.gap(pose.data) for pose in poses]
    opened = poses[int(np.argmax(gaps))]
    least = [pose for pose, gap in zip(poses, gaps, strict=True) if gap < min(gaps) + SETTINGS.near]
    closing = min(least, key=lambda pose: shape.aside(pose.data, opened.data)).commands
    closed = stage.settled(closing, opened.data)  # as it closes in use
    names = [str(model.joint(joint).name or f"joint{joint}") for joint in hand.joints]
    found = Gripper(
        tuple(actuators),
        opened.commands,
        closed.commands,
        max(shape.gap(opened.data), 0.0),
        max(shape.gap(closed.data), 0.0),
        closed.time,
        {
            name: float(opened.data.qpos[model.jnt_qposadr[joint]])
            for name, joint in zip(names, hand.joints, strict=True)
        },
    )
    return found, shape.frame(opened.data, closed.data)


def _above(model: Any, body: int) -> Iterator[int]:
    """Yield the bodies above a body."""
    while body:
        body = int(model.body_parentid[body])
        yield body


def _below(model: Any, roots: Iterable[int]) -> set[int]:
    """Return bodies and all below them."""
    roots = set(roots)
    return {body for body in range(1, model.nbody) if roots & {body, *_above(model, body)}}


def _geoms(model: Any, bodies: Iterable[int]) -> list[int]:
    """Return the geoms of bodies that touch others."""
    inside, touch = np.isin(model.geom_bodyid, list(bodies)), model.geom_contype | model.geom_conaffinity
    return np.flatnonzero(inside & (touch != 0)).tolist()


class _Stage:
    """A copy of the model in which only fingers move and touch."""

    def __init__(self, mj: Any, model: Any, now: Array, hand: Hand, actuators: Sequence[int]):
        self.mj, self.model, self.actuators = mj, copy.copy(model), list(actuators)
        self.model.opt.gravity[:] = 0.0
        own = _below(model, [int(model.jnt_bodyid[joint]) for joint in hand.joints])
        others = ~np.isin(model.geom_bodyid, list(own))
        self.model.geom_contype[others] = self.model.geom_conaffinity[others] = 0
        positions, speeds = (
            [int(addresses[joint]) for joint in hand.joints]
            for addresses in (model.jnt_qposadr, model.jnt_dofadr)
        )
        self.speeds, self.now = speeds, np.array(model.qpos0)
        self.now[positions] = now[positions]
        self.still = np.setdiff1d(np.arange(model.nq), positions), np.setdiff1d(np.arange(model.nv), speeds)

    def start(self) -> Any:
        """Return the state in which the fingers begin."""
        data = self.mj.MjData(self.model)
        data.qpos[:] = self.now
        self.mj.mj_forward(self.model, data)
        return data

    def settled(self, commands: tuple[float, ...], begun: Any = None) -> _Pose:
        """Move the fingers until they rest."""
        mj, model, data = self.mj, self.model, self.start()
        if begun is not None:
            data.qpos[:], data.act[:] = begun.qpos, begun.act
        data.ctrl[self.actuators] = commands
        stays, (positions, speeds) = data.qpos.copy(), self.still
        step, rested, path = float(model.opt.timestep), 0, [stays]
        with without_log():
            while len(path) * step < SETTINGS.longest and rested * step < SETTINGS.resting:
                mj.mj_step(model, data)
                data.qpos[positions], data.qvel[speeds] = stays[positions], 0.0
                rested = rested + 1 if np.abs(data.qvel[self.speeds]).max() < SETTINGS.still else 0
                path.append(data.qpos.copy())
        mj.mj_forward(model, data)
        left = np.linalg.norm(np.array(path) - path[-1], axis=1)
        return _Pose(tuple(map(float, commands)), data, step * int((left > SETTINGS.left * left[0]).sum()))


def _sides(model: Any, data: Any, roots: Sequence[int]) -> tuple[list[int], list[int]]:
    """Return the geoms of the fingers on either side of a palm. Linkages have several bodies a side."""
    geoms = [_geoms(model, _below(model, [root])) for root in roots]
    middles = np.array(
        [
            data.geom_xpos[own].mean(axis=0) if own else data.xipos[root]
            for root, own in zip(roots, geoms, strict=True)
        ]
    )
    middles -= middles.mean(axis=0)
    across = middles @ np.linalg.svd(middles)[2][0]
    left, right = (
        [geom for own, at in zip(geoms, across, strict=True) if (at >= 0.0) == side for geom in own]
        for side in (True, False)
    )
    return left, right


@dataclass(frozen=True)
class _Shape:
    """Palm, pads and directions of a gripper; `approach` and `closing` are in the palm's frame."""

    mj: Any
    model: Any
    palm: int
    pads: tuple[int, int]
    approach: Array
    closing: Array

    @classmethod
    def of(
        cls,
        mj: Any,
        model: Any,
        hand: Hand,
        sides: tuple[list[int], list[int]],
        roots: Sequence[int],
        poses: Sequence[_Pose],
    ) -> _Shape:
        """Find pads and directions, where both sides are farthest apart."""
        ends = [_seen(pose.data, hand.palm, pose.data.geom_xpos) for pose in poses]
        apart = [at[sides[0]].mean(axis=0) - at[sides[1]].mean(axis=0) for at in ends]
        order = np.argsort([np.linalg.norm(one) for one in apart])
        wide, narrow = int(order[-1]), int(order[0])
        closing = _aligned(apart[wide] - apart[narrow])
        data, at = poses[wide].data, ends[wide]
        begins = _seen(data, hand.palm, data.xpos)[list(roots)].mean(axis=0)
        out = at[[*sides[0], *sides[1]]].mean(axis=0) - begins
        if np.linalg.norm(out - closing * (out @ closing)) < SETTINGS.near:
            out = begins
        approach = _aligned(out - closing * (out @ closing))
        pads = tuple(
            _pad(mj, model, poses[narrow].data, hand.palm, side, approach, sign * closing)
            for sign, side in zip((-1.0, 1.0), sides, strict=True)
        )
        return cls(mj, model, hand.palm, (pads[0], pads[1]), approach, closing)

    def gap(self, data: Any) -> float:
        """Return the signed distance between the pads [m]."""
        return float(self.mj.mj_geomDistance(self.model, data, *self.pads, 1.0, None))

    def aside(self, data: Any, other: Any) -> float:
        """Return how far pads of two states are apart across [m]."""
        middles = [
            _seen(state, self.palm, state.geom_xpos)[list(self.pads)].mean(axis=0) for state in (data, other)
        ]
        return float(abs((middles[0] - middles[1]) @ self.closing))

    def frame(self, opened: Any, closed: Any) -> Array:
        """Return the grasp frame in the palm, midway between the pads; array, shape (4, 4)."""
        turn = np.column_stack((np.cross(self.closing, self.approach), self.closing, self.approach))
        shut, wide = (
            [_points(self.mj, self.model, data, self.palm, pad) @ turn for pad in self.pads]
            for data in (closed, opened)
        )
        place = np.mean([0.5 * (one.min(axis=0) + one.max(axis=0)) for one in wide], axis=0)
        place[1] = 0.5 * (wide[0][:, 1].min() + wide[1][:, 1].max())  # between their faces
        low, high = max(one[:, 2].min() for one in shut), min(one[:, 2].max() for one in shut)
        place[2] = max(0.5 * (low + high), high - SETTINGS.pad)
        frame = np.eye(4)
        frame[:3, :3], frame[:3, 3] = turn, turn @ place
        return frame


def _seen(data: Any, palm: int, points: Array) -> Array:
    """Return points in the frame of a palm."""
    return np.asarray((points - data.xpos[palm]) @ data.xmat[palm].reshape(3, 3))


def _points(mj: Any, model: Any, data: Any, palm: int, geom: int) -> Array:
    """Return a geom's vertices or corners in the palm; array, shape (n, 3) [m]."""
    if int(model.geom_type[geom]) == int(mj.mjtGeom.mjGEOM_MESH):
        mesh = int(model.geom_dataid[geom])
        first = int(model.mesh_vertadr[mesh])
        points = np.array(model.mesh_vert[first : first + int(model.mesh_vertnum[mesh])], dtype=np.float64)
    else:
        middle, half = model.geom_aabb[geom].reshape(2, 3)
        points = middle + half * np.array(list(product((-1.0, 1.0), repeat=3)))
    return _seen(data, palm, points @ data.geom_xmat[geom].reshape(3, 3).T + data.geom_xpos[geom])


def _pad(
    mj: Any, model: Any, data: Any, palm: int, side: Sequence[int], approach: Array, inwards: Array
) -> int:
    """Return the smallest of the innermost geoms at fingertips of a side."""
    points = {geom: _points(mj, model, data, palm, geom) for geom in side}
    reach = {geom: float((one @ approach).max()) for geom, one in points.items()}
    begin, end = min(float((one @ approach).min()) for one in points.values()), max(reach.values())
    tips = [geom for geom in side if reach[geom] >= begin + SETTINGS.tips * (end - begin)]
    face = {geom: float((points[geom] @ inwards).max()) for geom in tips}
    inner = [geom for geom in tips if face[geom] >= max(face.values()) - SETTINGS.near]
    return min(inner, key=lambda geom: float(np.prod(np.ptp(points[geom], axis=0))))


def _aligned(direction: Array) -> Array:
    """Return a unit direction, or the axis that it nearly is."""
    unit = direction / np.linalg.norm(direction)
    axis = int(np.abs(unit).argmax())
    if abs(unit[axis]) >= np.cos(np.deg2rad(SETTINGS.aligned)):
        return np.asarray(np.sign(unit[axis]) * np.eye(3)[axis])
    return np.asarray(unit)

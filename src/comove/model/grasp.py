"""The orientations of end effectors that hold a payload.

They follow from the positions of the end effectors and of the payload's keypoints. Of a payload that turns about the
vertical only, the heading psi is the direction, seen from above, from its second holder to its first. A grasp frame
(z the approach direction, fingers open along y) keeps its tilt and turns with the payload:

    R(psi) = Rz(psi + offset) R(0)

The orientation of a payload that turns in any way follows from three keypoints that are not on one line: x points
from the first to the second, and z is normal to all three. A grasp frame is constant in that frame K:

    R = K R(0)

End effectors that hold a payload must also be near its surface.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.geometry.rotations import (
    cross,
    exponential,
    matrices,
    quaternion_of_rotation,
    rotation_in_plane,
)
from comove.model.files.keys import (
    BoxLoad,
    FrameLoad,
    GraspChoice,
    GraspOption,
    GraspPart,
    Gripped,
    Manipulator,
    MeshLoad,
    PartsLoad,
    PayloadPose,
    PolygonLoad,
    SceneFile,
)
from comove.model.groups import RigidGroup
from comove.model.shapes import MovingBody, inside_polygon, parts_of, spatial

SAME = 1e-9
"""By which a pose may differ from one that a free goal allows [m] or [rad]."""
DIGITS = 9
"""Digits of lengths [m] by which points are compared."""
HELD = {
    "down": np.diag([-1.0, 1.0, -1.0]),
    "forward": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}
"""Grasp frames at heading 0, by their names: the approach points down, or along the heading with fingers that open
upwards."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """The orientations of end effectors that hold the payload.

    Attributes
    ----------
    holders : numbers of the end effectors that hold the payload; the heading points from the second to the first.
        With a single holder the heading is always 0
    at_rest : array, shape (n_manipulators, 3, 3), every end effector's grasp frame at heading 0, offset included; in
        the frame of the keypoints where there are some
    turning : array of bool, shape (n_manipulators,), True for end effectors that turn with the payload; the others do
        not turn
    keypoints : numbers of three nodes that determine the payload's orientation; none where it turns about the
        vertical only
    """

    holders: tuple[int, ...]
    at_rest: Array
    turning: NDArray[np.bool_]
    keypoints: tuple[int, ...] = ()

    def hand_rotations(self, nodes: Array) -> Array:
        """Return the orientations of the grasp frames; array, shape (..., n_manipulators, 3, 3).

        Parameters
        ----------
        nodes : array, shape (..., n_nodes, 3), end effectors first, then the payload's corners [m]; without
            keypoints, end effectors suffice
        """
        if self.keypoints:
            frames = keypoint_frames(np.asarray(nodes)[..., list(self.keypoints), :])[..., None, :, :]
            return np.where(self.turning[:, None, None], frames @ self.at_rest, self.at_rest)
        x, y = self._along(nodes)
        size = np.hypot(x, y)[..., None]
        c = np.where(self.turning, x[..., None] / size, 1.0)[..., None]
        s = np.where(self.turning, y[..., None] / size, 0.0)[..., None]
        rotations = np.empty((*c.shape[:-1], 3, 3))
        rotations[..., 0, :] = c * self.at_rest[:, 0] - s * self.at_rest[:, 1]
        rotations[..., 1, :] = s * self.at_rest[:, 0] + c * self.at_rest[:, 1]
        rotations[..., 2, :] = self.at_rest[:, 2]
        return rotations

    def payload_rotations(self, hands: Array, nodes: Array, rotation: Array) -> Array:
        """Return the orientations of a payload from grasps; array, shape (..., 3, 3).

        Each holder gives one; of several it is the rotation nearest to their mean.

        Parameters
        ----------
        hands : array, shape (..., n_manipulators, 3, 3), grasp frames
        nodes, rotation : arrays, shapes (n_nodes, 3) [m] and (3, 3), nodes as of `hand_rotations` in one pose of the
            payload, and its orientation there
        """
        held, holders = self.hand_rotations(nodes).swapaxes(-1, -2) @ rotation, list(self.holders)
        left, _, right = np.linalg.svd((hands[..., holders, :, :] @ held[holders]).mean(axis=-3))
        left[..., :, 2] *= np.sign(np.linalg.det(left @ right))[..., None]
        return left @ right

    def spins(self, nodes: Array, velocities: Array) -> Array:
        """Compute the payload's angular velocity; array, shape (..., 3, n) [rad/s].

        Parameters
        ----------
        nodes : array, shape (..., n_nodes, 3), as in `hand_rotations` [m]
        velocities : array, shape (..., n_nodes, 3, n), n motions as one body [m/s]
        """
        if self.keypoints:
            three = list(self.keypoints)
            return _angular_velocity(nodes[..., three, :], velocities[..., three, :, :])
        spin = np.zeros((*velocities.shape[:-3], 3, velocities.shape[-1]))
        if len(self.holders) > 1:
            first, second = self.holders[:2]
            x, y = (along[..., None] for along in self._along(nodes))
            change = velocities[..., first, :, :] - velocities[..., second, :, :]
            spin[..., 2, :] = (x * change[..., 1, :] - y * change[..., 0, :]) / (x * x + y * y)
        return spin

    def _along(self, hands: Array) -> tuple[Array, Array]:
        """Return x and y from the second to the first holder [m]. Two arrays, shape (...)."""
        hands = np.asarray(hands, dtype=float)
        if len(self.holders) == 1:
            return np.ones(hands.shape[:-2]), np.zeros(hands.shape[:-2])
        first, second = self.holders[:2]
        return tuple(np.moveaxis(hands[..., first, :2] - hands[..., second, :2], -1, 0))


def keypoint_frames(points: Array) -> Array:
    """Return the frames K of three points each; (..., 3, 3), [m] -> (..., 3, 3)."""
    along, aside = points[..., 1, :] - points[..., 0, :], points[..., 2, :] - points[..., 0, :]
    x, z = (v / np.linalg.norm(v, axis=-1, keepdims=True) for v in (along, cross(along, aside)))
    return np.stack([x, cross(z, x), z], axis=-1)


def _angular_velocity(points: Array, velocities: Array) -> Array:
    """Compute a rigid body's angular velocity w from three of its points.

    Arrays are as in `Grasp.spins`. With edges e_i from the first point, their normal included, and g_i the dual
    basis, ``2 w = sum_i g_i x e_i'``.
    """
    first, second = points[..., 1, :] - points[..., 0, :], points[..., 2, :] - points[..., 0, :]
    rates = (velocities[..., 1:, :, :] - velocities[..., :1, :, :]).swapaxes(-1, -2)
    normal = cross(first, second)
    turned = cross(rates[..., 0, :, :], second[..., None, :]) + cross(
        first[..., None, :], rates[..., 1, :, :]
    )
    square = (normal * normal).sum(axis=-1, keepdims=True)
    dual = (
        one[..., None, :] / square[..., None] for one in (cross(second, normal), cross(normal, first), normal)
    )
    changes = rates[..., 0, :, :], rates[..., 1, :, :], turned
    spins = sum(cross(one, change) for one, change in zip(dual, changes, strict=True))
    return 0.5 * np.asarray(spins).swapaxes(-1, -2)


def keypoints_of(points: Array) -> tuple[int, int, int]:
    """Return three of a body's points (n, 3) far from one line. They determine its orientation well."""
    away = np.linalg.norm(points - points[0], axis=1).round(DIGITS)
    second = int(away.argmax())
    along = (points[second] - points[0]) / away[second]
    aside = points - points[0]
    third = int(np.linalg.norm(aside - (aside @ along)[:, None] * along, axis=1).round(DIGITS).argmax())
    return 0, second, third


def grasp_of(file: SceneFile, groups: Sequence[RigidGroup]) -> Grasp | None:
    """Return the (first) grasp of a scene file, or None."""
    if file.grasp is None:
        return None
    part, holders, corner = alternatives(file)[0], set(file.holder_numbers), len(file.names)
    carried: tuple[int, ...] = ()
    for group in groups:
        if holders & set(group.members):
            carried = group.members
            break
        corner += len(group.corners)
    if part.frames is not None and file.load is not None and file.load.start is not None:
        three = list(keypoints_of(group.points))
        payload = group.start.rotation.T @ matrices(np.array(file.load.start.quaternion_wxyz))
        turn = keypoint_frames(group.points[three]).T @ payload
        frames = [matrices(np.array(part.frames[name])) for name in file.names]
        nodes = [*group.members, *range(corner, corner + len(group.corners))]
        return Grasp(
            holders=file.holder_numbers,
            at_rest=np.stack([turn @ held if i in carried else held for i, held in enumerate(frames)]),
            turning=np.isin(np.arange(len(frames)), carried),
            keypoints=tuple(nodes[k] for k in three),
        )
    offset = part.offset_deg
    offsets = [offset.get(name, 0.0) if isinstance(offset, dict) else offset for name in file.names]
    held = HELD[part.orientation or "down"]
    if part.quaternion_wxyz is not None:
        held = matrices(np.array(part.quaternion_wxyz))
    return Grasp(
        holders=file.holder_numbers,
        at_rest=np.stack([rotation_in_plane(np.deg2rad(angle)) @ held for angle in offsets]),
        turning=np.isin(np.arange(len(file.names)), carried),
    )


def alternatives(file: SceneFile, step: float = 45.0) -> tuple[GraspPart, ...]:
    """Return the grasps that a scene file leaves open, with yaws.

    Where the yaw is free, end effectors are turned by all multiples of `step` [deg] beyond their offsets: all by the
    same, or the first against the others. There are none where the file has no grasp.
    """
    if file.grasp is None:
        return ()
    found = list[GraspPart]()
    for part in file.grasp.any_of or (file.grasp,):
        if part.yaw == "load":
            found.append(part)
            continue
        turns = step * np.arange(round(360 / step))
        for first, others in ((1, 1), (1, -1)):
            for turn in turns.tolist():
                signs = [first if name == file.names[0] else others for name in file.names]
                said = part.offset_deg
                offset = {
                    name: (said.get(name, 0.0) if isinstance(said, dict) else said) + sign * turn
                    for name, sign in zip(file.names, signs, strict=True)
                }
                same = all(abs((sign - 1) * turn) % 360 == 0 for sign in signs)
                if others == 1 or not same:
                    found.append(part.model_copy(update={"yaw": "load", "offset_deg": offset}))
    return tuple(found)


def hands_of(
    start: PayloadPose, goal: PayloadPose, grasps: Mapping[str, tuple[float, ...]]
) -> list[dict[str, Any]]:
    """Return the manipulators of a payload's grasps, as in scene files."""
    n_dims, placed = len(start.position), dict[str, Array]()
    points = spatial(np.array([*grasps.values()]))
    for end, pose in (("start", start), ("goal", goal)):
        turned = points @ matrices(np.array(pose.quaternion_wxyz)).T
        placed[end] = np.array(pose.position) + turned[:, :n_dims]
    return [
        {"name": name, **{end: tuple(places[i].tolist()) for end, places in placed.items()}}
        for i, name in enumerate(grasps)
    ]


def axis_of(free: str) -> Array:
    """Return the unit vector about which a goal is free. `yaw` is in the world, others in the payload."""
    return np.eye(3)["xyz".index("z" if free == "yaw" else free)]


def turned_goal(option: GraspOption, angle: float) -> GraspOption:
    """Return the option with its free goal turned and fixed [rad]."""
    if option.free is None:
        return option
    given, turn = (
        matrices(np.array(option.goal.quaternion_wxyz)),
        matrices(exponential(angle * axis_of(option.free))),
    )
    rotation = turn @ given if option.free == "yaw" else given @ turn
    quaternion = tuple(quaternion_of_rotation(rotation).tolist())
    goal = PayloadPose(position=option.goal.position, quaternion_wxyz=quaternion)
    return option.model_copy(update={"goal": goal, "free": None})


def nearest_turn(start: Array, goal: Array, free: str) -> float:
    """Return the angle [rad] that turns a goal nearest to the start. The turn is about a free axis.

    Parameters
    ----------
    start, goal : arrays, shape (3, 3), orientations
    """
    axis = axis_of(free)
    between = start @ goal.T if free == "yaw" else goal.T @ start
    skew = np.array(
        [between[2, 1] - between[1, 2], between[0, 2] - between[2, 0], between[1, 0] - between[0, 1]]
    )
    return float(np.arctan2(skew @ axis, np.trace(between) - axis @ between @ axis))


def angle_to(option: GraspOption, goal: PayloadPose) -> float | None:
    """Return the angle [rad] to a goal about a free axis. It is None where no angle leads there."""
    if option.free is None or np.abs(np.subtract(option.goal.position, goal.position)).max() > SAME:
        return None
    wanted, own = (matrices(np.array(pose.quaternion_wxyz)) for pose in (goal, option.goal))
    angle = nearest_turn(wanted, own, option.free)
    found = matrices(np.array(turned_goal(option, angle).goal.quaternion_wxyz))
    return angle if np.abs(found - wanted).max() <= SAME else None


def chosen(file: SceneFile, choice: GraspOption) -> SceneFile:
    """Return a scene file with one choice of grasps and goal."""
    load = file.load
    assert load is not None and load.start is not None, "choices are about payloads with poses"
    changes: dict[str, Any] = {"goal": choice.goal}
    if isinstance(load, Gripped):
        changes["grasps"] = choice.grasps
    hands = hands_of(load.start, choice.goal, choice.grasps)
    others = [hand for hand in file.manipulators if hand.name not in choice.grasps]
    return file.model_copy(
        update={
            "load": load.model_copy(update=changes),
            "manipulators": (*(Manipulator(**hand) for hand in hands), *others),
            "grasp": None if choice.frames is None else GraspChoice(frames=choice.frames),
            "choices": None,
        }
    )


FINGERS = 0.04
"""Distance from a payload at which a hand still holds it [m]: fingers of parallel grippers are about 4 cm long, and a
hand may be given by their roots."""
SHARE = 0.02
"""Share of the payload's longest side that is allowed besides, for sizes that are rounded."""


def far_grasps(file: SceneFile, groups: Sequence[RigidGroup], body: MovingBody) -> Array:
    """Compute the distances of ineffective grasps from the payload.

    Every choice is computed. A grasp holds it up to `FINGERS` and `SHARE` of the payload's longest side from its
    surface. Of a mesh, distances are those from the polytopes that contain it, which are at most their
    over-approximation error less.

    Parameters
    ----------
    groups : the rigid groups of the scene; one of them holds the payload
    body : the geometry of payload and end effectors

    Returns
    -------
    array, shape (n_ways, n_holders), [m]; 0 for grasps that hold it. Ways are the choices of the file, or one.
    """
    group = next((g for g in groups if set(file.holder_numbers) <= set(g.members)), None)
    if file.load is None or group is None:
        return np.zeros((max(len(file.choices or ()), 1), len(file.holders)))
    hands = _held_at(file, group)
    corners = np.concatenate([g.corners for g in groups])
    hulls = [corners[np.unique(solid) - len(file.names)] for solid in body.solids]
    apart = np.stack([_distances(file, group, way, hulls) for way in hands])
    points = group.corners if len(group.corners) else group.grasps
    allowed = FINGERS + SHARE * float(np.ptp(points, axis=0).max())
    return np.where(apart > allowed, apart, 0.0)


def _held_at(file: SceneFile, group: RigidGroup) -> Array:
    """Return the choices' grasps in the group's frame; array, shape (n_ways, n_holders, 3) [m]."""
    load = file.load
    if not file.choices or load is None or load.start is None:
        return group.grasps[None, [group.members.index(i) for i in file.holder_numbers]]
    turn, center = matrices(np.array(load.start.quaternion_wxyz)), spatial(np.array(load.start.position))
    points = spatial(np.array([[way.grasps[name] for name in file.holders] for way in file.choices]))
    return (center + points @ turn.T - group.start.center) @ group.start.rotation


def _distances(file: SceneFile, group: RigidGroup, hands: Array, hulls: Sequence[Array]) -> Array:
    """Compute end effectors' distances from the payload; (n_holders, 3), [m] -> (n_holders,). They are 0 inside of
    it.

    The corners of a payload of convex solids are those of `hulls`, arrays of shape (n_corners, 3) [m].
    """
    load = file.load
    if isinstance(load, FrameLoad):
        at = dict(zip(file.holders, hands, strict=True))
        ends = np.array([[at[first], at[second]] for first, second in load.edges])
        return np.maximum(_from_segments(hands, ends) - load.radius, 0.0)
    if isinstance(load, PolygonLoad):
        border = np.stack([group.corners, np.roll(group.corners, -1, axis=0)], axis=1)
        apart = np.maximum(_from_segments(hands, border) - load.radius, 0.0)
        return np.where(inside_polygon(group.corners, hands), 0.0, apart)
    if isinstance(load, BoxLoad):
        edges = group.corners[[1, 3] if file.dimension == 2 else [1, 2, 4]] - group.corners[0]
        lengths = np.linalg.norm(edges, axis=1)
        along = np.abs((hands - group.corners.mean(axis=0)) @ (edges / lengths[:, None]).T)
        return np.linalg.norm(np.maximum(along - lengths / 2, 0.0), axis=1)
    if isinstance(load, PartsLoad | MeshLoad):
        from comove.geometry.polytopes import nearest_in_hull  # most scenes need no polytopes

        rods = np.full(len(hands), np.inf)
        for a, b, radius in parts_of(load).rods if isinstance(load, PartsLoad) else ():
            apart = _from_segments(hands, group.corners[[a, b]][None]) - radius
            rods = np.minimum(rods, np.maximum(apart, 0.0))
        feet = [nearest_in_hull(np.ascontiguousarray(hull), hands) for hull in hulls]
        return np.min(
            [rods, *np.linalg.norm(hands - np.array(feet).reshape(-1, *hands.shape), axis=2)], axis=0
        )
    return np.zeros(len(hands))  # a bar lies between its hands


def told_far(name: str, apart: float, file: SceneFile) -> str:
    """Return a message about an ineffective grasp, with its distance [m]."""
    return (
        f"'{name}' is to hold the payload, and is {apart:.3g} m away from its surface: there is nothing between its "
        f"fingers; {_advice(file)}"
    )


def _advice(file: SceneFile) -> str:
    load = file.load
    if load is not None and load.start is not None:
        return "move its grasp onto the payload"
    if isinstance(load, FrameLoad):
        return "give the frame an edge that ends at this hand, or leave the hand out of held_by"
    if isinstance(load, Gripped) and load.grasps:
        return "give load.grasps on the payload, and hands at start and goal that are as far apart"
    if file.dimension == 3 and len(file.holders) == 2:
        lies = "it is centred between its two hands, and its x axis is the line through them"
        first = (
            "give its length along this line as the first of its sizes" if isinstance(load, BoxLoad) else ""
        )
        return f"{lies}: {first or 'turn the mesh'}, move the hands onto it, or give load.grasps"
    return (
        "it is centred between its hands, and its axes are those of the world at the start: move the hands onto it, "
        "or give load.grasps"
    )


def _from_segments(points: Array, ends: Array) -> Array:
    """Compute points' (n, 3) distances from the nearest segment (m, 2, 3); array, shape (n,) [m]."""
    start, along = ends[:, 0], ends[:, 1] - ends[:, 0]
    to = points[:, None] - start
    share = np.clip((to * along).sum(axis=2) / (along**2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(to - share[..., None] * along, axis=2).min(axis=1)

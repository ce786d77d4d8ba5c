"""Scenes of version 2 from planning scenes of MoveIt, for a robot.

A planning scene has objects in the world and on the robot's links, joints, and a matrix of pairs that may touch, but
no goal. An object becomes the payload: one that is attached to a hand, with the grasps by which hands hold it, or one
in the world, with proposed grasps. Notes tell in words what has no place in a scene.
"""

from __future__ import annotations

import re
import shlex
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from comove.arrays import Array
from comove.errors import ComoveWarning, RobotError, SceneError, listed, near_name, shortened
from comove.geometry.rotations import quaternion_of_rotation
from comove.io.keys import MAX_NAME
from comove.model.files.keys import Turned
from comove.model.files.moveit import (
    AttachedObject,
    CollisionObject,
    PlacedShape,
    PlanningScene,
    as_off,
    obstacle_of,
    obstacles_in,
    planning_scene_in,
)
from comove.model.files.upgrade import DIGITS
from comove.model.scene import Scene
from comove.robots.formats import SRDF, elements_in, srdf_of
from comove.robots.model import Arm, Robot
from comove.robots.present import present_joints

MARGIN = 0.5
"""Room around the payload and its grasps at both ends, within the workspace [m]."""
POINT = 1e-3
"""Length of the bar that contains a sphere, as a share of its radius."""


@dataclass(frozen=True)
class Goal:
    """Where the payload goes.

    It is `shift` [m] from its start, or at `position` [m]; its orientation is that of the start unless `rpy_deg` is
    given.
    """

    shift: tuple[float, float, float] | None = None
    position: tuple[float, float, float] | None = None
    rpy_deg: tuple[float, float, float] | None = None

    def of(self, start: Array) -> Array:
        """Return the goal of a payload; arrays, shape (4, 4).

        Raises
        ------
        SceneError
            If nothing is given, or two things that exclude each other.
        """
        if self.shift is None and self.position is None and self.rpy_deg is None:
            raise SceneError(
                "a planning scene holds no goal",
                key="goal",
                way_out="say by how far the payload goes, --shift 0 0 0.2, or where to: "
                "--goal-position 0.5 0 0.4 --goal-rpy-deg 0 0 90",
            )
        if self.shift is not None and self.position is not None:
            raise SceneError(
                "the goal is given twice", key="--shift", way_out="leave it or --goal-position out"
            )
        goal = start.copy()
        if self.rpy_deg is not None:
            goal[:3, :3] = Turned(rpy_deg=self.rpy_deg).rotation
        goal[:3, 3] = start[:3, 3] + self.shift if self.shift is not None else self.position or start[:3, 3]
        return goal


class Displacement(NamedTuple):
    """Where the payload goes: its start displaced in the scene; array, shape (4, 4)."""

    pose: Array

    def of(self, start: Array) -> Array:
        """Return the goal of a payload; arrays, shape (4, 4)."""
        return self.pose @ start


@dataclass(frozen=True)
class ImportedScene:
    """A scene of version 2, and what belongs to it.

    Attributes
    ----------
    data : contents of the scene file
    meshes : contents of mesh files beside it, by name
    present : joints of the robot in the planning scene, by name; empty if it has none [rad, m]
    is_held : whether the robot holds the payload with them
    notes : choices, and what has no place in a scene, in words
    """

    data: dict[str, Any]
    meshes: Mapping[str, bytes]
    present: Mapping[str, float]
    is_held: bool
    notes: tuple[str, ...]


@dataclass(frozen=True)
class ImportOptions:
    """What a planning scene leaves open.

    Attributes
    ----------
    goal : where the payload goes
    payload : name of the object that is the payload; the attached one unless given
    leave_out : names of objects that are left out
    supports : names of objects on which the payload rests
    srdf, state : file and name of a group state, whose joints replace those of the planning scene
    """

    goal: Goal | Displacement = field(default_factory=Goal)
    payload: str | None = None
    leave_out: tuple[str, ...] = ()
    supports: tuple[str, ...] = ()
    srdf: Path | None = None
    state: str | None = None


@dataclass(frozen=True, eq=False)
class PlacedPayload:
    """A payload in a planning scene, where a robot's joints have it.

    Attributes
    ----------
    robot, scene : the robot, and the planning scene
    q : array, shape (n_joints,), joints of the planning scene; home where it has none [rad, m]
    present : the same by name; empty where it has none
    payload : object that is the payload
    is_held : whether it is attached to the robot
    base : array, shape (4, 4), pose of the planning frame in comove's scene
    start : array, shape (4, 4), pose of the object in comove's scene
    """

    robot: Robot
    scene: PlanningScene
    q: Array
    present: Mapping[str, float]
    payload: AttachedObject
    is_held: bool
    base: Array
    start: Array

    @classmethod
    def of(cls, file: Path, robot: Robot, options: ImportOptions) -> PlacedPayload:
        """Return the payload of a planning scene.

        Raises
        ------
        InputError
            If the planning scene cannot be read, or has no such payload.
        """
        scene = planning_scene_in(file)
        q, present = _joints(scene, robot, options)
        payload, is_held = _payload_of(scene, options, file)
        if is_held and not present:
            raise SceneError(
                "an object is attached to the robot, whose joints are not given",
                file=file,
                way_out="record it anew, or name a group state: --srdf FILE --state NAME",
            )
        links, frame = _links(robot), payload.object.frame
        base = _placed(robot, scene.frame, q) if scene.frame in links else np.eye(4)
        if is_held and frame in links:
            start = _placed(robot, frame, q) @ payload.object.pose
        else:
            start = base @ scene.pose_of(payload.object)
        return cls(robot, scene, q, present, payload, is_held, base, start)

    @property
    def holders(self) -> tuple[Arm, ...]:
        """Return the arms that hold it.

        Raises
        ------
        SceneError
            If it is attached to no hand.
        """
        return _holders(self.robot, self.payload) if self.is_held else ()

    @property
    def payload_start(self) -> Array:
        """Return the pose of the payload's frame in comove's scene."""
        return np.asarray(self.start @ _payload_shape(self.payload.object, "payload")[0])

    def pose_of(self, body: str) -> Array | None:
        """Return the pose of a body moving with it, or None."""
        if body == self.payload.object.name:
            return self.start
        if any(body in _hand_links(self.robot, arm) for arm in self.holders):
            return _placed(self.robot, body, self.q)
        return None

    def pose_of_frame(self, frame: str) -> Array | None:
        """Return a resting frame's pose in the scene, or None."""
        if frame in ("", self.scene.frame):
            return self.base
        if frame in self.scene.transforms:
            return self.base @ self.scene.transforms[frame]
        if frame in _links(self.robot) and _is_fixed(self.robot, frame):
            return _placed(self.robot, frame, self.q)
        return None


def scene_from(file: Path, robot: Robot, folder: Path, named: str, options: ImportOptions) -> ImportedScene:
    """Return the scene that a planning scene describes.

    Parameters
    ----------
    file : planning scene, as of `comove.model.files.moveit.planning_scene_in`, in `folder` or below
    folder : folder of the scene file, to which its paths are relative
    named : name of the scene
    options : what the planning scene leaves open

    Raises
    ------
    InputError
        If the planning scene cannot be read or used.
    """
    if not file.resolve().is_relative_to(folder.resolve()):
        raise SceneError(
            f"it is not in the scene's folder, {folder}",
            file=file,
            way_out=f"write it there: --out {file.parent / named}.yaml",
        )
    placed = PlacedPayload.of(file, robot, options)
    scene, payload, is_held, holders = placed.scene, placed.payload, placed.is_held, placed.holders
    own, shape, meshes = _payload_shape(payload.object, named)
    start = placed.start @ own
    goal = options.goal.of(start)
    grasps: Any = "auto"
    if is_held:
        grasps = {
            arm.name: _written(np.linalg.inv(start) @ robot.tool_pose(placed.q, arm)) for arm in holders
        }
    out = {*options.leave_out} | (set() if is_held else {payload.object.name})
    supports, notes = _matrix(scene, robot, payload, holders)
    entry = _obstacles(file, folder, placed.base, out, [*options.supports, *supports])
    data: dict[str, Any] = {"version": 2, "name": named}
    data["workspace"] = _workspace((start, goal), shape, grasps, meshes)
    data |= {"obstacles": [entry]} if entry else {}
    mass = {"mass": payload.mass} if payload.mass > 0.0 else {}
    data["payload"] = shape | mass | {"start": _written(start), "goal": _written(goal)}
    data["grasps"] = grasps
    where = "where the robot has it" if scene.frame in _links(robot) else "taken for the scene's own"
    told = [f"the planning frame '{shortened(scene.frame)}' is {where}"]
    return ImportedScene(data, meshes, placed.present, is_held, (*told[: bool(scene.frame)], *notes))


def with_supports_at_rest(data: dict[str, Any], folder: Path) -> tuple[dict[str, Any], list[str]]:
    """Return a scene with those supports on which its payload rests.

    The names of the others are returned as well, which the scene may not have.
    """
    entry = next((one for one in data.get("obstacles", ()) if one.get("supports")), None)
    if entry is None:
        return data, []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)  # they come once, with the last scene
        scene = Scene.from_dict(data, folder=folder, check_ends=False)
    found = obstacles_in(folder / entry["file"])
    names = [one["name"] for one in found if one["name"] not in entry.get("leave_out", ())]
    resting = sorted({rest.obstacle for rest in scene.rests})
    idle = [name for name in entry["supports"] if name not in {names[i] for i in resting}]
    at_rest = [names[i] if names.count(names[i]) == 1 else scene.file.obstacles[i].name for i in resting]
    kept = {key: value for key, value in entry.items() if key != "supports"}
    if at_rest:
        kept["supports"] = at_rest
    return data | {"obstacles": [kept]}, idle


def _joints(scene: PlanningScene, robot: Robot, options: ImportOptions) -> tuple[Array, dict[str, float]]:
    """Return the joints in the robot's order, and by name if given. They are home unless given."""
    given = dict(scene.joints)
    if options.state is not None and options.srdf is not None:
        srdf = srdf_of(elements_in(options.srdf, SRDF), _links(robot))
        states = [state for state in srdf.states if state.name == options.state]
        if not states:
            way_out = near_name(options.state, dict.fromkeys(state.name for state in srdf.states))
            told = f"it has no group state '{shortened(options.state)}'"
            raise RobotError(told, file=options.srdf, key="--state", way_out=way_out)
        given |= {name: value for state in states for name, value in state.values.items()}
    elif options.state is not None or options.srdf is not None:
        told = "a group state is given by its name and the SRDF that has it"
        raise SceneError(told, key="--state", way_out="give both --srdf FILE and --state NAME, or neither")
    if not given:
        return robot.home, {}
    q = present_joints(given, robot, "robot_state")
    return q, dict(zip(robot.joint_names, q.tolist(), strict=True))


def _payload_of(scene: PlanningScene, options: ImportOptions, file: Path) -> tuple[AttachedObject, bool]:
    """Return the payload's object, and whether it is attached."""
    attached = {one.object.name: one for one in scene.attached}
    world = {one.name: one for one in scene.objects}
    given = [("--leave-out", one) for one in options.leave_out] + [
        ("--support", one) for one in options.supports
    ]
    for key, name in given:
        if name not in world and (name not in attached or key == "--support"):
            way_out = near_name(name, [*attached, *world])
            raise SceneError(f"it holds no '{shortened(name)}'", file=file, key=key, way_out=way_out)
    left = [key for key in attached if key not in options.leave_out]
    if options.payload is None and not left:
        raise SceneError(
            "nothing is attached to the robot, and a scene has a payload",
            file=file,
            way_out=f"name the object that is carried: --payload NAME (it holds {listed([*world]) or 'none'})",
        )
    name = left[0] if options.payload is None else options.payload
    if others := [key for key in left if key != name]:
        raise SceneError(
            f"{listed(others)} {'is' if len(others) == 1 else 'are'} attached to the robot besides the payload "
            f"'{shortened(name)}'",
            file=file,
            way_out="name the payload by --payload, and leave the others out: "
            + " ".join(f"--leave-out {shlex.quote(key)}" for key in others),
        )
    if name in attached:
        return attached[name], True
    if name not in world:
        way_out = near_name(name, [*attached, *world])
        raise SceneError(f"it holds no '{shortened(name)}'", file=file, key="--payload", way_out=way_out)
    return AttachedObject(world[name], ""), False


def _holders(robot: Robot, payload: AttachedObject) -> tuple[Arm, ...]:
    """Return the arms that hold the payload. Their hands are attached to it, or may touch it."""
    touching = {payload.link, *payload.touch_links}
    found = tuple(arm for arm in robot.arms if touching & _hand_links(robot, arm))
    if not any(payload.link in _hand_links(robot, arm) for arm in found):
        hands = {link: None for arm in robot.arms for link in sorted(_hand_links(robot, arm))}
        raise SceneError(
            f"'{shortened(payload.object.name)}' is attached to '{shortened(payload.link)}', and no hand of "
            f"'{robot.name}' has such a link",
            way_out=f"attach it to one of {listed([*hands], 12)}",
        )
    return found


def _hand_links(robot: Robot, arm: Arm) -> frozenset[str]:
    """Return the links that an arm's last joint moves."""
    joint, _ = robot.grasp_frame(arm)
    frames = robot.model.frames
    return frozenset(f.name for f in frames if f.type == pin.FrameType.BODY and f.parentJoint == joint)


def _links(robot: Robot) -> frozenset[str]:
    return frozenset(frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY)


def _placed(robot: Robot, link: str, q: Array) -> Array:
    """Return the pose of a link in the scene; array, shape (4, 4)."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    found: Array = data.oMf[robot.model.getFrameId(link, pin.FrameType.BODY)].homogeneous
    return found


def _payload_shape(one: CollisionObject, stem: str) -> tuple[Array, dict[str, Any], dict[str, bytes]]:
    """Return the payload's frame in the object's, its shape, and meshes."""
    meshes = dict[str, bytes]()
    if len(one.shapes) == 1 and one.shapes[0].kind in ("box", "cylinder", "mesh"):
        (shape,) = one.shapes
        return shape.pose, _part(one.name, shape._replace(pose=np.eye(4)), stem, meshes), meshes
    parts = [_part(one.name, shape, stem, meshes) for shape in one.shapes]
    return np.eye(4), {"shape": "parts", "parts": parts}, meshes


def _part(name: str, shape: PlacedShape, stem: str, meshes: dict[str, bytes]) -> dict[str, Any]:
    """Return a shape as a payload's part. Its mesh is added to `meshes`."""
    if shape.kind == "plane":
        raise SceneError(
            f"'{shortened(name)}' is a plane, and no payload has that shape",
            key=shape.where,
            way_out="write it as a box, a cylinder, a sphere or a mesh",
        )
    entry = obstacle_of(name, shape, np.eye(4))
    if shape.kind == "sphere":
        entry = {
            "shape": "bar",
            "length": POINT * entry["radius"],
            "radius": entry["radius"],
            "center": entry["center"],
        }
    if shape.mesh is not None:
        more = f"-{len(meshes) + 1}" if meshes else ""
        entry["file"] = f"{stem}-{_name(name)}{more}.off"
        meshes[entry["file"]] = as_off(shape.mesh)
    entry.pop("center"), entry.pop("quaternion_wxyz", None)
    return entry | ({} if np.array_equal(shape.pose, np.eye(4)) else _written(shape.pose))


def _matrix(
    scene: PlanningScene, robot: Robot, payload: AttachedObject, holders: Sequence[Arm]
) -> tuple[list[str], list[str]]:
    """Return the supports that the allowed collision matrix makes.

    What it says besides, and a scene cannot, is returned in words.
    """
    links, world = _links(robot), {one.name for one in scene.objects}
    name = payload.object.name
    hands = {link for arm in holders or robot.arms for link in _hand_links(robot, arm)}
    supports, stricter, anything = set[str](), set[tuple[str, str]](), set[str]()
    kept = _kept_apart(robot)
    for pair in scene.allowed:
        if len(pair) == 1:
            anything |= pair
            continue
        a, b = sorted(pair)
        if name in pair and (other := next(iter(pair - {name}))) in world:
            supports.add(other)
        elif (name in pair and pair & hands) or (pair <= links and pair not in kept) or not pair & links:
            continue  # which scenes say too, or compare with nothing
        elif not (pair & world and any(_is_fixed(robot, link) for link in pair & links)):
            stricter.add((a, b))
    notes = []
    if stricter:
        told = listed([f"'{a}' and '{b}'" for a, b in sorted(stricter)], 6)
        notes.append(f"the matrix lets touch what comove keeps apart (of links, an SRDF may say so): {told}")
    if anything:
        told = listed([repr(one) for one in sorted(anything)], 6)
        notes.append(f"the matrix lets everything touch {told}, and comove keeps a clearance from that")
    ignored = {frozenset((a, b)) for a in scene.compared & links for b in scene.compared & links if a != b}
    ignored -= scene.allowed | kept | {pair for pair in ignored if pair & anything}
    ignored = {pair for pair in ignored if not _move_together(robot, *pair)}
    if ignored and scene.allowed:
        told = listed(sorted(" and ".join(map(repr, sorted(pair))) for pair in ignored), 6)
        notes.append(f"the matrix keeps apart what the robot's description does not compare: {told}")
    if scene.padded:
        told = listed([repr(one) for one in sorted(scene.padded)], 6)
        notes.append(f"links are padded or scaled, for which limits: {{clearance: METRES}} may stand: {told}")
    return sorted(supports), notes


def _kept_apart(robot: Robot) -> set[frozenset[str]]:
    """Return the pairs of links that comove compares."""
    objects, frames = robot.collision.geometryObjects, robot.model.frames
    return {
        frozenset(frames[objects[number].parentFrame].name for number in (pair.first, pair.second))
        for pair in robot.collision.collisionPairs
    }


def _is_fixed(robot: Robot, link: str) -> bool:
    return robot.model.frames[robot.model.getFrameId(link, pin.FrameType.BODY)].parentJoint == 0


def _move_together(robot: Robot, a: str, b: str) -> bool:
    one, other = (
        robot.model.frames[robot.model.getFrameId(x, pin.FrameType.BODY)].parentJoint for x in (a, b)
    )
    return bool(one == other or robot.model.parents[one] == other or robot.model.parents[other] == one)


def _obstacles(
    file: Path, folder: Path, base: Array, left_out: set[str], supports: Sequence[str]
) -> dict[str, Any] | None:
    """Return the entry of a scene for the obstacles, or None."""
    found = obstacles_in(file)
    names = {entry["name"] for entry in found}
    for entry in found:
        if entry["name"] not in left_out and (error := entry.get("refused")) is not None:
            way_out = f"leave it out: --leave-out {shlex.quote(entry['name'])}, or record it otherwise"
            raise SceneError(error.message, file=file, key=error.key, way_out=way_out)
    if not names - left_out:
        return None
    entry = {"shape": "moveit", "file": file.resolve().relative_to(folder.resolve()).as_posix()}
    if not np.array_equal(base, np.eye(4)):
        pose = _written(base)
        entry |= {"center": pose["position"]} | {key: pose[key] for key in pose if key != "position"}
    entry |= {"leave_out": sorted(names & left_out)} if names & left_out else {}
    kept = [name for name in dict.fromkeys(supports) if name in names - left_out]
    return entry | ({"supports": kept} if kept else {})


def _workspace(
    ends: tuple[Array, Array], shape: dict[str, Any], grasps: Any, meshes: Mapping[str, bytes]
) -> dict[str, Any]:
    """Return a workspace around the payload and its grasps at both ends."""
    parts = shape.get("parts", [shape])
    reaches = [_radius(part, meshes) + float(np.linalg.norm(part.get("position", 0.0))) for part in parts]
    if grasps != "auto":
        reaches += [float(np.linalg.norm(grasp["position"])) for grasp in grasps.values()]
    around = max(reaches) + MARGIN
    middles = np.array([end[:3, 3] for end in ends])
    lower, upper = middles.min(axis=0) - around, middles.max(axis=0) + around
    return {"lower": np.round(lower, 3).tolist(), "upper": np.round(upper, 3).tolist()}


def _radius(part: Mapping[str, Any], meshes: Mapping[str, bytes]) -> float:
    """Return the distance of a part's farthest point from its frame [m]."""
    if part["shape"] == "mesh":
        lines = meshes[part["file"]].decode().splitlines()
        vertices = np.array(
            [line.split() for line in lines[2 : 2 + int(lines[1].split()[0])]], dtype=np.float64
        )
        return float(np.linalg.norm(vertices, axis=1).max())
    if part["shape"] == "box":
        return float(np.linalg.norm(part["size"])) / 2
    return float(part["radius"] + part.get("height", part.get("length", 0.0)))


def _written(pose: Array) -> dict[str, Any]:
    """Return a pose as keys of a scene."""
    written = {"position": (np.round(pose[:3, 3], DIGITS) + 0.0).tolist()}
    if np.array_equal(pose[:3, :3], np.eye(3)):
        return written
    return written | {"quaternion_wxyz": quaternion_of_rotation(pose[:3, :3]).tolist()}


def _name(text: str) -> str:
    return re.sub(r"[^\w+-]+", "_", text).strip("_+-")[: MAX_NAME - 10] or "payload"

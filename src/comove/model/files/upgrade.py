"""Conversion of version 1 scenes to version 2. Poses of the payload and grasps replace the ends of manipulators."""

from __future__ import annotations

from collections.abc import Mapping
from math import degrees
from typing import Any

import numpy as np
import yaml

from comove.arrays import Array
from comove.geometry.rotations import facing, fit_quaternion, matrices, quaternion_of_rotation
from comove.model.files.keys import BarLoad, SceneFile, Turned
from comove.model.grasp import Grasp, alternatives
from comove.model.groups import GroupPose, RigidGroup
from comove.model.rigid import ENDS, load_shape
from comove.model.scene import Scene
from comove.model.shapes import LOAD, read_meshes, spatial

DIGITS = 13
"""Decimals of lengths [m] and directions that are written."""
UPRIGHT = 89.9
"""Pitch from which an orientation is written as a quaternion [deg]."""
KEPT = ("obstacles", "limits", "constraints", "demonstration", "objective")
"""Keys that mean the same in both versions."""


def upgraded(scene: Scene, data: Mapping[str, Any]) -> dict[str, Any]:
    """Return version 2 contents that describe the same scene.

    Parameters
    ----------
    scene : the scene that `data` describes
    data : contents of a file of version 1

    Returns
    -------
    dict, whose text is that of `as_text`
    """
    file = scene.file
    new: dict[str, Any] = {"version": 2, "name": file.name}
    new |= {key: data[key] for key in ("duration", "robot", "workspace") if data.get(key) is not None}
    ends = {m.name: {"start": [*m.start], "goal": [*m.goal]} for m in file.manipulators}
    if file.load is not None:
        members = set(file.holder_numbers)
        group = next(group for group in scene.groups if members <= set(group.members))
        frame = _frame_of(scene, group)
        poses = [_posed(pose, frame) for pose in (group.start, group.goal)]
        new["payload"] = _payload(data["load"], file.load)
        new["payload"] |= {end: _pose(pose, scene.n_dims) for end, pose in zip(ENDS, poses, strict=True)}
        held = (group.grasps - frame.center) @ frame.rotation
        at = {file.names[i]: _rounded(held[k, : scene.n_dims]) for k, i in enumerate(group.members)}
        grasps = [scene.held_as(part).grasp for part in alternatives(file)] or [None]
        sets = [_grasps(scene, at, grasp, poses[0]) for grasp in grasps]
        new["grasps"] = sets[0] if len(sets) == 1 else sets
        ends = {
            name: own | _of_free_hand(scene, name, group, grasps[0], poses[0])
            for name, own in ends.items()
            if name not in file.holders
        }
    if ends:
        new["end_effectors"] = ends
    new |= {key: data[key] for key in KEPT if data.get(key)}
    if file.grasp is not None and not any(constraint.type == "upright" for constraint in file.constraints):
        new["constraints"] = [*new.get("constraints", []), {"type": "upright"}]
    return new


def has_poses(file: SceneFile) -> bool:
    """Return whether a scene has payload poses and grasps in its frame."""
    own = file.load is not None and file.load.start is not None and file.load.goal is not None
    return own and (file.grasp is None or file.grasp.frames is not None)


def written(file: SceneFile) -> dict[str, Any]:
    """Return version 2 contents of a scene that `has_poses`."""
    data, load = file.model_dump(mode="json", exclude_defaults=True), file.load
    assert load is not None and load.start is not None and load.goal is not None, "see `has_poses`"
    new: dict[str, Any] = {"version": 2, "name": file.name}
    new |= {key: data[key] for key in ("duration", "robot", "workspace") if data.get(key) is not None}
    shape = data["load"] | {"shape": load.shape}
    parts = shape.get("parts", ())
    if (
        len(parts) == 1
        and not {"position", *Turned.orientation_keys()} & {*parts[0]}
        and parts[0]["shape"] != "hull"
    ):
        shape = (
            {"shape": parts[0]["shape"]} | parts[0] | {key: shape[key] for key in ("mass",) if key in shape}
        )
    new["payload"] = _payload({key: value for key, value in shape.items() if key not in ENDS}, load)
    first = (file.choices or (None,))[0]
    for end in ENDS:
        pose = first.goal if first is not None and end == "goal" else getattr(load, end)
        turn = matrices(np.array(pose.quaternion_wxyz))
        new["payload"][end] = _pose(GroupPose(spatial(np.array(pose.position)), turn), file.dimension)
    if first is not None and first.free is not None:
        new["payload"]["goal"]["free"] = first.free
    frames = None if file.grasp is None else file.grasp.frames
    ways: list[tuple[Mapping[str, Any], Mapping[str, Any] | None]] = [(held_at(file), frames)]
    ways = [(choice.grasps, choice.frames) for choice in file.choices or ()] or ways
    sets = [
        {
            name: {"position": [*at]} | ({} if frames is None else _frame(frames[name]))
            for name, at in grasps.items()
        }
        for grasps, frames in ways
    ]
    new["grasps"] = sets[0] if len(sets) == 1 else sets
    others = [m for m in file.manipulators if m.name not in file.holders]
    if others:
        new["end_effectors"] = {m.name: {"start": [*m.start], "goal": [*m.goal]} for m in others}
    return new | {key: data[key] for key in KEPT if data.get(key)}


def held_at(file: SceneFile) -> dict[str, list[float]]:
    """Return a payload's grasp positions in its frame by name."""
    load = file.load
    assert load is not None and load.start is not None, "the payload has poses"
    if getattr(load, "grasps", None):
        return {name: [*at] for name, at in load.grasps.items()}  # type: ignore[union-attr]
    turn, middle = matrices(np.array(load.start.quaternion_wxyz)), spatial(np.array(load.start.position))
    at = {
        m.name: (spatial(np.array(m.start)) - middle) @ turn
        for m in file.manipulators
        if m.name in file.holders
    }
    return {name: _rounded(place[: file.dimension]) for name, place in at.items()}


def _frame(quaternion: tuple[float, ...]) -> dict[str, Any]:
    """Return a grasp frame's orientation, by directions if along its parent's axes."""
    frame = matrices(np.array(quaternion))
    if np.abs(frame - frame.round()).max() < 10.0**-DIGITS:
        return {"approach": _rounded(frame[:, 2]), "closing": _rounded(frame[:, 1])}
    return {"quaternion_wxyz": [*quaternion]}


def as_text(contents: Mapping[str, Any]) -> str:
    """Return a scene file as YAML, one line per part."""
    lines = list[str]()
    for key, value in contents.items():
        if isinstance(value, dict) and any(isinstance(part, dict) for part in value.values()):
            lines += [f"{key}:", *(f"  {name}: {_inline(part)}" for name, part in value.items())]
        elif isinstance(value, list) and any(isinstance(part, dict) for part in value):
            lines += [f"{key}:", *(f"  - {_inline(part)}" for part in value)]
        else:
            lines.append(f"{key}: {_inline(value)}")
    return "\n".join(lines) + "\n"


class _Plain(yaml.SafeDumper):
    """A writer that repeats equal lists in full."""

    def ignore_aliases(self, data: Any) -> bool:
        """Return True, so that nothing is written as an alias."""
        return True


def _inline(value: Any) -> str:
    text = yaml.dump([value], Dumper=_Plain, sort_keys=False, default_flow_style=True, width=10_000_000)
    return text.strip()[1:-1]


def _payload(data: Mapping[str, Any], load: Any) -> dict[str, Any]:
    """Return the keys of the payload's shape."""
    left_out = ("held_by", "grasps", "overhang")
    payload = {key: value for key, value in data.items() if key not in left_out and value is not None}
    if isinstance(load, BarLoad) and load.overhang:
        payload["length"] = load.length + 2 * load.overhang
    return payload


def _frame_of(scene: Scene, group: RigidGroup) -> GroupPose:
    """Return the pose of the payload's frame in the group's."""
    file = scene.file
    mesh = read_meshes(file, scene.folder, scene.path).get(LOAD)
    decomposition = None if mesh is None else mesh[0].decomposed(mesh[1].resolution, few=True)
    holders = tuple(i for i in group.members if i in file.holder_numbers)
    grasps, corners = load_shape(file, holders, decomposition)
    own, there = corners, group.corners[: len(corners)]
    if grasps is not None:
        held = group.grasps[[group.members.index(i) for i in holders]]
        own, there = np.concatenate([grasps, own]), np.concatenate([held, there])
    if not len(own):  # a frame of rods has none of its own
        return GroupPose(np.zeros(3), np.eye(3))
    if isinstance(file.load, BarLoad):
        x = (there[1] - there[0]) * (own[1, 0] - own[0, 0])
        x /= np.linalg.norm(x)
        turn = np.eye(3) if x[0] == 1.0 else facing(x)
        return GroupPose(there[:2].mean(axis=0), turn)
    turn = matrices(fit_quaternion(own, there))
    return GroupPose(there.mean(axis=0) - turn @ own.mean(axis=0), turn)


def _posed(pose: GroupPose, frame: GroupPose) -> GroupPose:
    return GroupPose(pose.place(frame.center[None])[0], pose.rotation @ frame.rotation)


def _grasps(
    scene: Scene, at: Mapping[str, list[float]], grasp: Grasp | None, start: GroupPose
) -> dict[str, Any]:
    return {
        name: {"position": at[name]} | _turned(scene, name, grasp, start.rotation)
        for name in scene.file.names
        if name in scene.file.holders
    }


def _of_free_hand(
    scene: Scene, name: str, group: RigidGroup, grasp: Grasp | None, start: GroupPose
) -> dict[str, Any]:
    """Return the orientation of a robot's free end effector. It is in the payload's frame if it moves with it."""
    goes_along = scene.manipulators.index(name) in group.members
    return _turned(scene, name, grasp, start.rotation if goes_along else np.eye(3))


def _turned(scene: Scene, name: str, grasp: Grasp | None, parent: Array) -> dict[str, Any]:
    """Return a grasp frame's start orientation in a parent frame, if any."""
    if grasp is None:
        return {}
    hands = scene.nodes_at("start")
    frame = parent.T @ grasp.hand_rotations(hands)[scene.manipulators.index(name)]
    return _frame(tuple(quaternion_of_rotation(frame).tolist()))


def _pose(pose: GroupPose, n_dims: int) -> dict[str, Any]:
    """Return a pose as written, without the world's orientation."""
    written: dict[str, Any] = {"position": _rounded(pose.center[:n_dims])}
    turn = pose.rotation
    pitch = degrees(np.arcsin(np.clip(-turn[2, 0], -1.0, 1.0)))
    yaw = degrees(np.arctan2(turn[1, 0], turn[0, 0]))
    if abs(pitch) > UPRIGHT:
        return written | {"quaternion_wxyz": quaternion_of_rotation(turn).tolist()}
    angles = _rounded([degrees(np.arctan2(turn[2, 1], turn[2, 2])), pitch, yaw])
    if not any(angles):
        return written
    return written | ({"angle_deg": angles[2]} if n_dims == 2 else {"rpy_deg": angles})


def _rounded(values: Any) -> list[float]:
    return (np.round(np.asarray(values, dtype=np.float64), DIGITS) + 0.0).tolist()

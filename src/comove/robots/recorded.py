"""End-effector paths from recordings of a robot's joints, by forward kinematics.

A recording's joints are found by their names: the same as in the description, or the same words at the end
(`joint1` for `panda_joint1`, `shoulder_pan.pos` for `left_shoulder_pan`). Joints without names in the recording are
those of the arm in order.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from comove.dmp.demonstrations import Demonstration
from comove.dmp.demonstrations.samples import fault
from comove.errors import ComoveWarning, listed
from comove.robots.model import Arm, Robot
from comove.robots.urdf import OF_JOINT

BEYOND = 0.05
"""How far a joint may be recorded beyond its limits without a warning [rad, m for prismatic joints]."""
_MOVED = 1e-3
"""How far a recorded joint may be from where the description holds it [rad, m for prismatic joints]."""
_UNNAMED = re.compile(r"(joint|.*\[)\d+\]?")
_IDLE_WORDS = ("joint", "pos", "position", "q", "angle", "state")


def end_effector_path(recording: Demonstration, robot: Robot, arm: str | None = None) -> Demonstration:
    """Return the path of an arm's grasp frame, in the robot's frame.

    Parameters
    ----------
    recording : movement of joints, with their names as `axes`; angles in any unit
    robot : robot that was recorded
    arm : name of the arm; by default the only one whose joints were recorded

    Returns
    -------
    path : positions [m] and orientations at the recorded times

    Raises
    ------
    DemonstrationError
        If the recording is none of joints, its unit is unknown, joints of the arm are missing, or several arms could
        be meant.

    Warns
    -----
    ComoveWarning
        If a joint was recorded beyond its limits.
    """
    name, recording = recording.name or None, recording.in_base_unit()
    if not recording.is_joints:
        message = f"it holds positions in {recording.unit}, not joints of the robot '{robot.name}'"
        raise fault(name, "robot", message, "leave the robot out, or choose joints of the recording")
    if recording.unit != "rad":
        message = f"its joints are in {recording.unit}, and a robot needs radians"
        raise fault(name, "unit", message, "say the unit of the recording, such as deg", unit="deg")
    chosen, columns = _arm_of(recording, robot, arm)
    _require_held(recording, robot, chosen)
    joints = np.tile(robot.home, (recording.n_steps, 1))
    joints[:, chosen.columns] = recording.position[:, columns]
    beyond = np.maximum(joints - robot.upper, robot.lower - joints)[:, chosen.columns].max(axis=0)
    if (beyond > BEYOND).any():
        worst = int(np.argmax(beyond))
        warnings.warn(
            f"{recording.name}: the joint '{robot.joint_names[chosen.columns[worst]]}' was recorded "
            f"{beyond[worst]:.3g} rad beyond its limits; its unit, zero or sign may be another one",
            ComoveWarning,
            stacklevel=2,
        )
    poses = robot.tool_poses(joints, (chosen,))[:, 0]
    taken = [recording.axes[column] for column in columns] if recording.axes else []
    note = f"end effector of '{chosen.name}' of the robot '{robot.name}'"
    note += f", from the joints {listed(taken, 8)}" if taken else ""
    return Demonstration(
        recording.time,
        poses[:, :3, 3],
        recording.name,
        (*recording.notes, note),
        orientation=Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]],
        stated=recording.stated,
    )


def _arm_of(recording: Demonstration, robot: Robot, arm: str | None) -> tuple[Arm, list[int]]:
    """Return the recorded arm, and its joints' columns in the recording."""
    arms = robot.arms if arm is None else (robot.arm(arm),)
    found = {
        one.name: _columns_of(recording.axes, [robot.joint_names[c] for c in one.columns]) for one in arms
    }
    whole = {one: columns for one, columns in found.items() if None not in columns}
    key = recording.name or None
    if not whole:
        nearest = min(found, key=lambda one: found[one].count(None))
        joints = [robot.joint_names[column] for column in robot.arm(nearest).columns]
        missing = [joint for joint, column in zip(joints, found[nearest], strict=True) if column is None]
        held = listed(recording.axes, 12) or f"{recording.n_dims} joints without names"
        raise fault(
            key,
            "robot",
            f"it holds {held}, and not {listed(missing, 8)} of the arm '{nearest}' of '{robot.name}'",
            "name the robot that was recorded",
        )
    if len(whole) > 1:
        message = f"its joints may be those of {listed(list(whole), 10)}"
        raise fault(key, "arm", message, "name the arm", arm=next(iter(whole)))
    ((chosen, columns),) = whole.items()
    return robot.arm(chosen), [column for column in columns if column is not None]


def _columns_of(axes: Sequence[str], joints: Sequence[str]) -> list[int | None]:
    """Return each joint's column in a recording. None for no match, or several."""
    if all(map(_UNNAMED.fullmatch, axes)) and len(axes) >= len(joints) and not set(axes) & set(joints):
        return list(range(len(joints)))
    words = [_words(axis) for axis in axes]
    found: list[int | None] = []
    for joint in joints:
        own = _words(joint)
        exact = [i for i, axis in enumerate(axes) if axis == joint or words[i] == own]
        alike = exact or [
            i for i, other in enumerate(words) if own[-len(other) :] == other or other[-len(own) :] == own
        ]
        found.append(alike[0] if len(alike) == 1 else None)
    return found if len(set(found)) == len(found) else [None] * len(joints)


def _words(name: str) -> list[str]:
    words = [word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+", name)]
    words = words[1:] if words[:1] == ["k"] and len(words) > 1 else words  # as kLeftElbow
    while len(words) > 1 and words[-1] in _IDLE_WORDS:
        words = words[:-1]
    return words


def _require_held(recording: Demonstration, robot: Robot, arm: Arm) -> None:
    """Raise if a recorded joint below the arm leaves its posture."""
    for joint in _supports(robot, arm.tip):
        held = robot.description.posture.get(joint)
        if held is None or joint not in recording.axes:
            continue
        away = np.abs(recording.position[:, recording.axes.index(joint)] - held).max()
        if away > _MOVED:
            raise fault(
                recording.name or None,
                joint,
                f"it is recorded up to {away:.3g} rad from {held:g}, where the robot '{robot.name}' holds it",
                "take it out of the description's posture, or choose other joints of the recording",
            )


def _supports(robot: Robot, tip: str) -> list[str]:
    """Return the names of joints between a frame and its base."""
    above, found = robot.joints_above, list[str]()
    moved = {name: link for link, (name, *_) in above.items()}
    link = tip if tip in above else moved.get(tip.removesuffix(OF_JOINT), tip)
    while link in above:
        name, link, _ = above[link]
        found.append(name)
    return found

"""Present joints: a robot's joints before its approach, read and checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from comove.arrays import Array
from comove.errors import RobotError, near_name
from comove.io.yaml_reader import read_yaml
from comove.results.sealed import read_json
from comove.robots.description import errors_in
from comove.robots.files import JOINTS
from comove.robots.model import Robot, frame_of_joint
from comove.robots.verification.bodies import beyond_wrists

Joints = Mapping[str, float] | Array
"""A value for each moving joint of a robot, by name or in the order of `Robot.joint_names` [rad, m]."""

SAME_POSTURE = 0.05  # rad or m, by which a joint that the description locks may differ from it
JOINT_STATE = ("name", "position")  # of sensor_msgs/JointState


def read_present(file: Path, robot: Robot) -> dict[str, float]:
    """Read present joints from a file (YAML, JSON) that holds {joint: value}, or names and positions.

    The latter is a JointState as ``ros2 topic echo --once`` prints it.

    Returns
    -------
    dict, joint positions by name, for each moving joint of the robot [rad, m]

    Raises
    ------
    SceneError, RobotError
        If the file cannot be read, or as `present_joints`.
    """
    data, _ = read_yaml(file)
    with errors_in(file):
        if set(JOINT_STATE) <= set(data):
            names, values = (data[key] for key in JOINT_STATE)
            if not isinstance(names, list) or not isinstance(values, list) or len(names) != len(values):
                raise RobotError(
                    "name and position are not two lists of one length",
                    key="position",
                    way_out="give one value a joint, or {joint: value}",
                )
            if twice := sorted({str(name) for name in names if names.count(name) > 1}):
                raise RobotError(f"'{twice[0]}' is there twice", key="name", way_out="give each joint once")
            data = dict(zip(map(str, names), values, strict=True))
        found = present_joints(data, robot)
    return dict(zip(robot.joint_names, found.tolist(), strict=True))


def stored_present(folder: str | Path, robot: Robot) -> Array | None:
    """Return the joints before the approach of a stored motion. None stands for home.

    Raises
    ------
    ResultError, RobotError
        If the summary cannot be read, or has joints that are not the robot's.
    """
    file = Path(folder) / JOINTS.summary
    told = read_json(file, JOINTS.hint).get("present")
    if told is None:
        return None
    with errors_in(file):
        if not isinstance(told, dict):
            raise RobotError("it is no mapping of joints", key="present", way_out="solve the scene again")
        return present_joints(told, robot)


def present_joints(given: Joints | None, robot: Robot, key: str = "present") -> Array:
    """Return joint positions in the order of the robot's joints; home unless given.

    Grippers' joints may be among those given, and other joints that the description locks, where they are as it has
    them.

    Parameters
    ----------
    given : a value for each moving joint of the robot [rad, m]
    key : name of the argument, for messages

    Returns
    -------
    array, shape (n_joints,) [rad, m]

    Raises
    ------
    RobotError
        If a joint is unknown or missing, or a value is no number, outside the joint's limits, or unlike the posture
        that the description locks.
    """
    if given is None:
        return robot.home
    names = robot.joint_names
    if not isinstance(given, Mapping):
        try:
            values = np.asarray(given)
        except ValueError:  # of lists of several lengths
            values = np.empty(0, dtype=object)
        if values.shape != (len(names),) or values.dtype.kind not in "iuf":
            raise RobotError(
                f"it is an array of {values.dtype.name}, shape {values.shape}, and '{robot.name}' has "
                f"{len(names)} joints",
                key=key,
                way_out=f"give a number for each of {', '.join(names)}, or {{joint: value}}",
            )
        given = dict(zip(names, values.tolist(), strict=True))
    _require_locked_ones(given, robot, key)
    if missing := [name for name in names if name not in given]:
        raise RobotError(
            f"{', '.join(missing)} of '{robot.name}' {'is' if len(missing) == 1 else 'are'} missing",
            key=key,
            way_out="give a value for each joint of all arms",
        )
    return np.array(
        [_within_limits(robot, k, _number(given[name], key, name), key) for k, name in enumerate(names)]
    )


def _number(value: Any, key: str, name: str) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float, np.number)) or not math.isfinite(value):
        raise RobotError(f"it is {value!r}", key=f"{key}.{name}", way_out="give a finite number in rad, or m")
    return float(value)


def _within_limits(robot: Robot, column: int, value: float, key: str) -> float:
    """Return a joint's value; reject one outside its limits."""
    lower, upper, name = float(robot.lower[column]), float(robot.upper[column]), robot.joint_names[column]
    if lower <= value <= upper:
        return value
    slides = robot.model.joints[column + 1].shortname().startswith("JointModelP")
    unit, other, right = (
        ("m", "millimetres", 1e-3 * value) if slides else ("rad", "degrees", math.radians(value))
    )
    way_out = f"give a value between {lower:.10g} and {upper:.10g} {unit}"
    told = f"it is {value:g} {unit}, outside its limits"
    if abs(value) > (2.0 if slides else math.pi) and lower <= right <= upper:
        told, way_out = f"{told}: {other}, it seems", f"give all joints in {unit}: {right:.6g} for this one"
    raise RobotError(told, key=f"{key}.{name}", way_out=way_out)


def _require_locked_ones(given: Mapping[str, Any], robot: Robot, key: str) -> None:
    """Reject unknown joints, and locked ones elsewhere, except in grippers."""
    posture, model = robot.description.posture, robot.model
    in_grippers = beyond_wrists(robot, robot.arms)
    for name, value in given.items():
        if name in robot.joint_names:
            continue
        frame = frame_of_joint(model, str(name))
        if frame == len(model.frames) or model.frames[frame].type == pin.FrameType.BODY:
            way_out = near_name(str(name), robot.joint_names)
            raise RobotError(f"'{robot.name}' has no joint '{name}'", key=key, way_out=way_out)
        if name not in posture or model.frames[frame].parentJoint in in_grippers:
            continue
        if abs(_number(value, key, name) - posture[name]) > SAME_POSTURE:
            raise RobotError(
                f"it is {value:g}, and the description of '{robot.name}' keeps it at {posture[name]:g}",
                key=f"{key}.{name}",
                way_out=f"write posture: {{{name}: {value:g}}} in the description, or move the joint there",
            )

"""Requests of MoveIt 2 for motions: what they ask of two arms that hold one payload.

A goal is a pose of the payload, or of a link of one hand with which the payload goes, or the joints of all arms. It
becomes a displacement: as the hands keep their grasps, it is the same of all that moves. The fields of a request are
those of `moveit_msgs/MotionPlanRequest`.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from comove.arrays import Array
from comove.arrays import listed as numbers
from comove.errors import InputError, listed, shortened
from comove.model.constraints.kinds import MAX_TOLERANCE
from comove.model.files.moveit import homogeneous
from comove.robots.formats import SRDF, elements_in
from comove.robots.model import Robot
from comove.robots.planning_scenes import PlacedPayload
from comove.robots.present import present_joints
from comove.robots.proposal.tree import Tree

Fields = Mapping[str, Any]
SAME, SAME_TURN = 1e-3, math.radians(0.1)
"""How far apart poses of the payload may be that are asked for at once [m, rad]."""
KEPT = math.radians(0.1)
"""Largest rotation by which an orientation that is kept may differ [rad]."""
EQUAL = 1e-6
"""Difference of orientations that counts as none [rad]."""
REGIONS = {1: "box", 2: "sphere", 3: "cylinder"}
"""Shapes whose centre is in their middle, by their number in `shape_msgs/SolidPrimitive`."""
XYZ_EULER, ROTATION_VECTOR = 0, 1


class ErrorCode(IntEnum):
    """Codes of `moveit_msgs/MoveItErrorCodes`."""

    SUCCESS = 1
    FAILURE = 99999
    PLANNING_FAILED = -1
    CONTROL_FAILED = -4
    TIMED_OUT = -6
    PREEMPTED = -7
    START_STATE_IN_COLLISION = -10
    START_STATE_VIOLATES_PATH_CONSTRAINTS = -11
    GOAL_IN_COLLISION = -12
    GOAL_VIOLATES_PATH_CONSTRAINTS = -13
    GOAL_CONSTRAINTS_VIOLATED = -14
    INVALID_GROUP_NAME = -15
    INVALID_GOAL_CONSTRAINTS = -16
    INVALID_ROBOT_STATE = -17
    INVALID_LINK_NAME = -18
    INVALID_OBJECT_NAME = -19
    FRAME_TRANSFORM_FAILURE = -21
    COLLISION_CHECKING_UNAVAILABLE = -22
    CRASH = -29
    NO_IK_SOLUTION = -31


class Refusal(Exception):
    """Request that cannot be met.

    Parameters
    ----------
    code : code of the reason
    text : the reason, with advice
    """

    def __init__(self, code: ErrorCode, text: str):
        super().__init__(text)
        self.code, self.text = code, text

    @classmethod
    def of(cls, code: ErrorCode, error: InputError) -> Refusal:
        """Return the refusal for an error, without the file that it names: it is comove's own."""
        key = "" if error.key is None or error.message.startswith(f"{error.key} ") else f"{error.key}: "
        return cls(code, f"{key}{error.message}" + (f"; {error.way_out}" if error.way_out else ""))


@dataclass(frozen=True, eq=False)
class PayloadGoal:
    """A goal of a request.

    Attributes
    ----------
    displacement : array, shape (4, 4), of the payload from its start, in comove's scene
    words : what was asked for
    joints : joints that were asked for, by name [rad, m]
    tolerances : how far a joint may be below and above that, by name [rad, m]
    """

    displacement: Array
    words: str
    joints: Mapping[str, float]
    tolerances: Mapping[str, tuple[float, float]]

    def require_met(self, reached: Mapping[str, float], rounding: float = 1e-6) -> None:
        """Refuse joints that miss those asked for. They are by name [rad, m]."""
        for name, (below, above) in self.tolerances.items():
            off = reached[name] - self.joints[name]
            if not -below - rounding <= off <= above + rounding:
                raise Refusal(
                    ErrorCode.GOAL_CONSTRAINTS_VIOLATED,
                    f"the motion ends with '{name}' at {reached[name]:.6g}, {abs(off):.3g} off its goal (tolerance "
                    f"{below:g} below, {above:g} above); give joints with which all arms hold the payload, or wider "
                    "tolerances",
                )


def require_plannable(request: Fields, only_plan: bool) -> None:
    """Refuse what comove does not do, and values that are no numbers."""
    if not only_plan:
        raise Refusal(
            ErrorCode.CONTROL_FAILED,
            "plan_only is false, and this server only plans; set planning_options.plan_only to true, and execute the "
            "trajectory by execute_trajectory or its controllers",
        )
    for where in _not_finite(request):
        raise Refusal(
            ErrorCode.INVALID_GOAL_CONSTRAINTS, f"{where} is not a finite number; give one in m, rad or s"
        )
    if request["trajectory_constraints"]["constraints"]:
        raise Refusal(
            ErrorCode.PLANNING_FAILED,
            "trajectory_constraints are not kept; leave them out, or use path_constraints",
        )
    if request["max_cartesian_speed"] > 0.0:
        raise Refusal(
            ErrorCode.PLANNING_FAILED,
            f"max_cartesian_speed is {request['max_cartesian_speed']:g} m/s, and no link's speed is limited; set it "
            "to 0, and use max_velocity_scaling_factor",
        )


def _not_finite(value: Any, where: str = "") -> Iterator[str]:
    """Yield the places of numbers that are infinite or none."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _not_finite(inner, f"{where}.{name}".removeprefix("."))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from _not_finite(inner, f"{where}[{i}]")
    elif isinstance(value, float) and not math.isfinite(value):
        yield where


def scaling(request: Fields) -> tuple[float, float]:
    """Return the scaling factors of velocity and acceleration; 1 where they are not set."""
    found = []
    for name in ("max_velocity_scaling_factor", "max_acceleration_scaling_factor"):
        factor = request[name]
        if not 0.0 <= factor <= 1.0:
            raise Refusal(
                ErrorCode.PLANNING_FAILED, f"{name} is {factor:g}; give a number above 0, and 1 at most"
            )
        found.append(factor or 1.0)
    return found[0], found[1]


def budget_in(request: Fields, usual: float) -> float:
    """Return the time for planning [s]; `usual` where none is set."""
    seconds = float(request["allowed_planning_time"])
    if seconds < 0.0:
        raise Refusal(
            ErrorCode.PLANNING_FAILED,
            f"allowed_planning_time is {seconds:g} s; give a positive number, or 0 for {usual:g} s",
        )
    return seconds or usual


def groups_in(robot: Robot, srdf: Path | None) -> dict[str, frozenset[str]]:
    """Return the joints of groups by name: of the whole robot, which has its name, and of those in an SRDF.

    Raises
    ------
    RobotError
        If the SRDF cannot be read.
    """
    found = dict[str, frozenset[str]]()
    if srdf is not None:
        root = elements_in(srdf, SRDF)
        for source in robot.sources:
            for name, joints in Tree.of(ET.fromstring(source.urdf)).groups(root).items():
                found[name] = found.get(name, frozenset()) | (joints & {*robot.joint_names})
    return {robot.name: frozenset(robot.joint_names)} | found


def joints_of_group(
    request: Fields, groups: Mapping[str, frozenset[str]], placed: PlacedPayload
) -> frozenset[str]:
    """Return the joints of the group that a request names. It has all arms that hold the payload."""
    name, robot = request["group_name"], placed.robot
    needed = {robot.joint_names[column] for arm in placed.holders for column in arm.columns}
    whole = [known for known, joints in groups.items() if needed <= joints]
    if name not in groups:
        raise Refusal(
            ErrorCode.INVALID_GROUP_NAME,
            f"there is no group '{shortened(name)}'; name one of: {listed(whole, 8)}, or start comove serve with the "
            "SRDF that has it: --srdf FILE",
        )
    if name not in whole:
        arms = listed([repr(arm.name) for arm in placed.holders])
        raise Refusal(
            ErrorCode.INVALID_GROUP_NAME,
            f"the group '{shortened(name)}' lacks joints of {arms}, which hold the payload; name one of: "
            f"{listed(whole)}",
        )
    return groups[name]


def goals_in(request: Fields, placed: PlacedPayload) -> list[PayloadGoal]:
    """Return the goals of a request. One is to be met."""
    if not request["goal_constraints"]:
        raise _no_goal("there are no goal_constraints", placed)
    return [_goal(goal, placed) for goal in request["goal_constraints"]]


def _no_goal(told: str, placed: PlacedPayload) -> Refusal:
    return Refusal(
        ErrorCode.INVALID_GOAL_CONSTRAINTS,
        f"{told}; give a position and an orientation of '{placed.payload.object.name}' or of one hand, or the joints "
        "of all arms",
    )


def _goal(goal: Fields, placed: PlacedPayload) -> PayloadGoal:
    """Return a goal. All that it asks for is one displacement of the payload."""
    if goal["visibility_constraints"]:
        raise _no_goal("visibility_constraints are not kept", placed)
    displacements = dict[str, Array]()
    bodies = dict.fromkeys(
        one["link_name"] for kind in ("position", "orientation") for one in goal[f"{kind}_constraints"]
    )
    for body in bodies:
        displacements[f"'{body}'"] = _displacement(goal, body, placed)
    joints, tolerances = _joints(goal["joint_constraints"], placed)
    if joints:
        displacements |= _by_joints(joints, placed)
    if not displacements:
        raise _no_goal("a goal is empty", placed)
    first, *others = displacements
    for other in others:
        away = [displacements[name] @ placed.start for name in (first, other)]
        apart = float(np.linalg.norm(away[0][:3, 3] - away[1][:3, 3]))
        turned = _angle(away[0][:3, :3], away[1][:3, :3])
        if apart > SAME or turned > SAME_TURN:
            raise Refusal(
                ErrorCode.INVALID_GOAL_CONSTRAINTS,
                f"the goals of {first} and {other} hold the payload at two poses, {1e3 * apart:.3g} mm and "
                f"{round(math.degrees(turned), 3):g} deg apart; give the pose of one hand, and the other one follows",
            )
    at = displacements[first] @ placed.start
    return PayloadGoal(
        displacements[first],
        f"{', '.join(displacements)}: the payload at {numbers(at[:3, 3], 3)}",
        joints,
        tolerances,
    )


def _displacement(goal: Fields, body: str, placed: PlacedPayload) -> Array:
    """Return how a body is to be displaced. Without an orientation, or a position, it keeps its own."""
    start = _start_of(body, placed)
    target = start.copy()
    turns = [one for one in goal["orientation_constraints"] if one["link_name"] == body]
    points = [one for one in goal["position_constraints"] if one["link_name"] == body]
    if len(turns) > 1 or len(points) > 1:
        raise _no_goal(f"'{shortened(body)}' has several positions or orientations", placed)
    for one in turns:
        target[:3, :3] = _frame(one["header"], placed)[:3, :3] @ _rotation(one["orientation"])
    for one in points:
        region, offset = one["constraint_region"], one["target_point_offset"]
        at = _frame(one["header"], placed) @ _centre(region, placed)
        target[:3, 3] = at[:3, 3] - target[:3, :3] @ _vector(offset)
    return np.asarray(target @ np.linalg.inv(start))


def _start_of(body: str, placed: PlacedPayload) -> Array:
    """Return where a body is that moves with the payload."""
    start = placed.pose_of(body)
    if start is None:
        known = [placed.payload.object.name, *(arm.tip for arm in placed.holders)]
        raise Refusal(
            ErrorCode.INVALID_LINK_NAME,
            f"'{shortened(body)}' is neither the payload nor a link of a hand that holds it; name one of: "
            f"{listed([repr(name) for name in known])}",
        )
    return start


def _centre(region: Fields, placed: PlacedPayload) -> Array:
    """Return the pose of a region's first shape; its centre is what is aimed at."""
    shapes, poses = region["primitives"], region["primitive_poses"]
    if region["meshes"] or not shapes or len(poses) != len(shapes) or shapes[0]["type"] not in REGIONS:
        kinds = " or ".join(REGIONS.values())
        raise _no_goal(f"a constraint_region has no {kinds} with a pose", placed)
    pose = poses[0]
    return _pose(pose["position"], pose["orientation"])


def _frame(header: Fields, placed: PlacedPayload) -> Array:
    """Return the pose of a constraint's frame."""
    name = header["frame_id"].removeprefix("/")
    found = placed.pose_of_frame(name)
    if found is None:
        known = [placed.scene.frame, *placed.scene.transforms]
        raise Refusal(
            ErrorCode.FRAME_TRANSFORM_FAILURE,
            f"the frame '{shortened(name)}' is unknown, or moves; give the goal in one of: "
            f"{listed([repr(one) for one in dict.fromkeys(known) if one] or ['the planning frame'], 8)}, or in a "
            "link at rest",
        )
    return found


def _vector(fields: Fields) -> Array:
    return np.array([fields[axis] for axis in "xyz"], dtype=np.float64)


def _pose(position: Fields, orientation: Fields) -> Array:
    quaternion = np.array([orientation[axis] for axis in "xyzw"], dtype=np.float64)
    pose = homogeneous(_vector(position), quaternion)
    if pose is None:
        raise Refusal(
            ErrorCode.INVALID_GOAL_CONSTRAINTS,
            f"the quaternion {quaternion.tolist()} has not the norm 1; give one, w last",
        )
    return pose


def _rotation(orientation: Fields) -> Array:
    return _pose({"x": 0.0, "y": 0.0, "z": 0.0}, orientation)[:3, :3]


def _angle(a: Array, b: Array) -> float:
    return float(Rotation.from_matrix(a.T @ b).magnitude())


def _joints(
    given: Sequence[Fields], placed: PlacedPayload
) -> tuple[dict[str, float], dict[str, tuple[float, float]]]:
    """Return the joints of a goal by name, and their tolerances; both are empty where none are given."""
    if not given:
        return {}, {}
    robot = placed.robot
    told = [one["joint_name"] for one in given]
    if twice := sorted({name for name in told if told.count(name) > 1}):
        raise Refusal(
            ErrorCode.INVALID_GOAL_CONSTRAINTS,
            f"joint_constraints tell '{twice[0]}' twice; give each joint once",
        )
    asked = {one["joint_name"]: float(one["position"]) for one in given}
    names = [robot.joint_names[column] for arm in placed.holders for column in arm.columns]
    if missing := [name for name in names if name not in asked]:
        raise Refusal(
            ErrorCode.INVALID_GOAL_CONSTRAINTS,
            f"the goal has no {listed(missing, 8)}; give the joints of all arms that hold the payload, or a pose",
        )
    try:
        q = present_joints({**placed.present, **asked}, robot, "joint_constraints")
    except InputError as error:
        raise Refusal.of(ErrorCode.INVALID_GOAL_CONSTRAINTS, error) from None
    moved = {
        name: (one["tolerance_below"], one["tolerance_above"]) for name, one in zip(asked, given, strict=True)
    }
    tolerances = {name: moved[name] for name in names}
    return dict(zip(robot.joint_names, q.tolist(), strict=True)), tolerances


def _by_joints(joints: Mapping[str, float], placed: PlacedPayload) -> dict[str, Array]:
    """Return how each arm displaces the payload."""
    robot, q = placed.robot, np.array([joints[name] for name in placed.robot.joint_names])
    return {
        f"the joints of '{arm.name}'": robot.tool_pose(q, arm) @ np.linalg.inv(robot.tool_pose(placed.q, arm))
        for arm in placed.holders
    }


def path_constraints(request: Fields, placed: PlacedPayload, goal: PayloadGoal) -> list[dict[str, Any]]:
    """Return the path constraints of a request as constraints of a scene."""
    asked = request["path_constraints"]
    for kind in ("joint", "position", "visibility"):
        if asked[f"{kind}_constraints"]:
            raise Refusal(
                ErrorCode.PLANNING_FAILED,
                f"path_constraints.{kind}_constraints are not kept; give orientation_constraints alone",
            )
    kept = (_orientation_kept(one, placed, goal) for one in asked["orientation_constraints"])
    return [one for one in kept if one is not None]


def _orientation_kept(one: Fields, placed: PlacedPayload, goal: PayloadGoal) -> dict[str, Any] | None:
    """Return the constraint of a scene within an orientation constraint; None where that allows everything.

    A direction of the payload stays upright where the body may turn about an axis; else the payload is not turned.
    """
    body = one["link_name"]
    start, wanted = _start_of(body, placed), _frame(one["header"], placed)[:3, :3]
    wanted = wanted @ _rotation(one["orientation"])
    most = np.array([one[f"absolute_{axis}_axis_tolerance"] for axis in "xyz"], dtype=np.float64)
    by_vector = one["parameterization"] == ROTATION_VECTOR
    ends = {"START_STATE": start[:3, :3], "GOAL": goal.displacement[:3, :3] @ start[:3, :3]}
    spare = np.inf
    for end, turned in ends.items():
        error = Rotation.from_matrix(wanted.T @ turned)
        off = np.abs(error.as_rotvec() if by_vector else error.as_euler("XYZ"))
        left = float((most - off).min())
        if left < -EQUAL:
            raise Refusal(
                ErrorCode[f"{end}_VIOLATES_PATH_CONSTRAINTS"],
                f"path_constraints: at its {end.removesuffix('_STATE').lower()} '{shortened(body)}' is turned by "
                f"{np.round(off, 4).tolist()} rad, and the tolerances are {most.tolist()}; widen them, or move it "
                "otherwise",
            )
        spare = min(spare, left)
    if (most >= math.pi).all():
        return None
    free = [k for k in range(3) if most[k] >= math.pi]
    axis = wanted[:, free[0]] if len(free) == 1 else np.zeros(3)
    if abs(axis[2]) > 1.0 - EQUAL and (by_vector or free != [1]):
        # Both other angles of Euler are at most the tilt; those of a rotation vector are at most pi / 2 times that.
        tilt = float(np.delete(most, free).min()) * (2.0 / math.pi if by_vector else 1.0)
        up = math.copysign(1.0, axis[2]) * placed.payload_start[:3, :3].T @ start[:3, free[0]]
        tolerance = min(math.degrees(tilt), MAX_TOLERANCE)
        return {"type": "upright", "up": (np.round(up, 9) + 0.0).tolist(), "tolerance_deg": tolerance}
    if _angle(*ends.values()) <= EQUAL:
        return {"type": "no_rotation", "tolerance_deg": math.degrees(min(KEPT, 0.5 * max(spare, 0.0)))}
    raise Refusal(
        ErrorCode.PLANNING_FAILED,
        f"path_constraints: '{shortened(body)}' is turned at the goal, and may not turn about one vertical axis "
        "alone; keep the orientation of the start there, or let one axis that is vertical turn: a tolerance of 3.15",
    )

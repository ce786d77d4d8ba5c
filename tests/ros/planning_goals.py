"""Goals of MoveIt's action for the tests: what clients send, as nested mappings of fields that differ from defaults.

`Wire` makes of one what `ros2_moveit.py` tells of it, by the definitions beside this file and without ROS.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import is_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from comove.robots import Robot
from tests.model.files.planning_scenes import Messages

HERE = Path(__file__).parent
PACKAGES = ("object_recognition_msgs", "octomap_msgs", "moveit_msgs")
LEFT, RIGHT = "left_panda_hand", "right_panda_hand"
BAR = ([0.04, 0.9, 0.04], 0.7)
"""Size [m] and mass [kg] of the bar between both hands."""


def definitions() -> dict[str, str]:
    """The texts of the messages beside this file, by type."""
    files = [file for package in PACKAGES for file in sorted((HERE / package / "msg").glob("*.msg"))]
    return {f"{file.parts[-3]}/msg/{file.stem}": file.read_text() for file in files}


def pose(matrix: np.ndarray) -> dict[str, Any]:
    """A pose as fields."""
    return {
        "position": dict(zip("xyz", matrix[:3, 3].tolist(), strict=True)),
        "orientation": dict(
            zip("xyzw", Rotation.from_matrix(matrix[:3, :3]).as_quat().tolist(), strict=True)
        ),
    }


def moved(matrix: np.ndarray, *by: float, yaw: float = 0.0) -> np.ndarray:
    """A pose that is shifted [m] and turned about the vertical [rad] in the scene."""
    other = matrix.copy()
    other[:3, 3] += by
    other[:3, :3] = Rotation.from_euler("z", yaw).as_matrix() @ other[:3, :3]
    return other


def box(name: str, size: list[float], at: np.ndarray, frame: str = "world") -> dict[str, Any]:
    """A box as an object."""
    return {
        "header": {"frame_id": frame},
        "id": name,
        "pose": pose(at),
        "primitives": [{"type": 1, "dimensions": [*map(float, size)]}],
        "primitive_poses": [pose(np.eye(4))],
    }


class Cell:
    """Two Pandas that hold a bar, a table below it and a post; what clients ask for there."""

    def __init__(self) -> None:
        self.robot = Robot.load("two_pandas")
        self.joints = dict(zip(self.robot.joint_names, self.robot.home.tolist(), strict=True))
        self.joints |= {"left_panda_joint1": 0.1, "right_panda_joint7": 0.7}
        left, right = (self.link_pose(link) for link in (LEFT, RIGHT))
        self.bar = np.eye(4)
        self.bar[:3, 3] = (left[:3, 3] + right[:3, 3]) / 2 - [0, 0, 0.1]
        self.bar[:3, :3] = Rotation.from_euler("z", 0.02).as_matrix()

    def link_pose(self, link: str, joints: Mapping[str, float] | None = None) -> np.ndarray:
        """The pose of a link, by Pinocchio."""
        data, model = self.robot.model.createData(), self.robot.model
        q = np.array([(joints or self.joints)[name] for name in self.robot.joint_names])
        pin.framesForwardKinematics(model, data, q)
        return np.asarray(data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous)

    def state(self, *, attached: bool = True) -> dict[str, Any]:
        """The state of the robot that holds the bar."""
        fingers = {f"{side}_panda_finger_joint{i}": 0.02 for side in ("left", "right") for i in (1, 2)}
        joints = self.joints | fingers
        held = box("bar", BAR[0], np.linalg.inv(self.link_pose(LEFT)) @ self.bar, LEFT)
        touch = [
            f"{side}_panda_{name}" for side in ("left", "right") for name in ("leftfinger", "rightfinger")
        ]
        one = {"link_name": LEFT, "object": held, "touch_links": [*touch, RIGHT], "weight": BAR[1]}
        return {
            "joint_state": {"name": list(joints), "position": list(joints.values())},
            "attached_collision_objects": [one] if attached else [],
        }

    def scene(self, **state: bool) -> dict[str, Any]:
        """The whole planning scene."""
        table, post = np.eye(4), np.eye(4)
        table[:3, 3], post[:3, 3] = (0.5, 0, -0.06), (0.75, 0, 0.15)
        return {
            "fixed_frame_transforms": [
                {
                    "header": {"frame_id": "world"},
                    "child_frame_id": "world",
                    "transform": {"rotation": {"w": 1.0}},
                },
                {
                    "header": {"frame_id": "world"},
                    "child_frame_id": "cell",
                    "transform": {"translation": {"x": 0.0, "y": 0.0, "z": 1.0}, "rotation": {"w": 1.0}},
                },
            ],
            "robot_state": self.state(**state),
            "world": {
                "collision_objects": [
                    box("table", [2, 2, 0.1], table),
                    box("post", [0.05, 0.05, 0.3], post),
                ]
            },
        }

    def goal(self, target: np.ndarray | None = None, body: str = "bar", **more: Any) -> dict[str, Any]:
        """A goal of the action: a body at a pose, 5 cm further and 10 cm higher unless given."""
        target = moved(self.bar, 0.05, 0.0, 0.1) if target is None else target
        return {
            "request": {
                "group_name": "two_pandas",
                "allowed_planning_time": 20.0,
                "goal_constraints": [posed(target, body)],
                **more,
            },
            "planning_options": {"plan_only": True},
        }


def posed(target: np.ndarray, body: str, frame: str = "world") -> dict[str, Any]:
    """Goal constraints: a body at a pose."""
    found = pose(target)
    region = {
        "primitives": [{"type": 2, "dimensions": [1e-3]}],
        "primitive_poses": [{"position": found["position"], "orientation": {"w": 1.0}}],
    }
    where = {"header": {"frame_id": frame}, "link_name": body, "weight": 1.0}
    turned = {f"absolute_{axis}_axis_tolerance": 1e-3 for axis in "xyz"}
    return {
        "position_constraints": [{**where, "constraint_region": region}],
        "orientation_constraints": [{**where, "orientation": found["orientation"], **turned}],
    }


def joint_goal(joints: Mapping[str, float], tolerance: float = 1e-4) -> dict[str, Any]:
    """Goal constraints: joints."""
    wide = {"tolerance_above": tolerance, "tolerance_below": tolerance, "weight": 1.0}
    return {
        "joint_constraints": [{"joint_name": name, "position": at, **wide} for name, at in joints.items()]
    }


class Wire:
    """What the program in ROS tells comove of messages, by rosbags."""

    @cached_property
    def messages(self) -> Messages:
        """Maker of messages by the definitions beside this file."""
        return Messages(**definitions())

    def make(self, kind: str, given: Mapping[str, Any]) -> Any:
        """A message of nested fields."""
        from rosbags.interfaces import Nodetype

        values = {}
        for name, (node, what) in self.messages.store.fielddefs[kind][1]:
            if name not in given:
                continue
            value = given[name]
            if node == Nodetype.NAME:
                values[name] = self.make(what, value)
            elif node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
                (inner, of), _ = what
                if inner == Nodetype.NAME:
                    values[name] = [self.make(of, one) for one in value]
                else:
                    values[name] = value if of[0] == "string" else np.array(value, dtype=of[0])
            else:
                values[name] = value
        unknown = given.keys() - {name for name, _ in self.messages.store.fielddefs[kind][1]}
        assert not unknown, f"{kind} has no {unknown}"
        return self.messages.make(kind, **values)

    def encoded(self, scene: Mapping[str, Any]) -> tuple[str, bytes]:
        """A planning scene as the server gets it."""
        kind = "moveit_msgs/msg/PlanningScene"
        return kind, bytes(self.messages.store.serialize_cdr(self.make(kind, scene), kind))

    def request(self, goal: Mapping[str, Any]) -> dict[str, Any]:
        """The request of a goal as the server gets it."""
        message = self.make("moveit_msgs/msg/MotionPlanRequest", goal["request"])
        found = _fields(message)
        del found["reference_trajectories"]
        del found["start_state"]
        return found


def _fields(value: Any) -> Any:
    if is_dataclass(value):
        names = (name for name in value.__dataclass_fields__ if not name.startswith("__"))
        return {name: _fields(getattr(value, name)) for name in names}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [_fields(one) for one in value] if isinstance(value, list) else value

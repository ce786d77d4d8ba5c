"""What bridges write into goals for controllers, with messages that hold whatever is put into them."""

import importlib
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import pytest

import comove.ros

JOINTS = ["a", "b", "c"]
GOAL = {
    "joints": JOINTS,
    "time": [0, 1_500_000_000],
    **{key: [[0.0] * 3, [1.0] * 3] for key in ("position", "velocity", "acceleration")},
    "path": [0.01, 0.02, 0.03],
    "end": [0.005, 0.0, 0.015],
    "late": 2.5,
}


class Message(SimpleNamespace):
    """A message of any kind."""


def empty():
    """A goal without entries."""
    return Message(trajectory=Message(points=[], joint_names=[]), path_tolerance=[], goal_tolerance=[])


@pytest.fixture
def bridges(monkeypatch):
    """The folder of the bridges in the path, and packages of ROS that are not there."""
    monkeypatch.syspath_prepend(str(Path(comove.ros.__file__).parent))
    for name in ("builtin_interfaces", "control_msgs", "trajectory_msgs"):
        package, messages = ModuleType(name), ModuleType(f"{name}.msg")
        for kind in ("Duration", "JointTolerance", "JointTrajectoryPoint"):
            setattr(messages, kind, Message)
        monkeypatch.setitem(sys.modules, name, package)
        monkeypatch.setitem(sys.modules, f"{name}.msg", messages)
    rospy = ModuleType("rospy")
    rospy.Duration = lambda *parts: parts
    monkeypatch.setitem(sys.modules, "rospy", rospy)


def of_ros2():
    bridge = importlib.import_module("ros2_bridge")
    server = SimpleNamespace(kind=SimpleNamespace(Goal=empty))
    return bridge.Ros2Bridge.goal_message(SimpleNamespace(servers={"arm": server}), "arm", GOAL)


def of_ros1():
    bridge = importlib.import_module("ros1_bridge")
    kinds = {
        "control_msgs/FollowJointTrajectoryGoal": empty,
        "trajectory_msgs/JointTrajectoryPoint": Message,
        "control_msgs/JointTolerance": Message,
    }
    (cls,) = [value for value in vars(bridge).values() if hasattr(value, "goal_message")]
    return cls.goal_message(SimpleNamespace(types=kinds), GOAL)


@pytest.mark.parametrize("written", [of_ros2, of_ros1])
def test_every_joint_has_its_own_tolerances(written, bridges):
    """A controller takes 0 for its own tolerance, so that a joint that has none is left out."""
    message = written()
    assert [(t.name, t.position) for t in message.path_tolerance] == [("a", 0.01), ("b", 0.02), ("c", 0.03)]
    assert [(t.name, t.position) for t in message.goal_tolerance] == [("a", 0.005), ("c", 0.015)]

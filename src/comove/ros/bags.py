"""Motions as ROS bags.

Controllers read `trajectory_msgs/JointTrajectory`, viewers `sensor_msgs/JointState`.

| topic | type | content |
|---|---|---|
| ``/comove/ARM/joint_trajectory`` | JointTrajectory | one arm, as its controller expects it |
| ``/comove/joint_trajectory`` | JointTrajectory | all moving joints |
| ``/comove/joint_states`` | JointState | all moving joints, one message a sample |
| ``/comove/provenance`` | String | JSON: version, and checksums of scene, robot and motion |

For RViz and MoveIt there are also:

| topic | type | content |
|---|---|---|
| ``/comove/robot_trajectory`` | moveit_msgs/RobotTrajectory | all moving joints, to be executed at once |
| ``/comove/display_planned_path`` | moveit_msgs/DisplayTrajectory | the same, with the joints at its start |

All but the states are latched (ROS 2: transient local), so late subscribers get them too. No robot listens to these
topics: playing back a bag moves nothing. Stamps begin at `START`, since 0 means "none" in ROS.
"""

from __future__ import annotations

import contextlib
import errno
import json
import os
import sqlite3
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from comove.io.files import installed
from comove.model.files.moveit_bags import DEFINITIONS, DISPLAY, ROBOT_TRAJECTORY
from comove.model.files.moveit_bags import store as moveit_store
from comove.ros.parts import NANO, JointSamples, MotionPart

START = NANO  # ns, stamp of time zero
CALLER = "/comove"
TRAJECTORY, STATE, TEXT = (
    "trajectory_msgs/msg/JointTrajectory",
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/String",
)
NONE: Mapping[str, str] = MappingProxyType({})
Message = tuple[str, str, int, Any]
"""Topic, type, stamp [ns] and the message."""


def require_rosbags(part: MotionPart) -> None:
    """Raise an error if the library rosbags is missing."""
    installed("rosbags", "a bag of ROS", "data")


def write_rosbag1(path: Path, part: MotionPart, rate: float) -> None:
    """Write a part as one bag file of ROS 1."""
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(path) as writer:

        def connect(topic: str, kind: str) -> Any:
            latching = int(kind != STATE)
            return writer.add_connection(topic, kind, typestore=store, callerid=CALLER, latching=latching)

        _write(writer, connect, store.serialize_ros1, _messages(store, part, part.samples(rate)))


def write_rosbag2(path: Path, part: MotionPart, rate: float) -> None:
    """Write a part as a bag folder of ROS 2: SQLite and ``metadata.yaml``."""
    inner = path / part.name  # the library names files after their folder, which has no name yet
    path.mkdir(exist_ok=True)
    _write_ros2(inner, part, rate, "SQLITE3")
    for file in sorted(inner.iterdir()):
        os.replace(file, path / file.name)
    inner.rmdir()


def write_mcap(path: Path, part: MotionPart, rate: float, definitions: Mapping[str, str] = NONE) -> None:
    """Write a part as one MCAP file. It equals the file that ROS 2 would record in a bag folder."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        _write_ros2(Path(folder, "bag"), part, rate, "MCAP", definitions)
        os.replace(Path(folder, "bag", "bag.mcap"), path)


def write_moveit(path: Path, part: MotionPart, rate: float) -> None:
    """Write a part as one MCAP file for RViz and MoveIt. The definitions of MoveIt's messages are in the file."""
    write_mcap(path, part, rate, DEFINITIONS)


def moveit_messages(part: MotionPart, rate: float) -> dict[str, bytes]:
    """Return a part as MoveIt's messages by type, encoded in CDR.

    With ROS, ``rclpy.serialization.deserialize_message(data, RobotTrajectory)`` makes a message of one.

    Parameters
    ----------
    rate : samples a second [Hz]

    Raises
    ------
    ExtraError
        If the library rosbags is missing.
    """
    require_rosbags(part)
    store = moveit_store()
    found = _moveit_messages(store, part.samples(rate))
    return {kind: bytes(store.serialize_cdr(message, kind)) for _, kind, _, message in found}


def _store(definitions: Mapping[str, str]) -> Any:
    """Return the types of ROS 2 with further ones, by their definitions."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for kind, text in definitions.items():
        store.register(get_types_from_msg(text, kind))
    return store


def _write_ros2(
    path: Path, part: MotionPart, rate: float, storage: str, definitions: Mapping[str, str] = NONE
) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer

    store, samples = _store(definitions), part.samples(rate)
    messages = _messages(store, part, samples)
    if ROBOT_TRAJECTORY in definitions:
        messages[1:1] = _moveit_messages(store, samples)
    with _telling(), Writer(path, version=8, storage_plugin=StoragePlugin[storage]) as writer:
        for key, value in part.provenance.asdict().items():
            writer.set_custom_data(f"comove.{key}", value)

        def connect(topic: str, kind: str) -> Any:
            qos = [_quality(latched=kind != STATE)]
            return writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=qos)

        _write(writer, connect, store.serialize_cdr, messages)


@contextlib.contextmanager
def _telling() -> Iterator[None]:
    """Convert database errors, such as a full disk, to `OSError`."""
    try:
        yield
    except sqlite3.Error as error:
        raise OSError(errno.EIO, str(error)) from error


def _quality(latched: bool) -> Any:
    """Return a reliable quality of service. Latched messages are kept for late subscribers."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    never = QosTime(0, 0)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=never,
        lifespan=never,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=never,
        avoid_ros_namespace_conventions=False,
    )


def _write(
    writer: Any,
    connect: Callable[[str, str], Any],
    encode: Callable[[Any, str], Any],
    messages: list[Message],
) -> None:
    kinds = {topic: kind for topic, kind, _, _ in messages}
    connections = {topic: connect(topic, kind) for topic, kind in kinds.items()}
    for topic, kind, stamp, message in messages:
        writer.write(connections[topic], stamp, encode(message, kind))


def _messages(store: Any, part: MotionPart, samples: JointSamples) -> list[Message]:
    """Return all messages in the order of their stamps."""
    String, State = store.types[TEXT], store.types[STATE]
    text = json.dumps(part.provenance.asdict(), sort_keys=True)
    messages: list[Message] = [("/comove/provenance", TEXT, START, String(data=text))]
    groups = {f"/comove/{arm}": names for arm, names in part.arms.items()}
    groups["/comove"] = part.joints.joint_names
    for prefix, names in groups.items():
        message = _trajectory(store, samples.of(names))
        messages.append((f"{prefix}/joint_trajectory", TRAJECTORY, START, message))
    every, none = list(part.joints.joint_names), np.empty(0)
    for row, time in enumerate(samples.nanoseconds.tolist()):
        message = State(
            header=_header(store, START + time, row),
            name=every,
            position=samples.position[row],
            velocity=samples.velocity[row],
            effort=none,
        )
        messages.append(("/comove/joint_states", STATE, START + time, message))
    return messages


def _moveit_messages(store: Any, samples: JointSamples) -> list[Message]:
    """Return MoveIt's messages of a motion. Their header has no stamp, so that it begins when it is executed."""
    types = store.types
    frameless = _header(store, 0, 0)
    no_joints = {"header": frameless, "joint_names": []}
    joints = _trajectory(store, samples, 0)
    several = types["trajectory_msgs/msg/MultiDOFJointTrajectory"](**no_joints, points=[])
    whole = types[ROBOT_TRAJECTORY](joint_trajectory=joints, multi_dof_joint_trajectory=several)
    none = np.empty(0)
    at_start = types[STATE](
        header=frameless,
        name=list(samples.joint_names),
        position=samples.position[0],
        velocity=none,
        effort=none,
    )
    none_floating = types["sensor_msgs/msg/MultiDOFJointState"](
        **no_joints, transforms=[], twist=[], wrench=[]
    )
    start = types["moveit_msgs/msg/RobotState"](
        joint_state=at_start,
        multi_dof_joint_state=none_floating,
        attached_collision_objects=[],
        is_diff=True,
    )
    shown = types[DISPLAY](model_id="", trajectory=[whole], trajectory_start=start)
    return [
        ("/comove/robot_trajectory", ROBOT_TRAJECTORY, START, whole),
        ("/comove/display_planned_path", DISPLAY, START, shown),
    ]


def _trajectory(store: Any, samples: JointSamples, stamp: int = START) -> Any:
    Point = store.types["trajectory_msgs/msg/JointTrajectoryPoint"]
    Duration = store.types["builtin_interfaces/msg/Duration"]
    position, velocity, acceleration = map(
        np.ascontiguousarray, (samples.position, samples.velocity, samples.acceleration)
    )
    points = [
        Point(
            positions=position[row],
            velocities=velocity[row],
            accelerations=acceleration[row],
            effort=np.empty(0),
            time_from_start=Duration(sec=time // NANO, nanosec=time % NANO),
        )
        for row, time in enumerate(samples.nanoseconds.tolist())
    ]
    return store.types[TRAJECTORY](
        header=_header(store, stamp, 0), joint_names=list(samples.joint_names), points=points
    )


def _header(store: Any, stamp: int, row: int) -> Any:
    Header, Time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    count = {"seq": row} if "seq" in Header.__dataclass_fields__ else {}  # ROS 1 counts its messages
    return Header(**count, stamp=Time(sec=stamp // NANO, nanosec=stamp % NANO), frame_id="")

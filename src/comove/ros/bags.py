"""Motions as ROS bags.

Controllers read `trajectory_msgs/JointTrajectory`, viewers `sensor_msgs/JointState`.

| topic | type | content |
|---|---|---|
| ``/comove/ARM/joint_trajectory`` | JointTrajectory | one arm, as its controller expects it |
| ``/comove/joint_trajectory`` | JointTrajectory | all moving joints |
| ``/comove/joint_states`` | JointState | all moving joints, one message a sample |
| ``/comove/provenance`` | String | JSON: version, and checksums of scene, robot and motion |

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
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from comove.io.files import installed
from comove.ros.parts import NANO, JointSamples, MotionPart

START = NANO  # ns, stamp of time zero
CALLER = "/comove"
TRAJECTORY, STATE, TEXT = (
    "trajectory_msgs/msg/JointTrajectory",
    "sensor_msgs/msg/JointState",
    "std_msgs/msg/String",
)
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


def write_mcap(path: Path, part: MotionPart, rate: float) -> None:
    """Write a part as one MCAP file. It equals the file that ROS 2 would record in a bag folder."""
    with tempfile.TemporaryDirectory(dir=path.parent) as folder:
        _write_ros2(Path(folder, "bag"), part, rate, "MCAP")
        os.replace(Path(folder, "bag", "bag.mcap"), path)


def _write_ros2(path: Path, part: MotionPart, rate: float, storage: str) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with _telling(), Writer(path, version=8, storage_plugin=StoragePlugin[storage]) as writer:
        for key, value in part.provenance.asdict().items():
            writer.set_custom_data(f"comove.{key}", value)

        def connect(topic: str, kind: str) -> Any:
            qos = [_quality(latched=kind != STATE)]
            return writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=qos)

        _write(writer, connect, store.serialize_cdr, _messages(store, part, part.samples(rate)))


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


def _trajectory(store: Any, samples: JointSamples) -> Any:
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
        header=_header(store, START, 0), joint_names=list(samples.joint_names), points=points
    )


def _header(store: Any, stamp: int, row: int) -> Any:
    Header, Time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    count = {"seq": row} if "seq" in Header.__dataclass_fields__ else {}  # ROS 1 counts its messages
    return Header(**count, stamp=Time(sec=stamp // NANO, nanosec=stamp % NANO), frame_id="")

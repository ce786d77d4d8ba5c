"""Bags of ROS 2 that tests write message by message."""

import numpy as np
from rosbags import rosbag2
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types


def make(kind, **fields):
    """A message of a short type name."""
    packages = {"Header": "std_msgs", "Time": "builtin_interfaces", "Duration": "builtin_interfaces"}
    package = packages.get(kind.split("/")[-1], "geometry_msgs")
    return TYPES[f"{package}/msg/{kind}" if "/" not in kind else kind.replace("/", "/msg/")](**fields)


def header(stamp):
    return make("Header", stamp=make("Time", sec=stamp // 10**9, nanosec=stamp % 10**9), frame_id="base")


def point(x=0.0, y=0.0, z=0.0, kind="Point"):
    return make(kind, x=x, y=y, z=z)


def pose(x, w=1.0, z=0.0):
    return make("Pose", position=point(x), orientation=make("Quaternion", x=0.0, y=0.0, z=z, w=w))


def pose_stamped(x, stamp, **turn):
    return make("PoseStamped", header=header(stamp), pose=pose(x, **turn))


def joint_state(names, position, stamp):
    none = np.empty(0)
    fields = {"name": list(names), "position": np.asarray(position, float), "velocity": none, "effort": none}
    return make("sensor_msgs/JointState", header=header(stamp), **fields)


def bag(path, messages):
    """Write (topic, type, received, message) as a ROS 2 folder."""
    with rosbag2.Writer(path, version=8) as writer:
        connections = {}
        for topic, kind, received, message in messages:
            kind = kind.replace("/", "/msg/")
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            if message is not None:
                raw = message if isinstance(message, bytes) else STORE.serialize_cdr(message, kind)
                writer.write(connections[topic], received, raw)
    return path

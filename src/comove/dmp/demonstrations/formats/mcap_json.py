"""JSON messages in MCAP files, in the shape of ROS messages.

Foxglove's schemas, rosbridge and others write them. The type of a topic follows from the name of its schema if it is
one of ROS, else from the keys of its first message: ``pose: {position: {x, y, z}, orientation: {x, y, z, w}}`` is a
pose, ``name`` and ``position`` are joints. Stamps are ``header.stamp`` or ``timestamp``, of seconds and nanoseconds,
of ISO 8601, or in seconds.
"""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace
from typing import IO, Any

from comove.dmp.demonstrations.formats.mcap import records, text_at
from comove.dmp.demonstrations.samples import fault
from comove.errors import DemonstrationError
from comove.io.files import extra

MAX_CHUNK = 2**30
"""Largest chunk when it is not compressed [bytes]."""
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK = 0x03, 0x04, 0x05, 0x06
_HEAD = struct.Struct("<HIQQ")  # of a message: its channel, number, and times of log and publication
_OF_CHUNK = struct.Struct("<QQQI")  # its times, size and checksum; the compression follows

_XYZ: dict[str, Any] = dict.fromkeys("xyz", float)
_XYZW: dict[str, Any] = dict.fromkeys("xyzw", float)
_POSE = {"position": _XYZ, "orientation": _XYZW}
_TRANSFORM = {"translation": _XYZ, "rotation": _XYZW}
_FRAMES = {"transform": _TRANSFORM, "child_frame_id": str}
_SHAPES: dict[str, Mapping[str, Any]] = {
    "tf2_msgs/msg/TFMessage": {"transforms": [_FRAMES]},
    "geometry_msgs/msg/TransformStamped": _FRAMES,
    "sensor_msgs/msg/JointState": {"name": [str], "position": [float]},
    "trajectory_msgs/msg/JointTrajectory": {
        "joint_names": [str],
        "points": [{"positions": [float], "time_from_start": int}],
    },
    "geometry_msgs/msg/PoseWithCovarianceStamped": {"pose": {"pose": _POSE}},
    "nav_msgs/msg/Odometry": {"pose": {"pose": _POSE}, "child_frame_id": str},
    "geometry_msgs/msg/PoseStamped": {"pose": _POSE},
    "nav_msgs/msg/Path": {"poses": [{"pose": _POSE}]},
    "geometry_msgs/msg/PoseArray": {"poses": [_POSE]},
    "geometry_msgs/msg/PointStamped": {"point": _XYZ},
    "geometry_msgs/msg/Pose": _POSE,
    "geometry_msgs/msg/Transform": _TRANSFORM,
    "geometry_msgs/msg/Point": _XYZ,
}
"""Keys of the messages that are read, the more special ones first; `int` stands for a stamp."""


@dataclass(frozen=True)
class Connection:
    """A channel as in `rosbags`: topic, message type and count."""

    id: int
    topic: str
    msgtype: str
    msgcount: int


class JsonReader:
    """The messages of a JSON MCAP file, read as by `rosbags`.

    Attributes
    ----------
    connections : the channels that have messages
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        schemas: dict[int, str] = {}
        channels: dict[int, tuple[str, int]] = {}
        first: dict[int, bytes] = {}
        counts: dict[int, int] = {}
        for kind, body in self._records():
            if kind == _SCHEMA:
                schemas[struct.unpack_from("<H", body)[0]] = text_at(body, 2)
            elif kind == _CHANNEL:
                number, schema = struct.unpack_from("<HH", body)
                channels[number] = text_at(body, 4), schema
            elif kind == _MESSAGE:
                number = _HEAD.unpack_from(body)[0]
                first.setdefault(number, body[_HEAD.size :])
                counts[number] = counts.get(number, 0) + 1
        self.connections = [
            Connection(
                number, topic, self._kind(topic, schemas.get(schema, ""), first[number]), counts[number]
            )
            for number, (topic, schema) in channels.items()
            if number in first
        ]

    def messages(self, connections: Sequence[Connection]) -> Iterator[tuple[Connection, int, bytes]]:
        """Iterate over channels' messages in the order of their times [ns]."""
        wanted = {one.id: one for one in connections}
        found = []
        for kind, body in self._records():
            if kind == _MESSAGE and (number := (head := _HEAD.unpack_from(body))[0]) in wanted:
                found.append((wanted[number], int(head[2]), body[_HEAD.size :]))
        yield from sorted(found, key=lambda one: one[1])

    def decode(self, data: bytes, kind: str) -> Any:
        """Return a message as an object with its ROS type's attributes.

        Raises
        ------
        DemonstrationError
            If it is no JSON object, or lacks a number or a text; names the key.
        """
        return _shaped(self._object(kind, data), _SHAPES[kind], self.path, kind)

    def _kind(self, topic: str, schema: str, data: bytes) -> str:
        """Return the ROS type of a topic's messages, else its schema."""
        package, _, last = schema.replace("/msg/", "/").replace("::msg::", "/").partition("/")
        if package.endswith("_msgs"):
            return f"{package}/msg/{last}"
        if last == "Vector3" or schema.endswith("Vector3"):
            return schema
        message = self._object(topic, data)
        for kind, shape in _SHAPES.items():
            try:
                _shaped(message, shape, self.path, topic)
            except DemonstrationError:
                continue
            return kind
        return schema or "JSON"

    def _object(self, key: str, data: bytes) -> Any:
        try:
            return json.loads(data)
        except (ValueError, RecursionError) as error:
            message = f"a message is no JSON ({error})"
            raise fault(self.path, key, message, "record it again, or choose another topic") from error

    def _records(self) -> Iterator[tuple[int, bytes]]:
        """Iterate over kind and content of records, also those in chunks."""
        with open(self.path, "rb") as file:
            size = file.seek(0, 2)
            for kind, body in _bodies(file, size, 8):
                if kind == _CHUNK:
                    content = self._uncompressed(body)
                    yield from _bodies(BytesIO(content), len(content) + 8, 0)
                else:
                    yield kind, body

    def _uncompressed(self, body: bytes) -> bytes:
        """Return the records of a chunk, compared with their checksum."""
        _, _, size, crc = _OF_CHUNK.unpack_from(body)
        name = text_at(body, _OF_CHUNK.size)
        content = body[_OF_CHUNK.size + 4 + len(name) + 8 :]
        if size > MAX_CHUNK:
            message = f"a chunk claims {size:,} bytes"
            raise fault(self.path, None, message, f"write chunks of {MAX_CHUNK:,} bytes at most")
        if name:
            content = extra("pyarrow", self.path).decompress(content, size, codec=name, asbytes=True)
        if len(content) != size or (crc and zlib.crc32(content) != crc):
            message = "a chunk has another checksum than the file says"
            raise fault(self.path, None, message, "copy it again: it is damaged")
        return content


def _bodies(file: IO[bytes], size: int, at: int) -> Iterator[tuple[int, bytes]]:
    """Iterate over kind and content of records, skipping those after the data."""
    for place, kind, length in records(file, size, at):
        if kind in (_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK):
            file.seek(place + 9)
            yield kind, file.read(length)


def _shaped(message: Any, shape: Any, path: Path, key: str) -> Any:
    """Return a JSON value with a shape's attributes; messages get a header."""
    if shape is float or shape is str:
        if isinstance(message, str if shape is str else float | int) and not isinstance(message, bool):
            return shape(message)
        what = "number" if shape is float else "text"
        raise fault(path, key, f"a message has no {what} there", "choose another topic")
    if shape is int:
        return SimpleNamespace(**dict(zip(("sec", "nanosec"), _stamp(message, path, key), strict=True)))
    if isinstance(shape, list):
        if not isinstance(message, list):
            raise fault(path, key, "a message has no list there", "choose another topic")
        return [_shaped(one, shape[0], path, f"{key}[{n}]") for n, one in enumerate(message)]
    if not isinstance(message, dict):
        raise fault(path, key, "a message has no object there", "choose another topic")
    if "transform" in shape and "translation" in message:  # of Foxglove
        message = {**message, "transform": message}
    fields = {name: _shaped(message.get(name), of, path, f"{key}.{name}") for name, of in shape.items()}
    fields |= {name: str(message[name]) for name in ("child_frame_id",) if name in message}
    return SimpleNamespace(**fields, header=_header(message, path, key))


def _header(message: Mapping[str, Any], path: Path, key: str) -> SimpleNamespace:
    """Return the header of a message, with stamp 0 if missing."""
    said = message.get("header")
    header = said if isinstance(said, dict) else message
    stamp = header.get("stamp", header.get("timestamp", 0))
    frame = header.get("frame_id", message.get("parent_frame_id", ""))
    return SimpleNamespace(stamp=_shaped(stamp, int, path, key), frame_id=str(frame))


def _stamp(stamp: Any, path: Path, key: str) -> tuple[int, int]:
    try:
        if isinstance(stamp, dict):
            sec = next((stamp[name] for name in ("sec", "secs", "seconds") if name in stamp), 0)
            names = ("nanosec", "nsec", "nsecs", "nanos", "nanoseconds")
            return int(sec), int(next((stamp[name] for name in names if name in stamp), 0))
        if isinstance(stamp, str):
            whole, _, rest = stamp.rstrip("Z").partition(".")
            digits = rest[: len(rest) - len(rest.lstrip("0123456789"))]
            sec = int(datetime.fromisoformat(f"{whole}{rest[len(digits) :] or '+00:00'}").timestamp())
            return sec, int(digits.ljust(9, "0")[:9])
        seconds, part = divmod(float(stamp), 1.0)
        return int(seconds), round(part * 1e9)
    except (ValueError, TypeError, OverflowError) as error:
        message = f"the stamp {stamp!r:.60} is no time"
        raise fault(path, key, message, "choose another topic, or record it again") from error

"""Recordings as ROS bags: ROS 1 (`.bag`), ROS 2 folders and single files (`.mcap`, `.db3`).

One topic is one movement. For poses, points, transforms and odometry, each message is a sample; a `Path` or a
`JointTrajectory` is a whole movement, and the last message counts. The order of quaternions, x y z w in ROS, is
changed to w x y z here. Time is that of the headers; if one of them is zero, the bag's own. Stamps are whole
nanoseconds.

Needs rosbags. Messages are decoded by the standard definitions; code or definitions in a bag are not used.
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
import tempfile
import warnings
from array import array
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.cleaning import Origin, check, check_orientation
from comove.demonstrations.demonstration import Demonstration
from comove.demonstrations.episodes import MAX_ROWS
from comove.demonstrations.loading import choose_name
from comove.demonstrations.mcap import check_mcap, seal_mcap
from comove.errors import ComoveWarning, DemonstrationError
from comove.io.files import existing_file, extra, telling, whole_path
from comove.io.folders import Contents, whole_folder

MAX_METADATA_BYTES = 4 * 2**20
"""Largest `metadata.yaml` [bytes]."""
MAX_BYTES = 64 * 2**30
"""Largest bag [bytes]: cameras fill it, and are not read."""
NANO = 10**9
_SQLITE_MAGIC = b"SQLite format 3\x00"
_RECORD = "copy it again, or let ROS repair it (rosbag reindex, ros2 bag reindex)"
_Messages = Iterator[tuple[int, Any]]
"""When the bag received each message [ns], and the message."""
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")


def read_rosbag(path: str | os.PathLike[str], *, topic: str | None = None) -> dict[str, Demonstration]:
    """Read the movements of a bag.

    Parameters
    ----------
    path : `.bag`, `.mcap` or `.db3` file, or folder with `metadata.yaml`
    topic : the only topic to read; None: all topics that hold movements

    Returns
    -------
    demos : movement by topic; each starts at time zero, and its notes give its delay after the first movement read

    Raises
    ------
    DemonstrationError
        If the bag cannot be read or is truncated, there is no such topic (lists those that can be read, with their
        types), or its messages are not a movement.

    Warns
    -----
    ComoveWarning
        If messages of other joints on the same topic were left out.
    """
    path = Path(path)
    with _opened(path) as bag:
        usable = _usable(path, bag)
        if topic is not None:
            usable = {topic: usable[choose_name(usable, topic, path, "topic")]}
        tracks = {name: _read_topic(path, bag, name, kind) for name, kind in usable.items()}
    for name, track in tracks.items():
        if track.warning:
            warnings.warn(f"{path.stem}{name}: {track.warning}", ComoveWarning, stacklevel=2)
    first = min(int(track.stamps[0]) for track in tracks.values())
    return {name: _movement(path, name, track, first) for name, track in tracks.items()}


def rosbag_topics(path: str | os.PathLike[str]) -> dict[str, str]:
    """Return the type of each topic that can be read.

    Raises
    ------
    DemonstrationError
        If the bag cannot be read, or has no such topic.
    """
    path = Path(path)
    with _opened(path) as bag:
        return _usable(path, bag)


def write_rosbag(
    path: str | os.PathLike[str],
    demos: Demonstration | Mapping[str, Demonstration],
    *,
    storage: str = "mcap",
    frame_id: str = "world",
    start_ns: int = NANO,
) -> None:
    """Write movements to a bag, from which `read_rosbag` returns the same numbers, bit by bit.

    Time stamps are rounded to whole nanoseconds. Movements in metres become `PoseStamped`, or `PointStamped` without
    orientations, on the topics `/NAME/pose` or `/NAME/point`; all others `JointState` on `/NAME/joint_states`.

    Parameters
    ----------
    path : `.bag`: ROS 1; `.mcap` or `.db3`: the single file of ROS 2; otherwise a ROS 2 folder, which must not
        exist or be empty. It appears only when complete
    demos : one movement, or movements by manipulator; their stamps may differ
    storage : storage format of a folder, "mcap" or "sqlite3"
    frame_id : reference frame of the positions
    start_ns : stamp of time zero [ns]; not 0, which means "none" in ROS

    Raises
    ------
    DemonstrationError
        If ROS cannot represent a movement or a name, or the bag cannot be written.
    """
    path = Path(path)
    demos = {"": demos} if isinstance(demos, Demonstration) else dict(demos)
    if not demos:
        raise DemonstrationError("there is no movement to write", file=path, way_out="give one at least")
    if storage not in ("mcap", "sqlite3"):
        raise DemonstrationError(
            f"{storage!r} is no storage", file=path, key="storage", way_out="choose mcap or sqlite3"
        )
    extra("rosbags", path)
    suffix = path.suffix.lower()
    if suffix == ".bag":
        with whole_path(path) as draft:
            _write_ros1(draft, demos, path, frame_id, start_ns)
    elif suffix in (".mcap", ".db3"):
        kind = "mcap" if suffix == ".mcap" else "sqlite3"
        with whole_path(path) as draft, tempfile.TemporaryDirectory(dir=draft.parent) as folder:
            _write_ros2(Path(folder, "bag"), demos, path, kind, frame_id, start_ns)
            os.replace(Path(folder, "bag", f"bag{suffix}"), draft)
    else:
        with whole_folder(path, Contents("recording", error=DemonstrationError)) as draft:
            _write_ros2(draft / path.name, demos, path, storage, frame_id, start_ns)
            for file in sorted((draft / path.name).iterdir()):  # the library names files after their folder
                os.replace(file, draft / file.name)
            (draft / path.name).rmdir()


@dataclass(frozen=True)
class _Track:
    """Content of a topic: stamps (n_steps,) [ns], values, and notes."""

    stamps: NDArray[np.int64]
    position: NDArray[np.float64]
    orientation: NDArray[np.float64] | None = None
    axes: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    warning: str = ""


@dataclass(frozen=True)
class _BagOrigin(Origin):
    """Names samples by topic and message."""

    topic: str = ""

    def time(self, sample: int) -> str:
        return f"{self.topic}, sample {sample}, stamp"

    def position(self, sample: int, dim: int) -> str:
        return f"{self.topic}, sample {sample}, coordinate {dim}"

    def orientation(self, sample: int) -> str:
        return f"{self.topic}, sample {sample}, orientation"


@dataclass(frozen=True)
class _Bag:
    """An open bag: the library's reader and the function that decodes its messages."""

    reader: Any
    decode: Callable[[bytes, str], Any]


@contextlib.contextmanager
def _opened(path: Path) -> Iterator[_Bag]:
    """Open a bag; convert its faults to a `DemonstrationError`."""
    with telling(path):
        is_folder = path.is_dir()
    if is_folder:
        existing_file(path / "metadata.yaml", MAX_METADATA_BYTES, _RECORD)
    else:
        existing_file(path, MAX_BYTES, "split the bag")
    extra("rosbags", path)
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    with _telling(path):
        for file in sorted(path.glob("*.db3")) if path.is_dir() else [path]:
            _check_sqlite_size(file)
        for file in sorted(path.glob("*.mcap")) if path.is_dir() else [path]:
            if file.suffix.lower() == ".mcap":
                check_mcap(file)
        if path.suffix.lower() == ".bag" and not path.is_dir():
            reader, store = rosbag1.Reader(path), get_typestore(Stores.ROS1_NOETIC)
            decode = store.deserialize_ros1
        else:
            reader, store = rosbag2.Reader(path), get_typestore(Stores.ROS2_HUMBLE)
            decode = store.deserialize_cdr
        with reader:
            yield _Bag(reader, decode)


@contextlib.contextmanager
def _telling(path: Path) -> Iterator[None]:
    """Convert the library's exceptions on a damaged bag, assertions included, to a `DemonstrationError`."""
    try:
        yield
    except (DemonstrationError, Warning):
        raise
    except Exception as error:
        reason = " ".join(f"{type(error).__name__}: {error}".split())[:160]
        raise DemonstrationError(f"it is no whole bag ({reason})", file=path, way_out=_RECORD) from error


def _check_sqlite_size(file: Path) -> None:
    """Raise if a database is truncated: SQLite itself only notices when it needs a missing page."""
    if file.suffix.lower() != ".db3":
        return
    with open(file, "rb") as stream:
        header = stream.read(100)
    size = file.stat().st_size
    if len(header) < 100 or not header.startswith(_SQLITE_MAGIC):
        raise DemonstrationError("it is no SQLite database", file=file, way_out=_RECORD)
    page_size, change, pages, valid_for = (
        struct.unpack(">H", header[16:18])[0],
        *(struct.unpack(">I", header[at : at + 4])[0] for at in (24, 28, 92)),
    )
    page_size = 65536 if page_size == 1 else page_size
    if change == valid_for and size != page_size * pages:
        raise DemonstrationError(
            f"it has {size} bytes and its header says {page_size * pages}", file=file, way_out=_RECORD
        )


def _usable(path: Path, bag: _Bag) -> dict[str, str]:
    """Return the type of each topic that can be read."""
    kinds = {connection.topic: connection.msgtype for connection in bag.reader.connections}
    usable = {topic: kind for topic, kind in sorted(kinds.items()) if kind in _READERS}
    if not usable:
        held = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items())[:20]) or "nothing"
        known = ", ".join(kind.replace("/msg/", "/") for kind in _READERS)
        raise DemonstrationError(f"it holds {held}", file=path, way_out=f"read are {known}")
    return usable


def _read_topic(path: Path, bag: _Bag, topic: str, kind: str) -> _Track:
    """Read all messages of a topic."""
    connections = [c for c in bag.reader.connections if c.topic == topic and c.msgtype == kind]
    n_messages = sum(connection.msgcount for connection in connections)
    if n_messages > MAX_ROWS:
        raise DemonstrationError(
            f"it has {n_messages:,} messages", file=path, key=topic, way_out=f"up to {MAX_ROWS:,} are read"
        )
    if not n_messages:
        raise DemonstrationError("it has no messages", file=path, key=topic, way_out="choose another topic")
    n_found = 0

    def messages() -> _Messages:
        """Decode one message at a time, so that only one is in memory."""
        nonlocal n_found
        for _, received, data in bag.reader.messages(connections=connections):
            n_found += 1
            if n_found <= n_messages:
                yield received, bag.decode(data, kind)

    track = _READERS[kind](path, topic, messages())
    if n_found != n_messages:
        raise DemonstrationError(
            f"it has {n_found} messages and the index says {n_messages}",
            file=path,
            key=topic,
            way_out=_RECORD,
        )
    return track


def _movement(path: Path, topic: str, track: _Track, first: int) -> Demonstration:
    """Build the movement of a topic; time is counted from the stamp `first` [ns]."""
    origin = _BagOrigin(path, topic)
    time, position = check((track.stamps - first) / NANO, track.position, origin)
    orientation = track.orientation
    if orientation is not None:
        orientation = check_orientation(orientation, len(time), origin)
    name = f"{path.stem}{topic}"
    unit = "rad" if track.axes else "m"
    try:
        return Demonstration(
            time, position, name, track.notes, unit, orientation=orientation, axes=track.axes
        )
    except DemonstrationError as error:
        raise DemonstrationError(error.message, file=path, key=topic, way_out=error.way_out) from None


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * NANO + int(stamp.nanosec)


def _chosen_stamps(stamps: array[int]) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the stamps of the headers, or the bag's own, with a note, if a header has none.

    Parameters
    ----------
    stamps : for each message in turn the time at which the bag received it and the stamp of its header [ns]
    """
    received, said = np.array(stamps, dtype=np.int64).reshape(-1, 2).T
    if (said != 0).all() or np.array_equal(received, said):
        return said, ()
    return received, ("headers without a stamp: time is that of the bag",)


def _track_of_poses(stamps: NDArray[np.int64], poses: array[float], notes: tuple[str, ...]) -> _Track:
    """Build a track from poses, each x y z and w x y z."""
    rows = np.array(poses, dtype=np.float64).reshape(-1, 7)
    if not rows[:, 3:].any():
        unset = "all quaternions are zero: orientations left out"
        return _Track(stamps, rows[:, :3], notes=(*notes, unset))
    return _Track(stamps, rows[:, :3], rows[:, 3:], notes=notes)


def _pose_reader(pick: Callable[[Any], tuple[Any, Any]]) -> Callable[..., _Track]:
    """Return a reader of messages that hold one pose each."""

    def read(path: Path, topic: str, messages: _Messages) -> _Track:
        stamps, poses = array("q"), array("d")
        for received, message in messages:
            p, q = pick(message)
            stamps.extend((received, _nanoseconds(message.header.stamp)))
            poses.extend((p.x, p.y, p.z, q.w, q.x, q.y, q.z))
        said, notes = _chosen_stamps(stamps)
        return _track_of_poses(said, poses, notes)

    return read


def _read_points(path: Path, topic: str, messages: _Messages) -> _Track:
    stamps, points = array("q"), array("d")
    for received, message in messages:
        stamps.extend((received, _nanoseconds(message.header.stamp)))
        points.extend((message.point.x, message.point.y, message.point.z))
    said, notes = _chosen_stamps(stamps)
    return _Track(said, np.array(points, dtype=np.float64).reshape(-1, 3), notes=notes)


def _read_path(path: Path, topic: str, messages: _Messages) -> _Track:
    message, notes = _last_of(messages)
    if not message.poses:
        raise DemonstrationError("the path is empty", file=path, key=topic, way_out="choose another topic")
    stamps = np.array([_nanoseconds(pose.header.stamp) for pose in message.poses], dtype=np.int64)
    poses = array("d")
    for stamped in message.poses:
        p, q = stamped.pose.position, stamped.pose.orientation
        poses.extend((p.x, p.y, p.z, q.w, q.x, q.y, q.z))
    return _track_of_poses(stamps, poses, notes)


def _read_joint_states(path: Path, topic: str, messages: _Messages) -> _Track:
    """Read joint states; if several publishers share the topic, only those of the most frequent set of joints."""
    kinds: dict[tuple[str, ...], tuple[array[int], array[float]]] = {}
    n_messages = 0
    for received, message in messages:
        n_messages += 1
        if not len(message.position):
            continue
        stamps, positions = kinds.setdefault(tuple(message.name), (array("q"), array("d")))
        _check_row(path, topic, n_messages - 1, message.position, message.name)
        stamps.extend((received, _nanoseconds(message.header.stamp)))
        positions.extend(message.position)
    if not kinds:
        raise DemonstrationError(
            "no message has positions", file=path, key=topic, way_out="choose another topic"
        )
    names = max(kinds, key=lambda kind: len(kinds[kind][0]))
    stamps, positions = kinds[names]
    said, notes = _chosen_stamps(stamps)
    left_out = n_messages - len(said)
    warning = f"{left_out} of {n_messages} messages are of other joints and left out" if left_out else ""
    position = np.array(positions, dtype=np.float64).reshape(len(said), len(names))
    return _Track(said, position, None, names, (*notes, *filter(None, [warning])), warning)


def _read_joint_trajectory(path: Path, topic: str, messages: _Messages) -> _Track:
    trajectory, notes = _last_of(messages)
    points, names = trajectory.points, tuple(trajectory.joint_names)
    if not points:
        raise DemonstrationError(
            "the trajectory is empty", file=path, key=topic, way_out="choose another topic"
        )
    for sample, point in enumerate(points):
        _check_row(path, topic, sample, point.positions, names)
    stamps = np.array([_nanoseconds(point.time_from_start) for point in points], dtype=np.int64)
    position = np.array([point.positions for point in points], dtype=np.float64)
    return _Track(stamps, position.reshape(len(points), len(names)), None, names, notes)


def _check_row(path: Path, topic: str, sample: int, row: Any, names: Any) -> None:
    if len(row) != len(names):
        raise DemonstrationError(
            f"it has {len(row)} positions of {len(names)} joints",
            file=path,
            key=f"{topic}, sample {sample}",
            way_out="record every joint that is named",
        )


def _last_of(messages: _Messages) -> tuple[Any, tuple[str, ...]]:
    """Return the last message, with a note if there were others."""
    number, message = 0, None
    for number, (_, message) in enumerate(messages, start=1):  # noqa: B007
        pass
    return message, (f"the last of {number} messages",) if number > 1 else ()


_READERS: dict[str, Callable[..., _Track]] = {
    "geometry_msgs/msg/PoseStamped": _pose_reader(lambda m: (m.pose.position, m.pose.orientation)),
    "geometry_msgs/msg/PointStamped": _read_points,
    "geometry_msgs/msg/TransformStamped": _pose_reader(
        lambda m: (m.transform.translation, m.transform.rotation)
    ),
    "nav_msgs/msg/Odometry": _pose_reader(lambda m: (m.pose.pose.position, m.pose.pose.orientation)),
    "nav_msgs/msg/Path": _read_path,
    "sensor_msgs/msg/JointState": _read_joint_states,
    "trajectory_msgs/msg/JointTrajectory": _read_joint_trajectory,
}


def _write_ros1(
    draft: Path, demos: Mapping[str, Demonstration], path: Path, frame_id: str, start_ns: int
) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(draft) as writer:
        _write_messages(writer, store, store.serialize_ros1, demos, path, frame_id, start_ns)


def _write_ros2(
    draft: Path, demos: Mapping[str, Demonstration], path: Path, storage: str, frame_id: str, start_ns: int
) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(draft, version=8, storage_plugin=plugin) as writer:
        _write_messages(writer, store, store.serialize_cdr, demos, path, frame_id, start_ns)
    for file in draft.glob("*.mcap"):
        seal_mcap(file)


def _write_messages(
    writer: Any,
    store: Any,
    encode: Callable[[Any, str], Any],
    demos: Mapping[str, Demonstration],
    path: Path,
    frame_id: str,
    start_ns: int,
) -> None:
    """Write the messages of all movements in the order of their stamps."""
    queue = []
    for name, demo in demos.items():
        topic, kind = _topic_and_type(path, name, demo)
        connection = writer.add_connection(topic, kind, typestore=store)
        make = _maker(store, kind, demo, frame_id)
        stamps = start_ns + np.rint(demo.time * NANO).astype(np.int64)
        queue += [(int(stamp), connection, kind, make, row) for row, stamp in enumerate(stamps)]
    for stamp, connection, kind, make, row in sorted(queue, key=lambda item: item[0]):
        writer.write(connection, stamp, encode(make(row, stamp), kind))


def _topic_and_type(path: Path, name: str, demo: Demonstration) -> tuple[str, str]:
    if name and not _NAME.fullmatch(name):
        raise DemonstrationError(
            f"the manipulator's name {name!r} is no name in ROS",
            file=path,
            way_out="begin with a letter and use letters, digits and underscores",
        )
    if demo.unit != "m" or demo.axes:
        last, kind = "joint_states", "sensor_msgs/msg/JointState"
        if demo.orientation is not None:
            raise DemonstrationError(
                f"{name or 'the movement'} has joints and orientations",
                file=path,
                way_out="write them as two movements",
            )
    elif demo.n_dims != 3:
        raise DemonstrationError(
            f"{name or 'the movement'} has {demo.n_dims} dimensions",
            file=path,
            way_out="a point has x, y and z in ROS: lay it into space first",
        )
    elif demo.orientation is None:
        last, kind = "point", "geometry_msgs/msg/PointStamped"
    else:
        last, kind = "pose", "geometry_msgs/msg/PoseStamped"
    return f"/{name}/{last}" if name else f"/{last}", kind


def _maker(store: Any, kind: str, demo: Demonstration, frame_id: str) -> Callable[[int, int], Any]:
    """Return a function that makes the message of a row at a stamp [ns]."""
    message, Header, Time = (
        store.types[name] for name in (kind, "std_msgs/msg/Header", "builtin_interfaces/msg/Time")
    )
    Point, Quaternion, Pose = (
        store.types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion", "Pose")
    )
    is_ros1 = "seq" in {name for name, _ in store.fielddefs["std_msgs/msg/Header"][1]}

    def header(row: int, stamp: int) -> Any:
        first = {"seq": row} if is_ros1 else {}
        return Header(**first, stamp=Time(sec=stamp // NANO, nanosec=stamp % NANO), frame_id=frame_id)

    position = demo.position.tolist()
    if kind.endswith("JointState"):
        names, none = list(demo.axes or (f"joint{i}" for i in range(demo.n_dims))), np.empty(0)
        return lambda row, stamp: message(
            header=header(row, stamp), name=names, position=demo.position[row], velocity=none, effort=none
        )

    def point(row: int) -> Any:
        x, y, z = position[row]
        return Point(x=x, y=y, z=z)

    if demo.orientation is None:
        return lambda row, stamp: message(header=header(row, stamp), point=point(row))
    orientation = demo.orientation.tolist()

    def pose(row: int) -> Any:
        w, x, y, z = orientation[row]
        return Pose(position=point(row), orientation=Quaternion(x=x, y=y, z=z, w=w))

    return lambda row, stamp: message(header=header(row, stamp), pose=pose(row))

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
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.formats.mcap import check_mcap, seal_mcap
from comove.demonstrations.samples import (
    MAX_ROWS,
    Format,
    Origin,
    RecordedSamples,
    by_manipulator,
    decoding,
    fault,
    select_name,
)
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
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Names that ROS allows in topics."""
Images = Mapping[str, tuple[NDArray[np.float64], Sequence[bytes]]]
NO_IMAGES: Images = {}


def read(path: str | os.PathLike[str], *, topic: str | None = None) -> dict[str, RecordedSamples]:
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
            usable = {topic: usable[select_name(usable, topic, path, "topic")]}
        tracks = {name: _read_topic(path, bag, name, kind) for name, kind in usable.items()}
    for name, track in tracks.items():
        if track.warning:
            warnings.warn(f"{path.stem}{name}: {track.warning}", ComoveWarning, stacklevel=3)
    first = min(int(track.stamps[0]) for track in tracks.values())
    return {name: _samples(path, name, track, first) for name, track in tracks.items()}


def topics(path: str | os.PathLike[str]) -> dict[str, str]:
    """Return the type of each topic that can be read.

    Raises
    ------
    DemonstrationError
        If the bag cannot be read, or has no such topic.
    """
    path = Path(path)
    with _opened(path) as bag:
        return _usable(path, bag)


def write(
    path: str | os.PathLike[str],
    demos: RecordedSamples | Mapping[str, RecordedSamples],
    *,
    storage: str = "mcap",
    frame_id: str = "world",
    start_ns: int = NANO,
    about: str = "",
    images: Images = NO_IMAGES,
) -> None:
    """Write movements to a bag, from which they are read again with the same numbers, bit by bit.

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
    about : text that stands in the bag as a `String` on the topic `/comove/about`
    images : times [s] and JPEG files of cameras by their names, on the topics `/NAME/image/compressed`

    Raises
    ------
    DemonstrationError
        If ROS cannot represent a movement or a name, or the bag cannot be written.
    """
    path = Path(path)
    demos = by_manipulator(demos, path, alike=False)
    if storage not in ("mcap", "sqlite3"):
        raise fault(path, "storage", f"{storage!r} is no storage", "choose mcap or sqlite3")
    extra("rosbags", path)
    said: dict[str, Any] = {"frame_id": frame_id, "start_ns": start_ns, "about": about, "images": images}
    fill = partial(_write_messages, demos=demos, path=path, **said)
    suffix = path.suffix.lower()
    if suffix == ".bag":
        with whole_path(path) as draft:
            _write_ros1(draft, fill)
    elif suffix in (".mcap", ".db3"):
        kind = "mcap" if suffix == ".mcap" else "sqlite3"
        with whole_path(path) as draft, tempfile.TemporaryDirectory(dir=draft.parent) as folder:
            _write_ros2(Path(folder, "bag"), kind, fill)
            os.replace(Path(folder, "bag", f"bag{suffix}"), draft)
    else:
        with whole_folder(path, Contents("recording", error=DemonstrationError)) as draft:
            _write_ros2(draft / path.name, storage, fill)
            for file in sorted((draft / path.name).iterdir()):  # the library names files after their folder
                os.replace(file, draft / file.name)
            (draft / path.name).rmdir()


FORMAT = Format(
    "rosbag2",
    read,
    suffixes=(".bag", ".mcap", ".db3"),
    marker="metadata.yaml",
    part="topic",
    parts=topics,
    write=write,
)


@dataclass(frozen=True)
class _Track:
    """Content of a topic: stamps (n_steps,) [ns], values, notes, and what is warned of."""

    stamps: NDArray[np.int64]
    position: NDArray[np.float64]
    orientation: NDArray[np.float64] | None = None
    axes: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    warning: str = ""


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

    # A damaged bag makes the library fail in any way, assertions included.
    with decoding(path, "bag", (Exception,), _RECORD):
        for file in sorted(path.iterdir()) if is_folder else [path]:
            if file.suffix.lower() == ".db3":
                _check_sqlite_size(file)
            elif file.suffix.lower() == ".mcap":
                check_mcap(file)
        if path.suffix.lower() == ".bag" and not is_folder:
            decode = get_typestore(Stores.ROS1_NOETIC).deserialize_ros1
            with rosbag1.Reader(path) as reader:
                yield _Bag(reader, decode)
        else:
            decode = get_typestore(Stores.ROS2_HUMBLE).deserialize_cdr
            with rosbag2.Reader(path) as reader:
                yield _Bag(reader, decode)


def _check_sqlite_size(file: Path) -> None:
    """Raise if a database is truncated: SQLite itself only notices when it needs a missing page."""
    with open(file, "rb") as stream:
        header = stream.read(100)
    size = file.stat().st_size
    if len(header) < 100 or not header.startswith(_SQLITE_MAGIC):
        raise fault(file, None, "it is no SQLite database", _RECORD)
    page_size, change, pages, valid_for = (
        struct.unpack(">H", header[16:18])[0],
        *(struct.unpack(">I", header[at : at + 4])[0] for at in (24, 28, 92)),
    )
    page_size = 65536 if page_size == 1 else page_size
    if change == valid_for and size != page_size * pages:
        raise fault(file, None, f"it has {size} bytes and its header says {page_size * pages}", _RECORD)


def _usable(path: Path, bag: _Bag) -> dict[str, str]:
    """Return the type of each topic that can be read."""
    kinds = {connection.topic: connection.msgtype for connection in bag.reader.connections}
    usable = {topic: kind for topic, kind in sorted(kinds.items()) if kind in _READERS}
    if not usable:
        held = ", ".join(f"{topic} ({kind})" for topic, kind in sorted(kinds.items())[:20]) or "nothing"
        known = ", ".join(kind.replace("/msg/", "/") for kind in _READERS)
        raise fault(path, None, f"it holds {held}", f"read are {known}")
    return usable


def _read_topic(path: Path, bag: _Bag, topic: str, kind: str) -> _Track:
    """Read all messages of a topic."""
    connections = [c for c in bag.reader.connections if c.topic == topic and c.msgtype == kind]
    n_messages = sum(connection.msgcount for connection in connections)
    if n_messages > MAX_ROWS:
        raise fault(path, topic, f"it has {n_messages:,} messages", f"up to {MAX_ROWS:,} are read")
    if not n_messages:
        raise fault(path, topic, "it has no messages", "choose another topic")
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
        raise fault(path, topic, f"it has {n_found} messages and the index says {n_messages}", _RECORD)
    return track


def _samples(path: Path, topic: str, track: _Track, first: int) -> RecordedSamples:
    """Return the movement of a topic; time is counted from the stamp `first` [ns]."""
    origin = Origin(
        path,
        time=lambda sample: f"{topic}, sample {sample}, stamp",
        position=lambda sample, dim: f"{topic}, sample {sample}, coordinate {dim}",
        orientation=lambda sample: f"{topic}, sample {sample}, orientation",
        axes=topic,
    )
    return RecordedSamples(
        (track.stamps - first) / NANO,
        track.position,
        f"{path.stem}{topic}",
        track.notes,
        "rad" if track.axes else "m",
        orientation=track.orientation,
        axes=track.axes,
        origin=origin,
    )


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


def _track(stamps: NDArray[np.int64], rows: array[float], notes: tuple[str, ...]) -> _Track:
    """Build a track from points x y z, or from poses x y z and w x y z."""
    values = np.array(rows, dtype=np.float64).reshape(len(stamps), len(rows) // max(len(stamps), 1))
    position, orientation = values[:, :3], values[:, 3:]
    if not orientation.size:
        return _Track(stamps, position, notes=notes)
    if not orientation.any():
        return _Track(stamps, position, notes=(*notes, "all quaternions are zero: orientations left out"))
    return _Track(stamps, position, orientation, notes=notes)


def _point(p: Any) -> tuple[float, ...]:
    return p.x, p.y, p.z


def _pose(p: Any, q: Any) -> tuple[float, ...]:
    return p.x, p.y, p.z, q.w, q.x, q.y, q.z


def _stamped(pick: Callable[[Any], tuple[float, ...]]) -> Callable[..., _Track]:
    """Return a reader of messages with headers, each of which holds one point or pose, which `pick` returns."""

    def read(path: Path, topic: str, messages: _Messages) -> _Track:
        stamps, rows = array("q"), array("d")
        for received, message in messages:
            stamps.extend((received, _nanoseconds(message.header.stamp)))
            rows.extend(pick(message))
        said, notes = _chosen_stamps(stamps)
        return _track(said, rows, notes)

    return read


def _read_path(path: Path, topic: str, messages: _Messages) -> _Track:
    message, notes = _last_of(messages)
    if not message.poses:
        raise fault(path, topic, "the path is empty", "choose another topic")
    stamps, rows = array("q"), array("d")
    for stamped in message.poses:
        stamps.append(_nanoseconds(stamped.header.stamp))
        rows.extend(_pose(stamped.pose.position, stamped.pose.orientation))
    return _track(np.array(stamps, dtype=np.int64), rows, notes)


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
        raise fault(path, topic, "no message has positions", "choose another topic")
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
        raise fault(path, topic, "the trajectory is empty", "choose another topic")
    for sample, point in enumerate(points):
        _check_row(path, topic, sample, point.positions, names)
    stamps = np.array([_nanoseconds(point.time_from_start) for point in points], dtype=np.int64)
    position = np.array([point.positions for point in points], dtype=np.float64)
    return _Track(stamps, position.reshape(len(points), len(names)), None, names, notes)


def _check_row(path: Path, topic: str, sample: int, row: Any, names: Any) -> None:
    if len(row) != len(names):
        raise fault(
            path,
            f"{topic}, sample {sample}",
            f"it has {len(row)} positions of {len(names)} joints",
            "record every joint that is named",
        )


def _last_of(messages: _Messages) -> tuple[Any, tuple[str, ...]]:
    """Return the last message, with a note if there were others."""
    number, message = 0, None
    for number, (_, message) in enumerate(messages, start=1):  # noqa: B007
        pass
    return message, (f"the last of {number} messages",) if number > 1 else ()


_READERS: dict[str, Callable[..., _Track]] = {
    "geometry_msgs/msg/PoseStamped": _stamped(lambda m: _pose(m.pose.position, m.pose.orientation)),
    "geometry_msgs/msg/PointStamped": _stamped(lambda m: _point(m.point)),
    "geometry_msgs/msg/TransformStamped": _stamped(
        lambda m: _pose(m.transform.translation, m.transform.rotation)
    ),
    "nav_msgs/msg/Odometry": _stamped(lambda m: _pose(m.pose.pose.position, m.pose.pose.orientation)),
    "nav_msgs/msg/Path": _read_path,
    "sensor_msgs/msg/JointState": _read_joint_states,
    "trajectory_msgs/msg/JointTrajectory": _read_joint_trajectory,
}


def _write_ros1(draft: Path, fill: Callable[..., None]) -> None:
    from rosbags.rosbag1 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    with Writer(draft) as writer:
        fill(writer, store, store.serialize_ros1)


def _write_ros2(draft: Path, storage: str, fill: Callable[..., None]) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(draft, version=8, storage_plugin=plugin) as writer:
        fill(writer, store, store.serialize_cdr)
    for file in draft.glob("*.mcap"):
        seal_mcap(file)


def _write_messages(
    writer: Any,
    store: Any,
    encode: Callable[[Any, str], Any],
    *,
    demos: Mapping[str, RecordedSamples],
    path: Path,
    frame_id: str,
    start_ns: int,
    about: str,
    images: Images,
) -> None:
    """Write the messages of all movements and cameras in the order of their stamps."""
    if about:
        text = "std_msgs/msg/String"
        connection = writer.add_connection("/comove/about", text, typestore=store)
        writer.write(connection, start_ns, encode(store.types[text](data=about), text))
    tracks = []
    for name, demo in demos.items():
        topic, kind = _topic_and_type(path, name, demo)
        tracks.append((topic, kind, demo.time, _maker(store, kind, demo, frame_id)))
    for name, (time, files) in images.items():
        kind = "sensor_msgs/msg/CompressedImage"
        tracks.append((f"/{name}/image/compressed", kind, time, _image_maker(store, kind, files, name)))
    queue = []
    for topic, kind, time, make in tracks:
        connection = writer.add_connection(topic, kind, typestore=store)
        stamps = start_ns + np.rint(time * NANO).astype(np.int64)
        queue += [(int(stamp), connection, kind, make, row) for row, stamp in enumerate(stamps)]
    for stamp, connection, kind, make, row in sorted(queue, key=lambda item: item[0]):
        writer.write(connection, stamp, encode(make(row, stamp), kind))


def _topic_and_type(path: Path, name: str, demo: RecordedSamples) -> tuple[str, str]:
    if name and not NAME.fullmatch(name):
        raise fault(
            path,
            None,
            f"the manipulator's name {name!r} is no name in ROS",
            "begin with a letter and use letters, digits and underscores",
        )
    if demo.unit != "m" or demo.axes:
        last, kind = "joint_states", "sensor_msgs/msg/JointState"
        if demo.orientation is not None:
            raise fault(
                path,
                None,
                f"{name or 'the movement'} has joints and orientations",
                "write them as two movements",
            )
    elif demo.n_dims != 3:
        raise fault(
            path,
            None,
            f"{name or 'the movement'} has {demo.n_dims} dimensions",
            "a point has x, y and z in ROS: lay it into space first",
        )
    elif demo.orientation is None:
        last, kind = "point", "geometry_msgs/msg/PointStamped"
    else:
        last, kind = "pose", "geometry_msgs/msg/PoseStamped"
    return f"/{name}/{last}" if name else f"/{last}", kind


def _header_maker(store: Any, frame_id: str) -> Callable[[int, int], Any]:
    """Return a function that makes the header of a row's message at a stamp [ns]."""
    Header, Time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    is_ros1 = "seq" in {name for name, _ in store.fielddefs["std_msgs/msg/Header"][1]}

    def header(row: int, stamp: int) -> Any:
        first = {"seq": row} if is_ros1 else {}
        return Header(**first, stamp=Time(sec=stamp // NANO, nanosec=stamp % NANO), frame_id=frame_id)

    return header


def _image_maker(store: Any, kind: str, files: Sequence[bytes], frame_id: str) -> Callable[[int, int], Any]:
    """Return a function that makes the message of a camera's picture at a stamp [ns]."""
    message, header = store.types[kind], _header_maker(store, frame_id)

    def image(row: int, stamp: int) -> Any:
        data = np.frombuffer(files[row], dtype=np.uint8)
        return message(header=header(row, stamp), format="jpeg", data=data)

    return image


def _maker(store: Any, kind: str, demo: RecordedSamples, frame_id: str) -> Callable[[int, int], Any]:
    """Return a function that makes the message of a row at a stamp [ns]."""
    message, header = store.types[kind], _header_maker(store, frame_id)
    Point, Quaternion, Pose = (
        store.types[f"geometry_msgs/msg/{name}"] for name in ("Point", "Quaternion", "Pose")
    )
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

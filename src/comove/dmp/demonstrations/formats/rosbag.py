"""Recordings as ROS bags: ROS 1 (`.bag`), ROS 2 folders and single files (`.mcap`, `.db3`).

One topic is one movement, or several: `TOPIC:NAME` is that of one set of joints, one body, one frame in another, or
one part of a recording whose clock was set back (`formats.ros_messages`). For poses, points, transforms and odometry,
each message is a sample; a `Path` or a `JointTrajectory` is a whole movement, and the last message counts. The order
of quaternions, x y z w in ROS, is changed to w x y z here. Time is that of the headers; if one of them is zero, the
bag's own. Stamps are whole nanoseconds.

Needs rosbags. Messages are decoded by the standard definitions; code or definitions in a bag are not used. A file
`.mcap` may hold JSON messages instead (`formats.mcap_json`).
"""

from __future__ import annotations

import contextlib
import os
import re
import struct
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.formats.mcap import check_mcap, seal_mcap
from comove.dmp.demonstrations.formats.mcap_json import JsonReader
from comove.dmp.demonstrations.formats.ros_messages import (
    KINDS,
    NANO,
    TRANSFORMS,
    WHOLE,
    Messages,
    Track,
    read_messages,
)
from comove.dmp.demonstrations.samples import (
    MAX_ROWS,
    TIME,
    Format,
    Origin,
    RecordedSamples,
    by_manipulator,
    decoding,
    fault,
    require_bytes,
    select_name,
)
from comove.errors import DemonstrationError, listed
from comove.io.files import existing_file, extra, telling, whole_path
from comove.io.folders import Contents, whole_folder

MAX_METADATA_BYTES = 4 * 2**20
"""Largest `metadata.yaml` [bytes]."""
MAX_BYTES = 64 * 2**30
"""Largest bag [bytes]: cameras fill it, and are not read."""
_SQLITE_MAGIC = b"SQLite format 3\x00"
_RECORD = "copy it again, or let ROS repair it (rosbag reindex, ros2 bag reindex)"
STATIC = "_static"
"""What the topic of constant transforms has behind the name of the topic of the others."""
_TYPES = ", ".join(kind.replace("/msg/", "/") for kind in KINDS)
NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Names that ROS allows in topics."""
Images = Mapping[str, tuple[NDArray[np.float64], Sequence[bytes]]]
NO_IMAGES: Images = {}


def read(
    path: str | os.PathLike[str], *, topic: str | None = None, rate: float | None = None
) -> dict[str, RecordedSamples]:
    """Read the movements of a bag.

    Parameters
    ----------
    path : `.bag`, `.mcap` or `.db3` file, or folder with `metadata.yaml`
    topic : the only topic to read, or the only movement `TOPIC:NAME` of a topic that holds several; None: all topics
        that hold movements. Transforms are read if no other topic holds a movement, or if their topic is given
    rate : samples a second of a `Path` whose poses have no stamps [Hz]

    Returns
    -------
    demos : movement by topic, or by `TOPIC:NAME`; each starts at time zero, and its notes give its delay after the
        first movement read

    Raises
    ------
    DemonstrationError
        If the bag cannot be read or is truncated, there is no such topic (lists those that can be read, with their
        types), or its messages are not a movement.
    """
    path = Path(path)
    name, _, body = (topic or "").partition(":")
    tracks: dict[str, Track] = {}
    with opened(path) as bag:
        for one, kind in _chosen(path, bag, name or None).items():
            found = _read_topic(path, bag, one, kind, body, rate)
            tracks |= {f"{one}:{part}" if part else one: track for part, track in found.items()}
    if body:
        tracks = {str(topic): tracks[select_name(_sizes(tracks), topic, path, "topic")]}
    first = min(int(track.stamps[0]) for track in tracks.values())
    return {name: _samples(path, name, track, first) for name, track in tracks.items()}


def topics(path: str | os.PathLike[str]) -> dict[str, str]:
    """Return the type of each topic that holds a movement. Transforms count only if no other topic does.

    Raises
    ------
    DemonstrationError
        If the bag cannot be read, or has no such topic.
    """
    path = Path(path)
    with opened(path) as bag:
        return _chosen(path, bag)


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
    """Write movements to a bag, without loss of any bit.

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
    about : text written as a `String` on the topic `/comove/about`
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
    options=frozenset({"rate"}),
    write=write,
)


@dataclass(frozen=True)
class Bag:
    """An open bag: the library's reader, its message decoder, and the definitions that this one uses.

    A bag of JSON messages has no definitions.
    """

    reader: Any
    decode: Callable[[bytes, str], Any]
    store: Any = None


@contextlib.contextmanager
def opened(path: Path, definitions: Mapping[str, str] = MappingProxyType({})) -> Iterator[Bag]:
    """Open a bag; convert its faults to a `DemonstrationError`.

    Parameters
    ----------
    definitions : texts of further types of ROS 2, by name
    """
    with telling(path):
        is_folder = path.is_dir()
    if is_folder:
        existing_file(path / "metadata.yaml", MAX_METADATA_BYTES, _RECORD)
    else:
        existing_file(path, MAX_BYTES, "split the bag")
    extra("rosbags", path)
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    # A damaged bag makes the library fail in any way, assertions included.
    with decoding(path, "bag", (Exception,), _RECORD), _supported(path):
        is_json = False
        for file in sorted(path.iterdir()) if is_folder else [path]:
            if file.suffix.lower() in (".db3", ".mcap", ".bag"):
                existing_file(file, MAX_BYTES, "split the bag")
                require_bytes(file)
            if file.suffix.lower() == ".db3":
                _check_sqlite_size(file)
            elif file.suffix.lower() == ".mcap":
                is_json = check_mcap(file)
        if is_json and not is_folder:
            json_messages = JsonReader(path)
            yield Bag(json_messages, json_messages.decode)
        elif path.suffix.lower() == ".bag" and not is_folder:
            store = get_typestore(Stores.ROS1_NOETIC)
            for kind in TRANSFORMS:
                store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", kind))
            with rosbag1.Reader(path) as reader:
                yield Bag(reader, store.deserialize_ros1, store)
        else:
            store = get_typestore(Stores.ROS2_HUMBLE)
            for kind, text in definitions.items():
                store.register(get_types_from_msg(text, kind))
            with rosbag2.Reader(path) as reader:
                yield Bag(reader, store.deserialize_cdr, store)


@contextlib.contextmanager
def _supported(path: Path) -> Iterator[None]:
    """Convert the library's refusal of a bag's kind to a fault."""
    try:
        yield
    except Exception as error:
        if type(error).__name__ == "ReaderError" and "not supported" in str(error):
            raise fault(
                path,
                None,
                f"it is a kind of bag that is not read ({error})",
                "convert it: ros2 bag convert, to messages in CDR, uncompressed or compressed by zstd",
            ) from error
        raise


def _check_sqlite_size(file: Path) -> None:
    """Raise if a database is truncated. SQLite itself only notices when it needs a missing page."""
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


def _kinds(bag: Bag) -> dict[str, tuple[str, int]]:
    """Return each topic's type and number of messages."""
    found: dict[str, tuple[str, int]] = {}
    for one in sorted(bag.reader.connections, key=lambda one: one.topic):
        found[one.topic] = one.msgtype, found.get(one.topic, ("", 0))[1] + one.msgcount
    return found


def _chosen(path: Path, bag: Bag, topic: str | None = None) -> dict[str, str]:
    """Return the type of a topic, or of all with movements. Transforms count only without others."""
    kinds = _kinds(bag)
    usable = {name: kind for name, (kind, _) in kinds.items() if kind in KINDS}
    if topic in usable:
        return {topic: usable[topic]}
    if topic in kinds:
        raise fault(
            path, topic, f"its type {kinds[topic][0]} is not read", f"read are {_in_words(usable) or _TYPES}"
        )
    if not usable:
        held = _in_words({name: kind for name, (kind, _) in kinds.items()}) or "nothing"
        raise fault(path, None, f"it holds {held}", f"read are {_TYPES}")
    if topic is not None:
        select_name(usable, topic, path, "topic")  # which says what there is
    moving = {
        name: kind for name, kind in usable.items() if kinds[name][1] > (0 if kind in WHOLE else 1)
    } or usable
    own = {name: kind for name, kind in moving.items() if kind not in TRANSFORMS}
    changing = {name: kind for name, kind in moving.items() if not name.endswith(STATIC)}
    return own or changing or usable


def _in_words(kinds: Mapping[str, str]) -> str:
    return listed([f"{topic} ({kind})" for topic, kind in kinds.items()], 20)


def _read_topic(
    path: Path, bag: Bag, topic: str, kind: str, body: str, rate: float | None
) -> dict[str, Track]:
    """Read all messages of a topic, with its constant transforms."""
    static = _messages(path, bag, topic + STATIC, kind) if kind in TRANSFORMS else iter(())
    return read_messages(
        path, topic, kind, _messages(path, bag, topic, kind), static=static, body=body, rate=rate
    )


def _messages(path: Path, bag: Bag, topic: str, kind: str) -> Messages:
    """Decode the messages of a topic, one at a time."""
    connections = [c for c in bag.reader.connections if c.topic == topic and c.msgtype == kind]
    n_messages, n_found = sum(connection.msgcount for connection in connections), 0
    if n_messages > MAX_ROWS:
        raise fault(path, topic, f"it has {n_messages:,} messages", f"up to {MAX_ROWS:,} are read")
    if not n_messages:
        if topic.endswith(STATIC):
            return
        raise fault(path, topic, "it has no messages", "choose another topic")
    for _, received, data in bag.reader.messages(connections=connections):
        n_found += 1
        if n_found <= n_messages:
            yield received, bag.decode(data, kind)
    if n_found != n_messages:
        raise fault(path, topic, f"it has {n_found} messages and the index says {n_messages}", _RECORD)


def _sizes(tracks: Mapping[str, Track]) -> dict[str, str]:
    return {
        name: ", ".join(filter(None, (listed(track.axes, 8), f"{len(track.stamps)} samples")))
        for name, track in tracks.items()
    }


def _samples(path: Path, topic: str, track: Track, first: int) -> RecordedSamples:
    """Return the movement of a topic, timed from stamp `first` [ns]."""
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
        stated=frozenset({TIME}),
        origin=origin,
    )


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
    """Write the messages of movements and cameras in stamp order."""
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
    """Return a function that makes a row's header at a stamp [ns]."""
    Header, Time = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    is_ros1 = "seq" in {name for name, _ in store.fielddefs["std_msgs/msg/Header"][1]}

    def header(row: int, stamp: int) -> Any:
        first = {"seq": row} if is_ros1 else {}
        return Header(**first, stamp=Time(sec=stamp // NANO, nanosec=stamp % NANO), frame_id=frame_id)

    return header


def _image_maker(store: Any, kind: str, files: Sequence[bytes], frame_id: str) -> Callable[[int, int], Any]:
    """Return a function that makes a camera's message at a stamp [ns]."""
    message, header = store.types[kind], _header_maker(store, frame_id)

    def image(row: int, stamp: int) -> Any:
        data = np.frombuffer(files[row], dtype=np.uint8)
        return message(header=header(row, stamp), format="jpeg", data=data)

    return image


def _maker(store: Any, kind: str, demo: RecordedSamples, frame_id: str) -> Callable[[int, int], Any]:
    """Return a function that makes a row's message at a stamp [ns]."""
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

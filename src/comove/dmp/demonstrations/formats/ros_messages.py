"""Movements in the messages of one ROS topic.

They are poses and points of one or several bodies, joints, or transforms. Messages of one topic are told apart by
their subject: the frames of a transform or pose, the number in an array of poses, the set of joints. Time is that of
the headers; the bag's own if a header has none, or all are alike. Samples that arrive late by little are sorted;
where time begins anew, another movement begins.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import chain, repeat
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.formats.ros_transforms import Transforms, TransformTree
from comove.dmp.demonstrations.samples import HZ, SAY_RATE, fault

NANO = 10**9
LATEST = NANO // 2
"""How much later than its successor a message may arrive in a topic, and is sorted [ns]."""
LATEST_SHARE = 0.1
"""The same, as a share of the duration."""
MOST_PARTS = 20
"""How often the clock of a topic may be set back."""
_NO_TURNS = "all quaternions are zero: orientations left out"

Messages = Iterator[tuple[int, Any]]
"""When the bag received each message [ns], and the message."""


@dataclass(frozen=True)
class Track:
    """One movement: stamps (n_steps,) [ns], values by row, notes, joints."""

    stamps: NDArray[np.int64]
    position: NDArray[np.float64]
    orientation: NDArray[np.float64] | None = None
    axes: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def rows(self, chosen: NDArray[np.intp], *notes: str) -> Track:
        """Return the samples with the numbers `chosen`, in their order."""
        return replace(
            self,
            stamps=self.stamps[chosen],
            position=self.position[chosen],
            orientation=None if self.orientation is None else self.orientation[chosen],
            notes=self.notes + notes,
        )


def read_messages(
    path: Path,
    topic: str,
    kind: str,
    messages: Messages,
    *,
    static: Messages | None = None,
    body: str = "",
    rate: float | None = None,
) -> dict[str, Track]:
    """Return the movements in a topic's messages by name. The name is "" if there is only one.

    Parameters
    ----------
    kind : type of the messages, one of `KINDS`
    static : messages of constant transforms
    body : name of a movement of transforms, CHILD@PARENT; by default those of all that moves
    rate : poses a second of a `Path` without stamps [Hz]

    Raises
    ------
    DemonstrationError
        If they hold no movement; names topic and message.
    """
    if kind in TRANSFORMS:
        found = _read_transforms(path, topic, messages, static or iter(()), body)
    elif kind == PATH:
        found = {"": _read_path(path, topic, messages, rate)}
    else:
        found = _READERS[kind](path, topic, messages)
    if rate is not None and kind != PATH:
        raise fault(path, topic, "its messages have times of their own", "leave the rate out")
    tracks = {}
    for name, track in found.items():
        pieces = _in_order(path, topic, track)
        for number, piece in enumerate(pieces):
            part = f"part{number}" if len(pieces) > 1 else ""
            tracks[":".join(filter(None, (name, part)))] = piece
    return tracks


def _in_order(path: Path, topic: str, track: Track) -> list[Track]:
    """Return the samples ordered by stamps, in parts if time restarts."""
    stamps = track.stamps
    latest, most = _latest(stamps), _most(stamps)
    if latest == 0:
        return [track]
    if latest <= most:
        n_late = np.count_nonzero(stamps < np.maximum.accumulate(stamps))
        note = f"samples out of order sorted by their stamps: {n_late}, up to {latest / 1e6:.3g} ms late"
        return [track.rows(np.argsort(stamps, kind="stable"), note)]
    starts = np.flatnonzero(np.diff(stamps) < -most) + 1
    bounds = [0, *starts.tolist(), len(stamps)]
    if not 0 < len(starts) <= MOST_PARTS:
        row = int(np.argmax(np.diff(stamps) < 0)) + 1
        raise fault(
            path,
            f"{topic}, sample {row}, stamp",
            f"time goes back {np.count_nonzero(np.diff(stamps) < 0)} times, by {latest / 1e9:.6g} s at most: two "
            "clocks write it",
            "choose another topic, or record it again with one clock",
        )
    pieces = []
    for first, stop in zip(bounds[:-1], bounds[1:], strict=True):
        note = f"samples {first} to {stop - 1} of {len(stamps)}, between which and the others the clock is set back"
        pieces.append(track.rows(first + np.argsort(stamps[first:stop], kind="stable"), note))
    return pieces


def _latest(stamps: NDArray[np.int64]) -> int:
    """Return the largest delay of a stamp behind an earlier one [ns]."""
    return int((np.maximum.accumulate(stamps) - stamps).max())


def _most(stamps: NDArray[np.int64]) -> int:
    """Return the largest delay of messages that are sorted [ns]."""
    return min(LATEST, int(LATEST_SHARE * np.ptp(stamps)))


def _nanoseconds(stamp: Any) -> int:
    return int(stamp.sec) * NANO + int(stamp.nanosec)


def _chosen_stamps(stamps: array[int]) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Return the headers' stamps, or else the bag's, and notes.

    The bag's are used if a header has none, or all are alike.

    Parameters
    ----------
    stamps : for each message in turn the time at which the bag received it and the stamp of its header [ns], -1 if
        messages of this type have no header
    """
    received, said = np.array(stamps, dtype=np.int64).reshape(-1, 2).T
    if (said == -1).all():
        return received, ("messages without a header: time is that of the bag",)
    if np.array_equal(received, said) or ((said != 0).all() and (np.ptp(said) > 0 or np.ptp(received) == 0)):
        return said, ()
    why = "with one and the same stamp" if said.all() else "without a stamp"
    return received, (f"headers {why}: time is that of the bag",)


def _track(stamps: NDArray[np.int64], rows: array[float], notes: tuple[str, ...]) -> Track:
    """Build a track from points or poses. A row is x y z, and w x y z of poses."""
    values = np.array(rows, dtype=np.float64).reshape(len(stamps), len(rows) // max(len(stamps), 1))
    position, orientation = values[:, :3], values[:, 3:]
    if not orientation.size:
        return Track(stamps, position, notes=notes)
    if not orientation.any():
        return Track(stamps, position, notes=(*notes, _NO_TURNS))
    return Track(stamps, position, orientation, notes=notes)


def _point(p: Any) -> tuple[float, ...]:
    return p.x, p.y, p.z


def _pose(pose: Any) -> tuple[float, ...]:
    p, q = pose.position, pose.orientation
    return p.x, p.y, p.z, q.w, q.x, q.y, q.z


def _transform(transform: Any) -> tuple[float, ...]:
    p, q = transform.translation, transform.rotation
    return p.x, p.y, p.z, q.w, q.x, q.y, q.z


_Body = tuple[str, ...]
"""What tells a body from others in the same messages: its own frame, the frame it is given in."""
_Picked = Iterable[tuple[_Body, tuple[float, ...]]]


def _reader(pick: Callable[[Any], _Picked], *, is_stamped: bool = True) -> Callable[..., dict[str, Track]]:
    """Return a reader of bodies' points or poses, found by `pick`."""

    def read(path: Path, topic: str, messages: Messages) -> dict[str, Track]:
        found: dict[_Body, tuple[array[int], array[float]]] = {}
        for received, message in messages:
            stamp = _nanoseconds(message.header.stamp) if is_stamped else -1
            for body, row in pick(message):
                stamps, rows = found.setdefault(body, (array("q"), array("d")))
                stamps.extend((received, stamp))
                rows.extend(row)
        if not found:
            raise fault(path, topic, "its messages hold no pose", "choose another topic")
        names = _names_of(list(found))
        tracks = {}
        for body, (stamps, rows) in found.items():
            said, notes = _chosen_stamps(stamps)
            tracks[names[body]] = _track(said, rows, notes)
        return tracks

    return read


def _names_of(bodies: list[_Body]) -> dict[_Body, str]:
    """Return the shortest distinct names of bodies; "" for one."""
    if len(bodies) == 1:
        return {bodies[0]: ""}
    for place in range(len(bodies[0])):
        if len({body[place] for body in bodies}) == len(bodies):
            return {body: body[place] or "unnamed" for body in bodies}
    return {body: "@".join(part or "unnamed" for part in body) for body in bodies}


def _read_pose_array(path: Path, topic: str, messages: Messages) -> dict[str, Track]:
    """Read arrays of poses, in which each place is a body. The number of poses is the same in all messages."""
    count = -1

    def pick(message: Any) -> _Picked:
        nonlocal count
        if count not in (-1, len(message.poses)):
            raise fault(
                path,
                topic,
                f"its messages hold {count} poses, then {len(message.poses)}: nothing tells which is whose",
                "choose another topic, or record each body's poses in a topic of its own",
            )
        count = len(message.poses)
        return (((str(i),), _pose(pose)) for i, pose in enumerate(message.poses))

    return _reader(pick)(path, topic, messages)


def _read_path(path: Path, topic: str, messages: Messages, rate: float | None) -> Track:
    message, notes = _last_of(messages)
    if message is None or not message.poses:
        raise fault(path, topic, "the path is empty", "choose another topic")
    stamps, rows = array("q"), array("d")
    for stamped in message.poses:
        stamps.append(_nanoseconds(stamped.header.stamp))
        rows.extend(_pose(stamped.pose))
    said = np.array(stamps, dtype=np.int64)
    is_timed = np.ptp(said) > 0 or len(said) == 1
    if rate is not None:
        if is_timed:
            raise fault(path, topic, "its poses have stamps of their own", "leave the rate out")
        said = np.rint(np.arange(len(said)) * (NANO / rate)).astype(np.int64)
        notes = (*notes, f"{rate:g} poses a second, as was said")
    elif not is_timed:
        raise fault(
            path,
            topic,
            f"its {len(said)} poses have one and the same stamp: it is a path without times",
            f"choose another topic, or {SAY_RATE}",
            rate=HZ,
        )
    return _track(said, rows, notes)


def _read_joint_states(path: Path, topic: str, messages: Messages) -> dict[str, Track]:
    """Read joint states; each set of joints is a movement. Joints are in the order of its first message."""
    kinds: dict[tuple[str, ...], tuple[array[int], array[float], array[int]]] = {}
    n_messages = 0
    for received, message in messages:
        n_messages += 1
        if not len(message.position):
            continue
        names = tuple(message.name) or tuple(f"joint{i}" for i in range(len(message.position)))
        _check_row(path, topic, n_messages - 1, message.position, names)
        stamps, positions, numbers = kinds.setdefault(names, (array("q"), array("d"), array("q")))
        stamps.extend((received, _nanoseconds(message.header.stamp)))
        positions.extend(message.position)
        numbers.append(n_messages)
    if not kinds:
        raise fault(path, topic, "no message has positions", "choose another topic")
    groups: dict[frozenset[str], list[tuple[str, ...]]] = {}
    for names in kinds:
        groups.setdefault(frozenset(names), []).append(names)
    found = {}
    for orders in groups.values():
        order = orders[0]
        stamps, numbers, rows = array("q"), array("q"), []
        for names in orders:
            stamps += kinds[names][0]
            numbers += kinds[names][2]
            rows.append(np.array(kinds[names][1], dtype=np.float64).reshape(-1, len(names)))
            if names != order:
                rows[-1] = rows[-1][:, [names.index(name) for name in order]]
        by_number = np.argsort(np.array(numbers), kind="stable")
        said, notes = _chosen_stamps(array("q", np.array(stamps).reshape(-1, 2)[by_number].ravel().tolist()))
        if len(orders) > 1:
            notes += (f"joints come in {len(orders)} orders: put into that of the first message",)
        others = set().union(*(set(other[0]) for other in groups.values() if other is not orders))
        own = [name for name in order if name not in others]
        label = "" if len(groups) == 1 else own[0] if own else "+".join(order)
        found[label] = Track(said, np.concatenate(rows)[by_number], None, order, notes)
    return found


def _read_joint_trajectory(path: Path, topic: str, messages: Messages) -> dict[str, Track]:
    trajectory, notes = _last_of(messages)
    points, names = trajectory.points, tuple(trajectory.joint_names)
    if not points:
        raise fault(path, topic, "the trajectory is empty", "choose another topic")
    for sample, point in enumerate(points):
        _check_row(path, topic, sample, point.positions, names)
    stamps = np.array([_nanoseconds(point.time_from_start) for point in points], dtype=np.int64)
    position = np.array([point.positions for point in points], dtype=np.float64)
    return {"": Track(stamps, position.reshape(len(points), len(names)), None, names, notes)}


def _read_transforms(
    path: Path, topic: str, messages: Messages, static: Messages, body: str
) -> dict[str, Track]:
    """Read transforms; `body` names a movement, CHILD@PARENT."""
    edges: dict[tuple[str, str], tuple[array[int], array[float]]] = {}
    constant = {}
    for is_static, (received, message) in chain(zip(repeat(False), messages), zip(repeat(True), static)):
        for one in message.transforms:
            # Frames began with a slash in the first version of TF.
            edge = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
            if is_static:
                constant[edge] = _transform(one.transform)
                continue
            stamps, rows = edges.setdefault(edge, (array("q"), array("d")))
            stamps.extend((received, _nanoseconds(one.header.stamp)))
            rows.extend(_transform(one.transform))
    if not edges:
        raise fault(path, topic, "its messages hold no transform", "choose another topic")
    tracks = {}
    for edge, (stamps, rows) in edges.items():
        said, notes = _chosen_stamps(stamps)
        values = np.array(rows, dtype=np.float64).reshape(-1, 7)
        tracks[edge] = Track(said, values[:, :3], values[:, 3:], notes=notes)
    if any(_latest(track.stamps) > _most(track.stamps) for track in tracks.values()):
        note = "the clock of the headers is set back: time is that of the bag"
        for edge, (stamps, _) in edges.items():
            of_bag = np.array(stamps, dtype=np.int64)[::2]
            tracks[edge] = replace(tracks[edge], stamps=of_bag, notes=(note,))
    transforms = [
        Transforms(*edge, np.zeros(1, np.int64), np.array([row[:3]]), np.array([row[3:]]))
        for edge, row in constant.items()
        if edge not in edges
    ]
    for edge, track in tracks.items():
        ordered = _in_order(path, topic, track)[0]
        first = np.unique(ordered.stamps, return_index=True)[1]  # tf2 ignores the others of the same stamp
        one = ordered.rows(first)
        transforms.append(Transforms(*edge, one.stamps, one.position, np.asarray(one.orientation), one.notes))
    tree = TransformTree(path, topic, transforms)
    found = {body: tree.movement(body)} if body else tree.movements()
    return {name: _of_transforms(one) for name, one in found.items()}


def _of_transforms(one: Transforms) -> Track:
    notes = (f"{one.child} in {one.parent}", *one.notes)
    if not one.orientation.any():
        return Track(one.stamps, one.position, notes=(*notes, _NO_TURNS))
    return Track(one.stamps, one.position, one.orientation, notes=notes)


def _check_row(path: Path, topic: str, sample: int, row: Any, names: Any) -> None:
    if len(row) != len(names):
        raise fault(
            path,
            f"{topic}, sample {sample}",
            f"it has {len(row)} positions of {len(names)} joints",
            "record every joint that is named",
        )


def _last_of(messages: Messages) -> tuple[Any, tuple[str, ...]]:
    number, message = 0, None
    for number, (_, message) in enumerate(messages, start=1):  # noqa: B007
        pass
    return message, (f"the last of {number} messages",) if number > 1 else ()


def _framed(pick: Callable[[Any], tuple[float, ...]]) -> Callable[..., dict[str, Track]]:
    return _reader(lambda m: [((getattr(m, "child_frame_id", ""), m.header.frame_id), pick(m))])


PATH = "nav_msgs/msg/Path"
TRANSFORMS = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")
"""Types of messages that hold the transforms of many frames."""
_READERS: dict[str, Callable[..., dict[str, Track]]] = {
    "geometry_msgs/msg/PoseStamped": _framed(lambda m: _pose(m.pose)),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _framed(lambda m: _pose(m.pose.pose)),
    "geometry_msgs/msg/PointStamped": _framed(lambda m: _point(m.point)),
    "geometry_msgs/msg/TransformStamped": _framed(lambda m: _transform(m.transform)),
    "nav_msgs/msg/Odometry": _framed(lambda m: _pose(m.pose.pose)),
    "geometry_msgs/msg/PoseArray": _read_pose_array,
    "geometry_msgs/msg/Pose": _reader(lambda m: [((), _pose(m))], is_stamped=False),
    "geometry_msgs/msg/Point": _reader(lambda m: [((), _point(m))], is_stamped=False),
    "geometry_msgs/msg/Transform": _reader(lambda m: [((), _transform(m))], is_stamped=False),
    "sensor_msgs/msg/JointState": _read_joint_states,
    "trajectory_msgs/msg/JointTrajectory": _read_joint_trajectory,
}
KINDS = (*_READERS, PATH, *TRANSFORMS)
"""Types of messages that are read."""
WHOLE = (PATH, "trajectory_msgs/msg/JointTrajectory")
"""Types of messages of which one is a whole movement."""

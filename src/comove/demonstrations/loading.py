"""Selection of the reader by the kind of file, and of the movement by its name."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from comove.demonstrations.demonstration import Demonstration
from comove.errors import DemonstrationError, near_name
from comove.io.files import telling

SUFFIXES = (".csv", ".npz", ".hdf5", ".h5", ".bag", ".mcap", ".db3")
"""Kinds of files; folders hold LeRobot datasets or rosbag2 recordings."""
_SHOWN = 20
"""Names that a message lists."""


def load(
    path: str | os.PathLike[str],
    manipulator: str | None = None,
    *,
    episode: str | int | None = None,
    topic: str | None = None,
) -> Demonstration:
    """Read one movement; see `Demonstration.load`."""
    path = Path(path)
    kind = _kind(path)
    if topic is not None and kind != "rosbag":
        raise _no_such_choice(path, "topic", topic, "only bags have topics", "leave the topic out")
    if episode is not None and kind not in ("hdf5", "lerobot"):
        raise _no_such_choice(path, "episode", episode, "it holds one recording", "leave the episode out")
    if kind == "rosbag" and manipulator is not None:
        raise _no_such_choice(
            path, "manipulator", manipulator, "a bag knows topics, not manipulators", "name a topic"
        )
    if kind == "rosbag":
        from comove.demonstrations.rosbag import read_rosbag, rosbag_topics

        topic = choose_name(rosbag_topics(path), topic, path, "topic")
        return read_rosbag(path, topic=topic)[topic]
    if kind in ("hdf5", "lerobot"):
        return choose(_episodes(path, kind, episode, several=False), manipulator, path)
    return choose(_read_plain(path, kind), manipulator, path)


def load_all(path: str | os.PathLike[str]) -> tuple[Demonstration, ...]:
    """Read all movements; see `Demonstration.load_all`."""
    path = Path(path)
    kind = _kind(path)
    if kind == "rosbag":
        from comove.demonstrations.rosbag import read_rosbag

        return tuple(read_rosbag(path).values())
    if kind in ("hdf5", "lerobot"):
        episodes = _episodes(path, kind, None, several=True)
        return tuple(demo for episode in episodes.values() for demo in episode.values())
    return tuple(_read_plain(path, kind).values())


def choose(demos: Mapping[str, Demonstration], manipulator: str | None, file: object) -> Demonstration:
    """Return one of the movements of a recording, selected by its manipulator.

    Raises
    ------
    DemonstrationError
        If there are several and the name is missing, or the name is unknown.
    """
    if list(demos) == [""] and manipulator is not None:
        raise DemonstrationError(
            f"it holds one movement without a name, not {manipulator!r}",
            file=file,
            key="manipulator",
            way_out="leave the manipulator out",
        )
    return demos[choose_name(demos, manipulator, file, "manipulator")]


def choose_name(names: Mapping[str, object], name: str | None, file: object, what: str) -> str:
    """Return `name` if it is one of `names`, or the only one that exists.

    Parameters
    ----------
    names : the existing names; texts among the values describe them in messages
    what : kind of thing that is chosen: the key in messages

    Raises
    ------
    DemonstrationError
        If there are several and the name is missing, or the name is unknown; lists the names.
    """
    if name is None and len(names) == 1:
        return next(iter(names))
    if name in names:
        return str(name)
    shown = [f"{key} ({kind})" if isinstance(kind, str) else key for key, kind in names.items()][:_SHOWN]
    more = f" and {len(names) - len(shown)} more" if len(names) > len(shown) else ""
    if name is None:
        message, way_out = f"it holds {len(names)} {what}s", f"name one of {', '.join(shown)}{more}"
    else:
        message, way_out = (
            f"there is no {name!r}",
            f"{near_name(name, names).partition('known: ')[0]}known: {', '.join(shown)}{more}",
        )
    raise DemonstrationError(message, file=file, key=what, way_out=way_out)


def _kind(path: Path) -> str:
    """Return the kind of reader for a path."""
    with telling(path):
        is_folder = path.is_dir()
        if is_folder and (path / "meta" / "info.json").exists():
            return "lerobot"
        if is_folder and (path / "metadata.yaml").exists():
            return "rosbag"
    if is_folder:
        raise DemonstrationError(
            "it is a folder without meta/info.json (LeRobot) or metadata.yaml (rosbag2)",
            file=path,
            way_out="name the folder that holds one of them, or a file",
        )
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        raise DemonstrationError(
            f"its kind {path.suffix!r} is not known", file=path, way_out=near_name(path.suffix, SUFFIXES)
        )
    return {".csv": "csv", ".npz": "npz", ".hdf5": "hdf5", ".h5": "hdf5"}.get(suffix, "rosbag")


def _read_plain(path: Path, kind: str) -> dict[str, Demonstration]:
    from comove.demonstrations.csv import read_csv
    from comove.demonstrations.npz import read_npz

    return read_csv(path) if kind == "csv" else read_npz(path)


def _episodes(
    path: Path, kind: str, episode: str | int | None, several: bool
) -> dict[str, dict[str, Demonstration]] | dict[str, Demonstration]:
    """Read all episodes of a file if `several`, otherwise the movements of the selected one."""
    if kind == "hdf5":
        from comove.demonstrations.hdf5 import hdf5_episodes as names
        from comove.demonstrations.hdf5 import read_hdf5 as read
    else:
        from comove.demonstrations.lerobot import lerobot_episodes as names
        from comove.demonstrations.lerobot import read_lerobot as read
    if several:
        return read(path)
    if episode is None:
        episode = choose_name(dict.fromkeys(names(path)), None, path, "episode")
    return next(iter(read(path, episode=episode).values()))


def _no_such_choice(path: Path, key: str, value: object, message: str, way_out: str) -> DemonstrationError:
    return DemonstrationError(f"{value!r} was asked for, but {message}", file=path, key=key, way_out=way_out)

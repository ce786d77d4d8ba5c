"""Episodes as a LeRobot dataset, version 3.0: few Parquet files that hold many episodes, and tables about them.

`observation.state` holds the hands, `action` the hands at the next sample, `observation.environment_state` their goal
and the centres of the obstacles [m]. Of a robot, `observation.state` holds its joints, `action` the planned joints of
the next sample [rad], and `observation.hands` the hands with their quaternions w x y z. Cameras are
`observation.images.CAMERA`, videos as the store has them, joined without being encoded anew. The table of the
episodes holds, besides what LeRobot writes there, all that is known of an episode, in columns that begin with
`comove/`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.data.datasets.samples import EpisodeSamples, require_alike
from comove.data.videos import CODEC, Video, VideoFile
from comove.dmp.demonstrations.formats.lerobot import (
    CHUNK,
    STATE,
    arrow_table,
    described_scalars,
    scalar_columns,
)
from comove.io.files import extra
from comove.io.videos import PIXELS

ACTION, ENVIRONMENT = "action", "observation.environment_state"
HANDS, IMAGES = "observation.hands", "observation.images."
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
FILE_MB, VIDEO_MB = 100, 200
"""About the size of a file of numbers before it is packed, and of a video [MB]."""
TASK = "carry the load"
"""What the only task of a dataset is called."""


def write(folder: Path, episodes: Iterable[EpisodeSamples]) -> int:
    """Write a dataset into an existing folder; return the number of its episodes.

    Raises
    ------
    DemonstrationError
        If pyarrow is not installed.
    ResultError
        If the episodes differ in hands or obstacles.
    """
    tables = _Tables(folder)
    with tables.closing, tables.files:
        for episode in episodes:
            tables.add(episode)
    if tables.first is not None:
        tables.write_meta(tables.first)
    return len(tables.rows)


class _Tables:
    """The tables of a dataset while it is written."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.pa, self.parquet = extra("pyarrow", folder), extra("pyarrow.parquet", folder)
        self.files, self.closing = ExitStack(), ExitStack()
        self.writer: Any = None
        self.first: EpisodeSamples | None = None
        self.videos: dict[str, _Videos] = {}
        self.rows: list[dict[str, Any]] = []
        self.stats: dict[str, Statistics] = {}
        self.file, self.bytes, self.frames = -1, 0, 0

    def add(self, episode: EpisodeSamples) -> None:
        """Write the samples of an episode, as a group of rows of its own."""
        self.first = self.first or episode
        require_alike(episode, self.first)
        columns = frame_columns(episode, len(self.rows), self.frames)
        size = sum(values.nbytes for values in columns.values())
        table = arrow_table(self.pa, columns)
        if self.writer is None or self.bytes + size > FILE_MB * 1_000_000:
            self._next_file(table.schema)
        self.writer.write_table(table)
        self.bytes += size
        n_steps = len(episode.time)
        row: dict[str, Any] = {
            "episode_index": len(self.rows),
            "tasks": [TASK],
            "length": n_steps,
            "data/chunk_index": self.file // CHUNK,
            "data/file_index": self.file % CHUNK,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + n_steps,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        for name, video in episode.videos.items():
            if name not in self.videos:
                self.videos[name] = _Videos(self.folder, f"{IMAGES}{name}", episode.rate)
                self.closing.callback(self.videos[name].close)
            row |= self.videos[name].add(video)
        for name, own in statistics_of(episode, columns).items():
            row |= {f"stats/{name}/{key}": value for key, value in own.plain().items()}
            self.stats[name] = self.stats[name].with_more(own) if name in self.stats else own
        self.rows.append(row | {f"comove/{key}": _cell(value) for key, value in episode.about.items()})
        self.frames += n_steps

    def _next_file(self, schema: Any) -> None:
        """Close the file of data, and begin the next one."""
        self.files.close()
        self.file, self.bytes = self.file + 1, 0
        path = self.folder / DATA.format(chunk_index=self.file // CHUNK, file_index=self.file % CHUNK)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.writer = self.files.enter_context(
            self.parquet.ParquetWriter(path, schema, write_page_checksum=True)
        )

    def write_meta(self, first: EpisodeSamples) -> None:
        """Write what describes the tables."""
        (self.folder / EPISODES).parent.mkdir(parents=True, exist_ok=True)
        self.parquet.write_table(self.pa.Table.from_pylist(self.rows), self.folder / EPISODES)
        info = {
            "codebase_version": "v3.0",
            "robot_type": first.robot,
            "total_episodes": len(self.rows),
            "total_frames": self.frames,
            "total_tasks": 1,
            "chunks_size": CHUNK,
            "data_files_size_in_mb": FILE_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": first.rate,
            "splits": {"train": f"0:{len(self.rows)}"},
            "data_path": DATA,
            "video_path": VIDEO if first.videos else None,
            "features": features_of(first),
        }
        stats = {name: own.plain() for name, own in self.stats.items()}
        for name, content in (("info", info), ("stats", stats)):
            path = self.folder / f"meta/{name}.json"
            path.write_text(json.dumps(content, indent=4, allow_nan=False), encoding="utf-8")
        self._write_tasks()

    def _write_tasks(self) -> None:
        """Write the table of tasks, whose index is the text of a task, as pandas marks it."""
        index = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"}
        column = {
            "name": "task_index",
            "field_name": "task_index",
            "pandas_type": "int64",
            "numpy_type": "int64",
        }
        marks = {
            "index_columns": ["task"],
            "column_indexes": [],
            "columns": [column | {"metadata": None}, index | {"metadata": None}],
            "pandas_version": "2.0.0",
        }
        table = self.pa.table({"task_index": self.pa.array([0], self.pa.int64()), "task": [TASK]})
        table = table.replace_schema_metadata({"pandas": json.dumps(marks)})
        self.parquet.write_table(table, self.folder / "meta/tasks.parquet")


def frame_columns(episode: EpisodeSamples, number: int, before: int) -> dict[str, NDArray]:
    """Return the columns of an episode by their names in a table of frames.

    Parameters
    ----------
    number : number of the episode in the dataset
    before : number of frames of the episodes before
    """
    vectors = {name: values.astype(np.float32) for name, (_, values) in _vectors(episode).items()}
    return vectors | scalar_columns(len(episode.time), episode.rate, number, before)


def features_of(first: EpisodeSamples) -> dict[str, Any]:
    """Return the description of the columns, in the form that LeRobot gives it."""
    features: dict[str, Any] = {
        key: {"dtype": "float32", "shape": [len(names)], "names": list(names)}
        for key, (names, _) in _vectors(first).items()
    }
    features |= {f"{IMAGES}{name}": _described(video, first.rate) for name, video in first.videos.items()}
    return features | described_scalars()


def _described(video: Video, rate: int) -> dict[str, Any]:
    """Return the description of a camera's videos, in the form that LeRobot gives it."""
    _, height, width, channels = video.pictures.shape
    about = {"height": height, "width": width, "codec": CODEC, "pix_fmt": PIXELS, "fps": rate}
    marks = {"channels": channels, "is_depth_map": False}
    return {
        "dtype": "video",
        "shape": [height, width, channels],
        "names": ["height", "width", "channels"],
        "info": {f"video.{key}": value for key, value in (about | marks).items()} | {"has_audio": False},
    }


def statistics_of(episode: EpisodeSamples, columns: Mapping[str, NDArray]) -> dict[str, Statistics]:
    """Return the statistics of an episode's columns, and of what its cameras saw, by feature."""
    found = {name: Statistics(values) for name, values in columns.items()}
    return found | {f"{IMAGES}{name}": PictureStatistics(v.pictures) for name, v in episode.videos.items()}


def _vectors(episode: EpisodeSamples) -> dict[str, tuple[tuple[str, ...], NDArray]]:
    """Return the vectors of an episode: names and values, array of shape (n_steps, n_values), by feature."""
    poses = {} if episode.poses is None else {HANDS: episode.poses}
    return {
        STATE: (episode.state_names, episode.state),
        ACTION: (episode.state_names, episode.command),
        **poses,
        ENVIRONMENT: (episode.environment_names, episode.environment),
    }


class Statistics:
    """Least, greatest and mean values of columns, their standard deviation, and the number of rows."""

    def __init__(self, values: NDArray):
        rows = values.reshape(len(values), -1).astype(np.float64)
        self.least, self.greatest, self.count = rows.min(axis=0), rows.max(axis=0), len(rows)
        self.mean = rows.mean(axis=0)
        self.squares = ((rows - self.mean) ** 2).sum(axis=0)

    def with_more(self, other: Statistics) -> Statistics:
        """Return the statistics of the rows of both."""
        both = object.__new__(type(self))
        both.least, both.greatest = (
            np.minimum(self.least, other.least),
            np.maximum(self.greatest, other.greatest),
        )
        both.count, apart = self.count + other.count, other.mean - self.mean
        both.mean = self.mean + apart * other.count / both.count
        both.squares = self.squares + other.squares + apart**2 * self.count * other.count / both.count
        return both

    def plain(self) -> dict[str, list]:
        """Return them by the names that LeRobot gives them."""
        deviation = np.sqrt(self.squares / self.count)
        named = {"min": self.least, "max": self.greatest, "mean": self.mean, "std": deviation}
        return {name: values.tolist() for name, values in named.items()} | {"count": [self.count]}


class PictureStatistics(Statistics):
    """Statistics of the colours of at most `most` pictures, as shares of the brightest; the number is theirs."""

    def __init__(self, pictures: NDArray[np.uint8], most: int = 32):
        every = -(-len(pictures) // most)
        chosen = pictures[::every]
        super().__init__(chosen.reshape(-1, 3) / 255.0)
        self.squares, self.count = self.squares * len(chosen) / self.count, len(chosen)

    def plain(self) -> dict[str, list]:
        """Return them by the names that LeRobot gives them, for arrays of shape (3, height, width)."""
        named = super().plain()
        return {key: values if key == "count" else [[[x]] for x in values] for key, values in named.items()}


class _Videos:
    """The videos of a camera while they are written: few files that hold many episodes."""

    def __init__(self, folder: Path, key: str, rate: int):
        self.folder, self.key, self.rate = folder, key, rate
        self.index = -1
        self.file: VideoFile | None = None

    def close(self) -> None:
        """Complete the file that is written."""
        if self.file is not None:
            self.file.close()

    def add(self, video: Video) -> dict[str, Any]:
        """Write the video of an episode; return where it is, by the columns of the table of episodes."""
        file = self.file
        if file is None or file.size > VIDEO_MB * 1_000_000 or not file.takes(video):
            file = self._next_file(video)
        begun = file.n_pictures / self.rate
        file.add(video)
        place = {"chunk_index": self.index // CHUNK, "file_index": self.index % CHUNK}
        time = {"from_timestamp": begun, "to_timestamp": file.n_pictures / self.rate}
        return {f"videos/{self.key}/{name}": value for name, value in (place | time).items()}

    def _next_file(self, video: Video) -> VideoFile:
        """Complete the file, and begin the next one."""
        self.close()
        self.index += 1
        place = {"chunk_index": self.index // CHUNK, "file_index": self.index % CHUNK}
        path = self.folder / VIDEO.format(video_key=self.key, **place)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.file = VideoFile(path, video, self.rate)
        return self.file


def _cell(value: Any) -> Any:
    """Return a value as a column can hold it: nested data as JSON."""
    return json.dumps(value, allow_nan=False) if isinstance(value, (dict, list)) else value

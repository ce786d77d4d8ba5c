"""Episodes as a LeRobot dataset, version 3.0.

Few Parquet files hold many episodes, and tables describe them. `observation.state` holds the end effectors, `action`
the end effectors at the next sample, `observation.environment_state` their goal and the centres of the obstacles
[m]. Of a robot, `observation.state` holds its joints, `action` the planned joints of the next sample [rad], and
`observation.hands` the end effectors with their quaternions w x y z. Cameras are `observation.images.CAMERA`, videos
from the run database, joined without encoding them again. The table of episodes also holds all other data of an
episode, in columns that begin with `comove/`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from contextlib import ExitStack
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.data.datasets.samples import EpisodeSamples, require_alike
from comove.data.videos import CODEC, Video, VideoFile
from comove.dmp.demonstrations.formats.lerobot_features import STATE
from comove.dmp.demonstrations.formats.lerobot_tables import CHUNK, VIDEO_MB, DatasetTables, Statistics
from comove.io.files import extra
from comove.io.videos import PIXELS

ACTION, ENVIRONMENT = "action", "observation.environment_state"
HANDS, IMAGES = "observation.hands", "observation.images."
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
TASK = "carry the load"
"""What the only task of a dataset is called."""


def write(folder: Path, episodes: Iterable[EpisodeSamples]) -> int:
    """Write a dataset to a folder; return the number of its episodes.

    Raises
    ------
    DemonstrationError
        If pyarrow is not installed.
    ResultError
        If the episodes differ in end effectors or obstacles.
    """
    extra("pyarrow", folder)
    episodes = iter(episodes)
    first = next(episodes, None)
    if first is None:
        return 0
    with ExitStack() as closing, DatasetTables(folder, first.rate, TASK, first.robot) as tables:
        videos = {name: _Videos(folder, f"{IMAGES}{name}", first.rate) for name in first.videos}
        for own in videos.values():
            closing.callback(own.close)
        for episode in chain([first], episodes):
            require_alike(episode, first)
            vectors = {name: values.astype(np.float32) for name, (_, values) in _vectors(episode).items()}
            about = {f"comove/{key}": _cell(value) for key, value in episode.about.items()}
            for name, video in episode.videos.items():
                about |= videos[name].add(video)
            seen = {f"{IMAGES}{name}": PictureStatistics(v.pictures) for name, v in episode.videos.items()}
            tables.add(vectors, about, seen)
        features: dict[str, Any] = {
            key: {"dtype": "float32", "shape": [len(names)], "names": list(names)}
            for key, (names, _) in _vectors(first).items()
        }
        features |= {f"{IMAGES}{name}": _described(v, first.rate) for name, v in first.videos.items()}
        tables.finish(features, VIDEO if first.videos else None)
        return len(tables.rows)


def _described(video: Video, rate: int) -> dict[str, Any]:
    """Return a camera's description in LeRobot's layout."""
    _, height, width, channels = video.pictures.shape
    about = {"height": height, "width": width, "codec": CODEC, "pix_fmt": PIXELS, "fps": rate}
    marks = {"channels": channels, "is_depth_map": False}
    return {
        "dtype": "video",
        "shape": [height, width, channels],
        "names": ["height", "width", "channels"],
        "info": {f"video.{key}": value for key, value in (about | marks).items()} | {"has_audio": False},
    }


def _vectors(episode: EpisodeSamples) -> dict[str, tuple[tuple[str, ...], NDArray]]:
    """Return names and values of an episode's vectors, by feature. Values are arrays of shape (n_steps, n_values)."""
    poses = {} if episode.poses is None else {HANDS: episode.poses}
    return {
        STATE: (episode.state_names, episode.state),
        ACTION: (episode.state_names, episode.command),
        **poses,
        ENVIRONMENT: (episode.environment_names, episode.environment),
    }


class PictureStatistics(Statistics):
    """Statistics of the colours of at most `most` pictures. Colours are shares of the brightest; the count is that
    of pictures."""

    def __init__(self, pictures: NDArray[np.uint8], most: int = 32):
        every = -(-len(pictures) // most)
        chosen = pictures[::every]
        super().__init__(chosen.reshape(-1, 3) / 255.0)
        self.squares, self.count = self.squares * len(chosen) / self.count, len(chosen)

    def plain(self) -> dict[str, list]:
        """Return the statistics under LeRobot's names, shape (3, 1, 1)."""
        named = super().plain()
        return {key: values if key == "count" else [[[x]] for x in values] for key, values in named.items()}


class _Videos:
    """Writer of a camera's videos into few files."""

    def __init__(self, folder: Path, key: str, rate: int):
        self.folder, self.key, self.rate = folder, key, rate
        self.index = -1
        self.file: VideoFile | None = None

    def close(self) -> None:
        """Complete the current file."""
        if self.file is not None:
            self.file.close()

    def add(self, video: Video) -> dict[str, Any]:
        """Write an episode's video; return its place as table columns."""
        file = self.file
        if file is None or file.size > VIDEO_MB * 1_000_000 or not file.takes(video):
            file = self._next_file(video)
        begun = file.n_pictures / self.rate
        file.add(video)
        place = {"chunk_index": self.index // CHUNK, "file_index": self.index % CHUNK}
        time = {"from_timestamp": begun, "to_timestamp": file.n_pictures / self.rate}
        return {f"videos/{self.key}/{name}": value for name, value in (place | time).items()}

    def _next_file(self, video: Video) -> VideoFile:
        """Complete the current file, and start the next one."""
        self.close()
        self.index += 1
        place = {"chunk_index": self.index // CHUNK, "file_index": self.index % CHUNK}
        path = self.folder / VIDEO.format(video_key=self.key, **place)
        path.parent.mkdir(parents=True, exist_ok=True)
        self.file = VideoFile(path, video, self.rate)
        return self.file


def _cell(value: Any) -> Any:
    return json.dumps(value, allow_nan=False) if isinstance(value, (dict, list)) else value

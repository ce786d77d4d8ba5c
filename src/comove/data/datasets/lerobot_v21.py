"""Episodes as a LeRobot dataset, version 2.1: a Parquet file for each episode, and lines of JSON about them.

The columns are those of version 3.0 (`comove.data.datasets.lerobot`). What is known of an episode stands in its
line of `meta/episodes.jsonl`, in keys that begin with `comove/`.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from comove.data.datasets.lerobot import IMAGES, TASK, features_of, frame_columns, statistics_of
from comove.data.datasets.samples import EpisodeSamples, require_alike
from comove.dmp.demonstrations.formats.lerobot import CHUNK, arrow_table
from comove.io.files import extra

DATA = "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet"
VIDEO = "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4"


def write(folder: Path, episodes: Iterable[EpisodeSamples]) -> int:
    """Write a dataset into an existing folder; return the number of its episodes.

    Raises
    ------
    DemonstrationError
        If pyarrow is not installed.
    ResultError
        If the episodes differ in hands or obstacles.
    """
    pa, parquet = extra("pyarrow", folder), extra("pyarrow.parquet", folder)
    meta = folder / "meta"
    meta.mkdir()
    first, count, frames = None, 0, 0
    with (
        open(meta / "episodes.jsonl", "w", encoding="utf-8") as described,
        open(meta / "episodes_stats.jsonl", "w", encoding="utf-8") as measured,
    ):
        for episode in episodes:
            first = first or episode
            require_alike(episode, first)
            columns = frame_columns(episode, count, frames)
            path = folder / DATA.format(episode_chunk=count // CHUNK, episode_index=count)
            path.parent.mkdir(parents=True, exist_ok=True)
            parquet.write_table(arrow_table(pa, columns), path, write_page_checksum=True)
            row: dict[str, Any] = {"episode_index": count, "tasks": [TASK], "length": len(episode.time)}
            described.write(_line(row | {f"comove/{key}": value for key, value in episode.about.items()}))
            stats = {name: own.plain() for name, own in statistics_of(episode, columns).items()}
            _write_videos(folder, episode, count)
            measured.write(_line({"episode_index": count, "stats": stats}))
            count, frames = count + 1, frames + len(episode.time)
    (meta / "tasks.jsonl").write_text(_line({"task_index": 0, "task": TASK}), encoding="utf-8")
    if first is not None:
        info = _info(first, count, frames)
        (meta / "info.json").write_text(json.dumps(info, indent=4, allow_nan=False), encoding="utf-8")
    return count


def _write_videos(folder: Path, episode: EpisodeSamples, number: int) -> None:
    """Write the videos of an episode, as the store has them."""
    for name, video in episode.videos.items():
        place = {"episode_chunk": number // CHUNK, "video_key": f"{IMAGES}{name}", "episode_index": number}
        path = folder / VIDEO.format(**place)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(video.content)


def _info(first: EpisodeSamples, episodes: int, frames: int) -> dict[str, Any]:
    """Return what describes the whole dataset."""
    return {
        "codebase_version": "v2.1",
        "robot_type": first.robot,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": 1,
        "total_videos": episodes * len(first.videos),
        "total_chunks": -(-episodes // CHUNK),
        "chunks_size": CHUNK,
        "fps": first.rate,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA,
        "video_path": VIDEO if first.videos else None,
        "features": features_of(first),
    }


def _line(content: dict[str, Any]) -> str:
    return json.dumps(content, allow_nan=False) + "\n"

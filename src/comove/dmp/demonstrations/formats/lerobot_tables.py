"""The tables of a LeRobot dataset, version 3.0, of many episodes each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from comove.io.files import extra

CHUNK = 1000
"""Episodes, or files, of one folder `chunk-...`."""
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
FILE_MB, VIDEO_MB = 100, 200
"""About the size of a file of numbers before it is packed, and of a video [MB]."""
SCALARS = {"timestamp": "float32"} | dict.fromkeys(
    ("frame_index", "episode_index", "index", "task_index"), "int64"
)
"""Columns of a number a row, which all tables of frames have, and their kinds."""


class DatasetTables:
    """The tables of a dataset being written. Use it in a `with` statement, and `finish` it there.

    Parameters
    ----------
    folder : folder that exists, and holds no dataset yet
    fps : frames a second
    task : description of the only task
    robot_type : kind of robot

    Raises
    ------
    DemonstrationError
        If pyarrow is not installed.
    """

    def __init__(self, folder: Path, fps: int, task: str, robot_type: str):
        self.folder, self.fps, self.task, self.robot_type = folder, fps, task, robot_type
        self.rows: list[dict[str, Any]] = []
        self._pa, self._parquet = extra("pyarrow", folder), extra("pyarrow.parquet", folder)
        self._files = ExitStack()
        self._writer: Any = None
        self._stats: dict[str, Statistics] = {}
        self._file, self._bytes, self._frames = -1, 0, 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._files.close()

    def add(
        self,
        vectors: Mapping[str, NDArray],
        about: Mapping[str, Any] | None = None,
        statistics: Mapping[str, Statistics] | None = None,
    ) -> None:
        """Write the samples of an episode as a row group.

        Parameters
        ----------
        vectors : arrays, shape (n_steps, n_values), by feature
        about : further columns of the episode's row in the table of episodes
        statistics : statistics of features outside the tables, by feature
        """
        columns = {**vectors, **self._scalars(len(next(iter(vectors.values()))))}
        size = sum(values.nbytes for values in columns.values())
        table = self._pa.table({name: self._column(values) for name, values in columns.items()})
        if self._writer is None or self._bytes + size > FILE_MB * 1_000_000:
            self._next_file(table.schema)
        self._writer.write_table(table)
        self._bytes += size
        row: dict[str, Any] = {
            "episode_index": len(self.rows),
            "tasks": [self.task],
            "length": table.num_rows,
            "data/chunk_index": self._file // CHUNK,
            "data/file_index": self._file % CHUNK,
            "dataset_from_index": self._frames,
            "dataset_to_index": self._frames + table.num_rows,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        own = {name: Statistics(values) for name, values in columns.items()} | dict(statistics or {})
        for name, one in own.items():
            row |= {f"stats/{name}/{key}": value for key, value in one.plain().items()}
            self._stats[name] = self._stats[name].with_more(one) if name in self._stats else one
        self.rows.append(row | dict(about or {}))
        self._frames += table.num_rows

    def finish(self, features: Mapping[str, Any], video_path: str | None = None) -> None:
        """Write the descriptions of the tables.

        Parameters
        ----------
        features : descriptions of all but `SCALARS`, in LeRobot's form
        video_path : pattern of the paths of videos; None without any
        """
        (self.folder / EPISODES).parent.mkdir(parents=True, exist_ok=True)
        table = self._pa.Table.from_pylist(self.rows)
        self._parquet.write_table(table, self.folder / EPISODES, write_page_checksum=True)
        scalars = {key: {"dtype": kind, "shape": [1], "names": None} for key, kind in SCALARS.items()}
        described = {
            "codebase_version": "v3.0",
            "robot_type": self.robot_type,
            "total_episodes": len(self.rows),
            "total_frames": self._frames,
            "total_tasks": 1,
            "chunks_size": CHUNK,
            "data_files_size_in_mb": FILE_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": self.fps,
            "splits": {"train": f"0:{len(self.rows)}"},
            "data_path": DATA,
            "video_path": video_path,
            "features": dict(features) | scalars,
        }
        stats = {name: own.plain() for name, own in self._stats.items()}
        for name, content in (("info", described), ("stats", stats)):
            path = self.folder / f"meta/{name}.json"
            path.write_text(json.dumps(content, indent=4, allow_nan=False), encoding="utf-8")
        self._write_tasks()

    def _scalars(self, n_steps: int) -> dict[str, NDArray]:
        frames = np.arange(n_steps, dtype=np.int64)
        return {
            "timestamp": (frames / self.fps).astype(np.float32),
            "frame_index": frames,
            "episode_index": np.full_like(frames, len(self.rows)),
            "index": frames + self._frames,
            "task_index": np.zeros_like(frames),
        }

    def _column(self, values: NDArray) -> Any:
        if values.ndim == 1:
            return self._pa.array(values)
        return self._pa.FixedSizeListArray.from_arrays(self._pa.array(values.ravel()), values.shape[1])

    def _next_file(self, schema: Any) -> None:
        """Close the file of data, and begin the next one."""
        self._files.close()
        self._file, self._bytes = self._file + 1, 0
        path = self.folder / DATA.format(chunk_index=self._file // CHUNK, file_index=self._file % CHUNK)
        path.parent.mkdir(parents=True, exist_ok=True)
        self._writer = self._files.enter_context(
            self._parquet.ParquetWriter(path, schema, write_page_checksum=True)
        )

    def _write_tasks(self) -> None:
        """Write the table of tasks, indexed by text as in pandas."""
        index = {"name": "task", "field_name": "task", "pandas_type": "unicode", "numpy_type": "object"}
        column = dict.fromkeys(("name", "field_name"), "task_index")
        column |= dict.fromkeys(("pandas_type", "numpy_type"), "int64")
        marks = {
            "index_columns": ["task"],
            "column_indexes": [],
            "columns": [column | {"metadata": None}, index | {"metadata": None}],
            "pandas_version": "2.0.0",
        }
        table = self._pa.table({"task_index": self._pa.array([0], self._pa.int64()), "task": [self.task]})
        table = table.replace_schema_metadata({"pandas": json.dumps(marks)})
        self._parquet.write_table(table, self.folder / "meta/tasks.parquet")


class Statistics:
    """Minimum, maximum, mean, standard deviation and count of columns."""

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
        """Return them by LeRobot's names."""
        deviation = np.sqrt(self.squares / self.count)
        named = {"min": self.least, "max": self.greatest, "mean": self.mean, "std": deviation}
        return {name: values.tolist() for name, values in named.items()} | {"count": [self.count]}

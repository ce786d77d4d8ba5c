"""Recordings as LeRobot datasets: folders of Parquet tables and JSON.

The readable layouts are v2.0, v2.1 (`data/chunk-000/episode_000000.parquet`, `meta/episodes.jsonl`) and v3.0
(`data/chunk-000/file-000.parquet`, `meta/episodes/chunk-000/file-000.parquet`), which is written. Videos are ignored.
One vector feature of each episode is read, by default `observation.state`. The names of its coordinates in
`meta/info.json` define position, orientation, joints and gripper, and their manipulators (`lerobot_features`).

LeRobot keeps time stamps as float32 and requires even steps of 1 / `fps`; where they are even within 0.1 ms, time is
read as frame / fps, exactly. The format has no units: Cartesian coordinates are read as metres, joints as radians,
those of LeRobot's own small arms unchanged.

Needs pyarrow. Sizes are compared with a limit before any data are read, and paths out of the folder are refused.
"""

from __future__ import annotations

import json
import math
import os
import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.bodies import Body
from comove.dmp.demonstrations.formats.lerobot_features import STATE, Feature, Movement, movements_of
from comove.dmp.demonstrations.formats.lerobot_tables import CHUNK, DATA, DatasetTables
from comove.dmp.demonstrations.plausibility import require_rate
from comove.dmp.demonstrations.samples import (
    AXES,
    MAX_ROWS,
    QUATERNION,
    TIME,
    UNIT,
    Episodes,
    Format,
    Origin,
    RecordedSamples,
    as_episodes,
    common_rate,
    decoding,
    fault,
    one_of,
)
from comove.dmp.demonstrations.units import TIMES, require_unit
from comove.errors import ComoveWarning, DemonstrationError, listed, near_name
from comove.io.files import existing_file, extra, telling
from comove.io.folders import Contents, whole_folder

if TYPE_CHECKING:
    from pyarrow import Table

MAX_BYTES = 1024 * 2**20
"""Largest Parquet file [bytes]."""
MAX_META_BYTES = 64 * 2**20
"""Largest file of JSON [bytes]."""
MAX_COLUMN_BYTES = 512 * 2**20
"""Largest columns of a file, unpacked [bytes]."""
_BATCH = 65_536
"""Rows that are read at a time."""
_STAMP_TOLERANCE = 1e-4
"""How far LeRobot lets stamps lie from even ones [s]."""
_PLACE = re.compile(r"\{(episode_chunk|episode_index|chunk_index|file_index)(:0?\d{1,2}d)?\}")
_INFO, _EPISODES = "meta/info.json", "meta/episodes.jsonl"
_COPY = "copy or record the dataset again"


def read(
    path: str | os.PathLike[str],
    *,
    episode: str | int | None = None,
    feature: str | None = None,
    columns: Sequence[str] | None = None,
    rate: float | None = None,
    unit: str | None = None,
) -> dict[str, dict[str, RecordedSamples]]:
    """Read the episodes of a dataset.

    Parameters
    ----------
    path : folder that holds `meta/info.json`
    episode : number of the only episode to read; None: all that have two rows at least
    feature : vector to read, such as `action`; by default `observation.state`, or the only one but actions
    columns : names, or numbers from 1, of its columns that are the positions, or joints
    rate : samples a second, instead of the stamps [Hz]
    unit : unit of positions or joints; by default metres, and radians or `lerobot_features.UNSTATED`

    Returns
    -------
    episodes : movements by manipulator ("" if the coordinates name none), by episode ("0", "1", ...)

    Raises
    ------
    DemonstrationError
        If the dataset cannot be read, is truncated or has another version, its parts do not agree, or the meaning of
        the coordinates is unknown; names the file.

    Warns
    -----
    ComoveWarning
        If episodes without two rows were left out.
    """
    dataset = _Dataset.open(Path(path))
    if rate is not None:
        require_rate(rate)
    names = one_of([str(number) for number in dataset.lengths], episode, "", dataset.folder)
    short = [name for name in names if dataset.lengths[int(name)] < 2] if len(names) > 1 else []
    if short and len(short) < len(names):
        names = [name for name in names if name not in short]
        message = f"{path}: episodes without two rows are left out: {listed(short, 10)}"
        warnings.warn(message, ComoveWarning, stacklevel=3)
    n_rows = sum(dataset.lengths[int(name)] for name in names)
    if n_rows > MAX_ROWS:
        raise fault(
            path, None, f"its episodes have {n_rows:,} rows", f"read one by one: up to {MAX_ROWS:,} are read"
        )
    info = dataset.folder / _INFO
    vector = Feature.of(info, dataset.info["features"], feature)
    movements = movements_of(
        info,
        vector,
        robot_type=str(dataset.info.get("robot_type")),
        columns=columns,
        unit=None if unit is None else require_unit(unit, path),
    )
    found: dict[str, dict[str, RecordedSamples]] = {}
    tables: dict[Path, Table] = {}
    for name in names:
        file, task = dataset.files[int(name)], dataset.tasks[int(name)]
        if file not in tables:
            tables = {file: _read_table(file, (vector.name, "timestamp", "frame_index", "episode_index"))}
        rows = _episode(dataset, file, tables[file], int(name), vector, rate)
        found[name] = {
            manipulator: RecordedSamples(
                rows.time,
                name=".".join(filter(None, (dataset.folder.name, name, manipulator))),
                notes=((f"task: {task}",) if task else ()) + rows.notes + one.notes,
                origin=_origin(file, vector.name, rows.first, one.body),
                **_fields(one, rows),
            )
            for manipulator, one in movements.items()
        }
    return found


def _fields(one: Movement, rows: _Rows) -> dict[str, Any]:
    """Return the fields of a movement. It states its unit and, where they fit the rate, its stamps."""
    fields = one.body.samples(rows.values, unit=one.unit)
    is_stated = one.unit not in (None, "rad") or fields.pop("stated", None) is not None
    return fields | {"stated": frozenset([TIME] * rows.is_timed + [UNIT] * is_stated)}


def episodes(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the numbers of the episodes of a dataset.

    Raises
    ------
    DemonstrationError
        If it is not a LeRobot dataset, or has another version.
    """
    return tuple(str(number) for number in _Dataset.open(Path(path)).lengths)


def write(
    path: str | os.PathLike[str],
    episodes: Episodes,
    *,
    task: str = "move together",
    robot_type: str = "unknown",
    dtype: str = "float32",
) -> None:
    """Write episodes as a dataset of version 3.0.

    `observation.state` holds the coordinates of all manipulators and their quaternions w x y z, if there are any;
    `action` is the state of the next sample.

    Parameters
    ----------
    path : folder to write; it appears only when complete, and must not exist or be empty
    episodes : movements in even time steps, with the same whole number of samples per second
    task : description of the task
    robot_type : kind of robot
    dtype : "float32", as LeRobot records, or "float64", which keeps every number exactly; stamps are always float32

    Raises
    ------
    DemonstrationError
        The episodes do not fit into one dataset, or the folder cannot be written.
    """
    written = as_episodes(episodes, path)
    if dtype not in ("float32", "float64"):
        raise fault(
            path, "dtype", f"{dtype!r} is no kind of number", near_name(dtype, ["float32", "float64"])
        )
    fps = _common_fps(path, written)
    names = _names(path, written[0])
    feature: dict[str, Any] = {"dtype": dtype, "shape": [len(names)], "names": names}
    units = {demo.unit for demo in written[0].values()}
    if units != {"m"} and len(units) == 1:
        feature["info"] = {"unit": units.pop()}
    _require_readable(path, feature, written[0])
    extra("pyarrow", path)
    with (
        whole_folder(Path(path), Contents("recording", error=DemonstrationError)) as draft,
        DatasetTables(draft, fps, task, robot_type) as tables,
    ):
        for demos in written:
            tables.add(_vectors(demos, dtype))
        tables.finish({STATE: feature, "action": feature})


FORMAT = Format(
    "LeRobot",
    read,
    marker=_INFO,
    part="episode",
    parts=episodes,
    options=frozenset({"feature", "columns", "rate", "unit"}),
    write=write,
)


@dataclass(frozen=True)
class _Dataset:
    """The content of a dataset's folder `meta`.

    Attributes
    ----------
    folder : folder of the dataset
    info : content of `meta/info.json`
    fps : sampling rate [Hz]
    lengths : number of rows by number of episode
    files : Parquet file by number of episode
    tasks : description of the task by number of episode
    """

    folder: Path
    info: Mapping[str, Any]
    fps: float
    lengths: Mapping[int, int]
    files: Mapping[int, Path]
    tasks: Mapping[int, str]

    @classmethod
    def open(cls, folder: Path) -> _Dataset:
        file = folder / _INFO
        (info,) = _json(file, lines=False)
        version = _value(file, info, "codebase_version", str)
        if not re.fullmatch(r"v?[23]\.\d+", version):
            raise fault(file, "codebase_version", f"{version!r} is not read", "convert it to v2.1 or v3.0")
        fps = _value(file, info, "fps", int | float)
        if not 0.0 < fps < 1e6:
            raise fault(file, "fps", f"{fps!r} is no rate", "give frames a second")
        _value(file, info, "features", dict)
        rows = _episodes_v3(folder) if version.lstrip("v").startswith("3") else _json(folder / _EPISODES)
        total = _value(file, info, "total_episodes", int)
        if len(rows) != total or not rows:
            raise fault(
                file, "total_episodes", f"it says {total}, and {len(rows)} episodes are described", _COPY
            )
        lengths, files, tasks = {}, {}, {}
        for row in rows:
            where = folder / ("meta/episodes" if "data/file_index" in row else _EPISODES)
            number, length = _value(where, row, "episode_index", int), _value(where, row, "length", int)
            if number in lengths or number < 0 or length < 0:
                raise fault(
                    where, "episode_index", f"episode {number} of length {length} stands there", _COPY
                )
            lengths[number] = length
            files[number] = folder / _data_path(file, info, row, number)
            tasks[number] = ", ".join(map(str, row.get("tasks") or ()))
        return cls(folder, info, float(fps), dict(sorted(lengths.items())), files, tasks)


def _episodes_v3(folder: Path) -> list[dict[str, Any]]:
    """Read the table of episodes of version 3."""
    files = sorted((folder / "meta" / "episodes").glob("*/*.parquet"))
    if not files:
        raise fault(folder / "meta" / "episodes", None, "there is no table of the episodes", _COPY)
    wanted = ("episode_index", "length", "data/chunk_index", "data/file_index")
    rows = [row for file in files for row in _read_table(file, wanted, ("tasks",)).to_pylist()]
    return sorted(rows, key=lambda row: (row["episode_index"] is None, row["episode_index"]))


def _data_path(file: Path, info: Mapping[str, Any], row: Mapping[str, Any], number: int) -> str:
    """Fill in the path of an episode's rows. Only numbers are inserted, and paths out of the folder are refused."""
    pattern = _value(file, info, "data_path", str)
    chunk_size = info.get("chunks_size") or CHUNK
    places = {
        "episode_index": number,
        "episode_chunk": number // chunk_size if isinstance(chunk_size, int) and chunk_size > 0 else 0,
        "chunk_index": row.get("data/chunk_index"),
        "file_index": row.get("data/file_index"),
    }
    bare = _PLACE.sub("", pattern)
    used = {match[1] for match in _PLACE.finditer(pattern)}
    parts = Path(bare).parts
    if (
        re.search(r"[{}]", bare)
        or ".." in parts
        or Path(pattern).is_absolute()
        or not all(isinstance(places[name], int) for name in used)
    ):
        raise fault(
            file,
            "data_path",
            f"{pattern!r} names no file in the dataset",
            f"use {DATA}",
        )
    return pattern.format(**places)


@dataclass(frozen=True)
class _Rows:
    """Rows of one episode.

    Attributes
    ----------
    time : array, shape (n_steps,), [s]
    values : array, shape (n_steps, n_columns)
    first : number of the first row in the table
    is_timed : whether it is certain that time is in seconds
    notes : notes about the stamps
    """

    time: NDArray[np.float64]
    values: NDArray[np.float64]
    first: int
    is_timed: bool
    notes: tuple[str, ...]


def _origin(file: Path, feature: str, first: int, body: Body) -> Origin:
    """Name samples by their row and column in the table."""
    turned = sorted(column.number for column in body.orientation)
    return Origin(
        file,
        time=lambda sample: f"row {first + sample}, column timestamp",
        position=lambda sample, dim: f"row {first + sample}, {feature}[{body.moving[dim].number}]",
        orientation=lambda sample: f"row {first + sample}, {feature}[{turned[0]}] to [{turned[-1]}]",
    )


def _episode(
    dataset: _Dataset, file: Path, table: Table, number: int, feature: Feature, rate: float | None
) -> _Rows:
    """Return the rows of one episode in a table."""
    pc = extra("pyarrow.compute", file)
    chosen = np.flatnonzero(_column(file, table, "episode_index") == number)
    expected = dataset.lengths[number]
    if len(chosen) != expected or (expected and chosen[-1] - chosen[0] != expected - 1):
        raise fault(
            file,
            None,
            f"it holds {len(chosen)} rows of episode {number}, and {expected} were recorded",
            _COPY,
        )
    if expected < 2:
        message = f"a movement needs two rows at least, episode {number} has {expected}"
        raise fault(file, None, message, "choose another episode")
    rows = table.slice(int(chosen[0]), expected)
    vectors, width = rows.column(feature.name).combine_chunks(), feature.width
    if vectors.null_count:
        raise fault(file, feature.name, f"{vectors.null_count} rows of episode {number} are empty", _COPY)
    if hasattr(vectors, "flatten") and str(vectors.type).startswith(
        ("list", "fixed_size_list", "large_list")
    ):
        lengths = pc.list_value_length(vectors).to_numpy(zero_copy_only=False)
        if (lengths != width).any():
            row = int(np.argmax(lengths != width))
            raise fault(
                file,
                f"row {chosen[row]}, {feature.name}",
                f"it has {lengths[row]} numbers, and {width} are described",
                _COPY,
            )
        vectors = vectors.flatten()
    values = _numeric(file, feature.name, vectors)
    if len(values) != width * expected:
        raise fault(file, feature.name, f"it has one number a row, and {width} are described", _COPY)
    first = int(chosen[0])
    time, is_timed, notes = _times(dataset, file, rows, first, rate)
    return _Rows(time, values.reshape(expected, width).astype(np.float64), first, is_timed, notes)


def _times(
    dataset: _Dataset, file: Path, rows: Table, first: int, rate: float | None
) -> tuple[NDArray[np.float64], bool, tuple[str, ...]]:
    """Return each row's time [s], whether it is certain, and notes."""
    frames = _column(file, rows, "frame_index")
    if rate is not None:
        return np.arange(len(frames)) / rate, True, ()
    stamps = _column(file, rows, "timestamp").astype(np.float64)
    even = frames / dataset.fps
    if np.array_equal(frames, frames[0] + np.arange(len(frames))) and (
        np.abs(stamps - stamps[0] - even + even[0]).max() <= _STAMP_TOLERANCE
    ):
        return even, True, ()
    passed = np.diff(stamps)
    if (passed < 0.0).any():
        row = int(np.argmax(passed < 0.0)) + 1
        raise fault(
            file,
            f"row {first + row}, column timestamp",
            f"time goes back from {stamps[row - 1]:.6g} s to {stamps[row]:.6g} s",
            f"say how many samples a second there are, instead of the stamps: --rate {dataset.fps:g}",
            rate=f"{dataset.fps:g}",
        )
    frames_a_step = float(np.median(passed)) * dataset.fps
    for unit in ("s", "ms", "us", "ns"):
        if abs(np.log2(max(frames_a_step * TIMES[unit], 1e-9))) < 1.0:
            notes = () if unit == "s" else (f"timestamp is taken to be in {unit}, as fps is {dataset.fps:g}",)
            return stamps * TIMES[unit], True, notes
    return stamps, False, (f"stamps pass in other steps than those of fps, {dataset.fps:g}",)


def _read_table(file: Path, columns: Sequence[str], optional: Sequence[str] = ()) -> Table:
    """Read columns of a Parquet file, with size limit and checksums.

    The sizes stated in the file's column metadata are not used: pyarrow ends the process where they are damaged.
    """
    parquet, pa = extra("pyarrow.parquet", file), extra("pyarrow", file)
    existing_file(file, MAX_BYTES, "split the dataset")

    broken = (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError)
    with (
        decoding(file, "Parquet file", broken, _COPY),
        parquet.ParquetFile(file, page_checksum_verification=True) as source,
    ):
        names = source.schema_arrow.names
        for column in columns:
            if column not in names:
                raise fault(file, column, "the column is missing", near_name(column, names))
        wanted = [*columns, *(column for column in optional if column in names)]
        n_rows, size, batches = source.metadata.num_rows, 0, []
        if n_rows > MAX_ROWS:
            raise _too_large(file, f"claims {n_rows:,} rows")
        for batch in source.iter_batches(batch_size=_BATCH, columns=wanted):
            size += batch.nbytes
            if size > MAX_COLUMN_BYTES:
                raise _too_large(file, f"has columns of more than {MAX_COLUMN_BYTES >> 20} MB")
            batches.append(batch)
        if not batches:
            return source.schema_arrow.empty_table().select(wanted)
        return pa.Table.from_batches(batches)


def _too_large(file: Path, what: str) -> DemonstrationError:
    return fault(file, None, f"it {what}", f"split the dataset: up to {MAX_ROWS:,} rows a file are read")


def _column(file: Path, table: Table, name: str) -> NDArray:
    """Return a column of scalars, shape (n_rows,)."""
    column = table.column(name)
    if column.null_count:
        raise fault(file, name, f"{column.null_count} rows are empty", _COPY)
    return _numeric(file, name, column.combine_chunks())


def _numeric(file: Path, name: str, array: Any) -> NDArray:
    values = np.asarray(array.to_numpy(zero_copy_only=False)) if str(array.type) in _NUMBERS else None
    if values is None:
        raise fault(file, name, f"it holds {array.type}, not numbers", "give real numbers")
    if array.null_count:
        raise fault(file, name, f"{array.null_count} numbers are missing", _COPY)
    return values


_NUMBERS = {
    *("int8", "int16", "int32", "int64", "uint8", "uint16", "uint32", "uint64"),
    *("halffloat", "float", "double"),
}


def _json(file: Path, lines: bool = True) -> list[dict[str, Any]]:
    """Read the objects of a JSON file, one per line or file."""
    existing_file(file, MAX_META_BYTES, "split the dataset")
    with telling(file):
        content = file.read_bytes()
    rows = []
    for number, line in enumerate(content.split(b"\n") if lines else [content], start=1):
        if lines and not line.strip():
            continue
        try:
            row = json.loads(line.decode())
        except (ValueError, RecursionError) as error:
            key = f"line {number}" if lines else None
            raise fault(file, key, f"it is no JSON ({error})", _COPY) from error
        if not isinstance(row, dict):
            raise fault(file, f"line {number}" if lines else None, "it is no JSON object", _COPY)
        rows.append(row)
    return rows


def _value(file: Path, row: Mapping[str, Any], key: str, kind: Any) -> Any:
    """Return one value of an object, checked for its type."""
    if key not in row:
        raise fault(file, key, "it is missing", near_name(key, list(row)[:20]))
    if not isinstance(row[key], kind) or isinstance(row[key], bool):
        raise fault(file, key, f"it is {str(row[key])[:40]!r}", "see LeRobot's description of the format")
    return row[key]


def _common_fps(path: object, episodes: list[dict[str, RecordedSamples]]) -> int:
    """Return the common integer sampling rate of all episodes [Hz]."""
    rate = common_rate(episodes, path)
    if not math.isclose(rate, round(rate), rel_tol=1e-9):
        raise fault(
            path,
            None,
            f"episode 0 runs at {rate:.6g} Hz",
            "LeRobot has a whole number of frames a second: resample the episodes",
        )
    return round(rate)


def _names(path: object, demos: Mapping[str, RecordedSamples]) -> list[str]:
    """Return the names of the coordinates of all manipulators."""
    names = []
    for manipulator, demo in demos.items():
        unnamed = AXES[: demo.n_dims] if demo.n_dims <= 3 else [f"axis{i}" for i in range(demo.n_dims)]
        axes = [*(demo.axes or unnamed), *(QUATERNION if demo.orientation is not None else ())]
        names += [f"{manipulator}_{axis}" if manipulator else axis for axis in axes]
    return names


def _require_readable(path: object, vector: dict[str, Any], demos: Mapping[str, RecordedSamples]) -> None:
    """Raise unless a vector's names determine its movements."""
    try:
        read = movements_of(Path(str(path)), Feature.of(Path(str(path)), {STATE: vector}, STATE))
    except DemonstrationError:
        read = {}
    expected = {name: demo.n_dims for name, demo in demos.items()}
    if {name: len(one.body.moving) for name, one in read.items()} != expected:
        raise fault(
            path,
            None,
            f"the names {', '.join(vector['names'][:8])} would not be read as {', '.join(map(repr, demos))}",
            "call the manipulators left and right, or give positions x, y, z",
        )


def _vectors(demos: Mapping[str, RecordedSamples], dtype: str) -> dict[str, NDArray]:
    blocks = [
        block for demo in demos.values() for block in (demo.position, demo.orientation) if block is not None
    ]
    state = np.concatenate(blocks, axis=1).astype(dtype)
    return {STATE: state, "action": np.concatenate((state[1:], state[-1:]))}

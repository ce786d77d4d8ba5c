"""Recordings in HDF5, in the two layouts that are common in learning from demonstrations.

robomimic, several episodes in one file: `data/demo_0/obs/robot0_eef_pos` (n_steps, 3) [m] and `robot0_eef_quat`
(n_steps, 4), quaternions **x y z w**, which are reordered to w x y z here; `robot1_...` for a second arm. There are
no time stamps: the rate is the `control_freq` in the attribute `env_args` of `data`, or else 20 Hz.

ALOHA, one episode per file: `observations/qpos` (n_steps, 14) [rad], for each arm six joints and the gripper
(0 closed, 1 open), the left arm first; or 7 columns, one arm. The rate is the attribute `fps`, or else 50 Hz.

Needs h5py. Shapes are compared with a limit before any data are read; links into other files and Python objects
are refused.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.samples import (
    MAX_ROWS,
    Episodes,
    Format,
    Origin,
    RecordedSamples,
    as_episodes,
    by_manipulator,
    common_rate,
    decoding,
    even_rate,
    fault,
    one_of,
)
from comove.errors import near_name
from comove.io.files import existing_file, extra, whole_path

if TYPE_CHECKING:
    from h5py import Dataset, Group

MAX_BYTES = 64 * 2**30
"""Largest file [bytes]: cameras fill it, and are not read."""
MAX_ARRAY_BYTES = 256 * 2**20
"""Largest array that is read [bytes]."""
ROBOMIMIC_RATE = 20.0
"""Rate of robosuite's controllers unless `env_args` says otherwise [Hz]."""
ALOHA_RATE = 50.0
"""Rate at which ALOHA records [Hz]."""
ALOHA_JOINTS = ("waist", "shoulder", "elbow", "forearm_roll", "wrist_angle", "wrist_rotate", "gripper")
_BROKEN = (OSError, RuntimeError, KeyError, ValueError, TypeError, MemoryError, OverflowError)
"""What h5py makes of damaged bytes."""
_VERSIONS = ("v110", "v110")
"""Of the format that is written: the oldest that has checksums of all that describes the data."""
_LAYOUTS = "give a robomimic file (data/demo_0/obs/...) or an ALOHA episode (observations/qpos)"


def read(
    path: str | os.PathLike[str], *, episode: str | int | None = None, rate_hz: float | None = None
) -> dict[str, dict[str, RecordedSamples]]:
    """Read the episodes of an HDF5 file; the layout is recognised.

    Parameters
    ----------
    path : file in one of the layouts of this module
    episode : name (demo_3) or number (3) of the only episode to read; None: all
    rate_hz : sampling rate [Hz], instead of the one in the file

    Returns
    -------
    episodes : movements by manipulator (robot0, robot1; left, right; "" for a single ALOHA arm), by episode, in
        the order of their numbers

    Raises
    ------
    DemonstrationError
        If the file cannot be read, is truncated or has another layout, or a dataset is missing or has a wrong
        shape; names it.
    """
    path = existing_file(path, MAX_BYTES, "keep fewer episodes in a file")
    if rate_hz is not None and not (0.0 < rate_hz < math.inf):
        raise fault(None, "rate_hz", f"{rate_hz!r} is no rate", "give hertz")

    found: dict[str, dict[str, RecordedSamples]] = {}
    n_rows = 0
    with _opened(path) as root:
        for name in one_of(_episode_names(path, root), episode, "demo_", path):
            if "observations" in root:
                found[name] = _read_aloha(path, root, rate_hz)
            else:
                found[name] = _read_robomimic(path, root, name, rate_hz)
            n_rows += sum(demo.n_steps for demo in found[name].values())
            if n_rows > MAX_ROWS:
                raise fault(path, None, f"it has more than {MAX_ROWS:,} rows", "read episode by episode")
    return found


def episodes(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the names of the episodes of a file, in the order of their numbers.

    Raises
    ------
    DemonstrationError
        The file cannot be read, or is of another layout.
    """
    path = existing_file(path, MAX_BYTES, "keep fewer episodes in a file")
    with _opened(path) as root:
        return tuple(_episode_names(path, root))


def write_robomimic(path: str | os.PathLike[str], episodes: Episodes) -> None:
    """Write episodes in robomimic's layout.

    Reading returns the same numbers bit by bit, except for the time stamps. The manipulators become robot0,
    robot1, ... in their order. `actions` (n_steps, n_manipulators * (3 or 6)) are the absolute poses of the next
    sample: position [m] and, if there are orientations, rotation vector [rad].

    Parameters
    ----------
    path : file to write; it appears only when complete
    episodes : movements of 3 dimensions in even time steps, all at the same rate

    Raises
    ------
    DemonstrationError
        If the episodes do not fit into one file, or the file cannot be written.
    """
    written = as_episodes(episodes, path)
    rate = common_rate(written, path)
    for index, demos in enumerate(written):
        for name, demo in demos.items():
            if demo.n_dims != 3 or demo.unit != "m" or demo.axes:
                raise fault(
                    path,
                    None,
                    f"{name or 'the movement'} of episode {index} has {demo.n_dims} coordinates in {demo.unit}",
                    "robomimic keeps positions x, y, z in metres",
                )
    with robomimic_file(path) as begin:
        data = begin(rate)
        data.attrs["total"] = sum(next(iter(demos.values())).n_steps for demos in written)
        for index, demos in enumerate(written):
            write_demo(data.create_group(f"demo_{index}"), list(demos.values()))


@contextmanager
def robomimic_file(path: str | os.PathLike[str]) -> Iterator[Callable[[float], Group]]:
    """Lend a function that makes the group of the episodes for a rate [Hz]; the file appears when all is written."""
    with _written(path) as root:

        def begin(rate: float) -> Group:
            data = root.create_group("data")
            environment = {"env_name": "comove", "type": 1, "env_kwargs": {"control_freq": rate}}
            data.attrs["env_args"] = np.bytes_(
                json.dumps(environment)
            )  # of fixed length, where checksums reach
            return data

        yield begin


def write_aloha(path: str | os.PathLike[str], demos: RecordedSamples | Mapping[str, RecordedSamples]) -> None:
    """Write one episode in ALOHA's layout.

    Reading returns the same numbers bit by bit, except for the time stamps. `qvel` holds differences of `qpos`,
    `action` the `qpos` of the next sample. There are no images.

    Parameters
    ----------
    path : file to write; it appears only when complete
    demos : joint movements of `left` and `right`, or one without a name; 7 coordinates each, as `ALOHA_JOINTS`, in
        even time steps

    Raises
    ------
    DemonstrationError
        If the movements do not fit the layout, or the file cannot be written.
    """
    demos = by_manipulator(demos, path)
    if len(demos) > 1 and sorted(demos) != ["left", "right"]:
        raise fault(
            path,
            None,
            f"the manipulators are {', '.join(map(repr, demos))}",
            "ALOHA has the arms left and right, or one",
        )
    first = next(iter(demos.values()))
    if first.n_dims != len(ALOHA_JOINTS):
        raise fault(
            path,
            None,
            f"an arm has {first.n_dims} coordinates",
            f"give {len(ALOHA_JOINTS)}: {', '.join(ALOHA_JOINTS)}",
        )
    rate = even_rate(demos, path)
    qpos = np.concatenate([demos[name].position for name in sorted(demos)], axis=1)
    with _written(path) as root:
        root.attrs["sim"] = False
        root.attrs["fps"] = rate
        put(root, "observations/qpos", qpos)
        put(root, "observations/qvel", np.gradient(qpos, 1.0 / rate, axis=0))
        put(root, "action", _next(qpos))


FORMAT = Format(
    "HDF5", read, suffixes=(".hdf5", ".h5"), part="episode", parts=episodes, write=write_robomimic
)


@contextmanager
def _written(path: str | os.PathLike[str]) -> Iterator[Group]:
    """Lend a new file, which appears when all is written."""
    h5py = extra("h5py", path)
    with whole_path(path) as draft, h5py.File(draft, "w", libver=_VERSIONS) as root:
        yield root


@contextmanager
def _opened(path: Path) -> Iterator[Group]:
    """Lend the open file; convert h5py's exceptions to a `DemonstrationError`."""
    h5py = extra("h5py", path)
    way_out = f"copy or record it again; {_LAYOUTS}"
    with decoding(path, "HDF5 file", _BROKEN, way_out), h5py.File(path, "r") as root:
        yield root


def _episode_names(path: Path, root: Group) -> list[str]:
    """Return the names of the episodes in the order of their numbers; for ALOHA the file's own name."""
    if "observations" in root:
        return [path.stem]
    names = [name for name in root["data"] if re.fullmatch(r"demo_\d+", name)] if "data" in root else []
    if not names:
        held = ", ".join(list(root)[:10]) or "nothing"
        raise fault(path, None, f"it holds {held}, and no episode", _LAYOUTS)
    return sorted(names, key=lambda name: int(name.removeprefix("demo_")))


def _read_robomimic(path: Path, root: Group, name: str, rate_hz: float | None) -> dict[str, RecordedSamples]:
    """Read one episode of a robomimic file."""
    folder = f"data/{name}/obs"
    if folder not in root:
        raise fault(path, folder, "it holds no observations", "extract them with robomimic first")
    held = list(root[folder])
    robots = sorted(key.removesuffix("_eef_pos") for key in held if re.fullmatch(r"robot\d+_eef_pos", key))
    if not robots:
        raise fault(
            path,
            f"{folder}/robot0_eef_pos",
            "the positions of the hands are missing",
            near_name("robot0_eef_pos", held[:20]),
        )
    rate = rate_hz or _control_rate(path, root["data"])
    n_steps = root[f"data/{name}"].attrs.get("num_samples")
    demos = {}
    for robot in robots:
        place, turns = f"{folder}/{robot}_eef_pos", f"{folder}/{robot}_eef_quat"
        position = _array(path, root, place, (3,))
        if n_steps is not None and (np.size(n_steps) != 1 or int(np.ravel(n_steps)[0]) != len(position)):
            message = f"it has {len(position)} rows and num_samples says {n_steps}"
            raise fault(path, place, message, "record or convert it again")
        orientation = None
        if f"{robot}_eef_quat" in held:
            orientation = _array(path, root, turns, (4,))[:, [3, 0, 1, 2]]
        demos[robot] = RecordedSamples(
            np.arange(len(position)) / rate,
            position,
            f"{path.stem}.{name}.{robot}",
            orientation=orientation,
            origin=_origin(path, place, turns),
        )
    return demos


def _read_aloha(path: Path, root: Group, rate_hz: float | None) -> dict[str, RecordedSamples]:
    """Read an ALOHA episode."""
    key, n_joints = "observations/qpos", len(ALOHA_JOINTS)
    if key not in root:
        raise fault(path, key, "the dataset is missing", near_name("qpos", list(root["observations"])[:20]))
    qpos = _array(path, root, key)
    if qpos.shape[1] not in (n_joints, 2 * n_joints):
        raise fault(
            path,
            key,
            f"it has {qpos.shape[1]} columns",
            f"ALOHA has {n_joints} an arm: {', '.join(ALOHA_JOINTS)}",
        )
    rate = rate_hz or _attribute_rate(path, "fps", root.attrs.get("fps"), ALOHA_RATE)
    arms = (
        {"left": qpos[:, :n_joints], "right": qpos[:, n_joints:]} if qpos.shape[1] > n_joints else {"": qpos}
    )
    return {
        arm: RecordedSamples(
            np.arange(len(position)) / rate,
            position,
            f"{path.stem}.{arm}" if arm else path.stem,
            ("gripper: 0 closed, 1 open",),
            "rad",
            axes=ALOHA_JOINTS,
            origin=_origin(path, key, first=n_joints * index),
        )
        for index, (arm, position) in enumerate(arms.items())
    }


def _origin(path: Path, position: str, orientation: str = "", first: int = 0) -> Origin:
    """Name samples by their indices in the datasets; the positions begin in the column `first`."""
    return Origin(
        path,
        position=lambda sample, dim: f"{position}[{sample}, {first + dim}]",
        orientation=lambda sample: f"{orientation}[{sample}]",
    )


def _control_rate(path: Path, data: Group) -> float:
    """Read `control_freq` from `env_args`."""
    text = data.attrs.get("env_args")
    if text is None:
        return ROBOMIMIC_RATE
    try:
        arguments = json.loads(text)
        rate = arguments.get("env_kwargs", {}).get("control_freq")
    except (ValueError, TypeError, AttributeError, RecursionError) as error:
        raise fault(path, "data, attribute env_args", "it is no JSON object", "give rate_hz") from error
    return _attribute_rate(path, "env_args.env_kwargs.control_freq", rate, ROBOMIMIC_RATE)


def _attribute_rate(path: Path, key: str, rate: object, default: float) -> float:
    if rate is None:
        return default
    if isinstance(rate, int | float | np.number) and not isinstance(rate, bool) and 0.0 < rate < 1e6:
        return float(rate)
    raise fault(path, key, f"{rate!r} is no rate", "give rate_hz")


def _array(path: Path, root: Group, key: str, width: tuple[int, ...] = ()) -> NDArray[np.float64]:
    """Read one dataset of numbers, shape (n_steps, ...), after a check of its type, shape and size."""
    h5py = extra("h5py", path)
    parts = key.split("/")
    for depth in range(1, len(parts) + 1):
        if isinstance(root.get("/".join(parts[:depth]), getlink=True), h5py.ExternalLink):
            raise fault(path, key, "it is a link into another file", "copy what it links to")
    dataset: Dataset = root[key]
    if not isinstance(dataset, h5py.Dataset):
        raise fault(path, key, "it is a group, not a dataset", _LAYOUTS)
    if dataset.is_virtual or dataset.external:
        raise fault(path, key, "its numbers lie in another file", "copy them into this one")
    if dataset.dtype.kind not in "iuf":
        raise fault(path, key, f"it holds {dataset.dtype}, not numbers", "give real numbers")
    shape, size = dataset.shape, dataset.dtype.itemsize
    if shape is None or len(shape) != 2 or (width and shape[1:] != width):
        expected = f"(n_steps, {width[0]})" if width else "(n_steps, n_joints)"
        raise fault(path, key, f"it has shape {shape}", f"give shape {expected}")
    claimed = max(math.prod(shape), math.prod(dataset.chunks or ())) * max(size, 8)
    if shape[0] > MAX_ROWS or claimed > MAX_ARRAY_BYTES:
        raise fault(
            path, key, f"it claims {dataset.dtype} of shape {shape}", f"up to {MAX_ROWS:,} rows are read"
        )
    _require_filled(path, key, dataset)
    if shape[0] < 2:
        message = f"a movement needs two rows at least, this one has {shape[0]}"
        raise fault(path, key, message, "record more samples, or remove the episode")
    return np.asarray(dataset[()], dtype=np.float64)


def _require_filled(path: Path, key: str, dataset: Dataset) -> None:
    """Raise if a part of a dataset was never written, which HDF5 would read as zeros."""
    if dataset.chunks is None:
        missing = dataset.id.get_storage_size() < dataset.nbytes
    else:
        per_axis = [-(-n // chunk) for n, chunk in zip(dataset.shape, dataset.chunks, strict=True)]
        missing = dataset.id.get_num_chunks() < math.prod(per_axis)
    if missing:
        raise fault(path, key, "not all of it was written", "record or copy it again")


def write_demo(
    group: Group, demos: list[RecordedSamples], actions: NDArray[np.float64] | None = None
) -> None:
    """Write one episode of a robomimic file.

    Parameters
    ----------
    actions : array, shape (n_steps, n_values), what a controller is sent; the hands at the next sample unless given
    """
    from scipy.spatial.transform import Rotation

    n_steps = demos[0].n_steps
    group.attrs["num_samples"] = n_steps
    reached = []
    for index, demo in enumerate(demos):
        put(group, f"obs/robot{index}_eef_pos", demo.position)
        reached.append(_next(demo.position))
        if demo.orientation is not None:
            turned = demo.orientation[:, [1, 2, 3, 0]]
            put(group, f"obs/robot{index}_eef_quat", turned)
            reached.append(_next(Rotation.from_quat(turned).as_rotvec()))
    put(group, "actions", np.concatenate(reached, axis=1) if actions is None else actions)
    group["rewards"] = np.zeros(n_steps)
    group["dones"] = (np.arange(n_steps) == n_steps - 1).astype(np.int64)


def put(group: Group, name: str, rows: NDArray[np.float64]) -> None:
    """Write a dataset with checksums, which every reader of HDF5 verifies."""
    group.create_dataset(name, data=rows, fletcher32=True)


def put_pictures(group: Group, name: str, pictures: NDArray[np.uint8]) -> None:
    """Write pictures, array of shape (n_steps, height, width, 3), each packed by itself and with a checksum."""
    chunk = (1, *pictures.shape[1:])
    group.create_dataset(
        name, data=pictures, chunks=chunk, compression="gzip", compression_opts=4, fletcher32=True
    )


def _next(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return each row's successor; the last row is repeated."""
    return np.concatenate((rows[1:], rows[-1:]))

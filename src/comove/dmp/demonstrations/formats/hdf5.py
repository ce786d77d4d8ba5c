"""Recordings in HDF5: common layouts, or the path of a dataset.

robosuite and robomimic, several episodes in one file: `data/demo_0/obs/robot0_eef_pos` (n_steps, 3) [m] and
`robot0_eef_quat` (n_steps, 4), quaternions **x y z w**, which are reordered to w x y z here; `robot1_...` for a
second arm, or `robot0_right_...` and `robot0_left_...` for the arms of one robot. LIBERO has `ee_pos` and `ee_ori`,
rotation vectors [rad]. There are no time stamps: the rate is the `control_freq` in the attribute `env_args` of
`data`, or else 20 Hz.

ManiSkill, several episodes in one file: `traj_0/obs/extra/tcp_pose` (n_steps, 7), positions and quaternions w x y z;
otherwise `traj_0/obs/agent/qpos`. The rate is 20 Hz.

ALOHA, one episode per file: `observations/qpos` (n_steps, 14) [rad], for each arm six joints and the gripper (0
closed, 1 open), the left arm first; or 7 columns, one arm. Other even numbers from 12 on are two arms as well, others
one arm, of joints without names. The rate is the attribute `fps`, or else 50 Hz.

Plain files: datasets beside each other with descriptive names, such as `time` and `position`, or `t`, `x`, `y`, `z`.
Anything else is read by its path, with `dataset`.

Needs h5py. Shapes are compared with a limit before any data are read; links into other files and Python objects are
refused (`formats.hdf5_access`).
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.formats.hdf5_access import LAYOUTS, HDF5File
from comove.dmp.demonstrations.formats.hdf5_layouts import ALOHA_JOINTS, EpisodeReader, episode_groups
from comove.dmp.demonstrations.plausibility import require_rate
from comove.dmp.demonstrations.samples import (
    MAX_ROWS,
    Episodes,
    Format,
    RecordedSamples,
    as_episodes,
    by_manipulator,
    common_rate,
    even_rate,
    fault,
    one_of,
)
from comove.dmp.demonstrations.units import require_unit
from comove.errors import OptionError
from comove.io.files import existing_file, extra, whole_path

if TYPE_CHECKING:
    from h5py import Group

MAX_BYTES = 64 * 2**30
"""Largest file [bytes]: cameras fill it, and are not read."""
_VERSIONS = ("v110", "v110")
"""Of the format that is written: the oldest that has checksums of all that describes the data."""


def read(
    path: str | os.PathLike[str],
    *,
    episode: str | int | None = None,
    dataset: str | None = None,
    columns: Sequence[str] | None = None,
    rate: float | None = None,
    unit: str | None = None,
) -> dict[str, dict[str, RecordedSamples]]:
    """Read the episodes of an HDF5 file. The layout is recognised.

    Parameters
    ----------
    path : file
    episode : name (demo_3) or number (3) of the only episode to read; None: all
    dataset : path of the dataset, or of the group of datasets, that holds the movement; in the file, or in an episode
    columns : numbers, from 1, of the columns of the dataset that are the positions, or joints
    rate : samples a second [Hz], instead of the file's
    unit : unit of the positions or joints that state none; an angle makes columns joints

    Returns
    -------
    episodes : movements by manipulator (robot0, robot1; left, right; "" for a single one), by episode, in the order
        of their numbers

    Raises
    ------
    DemonstrationError
        If the file cannot be read, is truncated or has another layout, or a dataset is missing or has a wrong
        shape; names it, and the datasets that can be named.
    """
    path = existing_file(path, MAX_BYTES, "keep fewer episodes in a file")
    if rate is not None:
        require_rate(rate)
    if columns is not None and dataset is None:
        raise OptionError(
            "they are chosen in a dataset",
            file=path,
            key="columns",
            way_out="give its path as well: --dataset PATH",
        )
    unit = None if unit is None else require_unit(unit, path)

    found: dict[str, dict[str, RecordedSamples]] = {}
    n_rows = 0
    with _opened(path) as file:
        if dataset is not None and episode is None and file.node(dataset) is not None:
            groups = {path.stem: ""}
        else:
            known = episode_groups(file)
            groups = {name: known[name] for name in one_of(list(known), episode, "demo_", path)}
        for name, group in groups.items():
            reader = EpisodeReader(file, group, name if group else "", rate, unit)
            found[name] = reader.movements() if dataset is None else reader.chosen(dataset, columns)
            n_rows += sum(demo.n_steps for demo in found[name].values())
            if n_rows > MAX_ROWS:
                raise fault(path, None, f"it has more than {MAX_ROWS:,} rows", "read episode by episode")
    return found


def episodes(path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Return the names of a file's episodes, in order of their numbers.

    Raises
    ------
    DemonstrationError
        If the file cannot be read, or its only episode is of another layout.
    """
    path = existing_file(path, MAX_BYTES, "keep fewer episodes in a file")
    with _opened(path) as file:
        return tuple(episode_groups(file))


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
    """Lend a function that makes the episodes' group for a rate [Hz]. The file appears when it is complete."""
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
    "HDF5",
    read,
    suffixes=(".hdf5", ".h5"),
    part="episode",
    parts=episodes,
    options=frozenset({"dataset", "columns", "rate", "unit"}),
    write=write_robomimic,
)


@contextmanager
def _written(path: str | os.PathLike[str]) -> Iterator[Group]:
    """Lend a new file, which appears when all is written."""
    h5py = extra("h5py", path)
    with whole_path(path) as draft, h5py.File(draft, "w", libver=_VERSIONS) as root:
        yield root


def _opened(path: Path) -> AbstractContextManager[HDF5File]:
    return HDF5File.opened(path, f"copy or record it again; {LAYOUTS}")


def write_demo(
    group: Group, demos: list[RecordedSamples], actions: NDArray[np.float64] | None = None
) -> None:
    """Write one episode of a robomimic file.

    Parameters
    ----------
    actions : array, shape (n_steps, n_values), commands to a controller; the poses at the next sample unless given
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
    """Write pictures (n_steps, height, width, 3), each packed with a checksum."""
    chunk = (1, *pictures.shape[1:])
    group.create_dataset(
        name, data=pictures, chunks=chunk, compression="gzip", compression_opts=4, fletcher32=True
    )


def _next(rows: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.concatenate((rows[1:], rows[-1:]))

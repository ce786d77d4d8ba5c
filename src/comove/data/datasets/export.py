"""Formats of datasets, and their atomic writing."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from comove.data.datasets import lerobot, mcap, npz, robomimic
from comove.data.datasets.samples import EpisodeSamples, episodes_of
from comove.errors import ResultError
from comove.io.files import extra
from comove.io.folders import Contents, check_target, whole_folder

if TYPE_CHECKING:
    from comove.data.generation import Study

DATASET = Contents("dataset")
"""A dataset replaces nothing."""


@dataclass(frozen=True)
class DatasetFormat:
    """Format of datasets.

    Attributes
    ----------
    name : name of the format for users
    target : name of the file or folder in the folder of the study
    write : function of a path and the episodes that writes them and returns their number
    library : library that writes it
    is_folder : whether it is a folder; the function then writes into an existing one
    """

    name: str
    target: str
    write: Callable[[Path, Iterable[EpisodeSamples]], int]
    library: str = "numpy"
    is_folder: bool = True


FORMATS = {
    format.name: format
    for format in (
        DatasetFormat("npz", "npz", npz.write),
        DatasetFormat("lerobot", "lerobot", lerobot.write, "pyarrow"),
        DatasetFormat("mcap", "mcap", mcap.write, "rosbags"),
        DatasetFormat("robomimic", "robomimic.hdf5", robomimic.write, "h5py", is_folder=False),
    )
}


def check_export(folder: Path, format: DatasetFormat) -> Path:
    """Check in advance that a dataset can be written; return its path.

    Raises
    ------
    ResultError
        If it exists already, or cannot be written.
    DemonstrationError
        If its library is not installed.
    """
    path = folder / format.target
    extra(format.library, path)
    if path.exists():
        raise ResultError("it is there already", file=path, way_out="move it away first")
    if format.is_folder and folder.exists():
        check_target(path, DATASET)
    return path


def export_episodes(
    folder: Path,
    scenes: Path,
    format: DatasetFormat,
    rate: int | None = None,
    study: Study | None = None,
) -> tuple[Path, int]:
    """Verify the episodes of a study again, and write a dataset.

    Parameters
    ----------
    folder : folder of the study, in which the dataset is written
    scenes : folder to which paths in the scenes are relative
    rate : samples a second [Hz]; those of the cameras unless given, 50 without any
    study : the study, whose scenes must be those of the episodes; the store's own scenes are taken unless given

    Returns
    -------
    path of the dataset, and number of its episodes

    Raises
    ------
    ResultError
        If the dataset is there already, there is no verified episode, or episodes do not fit into one dataset.
        Nothing is written then.
    DemonstrationError
        If a library is not installed, or the file cannot be written.
    """
    path = check_export(folder, format)
    episodes = episodes_of(folder, scenes, rate, study)
    if not format.is_folder:
        return path, format.write(path, episodes)
    with whole_folder(path, DATASET) as draft:
        return path, format.write(draft, episodes)

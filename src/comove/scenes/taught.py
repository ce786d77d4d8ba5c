"""The demonstration that a scene names, in the scene's dimension."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations import Demonstration
from comove.errors import DemonstrationError, SceneError
from comove.scenes.model import DemonstrationSource

PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


def read_demonstration(
    source: DemonstrationSource, folder: Path, n_dims: int, file: object = None
) -> Demonstration:
    """Read the recording of a scene.

    Parameters
    ----------
    source : what the scene says
    folder : to which its path is relative
    n_dims : of the scene; a planar recording is laid into space by `source.plane`

    Raises
    ------
    SceneError
        If the recording cannot be read or has another dimension.
    """
    key = "demonstration.file" if source.file is not None else "demonstration.lasa"
    try:
        if source.file is not None:
            recording = Demonstration.load(folder / source.file, manipulator=source.manipulator)
        else:
            recording = Demonstration.from_lasa(source.lasa, source.demo)
    except DemonstrationError as error:
        raise SceneError(str(error), file=file, key=key) from error
    position = recording.position * (source.scale or 1.0)
    if n_dims == 3 and recording.n_dims == 2 and source.plane is not None:
        position = _in_space(position, source.plane)
    if position.shape[1] != n_dims:
        raise SceneError(
            f"the recording has {recording.n_dims} dimensions, the scene {n_dims}",
            file=file,
            key=key,
            way_out="add `plane: xy` to lay it into space" if n_dims == 3 else "give a planar recording",
        )
    return Demonstration(recording.time, position, recording.name, recording.notes, recording.unit)


def _in_space(position: NDArray[np.float64], plane: str) -> NDArray[np.float64]:
    laid = np.zeros((len(position), 3))
    laid[:, list(PLANES[plane])] = position
    return laid

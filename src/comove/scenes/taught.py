"""The demonstration that a scene names, in the scene's dimension: a recording, or a primitive of a library."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations import Demonstration
from comove.errors import DemonstrationError, LibraryError, SceneError
from comove.primitives import DMP, Library, PoseDMP, Variant
from comove.primitives.operations import PLANES, in_space, scale
from comove.scenes.model import DemonstrationSource

LIBRARY = "library"
"""The folder beside a scene file in which primitives are looked for."""


def read_demonstration(
    source: DemonstrationSource, folder: Path, n_dims: int, file: object = None
) -> Demonstration:
    """Read the recording of a scene.

    Parameters
    ----------
    source : the demonstration as the scene names it
    folder : the folder to which its path is relative
    n_dims : dimension of the scene; a planar recording is laid into space by `source.plane`

    Raises
    ------
    SceneError
        If the recording cannot be read or has another dimension.
    """
    key = "demonstration.file" if source.file is not None else "demonstration.lasa"
    try:
        if source.file is not None:
            recording = Demonstration.load(
                folder / source.file, source.manipulator, episode=source.episode, topic=source.topic
            )
        else:
            recording = Demonstration.from_lasa(source.lasa, source.demo)
    except DemonstrationError as error:
        raise SceneError(str(error), file=file, key=key) from error
    position = recording.position * (source.scale or 1.0)
    if n_dims == 3 and recording.n_dims == 2 and source.plane is not None:
        position = _in_space(position, source.plane)
    if position.shape[1] != n_dims:
        raise _other_dimension("recording", recording.n_dims, n_dims, file, key)
    axes = recording.axes if position.shape == recording.position.shape else ()
    return replace(recording, position=position, axes=axes)


def read_hands(
    source: DemonstrationSource, folder: Path, n_dims: int, names: tuple[str, ...], file: object = None
) -> tuple[Demonstration, ...] | None:
    """Read the recordings of all hands of a scene, one each; return None where the file does not hold all of them.

    Parameters
    ----------
    source, folder, n_dims, file : as for `read_demonstration`
    names : names of the manipulators
    """
    if source.file is None or source.manipulator is not None or len(names) < 2:
        return None
    recordings = []
    for name in names:
        try:
            Demonstration.load(folder / source.file, name, episode=source.episode, topic=source.topic)
        except DemonstrationError:
            return None  # of one movement, or of others: said by whoever reads one
        each = source.model_copy(update={"manipulator": name})
        recordings.append(read_demonstration(each, folder, n_dims, file))
    return tuple(recordings)


def read_movement(
    source: DemonstrationSource, folder: Path, n_dims: int, file: object = None, *, posed: bool = False
) -> DMP | PoseDMP:
    """Read the primitive that a scene names: NAME in the folder `library`, or FOLDER/NAME.

    Parameters
    ----------
    source, folder, n_dims : as for `read_demonstration`
    posed : whether a primitive of poses is returned as such, where it need not be scaled or laid into space;
        otherwise its positions are returned

    Raises
    ------
    SceneError
        If the primitive cannot be read, lies outside the scene's folder, has another dimension or never ends.
    """
    key = "demonstration.library"
    place = PurePosixPath(source.library or "")
    inner = str(place.parent) if len(place.parts) > 1 else LIBRARY
    try:
        inside = (folder / inner).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # name too long, a zero byte, a circle of links
        inside = False
    if not inside or place.is_absolute() or ".." in place.parts:
        raise SceneError(
            f"{source.library!r} lies outside the scene's folder",
            file=file,
            key=key,
            way_out="move the library into it",
        )
    try:
        primitive = Library(folder / inner).get(place.name)
    except LibraryError as error:
        raise SceneError(str(error), file=file, key=key) from error
    if posed and primitive.kind == "pose" and primitive.dmp.n_dims == n_dims and source.scale is None:
        return primitive.dmp
    dmp = primitive.positions
    if dmp.variant is Variant.RHYTHMIC:
        raise SceneError(
            f"the primitive {place.name!r} is rhythmic and never ends",
            file=file,
            key=key,
            way_out="name one that ends",
        )
    if source.scale is not None:
        dmp = scale(dmp, source.scale, about=np.zeros(dmp.n_dims))
    if n_dims == 3 and dmp.n_dims == 2 and source.plane is not None:
        dmp = in_space(dmp, source.plane)
    if dmp.n_dims != n_dims:
        raise _other_dimension("primitive", dmp.n_dims, n_dims, file, key)
    return dmp


def _other_dimension(what: str, found: int, n_dims: int, file: object, key: str) -> SceneError:
    return SceneError(
        f"the {what} has {found} dimensions, the scene {n_dims}",
        file=file,
        key=key,
        way_out="add `plane: xy` to lay it into space" if n_dims == 3 else f"give a planar {what}",
    )


def _in_space(position: NDArray[np.float64], plane: str) -> NDArray[np.float64]:
    laid = np.zeros((len(position), 3))
    laid[:, list(PLANES[plane])] = position
    return laid

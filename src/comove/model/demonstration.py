"""The demonstration that a scene names: a recording or a primitive."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from comove.dmp import DMP, Library, PoseDMP, Primitive, ProMP, Variant, read_primitive
from comove.dmp.demonstrations import Demonstration
from comove.dmp.demonstrations.samples import AXES, HZ, WHICH_UNIT
from comove.dmp.files import is_primitive
from comove.dmp.library import SUFFIX
from comove.dmp.operations import PLANES, in_space, scale
from comove.dmp.recordings import is_several, read_several
from comove.errors import DemonstrationError, LibraryError, OptionError, SceneError
from comove.model.files.keys import DemonstrationSource
from comove.model.scene import Scene

LIBRARY = "library"
"""The folder beside a scene file in which primitives are looked for."""


def recording_of(scene: Scene) -> Demonstration | None:
    """Read the recording that a scene names, or return None.

    Raises
    ------
    SceneError
        If the recording cannot be read or has another dimension.
    """
    source = scene.file.demonstration
    if source is None or source.library is not None or _primitive_of(scene, source) is not None:
        return None
    return _recording(scene, source)


def demonstration_of(scene: Scene) -> DMP | PoseDMP | ProMP | tuple[DMP, ...] | None:
    """Return the movement that a scene names, or None.

    It is a primitive fitted to its recording, or read from a library; of a folder of recordings it is their
    distribution. There is one primitive for each manipulator where the recording holds movements of all of them.
    Poses are those of the payload.

    Raises
    ------
    SceneError
        If it cannot be read or has another dimension.
    """
    source = scene.file.demonstration
    if source is None:
        return None
    if source.library is not None:
        return _from_library(scene, source, source.library)
    if source.file is not None and is_several(str(scene.folder / source.file)):
        return _distribution(scene, source, source.file)
    if (primitive := _primitive_of(scene, source)) is not None:
        return followed_in(
            scene, primitive, key="demonstration.file", plane=source.plane, factor=source.scale
        )
    hands = _recordings_of_hands(scene, source)
    return fitted(scene, _recording(scene, source)) if hands is None else tuple(map(DMP.fit, hands))


def _primitive_of(scene: Scene, source: DemonstrationSource) -> Primitive | None:
    """Read the primitive in a scene's file, or return None."""
    if source.file is None or not is_primitive(scene.folder / source.file):
        return None
    for key in ("manipulator", *source.reading):
        if getattr(source, key) is not None:
            raise SceneError(
                f"{key} {getattr(source, key)!r} belongs to a recording, and {source.file} is a primitive",
                file=scene.path,
                key=f"demonstration.{key}",
                way_out=f"leave {key} out, or name the recording",
            )
    try:
        return read_primitive(scene.folder / source.file)
    except LibraryError as error:
        raise SceneError(str(error), file=scene.path, key="demonstration.file") from error


def fitted(scene: Scene, recording: Demonstration) -> DMP | PoseDMP:
    """Return a primitive fitted to a recording.

    It is a primitive of poses where the recording holds orientations and a single body turns with all end effectors.
    """
    if recording.is_joints:
        raise _of_joints("recording", recording.name, recording.unit, scene, "demonstration")
    require_dimension(recording.n_dims, scene)
    posed = recording.orientation is not None and scene.turns_as_one
    return PoseDMP.fit(recording) if posed else DMP.fit(recording)


def require_dimension(n_dims: int, scene: Scene) -> None:
    """Raise if a demonstration's dimension is not the scene's."""
    if n_dims != scene.n_dims:
        raise OptionError(
            f"the demonstration has {n_dims} dimensions, the scene {scene.n_dims}",
            key="demonstration",
            way_out="give one of the scene's dimension",
        )


def _distribution(scene: Scene, source: DemonstrationSource, folder: str) -> ProMP:
    """Fit a distribution to all recordings of a folder."""
    options = source.reading | ({} if source.manipulator is None else {"manipulator": source.manipulator})
    try:
        found, _ = read_several([str(scene.folder / folder)], **options)
        laid = [
            {name: _in_scene(part, scene, source, "demonstration.file") for name, part in one.items()}
            if isinstance(one, dict)
            else _in_scene(one, scene, source, "demonstration.file")
            for one in found
        ]
        return ProMP.fit(laid)
    except (DemonstrationError, OptionError) as error:
        raise _unread(error, scene, "demonstration.file") from error


def _recording(scene: Scene, source: DemonstrationSource) -> Demonstration:
    """Read a recording in the scene's dimension. A planar one is placed in space by `source.plane`."""
    key = "demonstration.file" if source.file is not None else "demonstration.lasa"
    try:
        if source.file is not None:
            recording = Demonstration.load(scene.folder / source.file, source.manipulator, **source.reading)
        else:
            recording = Demonstration.from_lasa(source.lasa or "", source.demo)
    except (DemonstrationError, OptionError) as error:
        raise _unread(error, scene, key) from error
    return _in_scene(recording, scene, source, key)


def _unread(error: DemonstrationError | OptionError, scene: Scene, key: str) -> SceneError:
    """Return the error about an unreadable recording, with keys as hints."""
    if isinstance(error, DemonstrationError) and error.options:
        keys = "; ".join(
            f"{option}: {_written(value)}" for option, value in error.options.items() if value is not None
        )
        place = f"{error.file}: {error.key}" if error.key else f"{error.file}"
        return SceneError(
            f"{place}: {error.message}",
            file=scene.path,
            key=key,
            way_out=f"{error.way_out.partition('; run: ')[0].replace('--', '')}; write below demonstration: {keys}",
        )
    return SceneError(str(error), file=scene.path, key=key)


def _written(value: object) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if value in (HZ, WHICH_UNIT):
        return str(value)
    return json.dumps(list(map(str, value)) if isinstance(value, list | tuple) else value, ensure_ascii=False)


def _in_scene(recording: Demonstration, scene: Scene, source: DemonstrationSource, key: str) -> Demonstration:
    """Return a recording scaled and placed as the scene says."""
    if recording.is_joints:
        raise _of_joints("recording", recording.name, recording.unit, scene, key)
    position, axes = recording.position * (source.scale or 1.0), recording.axes
    if axes and set(axes) == set(AXES[: len(axes)]):  # written in another order
        position, axes = position[:, [axes.index(axis) for axis in sorted(axes)]], ()
    if scene.n_dims == 3 and recording.n_dims == 2 and source.plane is not None:
        flat, position = position, np.zeros((len(position), 3))
        position[:, list(PLANES[source.plane])] = flat
    if position.shape[1] != scene.n_dims:
        raise _other_dimension("recording", recording.n_dims, scene, key)
    axes = axes if position.shape == recording.position.shape else ()
    return replace(recording, position=position, axes=axes)


def _recordings_of_hands(scene: Scene, source: DemonstrationSource) -> tuple[Demonstration, ...] | None:
    """Read a recording for each end effector, or return None."""
    if source.file is None or source.manipulator is not None or len(scene.manipulators) < 2:
        return None
    file = scene.folder / source.file
    try:
        hands = [Demonstration.load(file, name, **source.reading) for name in scene.manipulators]
    except (DemonstrationError, OptionError) as error:
        if error.key == "manipulator":
            return None  # it holds one movement, or those of others
        raise _unread(error, scene, "demonstration.file") from error
    return tuple(_in_scene(hand, scene, source, "demonstration.file") for hand in hands)


def _from_library(scene: Scene, source: DemonstrationSource, library: str) -> DMP | PoseDMP | ProMP:
    """Read the primitive NAME in folder `library`, or FOLDER/NAME.

    Raises
    ------
    SceneError
        If the primitive cannot be read or lies outside the scene's folder, or as `followed_in`.
    """
    key, folder, file = "demonstration.library", scene.folder, scene.path
    place = PurePosixPath(library)
    inner = _library_folder(place)
    try:
        inside = (folder / inner).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError):  # name too long, a zero byte, a circle of links
        inside = False
    if not inside or place.is_absolute() or ".." in place.parts:
        raise SceneError(
            f"{library!r} lies outside the scene's folder",
            file=file,
            key=key,
            way_out="move the library into it",
        )
    try:
        primitive = Library(folder / inner).get(place.name)
    except LibraryError as error:
        raise SceneError(str(error), file=file, key=key) from error
    return followed_in(scene, primitive, key=key, plane=source.plane, factor=source.scale)


def followed_in(
    scene: Scene,
    primitive: Primitive,
    *,
    key: str = "demonstration",
    plane: str | None = None,
    factor: float | None = None,
) -> DMP | PoseDMP | ProMP:
    """Return the movement of a primitive that a scene follows.

    A primitive of poses is returned as such where a single body turns and it needs no scaling or placing in space;
    otherwise its positions are returned.

    Parameters
    ----------
    scene, primitive : the scene, and the primitive that it follows
    key : place of the primitive's name, for messages
    plane : plane of a spatial scene in which a planar primitive is placed
    factor : factor by which it is scaled about the origin

    Raises
    ------
    SceneError
        If it is one of joints, has another dimension or never ends.
    """
    if primitive.is_joints:
        raise _of_joints("primitive", primitive.name, primitive.unit, scene, key)
    followed = primitive.followed
    if isinstance(followed, ProMP):  # the similarity to the scene's ends scales it
        if followed.n_dims != scene.n_dims:
            raise _other_dimension("distribution", followed.n_dims, scene, key)
        return followed
    as_it_is = scene.turns_as_one and isinstance(followed, PoseDMP) and factor is None
    if as_it_is and followed.n_dims == scene.n_dims:
        return followed
    dmp = primitive.positions
    if dmp.variant is Variant.RHYTHMIC:
        raise SceneError(
            f"the primitive {primitive.name!r} is rhythmic and never ends",
            file=scene.path,
            key=key,
            way_out="name one that ends",
        )
    if factor is not None:
        dmp = scale(dmp, factor, about=np.zeros(dmp.n_dims))
    if scene.n_dims == 3 and dmp.n_dims == 2 and plane is not None:
        dmp = in_space(dmp, plane)
    if dmp.n_dims != scene.n_dims:
        raise _other_dimension("primitive", dmp.n_dims, scene, key)
    return dmp


def library_file(scene: Scene, library: str) -> Path:
    """Return the file of a primitive in a scene's library."""
    place = PurePosixPath(library)
    return scene.folder / _library_folder(place) / f"{place.name}{SUFFIX}"


def _library_folder(place: PurePosixPath) -> str:
    return str(place.parent) if len(place.parts) > 1 else LIBRARY


def _of_joints(what: str, name: str, unit: str, scene: Scene, key: str) -> SceneError:
    return SceneError(
        f"the {what} {name!r} is a movement of joints in {unit}, which is no path of an end effector",
        file=scene.path,
        key=key,
        way_out="take the path that they give a robot's end effector: comove learn RECORDING --robot ROBOT --out "
        "taught.json, and write file: taught.json",
    )


def _other_dimension(what: str, found: int, scene: Scene, key: str) -> SceneError:
    return SceneError(
        f"the {what} has {found} dimensions, the scene {scene.n_dims}",
        file=scene.path,
        key=key,
        way_out="add `plane: xy` to lay it into space" if scene.n_dims == 3 else f"give a planar {what}",
    )

"""Inputs of a result, kept in its folder.

The folder can thus be moved, inspected and repeated elsewhere. Files keep their places relative to each other, below
`FOLDER`; `LIST` holds their origins and the command.
"""

from __future__ import annotations

import hashlib
import json
import os
import shlex
import shutil
import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath
from types import MappingProxyType
from typing import Any

from comove.errors import ComoveWarning, ResultError
from comove.io.files import telling, whole_file
from comove.io.folders import FOLDER, LIST, listed_inputs
from comove.model.files.keys import canonical
from comove.model.scene import Scene

MOST = 2**28
"""What is copied at most [bytes]; of more, only origin and checksum are kept."""

Words = Sequence[str | Path]


def write_inputs(
    folder: Path,
    scene: Scene | None,
    *,
    files: Iterable[Path] = (),
    command: Words = (),
    made: Mapping[Path, bytes] = MappingProxyType({}),
) -> None:
    """Copy the inputs of a result into its folder, with its command.

    Parameters
    ----------
    folder : result folder, which exists
    scene : scene that was solved; its file is copied, and every file that it names. None where `files` are complete
    files : further files and folders, such as a robot's description and models
    command : words after ``comove``; paths that exist are files that were read. Empty for results made in Python
    made : contents of files that are nowhere yet, by the paths at which they would be

    Raises
    ------
    ResultError
        If something cannot be read or written.
    """
    made, place, places = {_whole(path): data for path, data in made.items()}, None, dict[Path, Path]()
    given = (word for word in command if isinstance(word, Path) and word.exists())  # not lasa:SHAPE
    read = [*files, *given]
    if scene is not None:
        place = place_of_scene(scene)
        read += files_of_scene(scene)
        if scene.path is None:
            made[place] = canonical(scene.file) + b"\n"
        else:  # a stored scene lies beside its files
            places = {_whole(scene.path): place}
    places = {path: path for path in map(_whole, read)} | places
    root = Path(os.path.commonpath([path.parent for path in [*places.values(), *made]]))
    entries: dict[str, dict[str, Any]] = {}
    for path, data in made.items():
        target = folder / _inside(path, root)
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(data)
        entries[_inside(path, root)] = {"from": None, "sha256": hashlib.sha256(data).hexdigest()}
    for source, at in places.items():
        if source not in made:
            entries |= _copied(source, folder, _inside(at, root))
    kept = {path: path for path in made} | places
    told = {
        "command": [_inside(kept[whole], root) if (whole := _whole(w)) in kept else str(w) for w in command],
        "scene": None if place is None else _inside(place, root),
        "files": entries,
    }
    with whole_file(folder / LIST, ResultError) as file:
        file.write(json.dumps(told, indent=2, ensure_ascii=False).encode() + b"\n")


def place_of_scene(scene: Scene) -> Path:
    """Return the path of a scene's file. For a scene made in Python it is the one that its file would have."""
    return _whole(scene.folder / ("scene.json" if scene.path is None else scene.path.name))


def files_of_scene(scene: Scene) -> list[Path]:
    """Return the files that a scene names, except its robot's description."""
    parts = [*scene.file.obstacles, scene.file.load, scene.file.demonstration]
    named = [getattr(part, "file", None) for part in parts if part is not None]
    files = [scene.folder / name for name in named if name is not None]
    source = scene.file.demonstration
    if source is not None and source.library is not None:
        from comove.model.demonstration import library_file  # which loads what reads recordings

        files.append(library_file(scene, source.library))
    return files


def names_files(scene: Scene) -> bool:
    """Return whether a scene names files relative to its folder. A robot's description counts too."""
    robot = scene.file.robot
    return bool(files_of_scene(scene)) or (robot is not None and (scene.folder / robot).is_file())


def command_again(folder: Path, out: str = "../again") -> str | None:
    """Return the command that repeats a result, run in its folder. It is None where none is known."""
    words = listed_inputs(folder).get("command")
    if not isinstance(words, list) or not words or not all(isinstance(word, str) for word in words):
        return None
    return shlex.join(["comove", *words, "--out", out])


def _whole(path: str | Path) -> Path:
    return Path(os.path.abspath(path))


def _inside(path: Path, root: Path) -> str:
    return (Path(FOLDER) / path.relative_to(root)).as_posix()


def _copied(source: Path, folder: Path, place: str) -> dict[str, dict[str, Any]]:
    """Copy a file or folder; return origins and checksums by place."""
    entries: dict[str, dict[str, Any]] = {}
    with telling(source, "copied", ResultError):
        found = sorted(path for path in source.rglob("*") if path.is_file()) if source.is_dir() else [source]
        size = sum(path.stat().st_size for path in found)
        small = size <= MOST
        if not small:
            message = (
                f"{source}: {size / 2**20:.0f} MB are not copied into the result; keep them to make it again"
            )
            warnings.warn(message, ComoveWarning, stacklevel=4)
        for path in found:
            name = (PurePosixPath(place) / path.relative_to(source).as_posix()).as_posix()
            entries[name] = {"from": str(path), "sha256": _sha256(path)} | (
                {} if small else {"copied": False}
            )
            if small:
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copyfile(path, folder / name)
    return entries


def _sha256(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()

"""The scenes that a page can show: one that is named, the one of a result, or the examples."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from comove.errors import ComoveWarning, ResultError
from comove.io.folders import require_folder
from comove.results.solution import SCENE
from comove.scenes.scene import Scene


@dataclass(frozen=True)
class Shelf:
    """The scenes that a page can show.

    Attributes
    ----------
    scenes : files by name
    first : name of the one that is shown first
    folder : folder that the save buttons write into
    result : result folder whose motion is shown; None where one is searched
    """

    scenes: Mapping[str, Path]
    first: str
    folder: Path
    result: Path | None = None


def shelf_of(path: Path | None, folder: Path) -> Shelf:
    """Return the scenes for a page.

    Parameters
    ----------
    path
        Scene file, or result folder; the examples of the package without.
    folder
        Folder that the save buttons write into.

    Raises
    ------
    SceneError
        If the file is no scene.
    ResultError
        If the folder is no result, or does not hold its scene.
    """
    if path is None:
        examples = sorted(Path(str(files("comove") / "examples")).glob("*.yaml"))
        return Shelf({example.stem: example for example in examples}, "narrow", folder)
    if not path.is_dir():
        read_scene(path)  # a mistake in it is told before a page is opened
        return Shelf({path.stem: path}, path.stem, folder)
    scene = require_folder(path, "comove solve SCENE --out DIR") / SCENE
    if not scene.is_file():
        raise ResultError(
            "the folder does not say which scene was solved", file=path, way_out="name the scene file instead"
        )
    read_scene(scene)
    return Shelf({path.name: scene}, path.name, folder, path)


def read_scene(path: Path) -> Scene:
    """Read a scene, without the warnings that who wrote it has seen.

    Raises
    ------
    SceneError
        If the file is no scene.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ComoveWarning)
        return Scene.load(path)

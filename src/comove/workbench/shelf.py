"""What a page can show: a scene that is named, what stands in a result folder, or the examples."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum
from importlib.resources import files
from pathlib import Path

from comove.errors import ComoveWarning, ResultError
from comove.io.folders import require_folder
from comove.results.solution import SCENE
from comove.scenes.scene import Scene


class PlayedPart(Enum):
    """A part of a result folder that is played; its value is the name of the file that tells of it."""

    MOTION = "solution.json"
    JOINTS = "robot.json"
    RUN = "run.json"
    SIMULATION = "simulation.json"


WORDS = {
    PlayedPart.MOTION: "the hands",
    PlayedPart.JOINTS: "the robot",
    PlayedPart.RUN: "the run",
    PlayedPart.SIMULATION: "the simulation",
}


@dataclass(frozen=True)
class Item:
    """Something that a page can show.

    Attributes
    ----------
    scene : file of the scene
    result : result folder whose motion is shown; None where one is searched
    part : what of the folder is played
    """

    scene: Path
    result: Path | None = None
    part: PlayedPart = PlayedPart.MOTION


@dataclass(frozen=True)
class Shelf:
    """The things that a page can show.

    Attributes
    ----------
    items : scenes and results by name
    first : name of the one that is shown first
    folder : folder that the save buttons write into
    """

    items: Mapping[str, Item]
    first: str
    folder: Path

    @property
    def item(self) -> Item:
        """Return what is shown first."""
        return self.items[self.first]


def shelf_of(path: Path | None, folder: Path) -> Shelf:
    """Return what a page can show.

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
        return Shelf({example.stem: Item(example) for example in examples}, "narrow", folder)
    if not path.is_dir():
        read_scene(path)  # a mistake in it is told before a page is opened
        return Shelf({path.stem: Item(path)}, path.stem, folder)
    scene = require_folder(path, "comove solve SCENE --out DIR") / SCENE
    if not scene.is_file():
        raise ResultError(
            "the folder does not say which scene was solved", file=path, way_out="name the scene file instead"
        )
    read_scene(scene)
    items = {WORDS[part]: Item(scene, path, part) for part in parts_of(path)}
    return Shelf(items, next(iter(items)), folder)


def parts_of(folder: Path) -> tuple[PlayedPart, ...]:
    """Return what of a result folder can be played, best first.

    Raises
    ------
    ResultError
        If it holds nothing of the kind.
    """
    found = tuple(part for part in reversed(PlayedPart) if (folder / part.value).is_file())
    if not found:
        raise ResultError(
            f"it holds no {PlayedPart.MOTION.value} and no {PlayedPart.RUN.value}",
            file=folder,
            way_out="name a folder of comove solve, robot solve or run",
        )
    return found


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

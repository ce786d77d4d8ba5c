"""Items that a page can show: scenes, result folders, or examples."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

from comove import stored
from comove.errors import ComoveWarning, OptionError, ResultError
from comove.model.scene import Scene
from comove.results.reference import SCENE
from comove.stored import ResultPart


@dataclass(frozen=True)
class Item:
    """Item that a page can show.

    Attributes
    ----------
    scene : file of the scene
    result : result folder whose motion is shown; None where one is searched
    part : shown part of the folder
    """

    scene: Path
    result: Path | None = None
    part: ResultPart = ResultPart.MOTION

    def absolute(self) -> Item:
        """Return the item with absolute paths, for other processes."""
        result = None if self.result is None else self.result.absolute()
        return Item(self.scene.absolute(), result, self.part)


@dataclass(frozen=True)
class Shelf:
    """List of items that a page can show.

    Attributes
    ----------
    items : scenes and results by name
    first : name of the one that is shown first
    folder : folder of saved files
    beside : name of the one that is shown beside it at first; None for none
    """

    items: Mapping[str, Item]
    first: str
    folder: Path
    beside: str | None = None

    @property
    def item(self) -> Item:
        """Return the item that is shown first."""
        return self.items[self.first]

    @property
    def comparable(self) -> Mapping[str, Item]:
        """Return the items that can be shown beside, by label. These are all named ones, but no examples."""
        if self.beside is None and (len(self.items) == 1 or self.item.result is None):
            return {}
        return {self.label(name): item for name, item in self.items.items()}

    def label(self, name: str) -> str:
        """Return an item's label, which differs from methods' names."""
        return f"{'scene' if self.items[name].result is None else 'stored'}: {name}"


def shelf_of(paths: Sequence[Path], folder: Path) -> Shelf:
    """Return the items that a page can show.

    Parameters
    ----------
    paths
        Scene files and result folders, the first to be shown with the second beside it; without, the examples of the
        package.
    folder
        Folder of saved files.

    Raises
    ------
    SceneError
        If a file is no scene.
    ResultError
        If a folder is no result, or does not hold its scene.
    OptionError
        If something is named twice.
    """
    if not paths:
        examples = sorted(Path(str(files("comove") / "examples")).glob("*.yaml"))
        return Shelf({example.stem: Item(example) for example in examples}, "narrow", folder)
    found = [_items_in(path) for path in paths]
    if len(found) == 1:
        return Shelf(found[0], next(iter(found[0])), folder)
    items: dict[str, Item] = {}
    firsts = []
    for name, parts in zip(_names_of(paths), found, strict=True):
        named = {name if len(parts) == 1 else f"{name}, {part}": item for part, item in parts.items()}
        firsts.append(next(iter(named)))
        items |= named
    return Shelf(items, firsts[0], folder, firsts[1])


def _items_in(path: Path) -> dict[str, Item]:
    """Return the items in a scene file or folder, best first."""
    if not path.is_dir():
        read_scene(path)  # a mistake in it is told before a page is opened
        return {path.stem: Item(path)}
    parts, scene = parts_of(path), path / SCENE
    if not scene.is_file():
        raise ResultError(
            "the folder does not say which scene was solved", file=path, way_out="name the scene file instead"
        )
    read_scene(scene)
    return {part.words: Item(scene, path, part) for part in parts}


def _names_of(paths: Sequence[Path]) -> list[str]:
    """Return short names of files and folders. They are whole paths where short names are equal."""
    whole = [path.resolve() for path in paths]
    twice = [path for path, count in zip(paths, map(whole.count, whole), strict=True) if count > 1]
    if twice:
        raise OptionError(f"{twice[0]} is named twice", way_out="name two different scenes or results")
    short = [path.name if path.is_dir() else path.stem for path in whole]
    times = Counter(short)
    return [str(path) if times[name] > 1 else name for path, name in zip(paths, short, strict=True)]


def parts_of(folder: Path) -> tuple[ResultPart, ...]:
    """Return the playable parts of a result folder, best first.

    Raises
    ------
    ResultError
        If it holds none.
    """
    return tuple(reversed(stored.parts_of(folder)))


def read_scene(source: Path | dict[str, Any], folder: str | Path | None = None) -> Scene:
    """Read a scene without warnings.

    Parameters
    ----------
    source : file of the scene, or contents of such a file, whose paths are relative to `folder`

    Raises
    ------
    SceneError
        If the file is no scene.
    """
    with warnings.catch_warnings(action="ignore", category=ComoveWarning):
        return Scene.load(source) if isinstance(source, Path) else Scene.from_dict(source, folder=folder)

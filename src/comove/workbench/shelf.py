"""The scenes that a page can show: one that is named, the one of a result, or the examples."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path

from comove.errors import ResultError
from comove.io.folders import require_folder
from comove.results.solution import SCENE
from comove.scenes.scene import Scene
from comove.workbench.session import Shelf


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
        If the folder holds no scene.
    """
    if path is None:
        examples = sorted(Path(str(files("comove") / "examples")).glob("*.yaml"))
        return Shelf({example.stem: example for example in examples}, "narrow", folder)
    if path.is_dir():
        require_folder(path, "comove solve SCENE --out DIR")
        if not (path / SCENE).is_file():
            raise ResultError(
                "the folder does not say which scene was solved",
                file=path,
                way_out="name the scene file instead",
            )
        path = path / SCENE
    Scene.load(path)  # a mistake in it is told before a page is opened
    return Shelf({path.stem: path}, path.stem, folder)

"""Saving of files inside the folder of the workbench, atomically."""

from __future__ import annotations

import re
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from comove.errors import OptionError, ResultError
from comove.io.files import whole_file
from comove.model.files.keys import SceneFile
from comove.model.files.upgrade import as_text, has_poses, written
from comove.model.scene import Scene
from comove.results.inputs import names_files
from comove.view.workbench.edits import Contents
from comove.view.workbench.teaching import Taught, csv_of

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}")
WORDS = "letters, digits, '-', '_' and '.', beginning with a letter or digit"


def target_in(folder: Path, name: object, suffix: str = "") -> Path:
    """Return the path of a new file or folder in `folder`. `suffix` is added to the name where it is missing.

    Raises
    ------
    OptionError
        If the name has other characters than a plain name, or the path is a link.
    """
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise OptionError(f"{str(name)[:80]!r} is no plain name", key="name", way_out=f"write {WORDS}")
    path = folder / (name.removesuffix(suffix) + suffix)
    if path.is_symlink() or path.parent.resolve() != folder.resolve():
        raise OptionError(
            f"{path.name} is a link to another place", key="name", way_out="choose another name"
        )
    return path


def scene_text(contents: Contents) -> str:
    """Return a scene file as YAML, without defaults. It has version 2 where a payload has poses."""
    import yaml

    file = SceneFile.model_validate(contents)
    if has_poses(file):
        return as_text(written(file))
    plain: dict[str, Any] = {"version": file.version} | file.model_dump(mode="json", exclude_defaults=True)
    return yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, default_flow_style=None, width=110)


def save_scene(contents: Contents, path: Path, source: Path, taught: Taught | None = None) -> None:
    """Write a new scene file that reads back to the same scene.

    Parameters
    ----------
    source : folder to which paths in the scene are relative
    taught : drawn recording, which is written beside it and is the scene's demonstration

    Raises
    ------
    ResultError
        If the scene names files and goes elsewhere, or the file cannot be written or exists already.
    SceneError
        If the contents are no scene.
    """
    if taught is not None:
        contents = {**contents, "demonstration": None}
    scene = Scene.from_dict(contents, folder=source)
    if names_files(scene) and source.resolve() != path.parent.resolve():
        raise ResultError(
            "the scene names files beside it, which it would not find from here",
            file=path,
            way_out=f"start comove view in {source}",
        )
    with ExitStack() as both:
        if taught is not None:
            recording = path.with_suffix(".csv")
            contents = {**contents, "demonstration": {"file": recording.name}}
            both.enter_context(whole_file(recording, ResultError, replace=False)).write(csv_of(taught))
        both.enter_context(whole_file(path, ResultError, replace=False)).write(scene_text(contents).encode())

"""Reading of scene files: YAML, the models, the checks across keys, and one message for all errors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from comove.io.folders import scene_folder
from comove.io.messages import explained, scene_error
from comove.io.yaml_reader import Lines, read_yaml
from comove.scenes.checks import cross_checked, warn_of_what_is_odd
from comove.scenes.model import CONTRACT, SceneFile


def load_scene_file(path: str | Path, changes: Mapping[str, Any] | None = None) -> SceneFile:
    """Read and check the scene file at `path`, with the values in `changes` in place of the file's.

    Raises
    ------
    SceneError
        One message that names file, key, line, value and correction of the first three errors.
    """
    data, lines = read_yaml(path)
    data = _changed(data, changes or {})
    folder = scene_folder(Path(path))
    return parse_scene(data, folder=folder, file=path, lines=lines, is_stored=folder != Path(path).parent)


def _changed(data: Any, changes: Mapping[str, Any]) -> Any:
    """Return data with other values under some keys; mappings are merged."""
    if not isinstance(data, dict):
        return data  # which is refused in words
    merged = {k: _changed(data.get(k) or {}, v) if isinstance(v, Mapping) else v for k, v in changes.items()}
    return data | merged


def parse_scene(
    data: dict[str, Any],
    *,
    folder: str | Path | None = None,
    file: str | Path | None = None,
    lines: Lines | None = None,
    is_stored: bool = False,
) -> SceneFile:
    """Check a scene given as plain data.

    Parameters
    ----------
    data
        The contents of a scene file; arrays are taken as lists.
    folder
        The folder to which paths in the scene are relative; where None, files are not looked for.
    file, lines
        The source of the data, for messages; `lines` as :func:`comove.io.yaml_reader.read_yaml` returns them.
    is_stored
        Whether it is the scene of a result, whose demonstration need not be there.

    Raises
    ------
    SceneError
        One message that names file, key, line, value and correction of the first three errors.
    """
    try:
        scene = SceneFile.model_validate(data)
    except ValidationError as error:
        flaws = explained(error, data, CONTRACT)
    else:
        flaws = cross_checked(scene, Path(folder) if folder is not None else None, is_stored=is_stored)
    if flaws:
        raise scene_error(flaws, file, lines or {})
    warn_of_what_is_odd(scene, file)
    return scene

"""What was named where something else is wanted: errors that say what it is, and what to do with it.

They are looked for only where a path was refused, so that no command reads more than it needs.
"""

from __future__ import annotations

import os
import shlex
from enum import Enum
from itertools import count
from pathlib import Path
from typing import Any

from comove.errors import InputError, ResultError
from comove.io.folders import listed_inputs
from comove.io.yaml_reader import near_files, read_yaml

SCENE = "scene.json"  # of a result folder
SCENES = (".yaml", ".yml", ".json")


class PathKind(Enum):
    """A kind of file or folder; the value describes it."""

    SCENE = "a scene"
    ROBOT = "the description of a robot"
    STUDY = "a study"
    RESULT = "a result folder"
    PART = "a file in a result folder"
    FILE = "a file"
    FOLDER = "a folder"
    NOTHING = "nothing"


def kind_of(path: Path) -> PathKind:
    """Return what a path is."""
    if os.path.isdir(path):  # unlike Path's, it takes any name
        return PathKind.RESULT if listed_inputs(path) else PathKind.FOLDER
    if not os.path.exists(path):
        return PathKind.NOTHING
    data = _contents(path)
    if listed_inputs(path.parent) and (path.name == SCENE or "workspace" not in data):
        return PathKind.PART
    if {"models", "arms"} <= set(data):
        return PathKind.ROBOT
    if "workspace" in data:
        return PathKind.SCENE
    return PathKind.STUDY if isinstance(data.get("scene"), str) else PathKind.FILE


def no_result_folder(path: Path, made_by: str) -> ResultError:
    """Return the error that a path is no folder of results.

    Parameters
    ----------
    made_by : command that makes such a folder from SCENE, if it names one, and calls it DIR
    """
    kind = kind_of(path)
    if kind is PathKind.NOTHING:
        return ResultError("there is no such folder", file=path, way_out=f"make it by: {made_by}")
    if kind is PathKind.SCENE:
        way_out = f"solve it, and name the folder that is made: {_command(path, made_by)}"
    elif kind is PathKind.PART:
        way_out = f"name the folder: {path.parent}"
    else:
        way_out = f"name a folder that is made by: {made_by}"
    wanted = "the folder" if kind is PathKind.PART else "a result folder"
    return ResultError(f"it is {kind.value}, not {wanted}", file=path, way_out=way_out)


def no_result_in(folder: Path, missing: str) -> ResultError:
    """Return the error that files of a result are missing."""
    why, way_out = f"it holds no {missing}", "name a folder of comove solve or comove run"
    scenes = [path for path in sorted(folder.glob("*.y*ml")) if kind_of(path) is PathKind.SCENE]
    if scenes:
        why = "it holds scenes, and no result"
        way_out = f"solve one, and name the folder that is made: {_command(scenes[0])}"
    return ResultError(why, file=folder, way_out=way_out)


def misnamed(path: Path, wanted: PathKind) -> tuple[str, str] | None:
    """Return why a refused file is wrong, and what to do.

    It is None where the file may be of the kind.

    Parameters
    ----------
    wanted : a scene, a robot's description or a study
    """
    kind = kind_of(path)
    way_out = _way_to_scene(path, kind) if wanted is PathKind.SCENE else ""
    if kind is PathKind.SCENE and wanted is PathKind.ROBOT:
        robot = _contents(path).get("robot")
        way_out = f"name its robot: {robot}" if isinstance(robot, str) else "name a robot or its description"
    if kind is PathKind.SCENE and wanted is PathKind.STUDY:
        way_out = f"write a study of it, with the keys name, 'scene: {path.name}' and episodes"
    return (f"it is {kind.value}, not {wanted.value}", way_out) if way_out else None


def _way_to_scene(path: Path, kind: PathKind) -> str:
    """Return which scene to name instead of something else; empty where that is not known."""
    scene = (path if os.path.isdir(path) else path.parent) / SCENE
    if kind is PathKind.RESULT or (kind is PathKind.PART and path.name != SCENE):
        return f"name its scene: {scene}" if scene.is_file() else "name the scene that was solved"
    if kind is PathKind.ROBOT:
        return f"make a scene for it: comove robot scene {shlex.quote(str(path))} --out scene.yaml"
    if kind is PathKind.STUDY:
        return f"name its scene: {path.parent / str(_contents(path)['scene'])}"
    if kind is PathKind.FILE and path.is_file() and path.suffix.lower() not in SCENES and not _contents(path):
        return f"name a scene (YAML); {near_files(path.parent, path.name, SCENES[:2])}"
    return ""


def _command(scene: Path, made_by: str = "comove solve SCENE --out DIR") -> str:
    """Return a command that makes a new folder of a scene."""
    if "robot" in _contents(scene):
        made_by = made_by.replace(" --robot NAME", "")
    names = (scene.stem if n == 1 else f"{scene.stem}-{n}" for n in count(1))
    folder = next(name for name in names if not Path(name).exists())
    return made_by.replace("SCENE", shlex.quote(str(scene))).replace("DIR", shlex.quote(folder))


def _contents(path: Path) -> dict[str, Any]:
    """Return the mapping that a file holds; empty where it holds none."""
    try:
        return read_yaml(path)[0] if path.is_file() else {}  # what a pipe held is gone
    except (InputError, OSError):
        return {}

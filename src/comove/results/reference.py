"""The scene for verifying a stored result: a trusted one, or its own.

A result may not loosen its own verification. Values that a trusted scene leaves open are therefore not read from the
folder: limits that it leaves out are the documented ones where its duration is open, else none. Only an open duration
is that of the result, and of several grasps its own is used.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comove.errors import ComoveWarning, InputError, ResultError
from comove.io.folders import require_folder, scene_folder
from comove.model.files.keys import PayloadPose
from comove.model.scene import Scene
from comove.results.sealed import AGAIN, Summary, read_json

SCENE = "scene.json"
SCENE_BYTES = 2**24  # of scene.json
MESHES_IN = (
    "robot.json",
    "meshes_in",
)  # file and entry that say where the meshes of the folder's own scene are


@dataclass(frozen=True, eq=False)
class Reference:
    """The scene that a stored result is verified against.

    Attributes
    ----------
    scene : the scene
    file : its file
    is_own : whether it is the folder's own, and so not trusted
    """

    scene: Scene
    file: Path
    is_own: bool

    def __str__(self) -> str:
        if self.is_own:
            return f"the folder's own scene, {self.file}"
        return f"the scene '{self.scene.name}'" if self.scene.path is None else f"{self.file}"

    def for_result(self, folder: Path, summary: Summary) -> Reference:
        """Return the reference with a result's open values; see `filled_in`."""
        return Reference(filled_in(self.scene, folder, summary), self.file, self.is_own)


def reference_of(folder: Path, scene: Scene | None = None) -> Reference:
    """Return the scene that the result in a folder is verified against.

    Parameters
    ----------
    scene : a trusted scene; the folder's own unless given

    Raises
    ------
    ResultError
        If none is given, and the folder holds none that can be read.
    """
    if scene is not None:
        return Reference(scene, scene.path or scene.folder / "scene", False)
    return Reference(own_scene(folder), folder / SCENE, True)


def own_scene(folder: Path) -> Scene:
    """Return the scene that a result folder holds.

    Raises
    ------
    ResultError
        If there is none, or it cannot be read.
    """
    path = require_folder(folder, "comove solve SCENE --out DIR") / SCENE
    if not path.is_file():
        raise ResultError(
            "the folder does not say which scene was solved",
            file=folder,
            way_out="name the scene as well: comove verify SCENE DIR",
        )
    data = read_json(path, AGAIN, SCENE_BYTES)
    try:
        with warnings.catch_warnings():  # what there is to warn of was said when it was solved
            warnings.simplefilter("ignore", ComoveWarning)
            if scene_folder(path) != folder:  # where what it was made from is kept
                return Scene.load(path)
            return Scene.from_dict(data, folder=_folder_of_meshes(folder, data))
    except InputError as error:
        raise ResultError(str(error), file=path, way_out=AGAIN) from error


def _folder_of_meshes(folder: Path, data: dict[str, Any]) -> Path | None:
    """Return the folder of the meshes of a folder's own scene.

    It is None if the scene names none: nothing else is read from a folder, and the demonstration may be gone.
    """
    obstacles = data.get("obstacles")
    parts = [*(obstacles if isinstance(obstacles, list) else []), data.get("load")]
    if not any(isinstance(part, dict) and part.get("shape") == "mesh" for part in parts):
        return None
    file, key = MESHES_IN
    if (folder / file).is_file():
        named = read_json(folder / file, AGAIN).get(key)
        if isinstance(named, str) and Path(named).is_dir():
            return Path(named)
    return folder


def filled_in(scene: Scene, folder: Path, summary: Summary) -> Scene:
    """Return the scene with documented limits, the result's duration, and its grasp.

    Raises
    ------
    ResultError
        If the duration is open and the result does not state it.
    """
    hasty = scene.file.objective is not None and scene.file.objective.type == "least_time"
    if hasty or not scene.is_timed:
        path = folder / SCENE
        try:
            duration = _positive(read_json(path, AGAIN, SCENE_BYTES)["duration"])
        except (ValueError, TypeError, KeyError, ResultError) as error:
            why = error.message if isinstance(error, ResultError) else str(error)
            raise ResultError(
                f"the scene leaves its duration open, and the result does not say it: {why}",
                file=path,
                way_out=AGAIN,
            ) from error
        scene = scene.with_limits().timed(duration)
    solved = summary.get("scene_sha256")
    return next((choice for choice in scene.ways_to(_goal_in(folder)) if choice.sha256 == solved), scene)


def _goal_in(folder: Path) -> PayloadPose | None:
    """Return the payload's goal pose in a result's own scene, or None."""
    try:
        load = read_json(folder / SCENE, AGAIN, SCENE_BYTES)["load"]
        goal = load["goal"]
        return PayloadPose(position=tuple(goal["position"]), quaternion_wxyz=tuple(goal["quaternion_wxyz"]))
    except (ValueError, TypeError, KeyError, ResultError):  # the folder is not trusted
        return None


def changes_to(scene: Scene, folder: Path, summary: Summary, file: Path) -> dict[str, float]:
    """Return the changes of duration and limits that make the solved scene.

    There are none if the scene, read from `file`, is the solved one, or if no such changes lead to it.
    """
    solved = summary.get("scene_sha256")
    if scene.sha256 == solved:
        return {}
    try:
        found = read_json(folder / SCENE, AGAIN, SCENE_BYTES)
        limits = found.get("limits") or {}
        limits = {
            key: limits.get(key) for key, own in scene.file.limits if limits.get(key) not in (None, own)
        }
        changes: dict[str, Any] = {"limits": limits} if limits else {}
        if found.get("duration") not in (None, scene.file.duration):
            changes["duration"] = found["duration"]
        if Scene.load(file, changes).sha256 != solved:
            return {}
    except (ValueError, TypeError, AttributeError, InputError):  # the folder is not trusted
        return {}
    return {key: value for key, value in changes.items() if key != "limits"} | limits


def _positive(value: object) -> float:
    if not isinstance(value, (int, float)) or not 0 < value < math.inf:
        raise ValueError(f"{value!r} is not a positive number")
    return float(value)

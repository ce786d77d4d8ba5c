"""Obstacles from other files: MoveIt planning scenes, URDF, and MJCF.

A file becomes entries of the scene's list of obstacles, with names. Readers that need a robot's or a simulator's
libraries are loaded by name, when a scene needs one.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator

from comove.errors import InputError, SceneError, near_name, shortened
from comove.geometry.rotations import matrices, quaternion_of_rotation
from comove.io.keys import MAX_NAME, UNTURNED, Part, Quaternion, Vector, as_tuple

READERS = {
    "moveit": "comove.model.files.moveit.obstacles_in",
    "urdf": "comove.robots.urdf_surroundings.obstacles_in",
    "mjcf": "comove.sim.mjcf.obstacles_in",
}
"""Functions that read the obstacles of a file, given its path, by the shape that names them in a scene."""

Names = Annotated[tuple[str, ...], BeforeValidator(as_tuple)]


class ImportedObstacles(Part):
    """The obstacles of another `file`, whose frame is at `center` [m].

    For spatial scenes only. `moveit` is a planning scene, in MoveIt's text format (.scene) or a bag of ROS 2; `urdf`
    and `mjcf` are models, whose collision bodies are placed with all joints at 0, or as the model starts.
    """

    shape: Literal["moveit", "urdf", "mjcf"]
    file: str
    center: Vector = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = UNTURNED
    leave_out: Names = ()
    """Names in the file of what becomes no obstacle."""
    supports: Names = ()
    """Names in the file, or in the scene, of that on which the payload may rest."""

    def obstacles(self, folder: Path, file: object, key: str) -> list[dict[str, Any]]:
        """Return the obstacles as entries of a scene.

        `file` and `key` are for messages. Readers give the path of a mesh's file, unless it is in their own.

        Raises
        ------
        SceneError
            If the file cannot be read, or holds a shape that no obstacle has.
        """
        module, _, reader = READERS[self.shape].rpartition(".")
        try:
            found = self._chosen(getattr(import_module(module), reader)(folder / self.file))
        except InputError as error:
            where = "" if error.key is None else f"{error.key}: "
            message = f"'{self.file}': {where}{error.message}"
            raise SceneError(message, file=file, key=key, way_out=error.way_out) from None
        turn = matrices(np.array(self.quaternion_wxyz))
        for entry in found:
            own = matrices(np.array(entry.get("quaternion_wxyz", UNTURNED)))
            entry["center"] = (np.array(self.center) + turn @ entry["center"]).tolist()
            if entry["shape"] != "sphere":
                entry["quaternion_wxyz"] = quaternion_of_rotation(turn @ own).tolist()
            if entry["shape"] == "mesh":
                path = entry.get("file", folder / self.file)
                entry["file"] = Path(os.path.relpath(path, folder)).as_posix()
        return found

    def _chosen(self, given: list[dict[str, Any]]) -> list[dict[str, Any]]:
        """Return the entries that become obstacles. They have their names in the scene."""
        own = dict.fromkeys(entry.get("name", "") for entry in given)
        _require_known("leave_out", self.leave_out, own)
        kept, names = list[dict[str, Any]](), dict[str, int]()
        for entry in given:
            there = entry.get("name", "")
            if there in self.leave_out:
                continue
            if "refused" in entry:
                raise entry["refused"]
            stem = re.sub(r"[^\w+-]+", "_", there).strip("_+-")[: MAX_NAME - 10] or self.shape
            names[stem] = names.get(stem, 0) + 1
            name = stem if names[stem] == 1 else f"{stem}_{names[stem]}"
            support = {"support": True} if {there, name} & {*self.supports} else {}
            kept.append(entry | {"name": name} | support)
        _require_known("supports", self.supports, own | dict.fromkeys(entry["name"] for entry in kept))
        return kept


def _require_known(key: str, given: Iterable[str], known: Mapping[str, None]) -> None:
    """Refuse names that nothing in the file has."""
    for name in given:
        if name not in known:
            raise SceneError(f"it holds no '{shortened(name)}'", key=key, way_out=near_name(name, known))

"""Obstacles from other files: MoveIt planning scenes, URDF, and MJCF.

A file becomes entries of the scene's list of obstacles, with names. Readers that need a robot's or a simulator's
libraries are loaded by name, when a scene needs one.
"""

from __future__ import annotations

import os
import re
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np

from comove.errors import InputError, SceneError
from comove.geometry.rotations import matrices, quaternion_of_rotation
from comove.io.keys import MAX_NAME, UNTURNED, Part, Quaternion, Vector

READERS = {
    "moveit": "comove.model.files.moveit.obstacles_in",
    "urdf": "comove.robots.urdf_surroundings.obstacles_in",
    "mjcf": "comove.sim.mjcf.obstacles_in",
}
"""Functions that read the obstacles of a file, given its path, by the shape that names them in a scene."""


class ImportedObstacles(Part):
    """The obstacles of another `file`, whose frame is at `center` [m].

    For spatial scenes only. `moveit` is a planning scene in MoveIt's text format (.scene), `urdf` and `mjcf` are
    models, whose collision bodies are placed with all joints at 0, or as the model starts.
    """

    shape: Literal["moveit", "urdf", "mjcf"]
    file: str
    center: Vector = (0.0, 0.0, 0.0)
    quaternion_wxyz: Quaternion = UNTURNED

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
            found = getattr(import_module(module), reader)(folder / self.file)
        except InputError as error:
            where = "" if error.key is None else f"{error.key}: "
            message = f"'{self.file}': {where}{error.message}"
            raise SceneError(message, file=file, key=key, way_out=error.way_out) from None
        turn, names = matrices(np.array(self.quaternion_wxyz)), dict[str, int]()
        for entry in found:
            own = matrices(np.array(entry.get("quaternion_wxyz", UNTURNED)))
            entry["center"] = (np.array(self.center) + turn @ entry["center"]).tolist()
            if entry["shape"] != "sphere":
                entry["quaternion_wxyz"] = quaternion_of_rotation(turn @ own).tolist()
            stem = re.sub(r"[^\w+-]+", "_", entry.get("name", "")).strip("_+-")[: MAX_NAME - 10] or self.shape
            names[stem] = names.get(stem, 0) + 1
            entry["name"] = stem if names[stem] == 1 else f"{stem}_{names[stem]}"
            if entry["shape"] == "mesh":
                path = entry.get("file", folder / self.file)
                entry["file"] = Path(os.path.relpath(path, folder)).as_posix()
        return found

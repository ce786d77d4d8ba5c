"""The parts of a result folder, each of which is verified and played by itself."""

from __future__ import annotations

from enum import Enum
from pathlib import Path

from comove.errors import ResultError
from comove.io.folders import require_folder


class Part(Enum):
    """A part of a result folder, with the name of its summary, and what it is called."""

    MOTION = "solution.json", "the hands"
    JOINTS = "robot.json", "the robot"
    RUN = "run.json", "the run"
    ROBOT_RUN = "robot_run.json", "the robot's run"
    SIMULATION = "simulation.json", "the simulation"

    def __init__(self, file: str, words: str):
        self.file, self.words = file, words


ARRAYS = {Part.JOINTS: "joints.npz"}
"""Further files that show that a part is there, so that it is not passed over where its summary was removed."""


def parts_of(folder: Path) -> tuple[Part, ...]:
    """Return the parts of a result folder.

    Raises
    ------
    ResultError
        If it holds none, or there is no such folder.
    """
    require_folder(folder, "comove solve SCENE --out DIR")
    found = tuple(
        part
        for part in Part
        if (folder / part.file).is_file() or (part in ARRAYS and (folder / ARRAYS[part]).is_file())
    )
    if not found:
        raise ResultError(
            f"it holds no {Part.MOTION.file} and no {Part.RUN.file}",
            file=folder,
            way_out="name a folder of comove solve, robot solve or run",
        )
    return found

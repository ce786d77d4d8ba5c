"""The file format of the Baxter SDK's ``joint_trajectory_file_playback.py``.

Its parser accepts only this header and rows of numbers: a comment, a blank line, an empty cell or a space stops it or
silently drops a joint. The program moves slowly to the first row, then sends positions only, and sets the grippers at
20 Hz according to the rows.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comove.errors import near_name
from comove.export.parts import ExportError, MotionPart
from comove.export.tables import write_table

SIDES = ("left", "right")
JOINTS = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
ARMS = {side: tuple(f"{side}_{joint}" for joint in JOINTS) for side in SIDES}
HEADER = ["time", *(name for side in SIDES for name in (*ARMS[side], f"{side}_gripper"))]


def write_baxter(path: Path, part: MotionPart, rate: float) -> None:
    """Write a part for the Baxter SDK: seconds, radians and the grippers' opening in per cent, 0 closed."""
    samples = part.samples(rate)
    opening = part.opening(samples.time)[:, None]
    arms = [block for side in SIDES for block in (samples.position[:, part.columns(ARMS[side])], opening)]
    write_table(path, HEADER, np.column_stack([samples.time, *arms]))


def require_baxter(part: MotionPart) -> None:
    """Refuse robots that are not a Baxter.

    Raises
    ------
    ExportError
        If the moving joints are not those of Baxter's two arms.
    """
    found, wanted = part.joints.joint_names, [*ARMS["left"], *ARMS["right"]]
    missing = [name for name in wanted if name not in found]
    strange = [name for name in found if name not in wanted]
    if missing:
        message = (
            f"the robot '{part.provenance.robot}' has no joint '{missing[0]}', and the file is for a Baxter"
        )
        raise ExportError(message, key="format", way_out="choose another format, csv for example")
    if strange:
        message = f"the robot '{part.provenance.robot}' has a joint '{strange[0]}' that a Baxter has not"
        raise ExportError(message, key="format", way_out=near_name(strange[0], wanted))

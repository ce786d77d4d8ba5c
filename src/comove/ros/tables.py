"""Motions as tables of CSV, NPZ and the Baxter SDK.

The parser of the SDK's ``joint_trajectory_file_playback.py`` accepts only its header and rows of numbers: a comment,
a blank line, an empty cell or a space stops it or silently drops a joint. The program moves slowly to the first row,
then sends positions only, and sets the grippers at 20 Hz according to the rows.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from comove.errors import ExportError, near_name
from comove.ros.parts import MotionPart

SIDES = ("left", "right")
JOINTS = ("s0", "s1", "e0", "e1", "w0", "w1", "w2")
ARMS = {side: tuple(f"{side}_{joint}" for joint in JOINTS) for side in SIDES}
HEADER = ["time", *(name for side in SIDES for name in (*ARMS[side], f"{side}_gripper"))]
KINDS = ("position", "velocity", "acceleration")


def write_csv(path: Path, part: MotionPart, rate: float) -> None:
    """Write a part as CSV.

    The columns are ``time`` [s], then ``JOINT.position``, ``JOINT.velocity``, ``JOINT.acceleration`` [rad, s] of each
    joint.
    """
    samples = part.samples(rate)
    header = ["time", *(f"{joint}.{kind}" for joint in part.joints.joint_names for kind in KINDS)]
    table = np.stack([getattr(samples, kind) for kind in KINDS], axis=-1)
    write_table(path, header, np.column_stack([samples.time, table.reshape(len(table), -1)]))


def write_npz(path: Path, part: MotionPart, rate: float) -> None:
    """Write a part as NPZ.

    The arrays are ``time (T,)``, ``joint_names (N,)``, ``position``, ``velocity`` and ``acceleration (T, N)``.

    Every entry of the provenance is a scalar array of text.
    """
    samples = part.samples(rate)
    arrays: dict[str, Any] = {"time": samples.time, "joint_names": np.array(samples.joint_names)}
    arrays |= {kind: getattr(samples, kind) for kind in KINDS}
    arrays |= {key: np.array(value) for key, value in part.provenance.asdict().items()}
    with open(path, "wb") as file:
        np.savez(file, **arrays)


def write_table(path: Path, header: list[str], table: np.ndarray) -> None:
    """Write a table as CSV without comments, blank lines or spaces. Numbers read back bit by bit."""
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(",".join(header) + "\n")
        file.writelines(",".join(map(repr, row)) + "\n" for row in table.tolist())


def write_baxter(path: Path, part: MotionPart, rate: float) -> None:
    """Write a part for the Baxter SDK. Times are in seconds, joints in radians, the grippers' opening in per cent, 0
    closed."""
    samples = part.samples(rate)
    opening = part.opening(samples.time)[:, None]
    arms = [block for side in SIDES for block in (samples.of(ARMS[side]).position, opening)]
    write_table(path, HEADER, np.column_stack([samples.time, *arms]))


def require_baxter(part: MotionPart) -> None:
    """Refuse robots that are not a Baxter."""
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

"""Motions as plain tables: CSV for programs that read text, NPZ for NumPy."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comove.export.parts import MotionPart

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
    with open(path, "wb") as file:
        np.savez(
            file,
            time=samples.time,
            joint_names=np.array(part.joints.joint_names),
            **{kind: getattr(samples, kind) for kind in KINDS},
            **{key: np.array(value) for key, value in part.provenance.asdict().items()},
        )


def write_table(path: Path, header: list[str], table: np.ndarray) -> None:
    """Write a table as CSV; numbers are written so that they read back bit by bit, without comments, blank lines
    or spaces.
    """
    with open(path, "w", encoding="ascii", newline="\n") as file:
        file.write(",".join(header) + "\n")
        file.writelines(",".join(map(repr, row)) + "\n" for row in table.tolist())

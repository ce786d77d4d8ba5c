"""Export formats, and atomic writing of all files of an export."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from comove.errors import ExportError
from comove.io.files import whole_file, whole_path
from comove.io.folders import Contents, whole_folder
from comove.robots.transfers import Transfers
from comove.robots.verification.verify import VerifiedJointMotion
from comove.ros.bags import require_rosbags, write_mcap, write_moveit, write_rosbag1, write_rosbag2
from comove.ros.parts import (
    CARRY,
    SAMPLE_RATE,
    MotionPart,
    parts_of,
    require_rate,
)
from comove.ros.tables import require_baxter, write_baxter, write_csv, write_npz


def _nothing(part: MotionPart) -> None:
    """Accept any part, since the format requires nothing."""


@dataclass(frozen=True)
class ExportFormat:
    """A file format that a motion can be exported to.

    Attributes
    ----------
    name : name of the format for users
    what : programs that read it
    suffix : suffix of the file; empty if the format is a folder
    write : function of path, part and rate [Hz] that writes the file
    require : function of a part that raises an error if the format cannot hold it, or lacks a library
    carry, others : names of the files, in which the part's name replaces the braces
    sidecar : whether provenance is written into a file of its own, as the format has no place for it
    """

    name: str
    what: str
    suffix: str
    write: Callable[[Path, MotionPart, float], None]
    require: Callable[[MotionPart], None] = _nothing
    carry: str = "motion"
    others: str = "motion_{}"
    sidecar: bool = False

    def path(self, folder: Path, part: str) -> Path:
        """Return the path to which a part is written."""
        stem = self.carry if part == CARRY else self.others.format(part)
        return folder / f"{stem}{self.suffix}"


BAXTER_CSV = ExportFormat(
    name="baxter-csv",
    what="the Baxter SDK's joint_trajectory_file_playback.py",
    suffix=".csv",
    write=write_baxter,
    require=require_baxter,
    carry="baxter",
    others="{}",
    sidecar=True,
)
CSV = ExportFormat("csv", "spreadsheets and scripts", ".csv", write_csv, sidecar=True)
NPZ = ExportFormat("npz", "NumPy", ".npz", write_npz)
ROSBAG1 = ExportFormat("rosbag1", "ROS 1", ".bag", write_rosbag1, require_rosbags)
ROSBAG2 = ExportFormat("rosbag2", "ROS 2", "", write_rosbag2, require_rosbags)
MCAP = ExportFormat("mcap", "ROS 2 and Foxglove", ".mcap", write_mcap, require_rosbags)
MOVEIT = ExportFormat(
    "moveit", "RViz and MoveIt", ".mcap", write_moveit, require_rosbags, carry="moveit", others="moveit_{}"
)
FORMATS = {format.name: format for format in (BAXTER_CSV, CSV, NPZ, ROSBAG1, ROSBAG2, MCAP, MOVEIT)}


def usual_format(motion: VerifiedJointMotion) -> ExportFormat:
    """Return the default format for a motion's robot. It is that of Baxter's SDK for a Baxter, else CSV."""
    (carry,) = parts_of(motion).values()
    try:
        BAXTER_CSV.require(carry)
    except ExportError:
        return CSV
    return BAXTER_CSV


def export(
    motion: VerifiedJointMotion,
    folder: str | Path,
    format: ExportFormat | None = None,
    *,
    rate: float = SAMPLE_RATE,
    transfers: Transfers | None = None,
) -> list[Path]:
    """Write a verified motion to files of a format.

    Parameters
    ----------
    motion : verified motion; no other is accepted
    folder : folder of the files, made if missing; files already in it are kept
    format : one of `FORMATS`; `usual_format` unless given
    rate : samples per second [Hz], at least 20
    transfers : approach and release, written as files of their own

    Returns
    -------
    list of the files and folders written, the carry first

    Raises
    ------
    ExportError
        If the motion is not verified, the rate is too low, the robot does not fit the format, or a file exists
        already. Nothing is written then.
    """
    parts = parts_of(motion, transfers)
    format = format or usual_format(motion)
    check_export(motion, folder, format, rate=rate, parts=parts)
    for part in parts.values():
        format.require(part)
    folder = Path(folder)
    targets, sidecars = _paths(folder, format, parts)
    with _all_or_none(folder) as (drafts, made):
        for name, part in parts.items():
            draft = drafts.enter_context(_draft(targets[name], format))
            format.write(draft, part, rate)
            made[targets[name]] = draft.stat().st_ino
            if name in sidecars:
                file = drafts.enter_context(whole_file(sidecars[name], ExportError, replace=False))
                told = {**part.provenance.asdict(), "rate_hz": rate, "duration_s": part.joints.duration}
                file.write((json.dumps(told, indent=2) + "\n").encode())
                made[sidecars[name]] = os.fstat(file.fileno()).st_ino
    return [*targets.values(), *sidecars.values()]


def check_export(
    motion: VerifiedJointMotion,
    folder: str | Path,
    format: ExportFormat | None = None,
    *,
    rate: float = SAMPLE_RATE,
    parts: Iterable[str] = (CARRY,),
) -> None:
    """Raise the errors of `export` before approach and release are planned.

    Parameters
    ----------
    motion, folder, format, rate : as for `export`
    parts : names of the motions to be exported
    """
    (carry,) = parts_of(motion).values()
    format = format or usual_format(motion)
    require_rate(motion, rate)
    format.require(carry)
    targets, sidecars = _paths(Path(folder), format, parts)
    for path in (*targets.values(), *sidecars.values()):
        if path.exists() or path.is_symlink():
            raise ExportError(
                "it is there already", file=path, way_out="name another folder, or move it away first"
            )


def _paths(
    folder: Path, format: ExportFormat, parts: Iterable[str]
) -> tuple[dict[str, Path], dict[str, Path]]:
    """Return the paths of parts and of their sidecars, by name."""
    targets = {name: format.path(folder, name) for name in parts}
    return targets, {name: Path(f"{path}.json") for name, path in targets.items() if format.sidecar}


@contextlib.contextmanager
def _all_or_none(folder: Path) -> Iterator[tuple[contextlib.ExitStack, dict[Path, int]]]:
    """Yield a stack of drafts and the inodes of written paths. The folder is made if it is missing. After an error,
    all that was written and made is removed. The inode distinguishes a path from a file of the same name that
    another process may have made meanwhile."""
    made: dict[Path, int] = {}
    missing = not folder.exists()
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExportError(
            f"it cannot be made: {error.strerror}", file=folder, way_out="name a folder that you may write"
        ) from error
    try:
        with contextlib.ExitStack() as drafts:
            yield drafts, made
    except BaseException:
        for path, inode in made.items():
            with contextlib.suppress(OSError):
                if path.lstat().st_ino == inode:
                    shutil.rmtree(path) if path.is_dir() else path.unlink()
        if missing:
            with contextlib.suppress(OSError):
                folder.rmdir()
        raise


def _draft(path: Path, format: ExportFormat) -> contextlib.AbstractContextManager[Path]:
    return (
        whole_path(path, ExportError, replace=False)
        if format.suffix
        else whole_folder(path, Contents("bag", error=ExportError))
    )

"""What readers and writers of recordings share: paths, sizes, whole files or none, and belonging together."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from comove.demonstrations.demonstration import Demonstration
from comove.errors import DemonstrationError

_MEGABYTE = 2**20


def existing_file(path: str | os.PathLike[str], max_bytes: int, way_out: str) -> Path:
    """Return `path` if it is a file of at most `max_bytes`; `way_out` says what to do with a larger one.

    Raises
    ------
    DemonstrationError
        It is missing, a folder, no regular file, or too large.
    """
    path = Path(path)
    with telling(path):
        if not path.exists():
            raise DemonstrationError(
                "there is no such file", file=path, way_out=f"check the path (relative to {Path.cwd()})"
            )
        if not path.is_file():
            what = "a folder" if path.is_dir() else "not a regular file"
            raise DemonstrationError(f"it is {what}", file=path, way_out="name the file that was recorded")
        size = path.stat().st_size
    if size > max_bytes:
        limit = max_bytes / _MEGABYTE
        raise DemonstrationError(
            f"it has {size / _MEGABYTE:.0f} MB, more than the {limit:.0f} MB that are read",
            file=path,
            way_out=way_out,
        )
    return path


@contextlib.contextmanager
def telling(path: Path, doing: str = "read") -> Iterator[None]:
    """Tell a failure of the file system as a `DemonstrationError` that names `path`."""
    try:
        yield
    except OSError as error:
        raise DemonstrationError(
            f"it cannot be {doing}: {error.strerror or error}",
            file=path,
            way_out="check the path, and that you may use it",
        ) from error


@contextlib.contextmanager
def whole_file(path: str | os.PathLike[str]) -> Iterator[IO[Any]]:
    """Open `path` for writing bytes; it appears, or replaces what was there, only when all went well.

    Raises
    ------
    DemonstrationError
        The folder is missing or not writable, or `path` is a folder.
    """
    path = Path(path)
    with telling(path, "written"):
        if path.exists() and not path.is_file():
            raise DemonstrationError(
                "it is there already and is no file", file=path, way_out="choose another name"
            )
        draft = path.with_name(f".{path.name}.{os.getpid()}.part")
        try:
            with open(draft, "wb") as file:
                yield file
            os.replace(draft, path)
        finally:
            draft.unlink(missing_ok=True)


def together(
    demos: Demonstration | Mapping[str, Demonstration], file: str | os.PathLike[str]
) -> dict[str, Demonstration]:
    """Return movements by manipulator after checking that one file can hold them.

    A single `Demonstration` has the name "".

    Raises
    ------
    DemonstrationError
        There are none, one of several has no name, or they differ in time stamps or dimensions.
    """
    demos = {"": demos} if isinstance(demos, Demonstration) else dict(demos)
    if not demos:
        raise DemonstrationError("there is no movement to write", file=file, way_out="give one at least")
    first_name, first = next(iter(demos.items()))
    for name, demo in demos.items():
        if len(demos) > 1 and not name:
            raise DemonstrationError(
                f"one of {len(demos)} manipulators has no name", file=file, way_out="name all of them"
            )
        if not np.array_equal(demo.time, first.time) or demo.n_dims != first.n_dims:
            raise DemonstrationError(
                f"{name!r} differs from {first_name!r} in its time stamps or dimensions",
                file=file,
                way_out="bring both to the same duration and resampled(n_steps), or write a file for each",
            )
    return demos

"""What readers and writers of files share: paths, sizes, whole files or none; and belonging together."""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import shutil
import threading
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import IO, Any

import numpy as np

from comove.demonstrations.demonstration import Demonstration
from comove.errors import DemonstrationError, InputError

MAX_ROWS = 2_000_000
"""Samples that are read from one file."""
_MEGABYTE = 2**20
_EVEN_SHARE = 1e-3
"""How far stamps may lie from even ones, in steps, where a format knows only a rate."""


def existing_file(
    path: str | os.PathLike[str], max_bytes: int, way_out: str, error: type[InputError] = DemonstrationError
) -> Path:
    """Return `path` if it is a file of at most `max_bytes`; `way_out` says what to do with a larger one.

    Raises
    ------
    error
        It is missing, a folder, no regular file, or too large.
    """
    path = Path(path)
    with telling(path, error=error):
        if not path.exists():
            raise error(
                "there is no such file", file=path, way_out=f"check the path (relative to {Path.cwd()})"
            )
        if not path.is_file():
            what = "a folder" if path.is_dir() else "not a regular file"
            raise error(f"it is {what}", file=path, way_out="name the file itself")
        size = path.stat().st_size
    if size > max_bytes:
        limit = max_bytes / _MEGABYTE
        raise error(
            f"it has {size / _MEGABYTE:.0f} MB, more than the {limit:.0f} MB that are read",
            file=path,
            way_out=way_out,
        )
    return path


@contextlib.contextmanager
def telling(path: Path, doing: str = "read", error: type[InputError] = DemonstrationError) -> Iterator[None]:
    """Tell a failure of the file system as an `error` that names `path`."""
    try:
        yield
    except OSError as failure:
        raise error(
            f"it cannot be {doing}: {failure.strerror or failure}",
            file=path,
            way_out="check the path, and that you may use it",
        ) from failure


def extra(module: str, file: object) -> ModuleType:
    """Import a library that only some formats need, when one of them is used.

    Raises
    ------
    DemonstrationError
        It is not installed; says the command.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        name = module.partition(".")[0]
        raise DemonstrationError(
            f"its kind needs {name}, which is not installed",
            file=file,
            way_out="run: pip install 'comove[data]'",
        ) from error


@contextlib.contextmanager
def whole_file(
    path: str | os.PathLike[str], error: type[InputError] = DemonstrationError, *, replace: bool = True
) -> Iterator[IO[Any]]:
    """Open `path` for writing bytes; as `whole_path`."""
    with whole_path(path, error, replace=replace) as draft, open(draft, "wb") as file:
        yield file


@contextlib.contextmanager
def whole_path(
    path: str | os.PathLike[str], error: type[InputError] = DemonstrationError, *, replace: bool = True
) -> Iterator[Path]:
    """Lend a path to write a file at; it becomes `path` only when all went well and the disk holds it.

    Parameters
    ----------
    replace : replace a file that is there already; otherwise it is refused, whoever made it meanwhile

    Raises
    ------
    error
        The folder is missing or not writable, or `path` is a folder or may not be replaced.
    """
    path = Path(path)
    with telling(path, "written", error):
        if path.exists() and not path.is_file():
            raise error("it is there already and is no file", file=path, way_out="choose another name")
        draft = _draft(path, error)
        try:
            yield draft
            with open(draft, "rb+") as file:
                os.fsync(file.fileno())
            if replace:
                os.replace(draft, path)
            else:
                _claim(draft, path, error)
        finally:
            draft.unlink(missing_ok=True)


def _draft(path: Path, error: type[InputError]) -> Path:
    """A path beside `path` that no other process or thread takes."""
    draft = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}.part")
    try:
        draft.lstat()
    except ValueError as failure:  # a zero byte, or what is no character
        raise error(
            f"it cannot name a file: {failure}", file=path, way_out="choose another name"
        ) from failure
    except OSError:  # not there yet
        pass
    return draft


def _claim(draft: Path, path: Path, error: type[InputError]) -> None:
    """Give the draft its name, unless somebody else was first."""
    try:
        try:
            os.link(draft, path)
        except FileExistsError:
            raise
        except OSError:  # a file system without links
            open(path, "xb").close()
            os.replace(draft, path)
    except FileExistsError as failure:
        raise error(
            "it is there already", file=path, way_out="choose another name, or replace it"
        ) from failure


@contextlib.contextmanager
def whole_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Lend a path to write a folder at; it becomes `path` only when all went well.

    Raises
    ------
    DemonstrationError
        There is something at `path` already, other than an empty folder, or it cannot be written.
    """
    path = Path(path)
    with telling(path, "written"):
        if path.exists() and not (path.is_dir() and not any(path.iterdir())):
            raise DemonstrationError("it is there already", file=path, way_out="choose another name")
        if not path.parent.is_dir():
            raise DemonstrationError(
                f"there is no folder {path.parent}", file=path, way_out="check the path, or make the folder"
            )
        draft = _draft(path, DemonstrationError)
        try:
            yield draft
            if path.exists():
                path.rmdir()
            os.replace(draft, path)
        finally:
            shutil.rmtree(draft, ignore_errors=True)


def one_of(episodes: Sequence[str], episode: str | int | None, prefix: str, file: object) -> list[str]:
    """Return the names to read: all, or the one that was asked for by its name or its number.

    Raises
    ------
    DemonstrationError
        There is no such episode; lists them.
    """
    if episode is None:
        return list(episodes)
    for name in (str(episode), f"{prefix}{episode}"):
        if name in episodes:
            return [name]
    shown = ", ".join(episodes[:20]) + (f" and {len(episodes) - 20} more" if len(episodes) > 20 else "")
    raise DemonstrationError(
        f"there is no episode {episode!r}", file=file, key="episode", way_out=f"known: {shown}"
    )


def as_episodes(
    episodes: Sequence[Demonstration | Mapping[str, Demonstration]], file: object
) -> list[dict[str, Demonstration]]:
    """Return each episode as movements by manipulator, after checking that one file can hold them.

    Raises
    ------
    DemonstrationError
        There are none, movements of one episode do not belong together, or episodes differ in what they hold.
    """
    if isinstance(episodes, Demonstration | Mapping):
        episodes = [episodes]
    if not episodes:
        raise DemonstrationError("there is no episode to write", file=file, way_out="give one at least")
    episodes = [together(episode, file) for episode in episodes]
    kinds = [[(name, demo.n_dims, demo.orientation is None) for name, demo in e.items()] for e in episodes]
    for index, kind in enumerate(kinds):
        if kind != kinds[0]:
            raise DemonstrationError(
                f"episode {index} differs from episode 0 in its manipulators or their coordinates",
                file=file,
                way_out="write a file for each kind",
            )
    return episodes


def even_rate(demo: Demonstration, file: object) -> float:
    """Return the rate [Hz] of a movement whose stamps a format leaves out.

    Raises
    ------
    DemonstrationError
        Its time does not pass in even steps.
    """
    rate = (demo.n_steps - 1) / demo.duration
    if math.isclose(rate, round(rate, 3), rel_tol=1e-9):
        rate = round(rate, 3)
    off = np.abs(demo.time * rate - np.arange(demo.n_steps))
    if off.max() > _EVEN_SHARE:
        row = int(off.argmax())
        raise DemonstrationError(
            f"time[{row}] of {demo.name or 'the movement'} is {demo.time[row]:.6g} s, which is no even step at "
            f"{rate:.6g} Hz",
            file=file,
            way_out="the format keeps a rate and no stamps: write demonstration.resampled(n_steps)",
        )
    return rate


def together(demos: Demonstration | Mapping[str, Demonstration], file: object) -> dict[str, Demonstration]:
    """Return movements by manipulator after checking that one file can hold them.

    A single `Demonstration` has the name "".

    Raises
    ------
    DemonstrationError
        There are none, one of several has no name, or they differ in time stamps or dimensions, or only some have
        orientations.
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
        if (demo.orientation is None) != (first.orientation is None):
            raise DemonstrationError(
                f"only one of {name!r} and {first_name!r} has orientations",
                file=file,
                way_out="give orientations to all or to none, or write a file for each",
            )
    return demos

"""Checks of paths, sizes and free space, and atomic writing."""

from __future__ import annotations

import contextlib
import errno
import importlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import IO, Any

from comove.errors import DemonstrationError, ExtraError, InputError
from comove.io import drafts

ROOM = 100_000
"""What must be free on a disk before anything is begun whose result goes there [bytes]."""
_MEGABYTE = 2**20
_POINTERS = {
    b"version https://git-lfs.github.com/spec/": ("Git LFS", "git lfs pull"),
    b"/annex/objects/": ("git-annex", "git annex get ."),
}
"""How files begin that stand for others, the tool that wrote them, and its command that fetches the others."""


def existing_file(
    path: str | os.PathLike[str], max_bytes: int, way_out: str, error: type[InputError] = DemonstrationError
) -> Path:
    """Return `path` if it is a file of at most `max_bytes`. `way_out` is the advice for a larger one.

    Raises
    ------
    error
        If it is missing, a folder, not a regular file, or too large.
    """
    path = Path(path)
    with telling(path, error=error):
        if not path.exists():
            if path.is_symlink():
                require_content(path, error)
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
    require_content(path, error)
    return path


def require_content(path: Path, error: type[InputError] = DemonstrationError) -> None:
    """Refuse pointer files of Git LFS or git-annex, and HTML pages."""
    with telling(path, error=error):
        if path.is_symlink() and not path.exists():
            head = b"/annex/objects/" if "annex/objects" in os.readlink(path) else b""
        else:
            with open(path, "rb") as file:
                head = file.read(512).lstrip()
    for start, (tool, command) in _POINTERS.items():
        if head.startswith(start):
            raise error(
                f"it is a pointer of {tool}, not the file itself",
                file=path,
                way_out=f"run in its folder: {command}",
            )
    if head[:15].lower().startswith((b"<!doctype html", b"<html")):
        raise error(
            "it is a page of a web site, not the file itself", file=path, way_out="download the raw file"
        )


@contextlib.contextmanager
def telling(path: Path, doing: str = "read", error: type[InputError] = DemonstrationError) -> Iterator[None]:
    """Convert file-system failures to an `error` that names `path`."""
    try:
        yield
    except OSError as failure:
        why, way_out = refusal(failure, path)
        raise error(f"it cannot be {doing}: {why}", file=path, way_out=way_out) from failure
    except ValueError as failure:
        if "\0" in str(path) and "null byte" in str(failure):
            raise error(
                f"it cannot name a file: {failure}", file=path, way_out="choose another name"
            ) from failure
        if not isinstance(failure, UnicodeEncodeError) or _encodable(path, failure.encoding):
            raise
        raise error(
            f"its name has characters that {failure.encoding} lacks",
            file=path,
            way_out="choose another name, or set PYTHONUTF8=1",
        ) from failure


def _encodable(path: Path, encoding: str) -> bool:
    try:
        os.path.abspath(path).encode(encoding)
        return True
    except UnicodeEncodeError:
        return False


def refusal(failure: OSError, path: Path) -> tuple[str, str]:
    """Return reason and advice for a file-system failure."""
    if failure.errno in (errno.ENOSPC, errno.EDQUOT):
        return f"the disk is full{_free(path)}", "make room there, or name a place on another disk"
    if failure.errno == errno.EFBIG:
        return "it would be larger than this process may write", "raise the limit: ulimit -f unlimited"
    if failure.errno == errno.ENAMETOOLONG:
        return "the name is too long", "choose a shorter one"
    if failure.errno == errno.ELOOP:
        return "links in its path lead round in a circle", "mend or remove them, or name another path"
    if failure.errno == errno.EROFS:
        return "the disk may only be read", "name a place that you may write"
    return failure.strerror or str(failure), "check the path, and that you may use it"


def _free(path: Path) -> str:
    """Return the free disk space in words; empty if ample or unknown."""
    for folder in path.absolute().parents:
        with contextlib.suppress(OSError):
            free = shutil.disk_usage(folder).free
            return f", {free / _MEGABYTE:.1f} MB of it are free" if free < 100 * _MEGABYTE else ""
    return ""


def require_room(path: Path, error: type[InputError] = DemonstrationError, room: int = ROOM) -> None:
    """Check in advance that a draft can be written beside `path`. See `drafts`.

    Parameters
    ----------
    room : space that must be free on the disk [bytes]

    Raises
    ------
    error
        If its folder is missing or not writable, its name is too long, or the disk is full.
    """
    with telling(path, "written", error):
        with contextlib.suppress(FileNotFoundError):
            os.stat(path)
        folder = path.parent
        while not folder.exists():
            folder = folder.parent
        for part in path.relative_to(folder).parts:  # each by itself: the system stops at the first missing
            with contextlib.suppress(FileNotFoundError):
                os.stat(folder / part)
        _try(folder)
        free = shutil.disk_usage(folder).free
    if free < room:
        raise error(
            f"the disk is full: {free / 1000:.0f} kB of it are free, about {room / 1000:.0f} kB are needed",
            file=path,
            way_out="make room there, or name a place on another disk",
        )


def _try(folder: Path) -> None:
    """Make a file in a folder and remove it. Where the system can, the file has no name, so that a killed process
    leaves nothing."""
    with contextlib.suppress(OSError, AttributeError):
        os.close(os.open(folder, os.O_TMPFILE | os.O_RDWR, 0o600))
        return
    os.rmdir(tempfile.mkdtemp(prefix=".comove.", dir=folder))


def extra(module: str, file: object) -> ModuleType:
    """Import a library that only some formats need.

    Raises
    ------
    DemonstrationError
        If it is not installed; the error gives the command to install it.
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


def installed(module: str, what: str, extra: str) -> Any:
    """Import and return a module of an extra of this package.

    Parameters
    ----------
    what : feature that needs it, in words
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ExtraError(what, extra) from error


@contextlib.contextmanager
def whole_file(
    path: str | os.PathLike[str], error: type[InputError] = DemonstrationError, *, replace: bool = True
) -> Iterator[IO[Any]]:
    """Open `path` for writing bytes; see `whole_path`."""
    with whole_path(path, error, replace=replace) as draft, open(draft, "wb") as file:
        yield file


@contextlib.contextmanager
def whole_path(
    path: str | os.PathLike[str], error: type[InputError] = DemonstrationError, *, replace: bool = True
) -> Iterator[Path]:
    """Yield a temporary path, moved to `path` once written completely.

    Parameters
    ----------
    replace : whether to replace an existing file; otherwise an existing file is an error, even one made meanwhile by
        another process

    Raises
    ------
    error
        If the folder is missing or not writable, or `path` is a folder or may not be replaced.
    """
    path = Path(path)
    with telling(path, "written", error):
        require_target(path, error)
        with drafts.draft(path) as folder:
            draft = folder / path.name
            yield draft
            with open(draft, "rb+") as file:
                os.fsync(file.fileno())
            if replace:
                os.replace(draft, path)
            else:
                _claim(draft, path, error)


def require_target(path: Path, error: type[InputError] = DemonstrationError) -> None:
    """Check in advance that a file can be written to `path`.

    Raises
    ------
    error
        If it does not name a file, if a folder or special file has that path, or as in `require_room`.
    """
    with telling(path, "written", error):
        with contextlib.suppress(FileNotFoundError):
            os.lstat(path)
        if not path.name:
            raise error("it names no file", file=path, way_out="give the file a name")
        if path.exists() and not path.is_file():
            raise error("it is there already and is no file", file=path, way_out="choose another name")
        if not path.parent.is_dir():
            raise error(
                f"it cannot be written: there is no folder {path.parent}",
                file=path,
                way_out="check the path, or make the folder",
            )
    require_room(path, error)


def _claim(draft: Path, path: Path, error: type[InputError]) -> None:
    """Move the draft to its path unless a file exists there."""
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

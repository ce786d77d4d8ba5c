"""Folders that are replaced as a whole by a complete draft."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comove.errors import InputError, ResultError
from comove.io import drafts
from comove.io.files import refusal, require_room, telling

FOLDER, LIST = "inputs", "inputs.json"
"""Where a folder keeps what it was made from, and the list of that, whose files belong to the folder."""
LIST_BYTES = 2**26  # of the list
ROOM = 2_000_000
"""What must be free on a disk before anything is begun that is written as a folder [bytes]."""


@dataclass(frozen=True)
class Contents:
    """Description of the files in a kind of folder.

    Attributes
    ----------
    what : name of the kind in messages
    marks : files by which it is recognised, of which one at least is present; where there are none, only a new or
        empty folder is written
    names : all files that may be in such a folder, relative to it
    error : kind of error that is raised
    """

    what: str
    marks: frozenset[str] = frozenset()
    names: frozenset[str] = frozenset()
    error: type[InputError] = ResultError


def check_target(folder: str | Path, contents: Contents) -> Path:
    """Check that a folder may be written; return its resolved path.

    Raises
    ------
    contents.error
        If `folder` is a file, holds other files, or is not writable.
    """
    folder = _resolved(folder, contents.error)
    with telling(folder, "written", contents.error):
        if folder.exists() and not folder.is_dir():
            raise contents.error("it is a file", file=folder, way_out="name a folder")
        if folder.is_dir():
            _require_only(folder, contents)
    require_room(folder, contents.error, ROOM)
    return folder


@contextmanager
def whole_folder(folder: str | Path, contents: Contents) -> Iterator[Path]:
    """Yield a draft that replaces `folder` if no error occurs. Otherwise it is deleted.

    Raises
    ------
    contents.error
        As `check_target`.
    """
    folder = check_target(folder, contents)
    made = [parent for parent in folder.parents if not parent.exists()]
    try:
        with telling(folder, "written", contents.error):
            folder.parent.mkdir(parents=True, exist_ok=True)
            with drafts.draft(folder) as draft:
                yield draft
                if folder.is_dir():
                    _require_only(folder, contents)  # whatever was put there meanwhile
                drafts.put(draft, folder, replace=bool(contents.marks))
    finally:
        for parent in made:
            with suppress(OSError):
                parent.rmdir()


def identity_of(folder: Path) -> int:
    """Return a number that identifies an existing folder, however named."""
    return folder.stat().st_ino


def add_files(folder: str | Path, files: Mapping[str, bytes], identity: int) -> None:
    """Write files into a folder, each atomically, unless it was replaced.

    Parameters
    ----------
    identity : number of the folder by `identity_of`

    Raises
    ------
    ResultError
        If they cannot be written.
    """
    folder = _resolved(folder, ResultError)
    with telling(folder, "written", ResultError), drafts.draft(folder) as draft:
        for name, data in files.items():
            (draft / name).write_bytes(data)
        for name in files if identity_of(folder) == identity else ():
            (draft / name).replace(folder / name)


def require_folder(folder: str | Path, made_by: str) -> Path:
    """Return an existing folder, after completing an interrupted replacement.

    Raises
    ------
    ResultError
        If there is none; the message says what it is, and names the command that makes one.
    """
    folder = Path(folder)
    with telling(folder, error=ResultError):
        if not folder.is_dir() and not drafts.finish(_resolved(folder, ResultError)):
            from comove.io.kinds import no_result_folder

            raise no_result_folder(folder, made_by)
    return folder


def _resolved(folder: str | Path, error: type[InputError]) -> Path:
    """Return the path with links resolved."""
    try:
        return Path(folder).resolve()
    except (OSError, RuntimeError, ValueError) as failure:
        why, way_out = str(failure), "name a folder"
        if isinstance(failure, RuntimeError):  # how Python 3.11 and 3.12 tell of a circle of links
            failure = OSError(errno.ELOOP, os.strerror(errno.ELOOP))
        if isinstance(failure, OSError):
            why, way_out = refusal(failure, Path(folder))
        raise error(f"it cannot be written: {why}", file=folder, way_out=way_out) from failure


def listed_inputs(folder: Path) -> dict[str, Any]:
    """Return the content of a folder's input list; empty if unreadable."""
    try:
        if (folder / LIST).stat().st_size > LIST_BYTES:
            return {}
        found = json.loads((folder / LIST).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def scene_folder(path: Path) -> Path:
    """Return the folder to which a scene file's paths are relative. It is the file's own folder, or that of the
    copies in a result."""
    place = listed_inputs(path.parent).get("scene") if path.name == "scene.json" else None
    if not isinstance(place, str) or Path(place).parts[:1] != (FOLDER,) or ".." in Path(place).parts:
        return path.parent
    return path.parent / Path(place).parent


def _require_only(folder: Path, contents: Contents) -> None:
    """Refuse a folder that cannot be replaced without loss."""
    what, names = contents.what, {entry.name for entry in folder.iterdir()}
    if names and not names & contents.marks:
        why, way_out = f"the folder is not empty and holds no {what}", "name another or empty it"
    elif other := _other_file(folder, names, contents):
        why = f"besides a {what} the folder holds '{other}'"
        way_out = "name another folder or move that away"
    elif os.path.ismount(folder):
        why = "it is a mount point, which cannot be replaced as a whole"
        way_out = f"name a folder in it, such as {folder / 'result'}"
    elif folder == Path.cwd():
        why = "it is the folder that you are in, and would be replaced as a whole"
        way_out = "name a folder in it"
    elif not os.access(folder, os.W_OK | os.X_OK):
        why, way_out = "you may not write it", "name a folder that you may write"
    else:
        return
    raise contents.error(why, file=folder, way_out=way_out)


def _other_file(folder: Path, names: set[str], contents: Contents) -> str | None:
    """Return the first file that does not belong to the folder's kind. Return None where there is none."""
    inputs = listed_inputs(folder).get("files") if contents.marks else None
    listed = {name for name in inputs if name.startswith(f"{FOLDER}/")} if isinstance(inputs, dict) else set()
    own = contents.names | ({LIST, *listed} if listed else set())
    known = own | {str(parent) for name in own for parent in Path(name).parents}
    others = names - known  # and only if there are none, which need not be looked through, those below
    others = others or {path.relative_to(folder).as_posix() for path in folder.rglob("*")} - known
    return min(others, default=None)

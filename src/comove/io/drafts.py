"""Atomic replacement of files and folders through drafts.

A draft is a hidden folder beside its target, moved there as a whole when it is complete. Its writer holds a lock on
it, which the system releases when the writer dies. So the next writer recognises abandoned drafts and removes them.

Where the system can exchange two folders (Linux), the target is at every instant the complete old or the complete
new one. Elsewhere the old one is renamed first; a writer that dies in between leaves both, and `finish` completes
the replacement.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import functools
import hashlib
import importlib
import os
import secrets
import shutil
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import TypeVar

from comove.errors import ComoveWarning, InputError

fcntl: ModuleType | None
try:
    fcntl = importlib.import_module("fcntl")
except ImportError:  # no Unix: drafts of writers that died stay
    fcntl = None

PART, OLD = ".part", ".old"
_NOW, _EXCHANGE = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of Linux
IN_THE_WAY = (errno.EEXIST, errno.ENOTEMPTY)
_UNKNOWN = (errno.ENOSYS, errno.EINVAL, errno.ENOTSUP)  # to the kernel, or to the file system
_ATTEMPTS = 1000
_GAP, _LONG = 10.0, 86400.0  # s, that nobody takes between two renames, or to write a draft

T = TypeVar("T")


@contextlib.contextmanager
def draft(target: Path) -> Iterator[Path]:
    """Yield an empty folder beside `target`. It is removed with its content when the context ends."""
    tidy(target)
    path, lock = _any_path(target), None
    try:
        while (lock := _made(path)) is None:  # inside, as a signal may come once there is a folder
            path = _any_path(target)
        yield path
    finally:
        try:
            shutil.rmtree(path, ignore_errors=True)
        except BaseException:  # of a signal, while it was being removed
            shutil.rmtree(path, ignore_errors=True)
            raise
        if lock is not None:
            os.close(lock)


def put(draft: Path, target: Path, *, replace: bool = True) -> None:
    """Rename the folder `draft` to `target`, as a whole. The former target is then at the path of `draft`, or
    removed. Unless `replace`, a target that is no empty folder stays, and the error's number is one of `IN_THE_WAY`.
    """
    settle(draft)
    for _ in range(_ATTEMPTS):
        try:
            os.rename(draft, target)  # onto nothing, or onto an empty folder
            return
        except OSError as failure:
            if failure.errno not in IN_THE_WAY or not replace:
                raise
        with contextlib.suppress(FileNotFoundError):  # somebody took the target away: once more
            if exchanged(draft, target) or _stepped_aside(draft, target):
                return
    raise OSError(errno.EBUSY, os.strerror(errno.EBUSY), str(target))


def exchanged(first: Path, second: Path) -> bool:
    """Exchange two folders atomically; return False if the system cannot."""
    rename = _renameat2()
    if rename is None:
        return False
    if rename(_NOW, os.fsencode(first), _NOW, os.fsencode(second), _EXCHANGE) == 0:
        return True
    code = ctypes.get_errno()
    if code in _UNKNOWN:
        return False
    raise OSError(code, os.strerror(code), str(second))


@functools.cache
def _renameat2() -> Callable[..., int] | None:
    """Return the system call `renameat2`, or None if there is none."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError, TypeError):
        return None
    rename.argtypes = [ctypes.c_int, ctypes.c_char_p, ctypes.c_int, ctypes.c_char_p, ctypes.c_uint]
    return rename


def _stepped_aside(draft: Path, target: Path) -> bool:
    """Replace the target by two renames; return False if it reappeared. A writer that dies between the two renames
    leaves the work to `finish`."""
    old = draft.with_suffix(OLD)
    try:
        os.rename(target, old)
        os.rename(draft, target)
        return True
    except OSError as failure:
        if failure.errno not in IN_THE_WAY:
            raise
        return False
    finally:
        with contextlib.suppress(OSError):  # another writer's is there by now
            if old.exists() and not os.path.lexists(target):
                os.rename(old, target)
        if os.path.lexists(target):
            shutil.rmtree(old, ignore_errors=True)


def finish(target: Path) -> bool:
    """Complete an interrupted replacement of `target`, with a warning. The former writer died between its two
    renames. Return whether there was a replacement to complete."""
    for old in _beside(target, OLD):
        part = old.with_suffix(PART)
        with contextlib.suppress(OSError), _held(part, wait=True, abandoned_after=_GAP) as held:
            if held and old.exists() and not os.path.lexists(target):
                os.rename(part, target)
                shutil.rmtree(old, ignore_errors=True)
                warnings.warn(
                    f"{target}: whoever replaced this folder was cut off before the end; that has been made up for, "
                    "the folder is the new one",
                    ComoveWarning,
                    stacklevel=3,
                )
                return True
    return False


def steadily(folder: Path, read: Callable[[], T]) -> T:
    """Return `read()` of a folder, repeated while the folder is replaced."""
    for _ in range(_ATTEMPTS):
        before = _identity(folder)
        try:
            found = read()
        except InputError:
            if _identity(folder) == before:
                raise
            continue
        if _identity(folder) == before:
            return found
    raise OSError(errno.EBUSY, os.strerror(errno.EBUSY), str(folder))


def _identity(folder: Path) -> tuple[int, ...] | None:
    """Return a value that changes when the folder is replaced. It is None if the folder does not exist."""
    try:
        found = os.stat(folder)
    except (OSError, ValueError):
        return None
    return found.st_dev, found.st_ino, found.st_ctime_ns


def tidy(target: Path) -> None:
    """Remove the drafts of `target` whose writers died."""
    finish(target)
    for part in _beside(target, PART):
        with contextlib.suppress(OSError), _held(part, abandoned_after=_LONG) as held:
            if held:
                shutil.rmtree(part, ignore_errors=True)
    for old in _beside(target, OLD):
        if not old.with_suffix(PART).exists():
            shutil.rmtree(old, ignore_errors=True)


def _beside(target: Path, suffix: str) -> list[Path]:
    """Return the existing drafts of `target`, from all processes."""
    prefix = _prefix(target)
    with contextlib.suppress(OSError):
        return [
            target.with_name(name)
            for name in sorted(os.listdir(target.parent))
            if name.startswith(prefix) and name.endswith(suffix)
        ]
    return []


def _prefix(target: Path) -> str:
    """Return the prefix of draft names, short even for long targets."""
    return f".{target.name[:40]}.{hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]}."


def _any_path(target: Path) -> Path:
    """Return a random path for a draft of `target`."""
    return target.with_name(f"{_prefix(target)}{secrets.token_hex(4)}{PART}")


def _made(path: Path) -> int | None:
    """Make a draft; return its lock, or None after a collision."""
    try:
        path.mkdir()
    except FileExistsError:
        return None
    with contextlib.suppress(FileNotFoundError):  # taken for one that was left
        lock = os.open(path, os.O_RDONLY)
        with contextlib.suppress(OSError):  # a file system without locks
            _lock(lock, wait=True)
        if _is(lock, path):
            return lock
        os.close(lock)
    return None


@contextlib.contextmanager
def _held(path: Path, *, abandoned_after: float, wait: bool = False) -> Iterator[bool]:
    """Yield whether this process has locked an abandoned draft.

    That is, whether the draft exists and its writer no longer does.

    Parameters
    ----------
    abandoned_after : age [s] after which a draft counts as abandoned, on file systems without locks
    wait : whether to wait for the lock
    """
    try:
        lock = os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        yield False
        return
    try:
        try:
            _lock(lock, wait=wait)
        except BlockingIOError:
            yield False
        except OSError:
            yield time.time() - os.fstat(lock).st_ctime > abandoned_after
        else:
            yield _is(lock, path)
    finally:
        os.close(lock)


def _lock(number: int, *, wait: bool) -> None:
    """Lock an open folder. Raise `OSError` if another process holds the lock, or locks are not supported."""
    if fcntl is None:
        raise OSError(errno.ENOSYS, os.strerror(errno.ENOSYS))
    fcntl.flock(number, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))


def _is(number: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(number), os.stat(path))
    except FileNotFoundError:
        return False


def settle(draft: Path) -> None:
    """Flush the whole content of a draft to the disk."""
    for folder, _, names in os.walk(draft, topdown=False):
        for name in names:
            _synchronise(os.path.join(folder, name))
        with contextlib.suppress(OSError):  # not all file systems know this of folders
            _synchronise(folder)


def _synchronise(path: str) -> None:
    number = os.open(path, os.O_RDONLY)
    try:
        os.fsync(number)
    finally:
        os.close(number)

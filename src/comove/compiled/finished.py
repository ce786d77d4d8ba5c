"""Records of jobs whose kernels are all compiled, beside compiled functions.

A record holds for one installation: one version of Python, of numba and of the sources, and one kind of processor.
Where records cannot be written, or compiled functions are lost, functions are compiled when they are first called.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path

import llvmlite.binding as llvm
import numba
from numba.core import config

import comove
from comove.compiled.cache import KernelCache

FILE = "comove_kernels.{}.json"  # by installation; one stays


def finished() -> frozenset[str]:
    """Return the names of the finished jobs; none where no note can be read."""
    try:
        noted = json.loads(_file().read_text(encoding="utf-8"))
        return frozenset(map(str, noted["finished"])) if noted["sources"] == _sources() else frozenset()
    except (OSError, ValueError, TypeError, KeyError):
        return frozenset()


def finish(*names: str) -> None:
    """Note that something has been compiled completely."""
    with suppress(OSError, TypeError):
        file = _file()
        file.parent.mkdir(parents=True, exist_ok=True)
        draft = file.with_suffix(f".{os.getpid()}")
        noted = {"sources": _sources(), "finished": sorted(finished() | {*names})}
        draft.write_text(json.dumps(noted), encoding="utf-8")
        draft.replace(file)


@cache
def folder() -> Path | None:
    """Return the folder of compiled functions; None where they cannot be kept."""
    path = KernelCache(finished, "entry")._cache_path
    return None if path is None else Path(path)


@cache
def _kind() -> tuple[str, ...]:
    return sys.version, numba.__version__, llvm.get_host_cpu_name(), llvm.get_host_cpu_features().flatten()


def _file() -> Path:
    digest = hashlib.sha256(repr((_kind(), config.OPT)).encode()).hexdigest()[:16]  # type: ignore[attr-defined]
    return folder() / FILE.format(digest)  # type: ignore[operator]  # a `TypeError` where there is none


@cache
def _sources() -> str:
    """Return a checksum of the sources' modification times and sizes."""
    found = sorted(_stats(str(Path(comove.__file__).parent)))
    return hashlib.sha256(repr(found).encode()).hexdigest()


def _stats(path: str) -> Iterator[tuple[str, int, int]]:
    for entry in os.scandir(path):
        if entry.is_dir() and entry.name != "__pycache__":
            yield from _stats(entry.path)
        elif entry.name.endswith(".py"):
            stat = entry.stat()
            yield entry.path, stat.st_mtime_ns, stat.st_size

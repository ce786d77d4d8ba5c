"""Limit of linear algebra to one thread. On small matrices, threads wait for each other longer than they compute."""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

MAPS = Path("/proc/self/maps")  # files that this process has loaded, on Linux
NAMES = tuple(product(("", "scipy_"), ("", "64_")))  # what builds put before and after OpenBLAS's names


class _Library(NamedTuple):
    """Loaded OpenBLAS library: getter and setter of its number of threads."""

    get: Callable[[], int]
    set: Callable[[int], None]


class _Limit:
    """One-thread limit of this process, shared by nested and parallel uses."""

    def __init__(self) -> None:
        self.lock, self.users = threading.Lock(), 0
        self.before: list[tuple[_Library, int]] = []

    def begin(self) -> None:
        """Limit the libraries, unless they are limited already."""
        with self.lock:
            self.users += 1
            if self.users == 1:
                self.before = [(library, library.get()) for library in _libraries(len(sys.modules))]
                for library, _ in self.before:
                    library.set(1)

    def end(self) -> None:
        """Restore the former numbers of threads with the last use."""
        with self.lock:
            self.users -= 1
            if self.users == 0:
                for library, n in self.before:
                    library.set(n)


_LIMIT = _Limit()


@contextmanager
def one_blas_thread() -> Iterator[None]:
    """Limit the OpenBLAS of NumPy and SciPy to one thread. In this context results have the same bits on any number
    of cores, and processor time is that of the work: threads that wait for each other spend as much."""
    _LIMIT.begin()
    try:
        yield
    finally:
        _LIMIT.end()


@lru_cache(maxsize=1)
def _libraries(n_modules: int) -> tuple[_Library, ...]:
    """Return the loaded OpenBLAS libraries. Listing them takes milliseconds, so it is repeated only after further
    modules were imported, which may load them."""
    found = list[_Library]()
    for path in sorted(_paths()):
        try:
            library = ctypes.CDLL(path)
        except OSError:
            continue
        for before, after in NAMES:
            name = f"{before}openblas_%s_num_threads{after}"
            if hasattr(library, name % "set"):
                found.append(_Library(getattr(library, name % "get"), getattr(library, name % "set")))
                break
    return tuple(found)


def _paths() -> set[str]:
    """Return the files of the loaded OpenBLAS libraries. Where the system does not list them, return those installed
    beside NumPy."""
    try:
        maps = MAPS.read_text(encoding="utf-8", errors="surrogateescape")
        loaded = {line.split(maxsplit=5)[-1] for line in maps.splitlines() if "openblas" in line.lower()}
    except OSError:
        here = Path(np.__file__).parent
        folders = (here / ".dylibs", here.with_name("numpy.libs"), here.with_name("scipy.libs"))
        loaded = {str(path) for folder in folders for path in folder.glob("*")}
    return {path for path in loaded if "openblas" in Path(path).name.lower()}

"""The cache of compiled numba kernels on disk, made safe against damaged files and folders that cannot be written.

numba keeps compiled functions beside the sources, in the user's cache or in NUMBA_CACHE_DIR. By itself it fails on
a truncated file, on a full disk, and where none of the three folders can be written; it runs machine code that was
damaged; and two processes that compile two signatures of one function at the same time can load each other's code.
Here every file carries a checksum of its contents and its signature: a damaged file is compiled again, and where no
folder can be written comove runs without a cache. The kernels of other packages are left alone.
"""

from __future__ import annotations

import hashlib
import importlib.util
import pickle
import re
import sys
import warnings
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from types import ModuleType
from typing import Any

CACHING = "numba.core.caching"
OURS = "comove."
ALONE = "COMOVE_COMPILE_ALONE"  # environment variable: if set, no other process helps to compile
_ADDRESS = re.compile(r"0x[0-9a-f]+")
_told = False


def guard_kernels() -> None:
    """Make numba store comove's kernels with checksums, now or when numba is imported."""
    if CACHING in sys.modules:
        _guard(sys.modules[CACHING])
    else:
        sys.meta_path.insert(0, _WhenImported())


class _WhenImported(MetaPathFinder):
    """A finder that waits for the import of numba's caching module and guards it once."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname != CACHING:
            return None
        sys.meta_path.remove(self)
        spec = importlib.util.find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def execute_and_guard(module: ModuleType) -> None:
                execute(module)
                _guard(module)

            spec.loader.exec_module = execute_and_guard  # type: ignore[method-assign]
        return spec


def _guard(caching: ModuleType) -> None:
    """Replace numba's functions that begin, load and save a cache by guarded ones."""
    cache, file = caching.FunctionCache, caching.IndexDataCacheFile
    begin, load, save = cache.__init__, cache.load_overload, cache.save_overload

    class Sealed(file):  # type: ignore[misc,valid-type]
        """Cache files whose contents and signature are checked; a file that does not match counts as missing.

        The index has signatures as texts: types themselves would import the modules that define them, so that
        whoever solves a scene would load robots because a robot's planner has the same kernels.
        """

        def load(self, key: Any) -> Any:
            signature = _text(key)
            name = self._load_index().get(signature)
            try:
                with open(self._data_path(name or ""), "rb") as stored:
                    seal, data = stored.read(32), stored.read()
                return pickle.loads(data) if seal == _seal(signature, data) else None
            except OSError:
                return None

        def save(self, key: Any, data: Any) -> None:
            self._sealed_for = _text(key)
            super().save(self._sealed_for, data)

        def _save_data(self, name: str, data: Any) -> None:
            data = self._dump(data)
            with self._open_for_write(self._data_path(name)) as stored:
                stored.write(_seal(self._sealed_for, data) + data)

        def _load_index(self) -> dict:
            try:
                index = super()._load_index()
            except Exception:  # pickle may raise anything on damaged data
                return {}
            return index if all(isinstance(signature, str) for signature in index) else {}

    def begin_guarded(self: Any, py_func: Any) -> None:
        if not py_func.__module__.startswith(OURS):
            begin(self, py_func)
            return
        try:
            begin(self, py_func)
        except RuntimeError:  # no folder can be written
            _tell_once()
            self._name, self._py_func, self._impl = repr(py_func), py_func, None
            self._cache_path, self._cache_file, self._enabled = None, None, False
            return
        self._cache_file = Sealed(self._cache_path, self._impl.filename_base, self._cache_file._source_stamp)

    def load_guarded(self: Any, sig: Any, target_context: Any) -> Any:
        if not isinstance(self._cache_file, Sealed):
            return load(self, sig, target_context)
        try:
            return load(self, sig, target_context)
        except Exception:  # of another version of LLVM, or whatever else does not fit
            return None

    def save_guarded(self: Any, sig: Any, data: Any) -> None:
        try:
            save(self, sig, data)
        except OSError:  # a full disk: it is compiled again next time
            if not isinstance(self._cache_file, Sealed):
                raise

    cache.__init__, cache.load_overload, cache.save_overload = begin_guarded, load_guarded, save_guarded


def _text(key: Any) -> str:
    """Return what a function is compiled for, types and processor, in words that every process finds alike."""
    return _ADDRESS.sub("", repr(key))


def _seal(signature: str, data: bytes) -> bytes:
    """Return the checksum of a compiled function and of the signature that it was compiled for."""
    return hashlib.sha256(signature.encode() + data).digest()


def _tell_once() -> None:
    global _told
    if not _told:
        _told = True
        from comove.errors import ComoveWarning

        warnings.warn(
            "compiled kernels cannot be kept, so every start takes as long as the first: let NUMBA_CACHE_DIR name a "
            "folder that you may write",
            ComoveWarning,
            stacklevel=3,
        )

"""Compiled functions on disk, safe against damaged files and folders that cannot be written.

numba keeps compiled functions beside the sources, in the user's cache or in NUMBA_CACHE_DIR. By itself it fails on
a truncated file, on a full disk, and where none of the three folders can be written; it runs machine code that was
damaged; and two processes that compile two signatures of one function at the same time can load each other's code.
Here every file carries a checksum of its contents and its signature: a damaged file is compiled again, and where no
folder can be written comove runs without a cache. To the signature belongs a fingerprint of all that the code depends
on.
"""

from __future__ import annotations

import hashlib
import pickle
import pkgutil
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from numba.core import sigutils
from numba.core.caching import FunctionCache, IndexDataCacheFile

from comove.compiled.fingerprint import ADDRESS, fingerprint
from comove.errors import ComoveWarning

_MAKERS = [pkgutil.get_data("comove.compiled", name) or b"" for name in ("kernels.py", "cache.py")]
_MADE_BY = hashlib.sha256(b"".join(_MAKERS)).hexdigest()[:16]  # what another comove compiled may not fit
_told = False


class KernelCache(FunctionCache):
    """Compiled functions on disk; what cannot be read or written counts as missing."""

    def __init__(self, py_func: Callable, role: str):
        self._role = role
        try:
            super().__init__(py_func)
        except RuntimeError:  # no folder can be written
            _tell_once()
            self._name, self._py_func, self._impl = repr(py_func), py_func, None
            self._cache_path, self._cache_file, self._enabled = None, None, False
            return
        self._cache_file = _Sealed(self._cache_path, self._impl.filename_base, self._cache_file._source_stamp)

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        depends_on = fingerprint(self._py_func, sigutils.normalize_signature(sig)[0])
        return (*super()._index_key(sig, codegen), self._role, _MADE_BY, depends_on)

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return a function compiled before, or None.

        Whoever takes up its code must load before it what that code calls. numba passes this on from what it has
        compiled, but not from what it has loaded.
        """
        try:
            found = super().load_overload(sig, target_context)
        except Exception:  # of another version of LLVM, or whatever else does not fit
            return None
        if found is not None:
            found.library._reload_init.update(found.reload_init)
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep a compiled function."""
        with suppress(OSError):  # a full disk: it is compiled again next time
            super().save_overload(sig, data)


class _Sealed(IndexDataCacheFile):
    """Cache files whose contents and signature are checked; a file that does not match counts as missing.

    The index has signatures as texts: types themselves would import the modules that define them, so that whoever
    solves a scene would load robots because a robot's planner has the same kernels.
    """

    def load(self, key: Any) -> Any:
        signature = text_of(key)
        name = self._load_index().get(signature)
        try:
            with open(self._data_path(name or ""), "rb") as stored:
                seal, data = stored.read(32), stored.read()
            return pickle.loads(data) if seal == _seal(signature, data) else None
        except OSError:
            return None

    def save(self, key: Any, data: Any) -> None:
        self._sealed_for = text_of(key)
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


def text_of(key: Any) -> str:
    """Return what a function is compiled for, types and processor, in words that every process finds alike."""
    return ADDRESS.sub("", repr(key))


def _seal(signature: str, data: bytes) -> bytes:
    """Return the checksum of a compiled function and of the signature that it was compiled for."""
    return hashlib.sha256(signature.encode() + data).digest()


def _tell_once() -> None:
    global _told
    if not _told:
        _told = True
        warnings.warn(
            "compiled kernels cannot be kept, so every start takes as long as the first: let NUMBA_CACHE_DIR name a "
            "folder that you may write",
            ComoveWarning,
            stacklevel=3,
        )

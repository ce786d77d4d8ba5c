"""Cache of compiled functions, safe against damaged files and unwritable folders.

numba keeps compiled functions beside the sources, in the user's cache or in NUMBA_CACHE_DIR. By itself it fails on a
truncated file, on a full disk, and where none of the three folders can be written; it runs damaged machine code; and
two processes that compile two signatures of one function at the same time can load each other's code. Here every file
carries a checksum of its contents and its signature: a damaged file is compiled again, and where no folder can be
written comove runs without a cache.

numba reuses compiled code until the file of the function itself changes. But the code of small functions is inlined
into their callers, and values of modules become constants, wherever they are defined. The signature therefore
includes a fingerprint of all that the code depends on: the functions it calls, and the values it takes from modules.
"""

from __future__ import annotations

import glob
import hashlib
import io
import os
import pickle
import pkgutil
import re
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from llvmlite import binding as llvm
from numba.core import event, sigutils
from numba.core.caching import CompileResultCacheImpl, FunctionCache, IndexDataCacheFile
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.compiler import compile_result
from numba.core.environment import Environment
from numba.core.runtime import _nrt_python  # type: ignore[attr-defined]  # of C

from comove.compiled.libraries import OptionalCode
from comove.errors import ComoveWarning

fcntl: ModuleType | None
try:
    fcntl = import_module("fcntl")
except ImportError:  # no Unix
    fcntl = None

LOADING = "comove:load"  # a kind of events
ADDRESS = re.compile(r"0x[0-9a-f]+")
# known to numba's cache by its own version
LIBRARIES = frozenset({"builtins", "llvmlite", "math", "numba", "numpy", "scipy"})


def fingerprint(function: Callable, argument_types: Iterable[Any] = ()) -> str:
    """Return a checksum of everything a function's compiled code depends on.

    Parameters
    ----------
    function : a Python function
    argument_types : numba's types of its arguments: named tuples, which select the kernels of a `Question`, and
        functions
    """
    argument_types = list(argument_types)
    kinds, reached = _kinds(argument_types), dict[Callable, bytes]()
    given = [one.dispatcher.py_func for one in argument_types if hasattr(one, "dispatcher")]
    pending = [function, *(one for one in given if one is not None)]
    while pending:
        one = pending.pop()
        if hasattr(one, "answers"):  # a `Question`
            pending += [one.answers[kind].py_func for kind in kinds if kind in one.answers]
        elif one not in reached:
            reached[one], called = _own(one)
            pending += called
    fields = [repr((kind.__module__, kind.__qualname__, getattr(kind, "_fields", ()))) for kind in kinds]
    return hashlib.sha256(b"".join(reached.values()) + "".join(fields).encode()).hexdigest()


def _kinds(types: Iterable[Any]) -> list[type]:
    """Return the named-tuple classes among numba's types, nested ones included."""
    found = dict[type, None]()
    for one in types:
        kind = getattr(one, "instance_class", None)
        found.update(dict.fromkeys([*([kind] if kind else []), *_kinds(getattr(one, "types", ()))]))
    return list(found)


@cache
def _own(function: Any) -> tuple[bytes, tuple[Callable, ...]]:
    """Return a function's checksum without its callees, and the callees."""
    code, words, called = function.__code__, list[str](), list[Callable]()
    known = {**function.__globals__, **_free(function)}
    for part in _codes(code):
        words += [part.co_code.hex(), *_constants(part, function.__doc__), *part.co_names]
        words += part.co_varnames[: part.co_argcount + part.co_kwonlyargcount]  # callers may use them
        for name in (*part.co_names, *part.co_freevars):
            if name in known:
                _describe(known[name], part.co_names, words, called)
    for values in (function.__defaults__, tuple(sorted((function.__kwdefaults__ or {}).items()))):
        _describe(values, (), words, called)
    return hashlib.sha256("\n".join(words).encode()).digest(), tuple(called)


def _free(function: Any) -> dict[str, Any]:
    """Return the values of a function's closure, except those not yet defined."""
    found = {}
    for name, cell in zip(function.__code__.co_freevars, function.__closure__ or (), strict=True):
        try:
            found[name] = cell.cell_contents
        except ValueError:
            continue
    return found


def _codes(code: CodeType) -> list[CodeType]:
    return [code, *(inner for part in code.co_consts if isinstance(part, CodeType) for inner in _codes(part))]


def _constants(code: CodeType, docstring: str | None) -> list[str]:
    plain = [part for part in code.co_consts if part != docstring and not isinstance(part, CodeType)]
    return [repr(sorted(map(repr, part)) if isinstance(part, frozenset) else part) for part in plain]


def _describe(value: Any, names: tuple[str, ...], words: list[str], called: list[Callable]) -> None:
    """Add words that describe a module's value, and its functions.

    Parameters
    ----------
    names : names that the code uses, of which some may be attributes of a module
    """
    if hasattr(value, "py_func"):  # of a kernel, or of numba's own
        words.append(repr(sorted(value.targetoptions.items())))
        called.append(value.py_func)
    elif hasattr(value, "answers") or (isinstance(value, FunctionType) and not _is_library(value.__module__)):
        called.append(value)
    elif isinstance(value, ModuleType):
        words.append(value.__name__)
        for name in () if _is_library(value.__name__) else names:
            if hasattr(value, name):
                _describe(getattr(value, name), (), words, called)
    elif isinstance(value, tuple | list):
        words.append(type(value).__qualname__)
        for part in value:
            _describe(part, (), words, called)
    elif isinstance(value, np.ndarray):
        words += [value.dtype.str, str(value.shape), hashlib.sha256(value.tobytes()).hexdigest()]
    elif isinstance(value, type):
        words += [value.__qualname__, *getattr(value, "_fields", ())]
    else:
        words.append(ADDRESS.sub("", f"{type(value).__qualname__} {value!r}"))


def _is_library(module: str) -> bool:
    return module.partition(".")[0] in LIBRARIES


_MAKERS = [
    pkgutil.get_data("comove.compiled", name) or b""
    for name in ("kernels.py", "cache.py", "libraries.py", "shared.py", "lowering.py")
]
_MADE_BY = hashlib.sha256(b"".join(_MAKERS)).hexdigest()[:16]  # what another comove compiled may not fit
_told = False


class _Found(OptionalCode, JITCodeLibrary):
    """The library of a compiled function on disk.

    Its machine code is loaded, its LLVM code only for its callers. numba parses the LLVM code of every function that
    it loads, to list its symbols, which takes most of the time.

    Parameters
    ----------
    machine_code, llvm_code : as `CodeLibrary.serialize_using_object_code` returns them
    symbols : names of the functions in it
    """

    def __init__(
        self, codegen: Any, name: str, machine_code: bytes, llvm_code: bytes, symbols: frozenset[str]
    ):
        CodeLibrary.__init__(self, codegen, name)  # without an empty module, which is slow to make
        self._llvm_code, self._symbols, self._shared_module = llvm_code, symbols, None
        self._finalized = self._disable_inspection = True
        self.has_code = bool(machine_code)
        if machine_code:
            codegen._engine._ee.add_object_file(llvm.ObjectFileRef.from_data(machine_code))
            codegen._engine.finalize_object()

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function; 0 if it is not in the library."""
        is_there = self.has_code and name in self._symbols
        return self._codegen._engine.get_function_address(name) if is_there else 0

    def _get_module_for_linking(self) -> Any:
        if self._shared_module is None:
            self._shared_module = llvm.parse_bitcode(self._llvm_code)
        return self._shared_module


@cache
def _offer_runtime() -> None:
    """Register numba's array allocation for functions loaded before any is compiled."""
    for name, address in _nrt_python.c_helpers.items():
        llvm.add_symbol(name if name.startswith("_") else f"NRT_{name}", address)


@cache
def _load_extensions(target_context: Any) -> None:
    """Load numba's extensions and the lowering of shared tuples."""
    import_module("comove.compiled.lowering")
    target_context.refresh()


class _Reader(pickle.Unpickler):
    """An unpickler that does not import the modules of inlined functions."""

    def find_class(self, module: str, name: str) -> Any:
        return _environment if name == "_rebuild_env" else super().find_class(module, name)


def _environment(module: str, constants: Any, name: str) -> Environment:
    """Return the constants of a function in machine code. Only Python objects in it would need its module."""
    found = Environment._memo.get(name)
    if found is None:
        found = Environment(vars(sys.modules[module]) if module in sys.modules else {"__name__": module})
        found.env_name = name
        Environment._memo[name] = found
    found.consts.extend(constants[len(found.consts) :])  # an entry has those of what it calls, and its own
    return found


_given: dict[str, Environment] = {}  # what machine code points to, by name: it stays as long as the process


class _Stored(CompileResultCacheImpl):
    """The record of a compiled function, with the function names in it."""

    def reduce(self, cres: Any) -> Any:
        module = cres.library._final_module
        symbols = frozenset(function.name for function in module.functions if not function.is_declaration)
        return symbols, cres._reduce()

    def rebuild(self, target_context: Any, payload: Any) -> Any:
        symbols, (code, description, environment, signature, in_objects, lifted, notes, reload, others) = (
            payload
        )
        for one in reload:
            one()
        name, _, (machine_code, llvm_code) = code
        library = _Found(target_context.codegen(), name, machine_code, llvm_code, symbols)
        library._reload_init.update(reload)  # numba passes it on to callers from what was compiled alone
        found = compile_result(
            typing_context=target_context.typing_context,
            target_context=target_context,
            entry_point=target_context.get_executable(library, description, environment),
            type_annotation=notes,
            signature=signature,
            library=library,
            environment=environment,
            fndesc=description,
            objectmode=in_objects,
            lifted=lifted,
            reload_init=reload,
            referenced_envs=others,
        )
        for one in others if library.has_code else ():
            if _given.get(one.env_name) is not one:
                _given[one.env_name] = one
                library.codegen.set_env(one.env_name, one)
        return found


@cache
def _lock_file(folder: str) -> int:
    """Return the open file whose bytes are locked. Closing it would release all locks."""
    return os.open(os.path.join(folder, "comove_kernels.lock"), os.O_RDWR | os.O_CREAT, 0o666)


class KernelCache(FunctionCache):
    """Compiled functions on disk; unreadable or unwritable ones count as missing."""

    _impl_class = _Stored
    patience = 60.0  # s, for which another process is waited for; it may be stopped

    def __init__(self, py_func: Callable, role: str):
        self._role = role
        self._turns: list[tuple[int, int]] = []
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

        numba's extensions, which are slow to load, are loaded only where something must be compiled.
        """
        _offer_runtime()
        found = self._found(sig, target_context)
        if found is None and self._begin_turn(sig, target_context):
            found = self._found(sig, target_context)
        if found is None:
            _load_extensions(target_context)
        return found

    def _found(self, sig: Any, target_context: Any) -> Any:
        try:
            with event.trigger_event(LOADING):
                return self._load_overload(sig, target_context)
        except Exception:  # of another version of LLVM, or whatever else does not fit
            return None

    def _begin_turn(self, sig: Any, target_context: Any) -> bool:
        """Wait for other processes that compile the function; return whether it locked.

        The lock is on a byte of a file, which the system releases when a process dies. Where there are no such locks,
        and after a wait that timed out, two processes may compile the same function.
        """
        if fcntl is None or not self._enabled:
            return False
        try:
            self._impl.locator.ensure_cache_path()
            file = _lock_file(self._cache_path)
            key = hashlib.sha256(text_of(self._index_key(sig, target_context.codegen())).encode()).digest()
            byte = int.from_bytes(key[:4], "big")
            self._lock(file, byte)
        except OSError:
            return False
        self._turns.append((file, byte))
        return True

    @staticmethod
    def _lock(file: int, byte: int) -> None:
        until = time.monotonic() + KernelCache.patience
        while True:
            try:
                fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, byte)  # type: ignore[union-attr]
                return
            except (BlockingIOError, PermissionError):
                if time.monotonic() > until:
                    KernelCache.patience = 0.0
                    raise
                time.sleep(0.01)

    @contextmanager
    def turns(self) -> Iterator[None]:
        """Release all locks taken in this context at its end."""
        before = len(self._turns)
        try:
            yield
        finally:
            while len(self._turns) > before:
                with suppress(OSError, IndexError):  # of another thread
                    file, byte = self._turns.pop()
                    fcntl.lockf(file, fcntl.LOCK_UN, 1, byte)  # type: ignore[union-attr]

    def save_overload(self, sig: Any, data: Any) -> None:
        """Store a compiled function."""
        with suppress(OSError):  # a full disk: it is compiled again next time
            super().save_overload(sig, data)
            if self._enabled:
                file = Path(self._py_func.__code__.co_filename)
                stamp = self._cache_file._source_stamp
                _remove_outdated(self._cache_path, file.stem, file.stat().st_mtime, stamp)


class _Sealed(IndexDataCacheFile):
    """Cache files with checked contents and signature; mismatches count as missing.

    The index has signatures as texts: types themselves would import the modules that define them, so that solving a
    scene would load robots because a robot's planner has the same kernels.
    """

    def load(self, key: Any) -> Any:
        signature = text_of(key)
        name = self._load_index().get(signature)
        try:
            with open(self._data_path(name or ""), "rb") as stored:
                seal, data = stored.read(32), stored.read()
            return _Reader(io.BytesIO(data)).load() if seal == _seal(signature, data) else None
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


@cache
def _remove_outdated(folder: str, module: str, changed: float, stamp: Any) -> None:
    """Remove what was compiled from earlier versions of a source file; names hold the lines of functions.

    Parameters
    ----------
    module : name of the file without its suffix
    changed : time at which the present version was written [s]
    stamp : numba's stamp of the present version
    """
    for index in Path(folder).glob(f"{module}.*.nbi"):
        with suppress(Exception):  # pickle may raise anything on damaged data
            version, (other, _) = (load := pickle.Unpickler(io.BytesIO(index.read_bytes())).load)(), load()
            if version == numba.__version__ and other != stamp and index.stat().st_mtime < changed:
                for data in Path(folder).glob(f"{glob.escape(index.stem)}.*.nbc"):
                    data.unlink()
                index.unlink()


def text_of(key: Any) -> str:
    """Return types and processor of a compiled function as reproducible text."""
    return ADDRESS.sub("", repr(key))


def _seal(signature: str, data: bytes) -> bytes:
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

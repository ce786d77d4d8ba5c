"""Kernels: functions that numba compiles, no more often than needed.

numba by itself makes three things of every function: its code, which takes up the code of all that it calls, an
entry for Python and one for C. What a robot's search calls would thereby be optimised anew in each of its callers,
and most of the machine code would be entries that nobody uses. A `Kernel` is compiled for its callers without
entries. One that is large is called where it lies. A small one always becomes part of its callers; LLVM by itself
would call many, as they take tuples of arrays, which every call copies. What Python itself calls gets one entry, none
for C.
"""

from __future__ import annotations

import copy
import gc
import hashlib
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from typing import Any

import llvmlite.binding as llvm
from numba.core import config, event, sigutils
from numba.core.environment import Environment
from numba.core.itanium_mangler import mangle
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys

from comove.compiled.cache import LOADING, KernelCache, text_of

LARGE = 1000  # lines of LLVM, of kernels that are called where they lie
_offered: dict[str, Any] = {}  # libraries by symbol: their code stays as long as the process


def kernel(function: Any = None, *, counted: bool = True, **options: Any) -> Any:
    """Return a function as a kernel, compiled when it is first called and kept on disk; a decorator.

    Parameters
    ----------
    function : function, or None to give options first
    counted : whether references to the arrays of its arguments are counted, as numba does by itself; without, calls
        with many arrays take a fraction of the time, but the function may neither allocate an array, nor return one,
        nor call a kernel that returns one
    options : of `numba.njit`, such as `nogil=True`

    Returns
    -------
    the kernel, whose divisions by zero follow NumPy's rules
    """
    if function is None:
        return partial(kernel, counted=counted, **options)
    if config.DISABLE_JIT:  # type: ignore[attr-defined]  # numba fills it from the environment
        return function
    fixed = {"nopython": True, "error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": counted}
    return Kernel(function, targetoptions={**options, **fixed})


class Kernel(CPUDispatcher):
    """A compiled function: `callee`, which other kernels call, and an entry to it for Python."""

    _compiler: Any  # numba's, without types
    targetctx: Any

    _kept: KernelCache | None

    def __init__(self, *args: Any, **options: Any):
        super().__init__(*args, **options)
        self._compiler.compile = self._entry

    def __repr__(self) -> str:
        return f"Kernel({'.'.join(self._names)})"

    def __reduce__(self) -> Any:
        return (_named, self._names) if self._is_named else super().__reduce__()

    @property
    def _names(self) -> tuple[str, str]:
        return self.py_func.__module__, self.py_func.__qualname__

    @property
    def _is_named(self) -> bool:
        """Return whether every process finds the kernel by its names."""
        module, name = self._names
        return getattr(sys.modules.get(module), name, None) is self

    def _compilation_chain_init_hook(self) -> None:
        """Load no extensions of numba before one must compile; that is when `KernelCache` finds nothing."""

    def _compile_for_args(self, *args: Any, **more: Any) -> Any:
        """Return the function for arguments, of which numba's types take long to find where many are nested."""
        with event.trigger_event(LOADING):
            return super()._compile_for_args(*args, **more)  # type: ignore[misc]  # of C

    def compile(self, sig: Any) -> Any:
        """Return the function for types of arguments, compiled now or before."""
        with _uncollected(), self._cache.turns():
            return super().compile(sig)

    @property
    def _cache(self) -> KernelCache:
        """Return the cache on disk, which is looked for when the kernel is called first."""
        if self._kept is None:
            self._kept = KernelCache(self.py_func, "entry")
        return self._kept

    @_cache.setter
    def _cache(self, _: Any) -> None:
        self._kept = None

    @cached_property
    def callee(self) -> Any:
        """Return what other kernels call, numba's dispatcher of the function without an entry."""
        made = _Callee(self.py_func, targetoptions={**self.targetoptions, "no_cpython_wrapper": True})
        made._cache = KernelCache(self.py_func, "callee")
        return made

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return numba's template of a call from another kernel."""
        return self.callee.get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        """Return the key under which numba finds how to call the function from another kernel."""
        args, _ = sigutils.normalize_signature(sig)
        compiled = self.callee.overloads[tuple(args)]
        if not _is_large(compiled):
            _code_of(compiled).add_function_attribute("alwaysinline")
        elif self._is_named:
            function, reload = self.offered(args)
            self.targetctx.insert_user_function(reload.symbol, function, [Elsewhere(reload)])
            return reload.symbol
        return compiled.entry_point

    def offered(self, args: tuple) -> tuple[Any, Reload]:
        """Compile or load the callee and let code find it by a symbol that is the same in every process.

        Returns
        -------
        numba's description of a function with that symbol, and what finds it again
        """
        self.callee.compile(args)
        compiled = self.callee.overloads[args]
        function = copy.copy(compiled.fndesc)
        words = f"{self!r} {text_of((args, function.restype))}"
        name = f"comove.{hashlib.sha256(words.encode()).hexdigest()}"
        symbol = mangle(name, ())
        if _offered.get(symbol) is not compiled.library:
            _offered[symbol] = compiled.library
            llvm.add_symbol(symbol, compiled.library.get_pointer_to_function(function.llvm_func_name))
        function.mangled_name, function.env_name = symbol, mangle(f".NumbaEnv.{name}", ())
        return function, Reload(self, args, symbol)

    def _entry(self, args: tuple, return_type: Any) -> Any:
        """Compile the entry for Python, as numba's compiler of the function would together with its code."""
        if not self._is_named:
            return type(self._compiler).compile(self._compiler, args, return_type)
        function, reload = self.offered(args)
        environment = Environment.from_fndesc(function)
        context = self.targetctx.subtarget(enable_nrt=True)  # arrays go to Python with their memory
        library = context.codegen().create_library(function.qualname)
        library.enable_object_caching()
        library.add_linking_library(Elsewhere(reload))
        library.add_linking_library(rtsys.library)  # which counts references to arrays
        context.create_cpython_wrapper(
            library, function, environment, None, release_gil=self.targetoptions.get("nogil", False)
        )
        return self.callee.overloads[args]._replace(
            library=library,
            fndesc=function,
            environment=environment,
            entry_point=context.get_executable(library, function, environment),
            reload_init=[reload],
            metadata={},
        )


class _Callee(CPUDispatcher):
    """A kernel without an entry for Python, as other kernels call it."""

    _cache: KernelCache

    def compile(self, sig: Any) -> Any:
        """Return the function for types of arguments, compiled now or before."""
        with self._cache.turns():
            return super().compile(sig)


@contextmanager
def _uncollected() -> Iterator[None]:
    """Collect no garbage meanwhile, of which compilers make little; each search of it goes through all they made."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _named(module: str, name: str) -> Kernel:
    return getattr(import_module(module), name)


@dataclass(frozen=True)
class Reload:
    """A call that finds a kernel, before code is loaded from disk that calls it by its symbol.

    Attributes
    ----------
    kernel : what is called
    args : types of its arguments
    symbol : by which the code calls it
    """

    kernel: Kernel
    args: tuple
    symbol: str

    def __call__(self) -> None:
        """Load or compile the kernel.

        Raises
        ------
        LookupError
            If it is not the kernel any more that the code calls; the code counts as missing then.
        """
        _, reload = self.kernel.offered(self.args)
        if reload.symbol != self.symbol:
            raise LookupError(self.symbol)


class Elsewhere:
    """A stand-in for a kernel's code when numba links a caller: it holds nothing but how to find the kernel."""

    def __init__(self, reload: Reload):
        codegen = reload.kernel.targetctx.codegen()
        self._reload_init = {reload}
        self._nothing = llvm.parse_assembly(str(codegen._create_empty_module(reload.symbol)))

    def _ensure_finalized(self) -> None: ...

    def _get_module_for_linking(self) -> Any:
        return self._nothing


def _is_large(compiled: Any) -> bool:
    """Return whether a compiled function has more code than its callers should take up."""
    return str(_code_of(compiled)).count("\n") > LARGE


def _code_of(compiled: Any) -> Any:
    return compiled.library._get_module_for_linking().get_function(compiled.fndesc.llvm_func_name)

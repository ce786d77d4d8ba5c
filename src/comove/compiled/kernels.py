"""Kernels: functions compiled by numba with as little code as possible.

numba by itself makes three things of every function: its code, with the code of all that it calls inlined, an entry
for Python and one for C. The kernels of a robot's search would thereby be optimised anew in each caller, and most of
the machine code would be unused entries. A `Kernel` is compiled for its callers without entries. A large one is
called through its address. A small one is always inlined; LLVM by itself would call many, as they take tuples of
arrays, which every call copies. A kernel called from Python gets one entry, none for C.
"""

from __future__ import annotations

import copy
import hashlib
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from importlib import import_module
from types import CodeType
from typing import Any

import llvmlite.binding as llvm
from numba.core import config, event, sigutils, types
from numba.core.compiler import CompilerBase, DefaultPassBuilder, Flags
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager
from numba.core.environment import Environment
from numba.core.itanium_mangler import mangle
from numba.core.registry import CPUDispatcher
from numba.core.runtime import rtsys
from numba.core.typed_passes import AnnotateTypes, InlineOverloads
from numba.core.untyped_passes import InlineClosureLikes

from comove._doors import uncollected
from comove.compiled.cache import LOADING, KernelCache, text_of
from comove.compiled.libraries import EntryLibrary, kernel_libraries
from comove.compiled.shared import shared

_offered: dict[str, Any] = {}  # libraries by symbol: their code stays as long as the process


def kernel(function: Any = None, *, counted: bool = True, **options: Any) -> Any:
    """Return a function as a kernel; usable as a decorator. It is compiled on the first call and cached on disk.

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


class _Flags(Flags):
    """Flags of kernels that differ from the defaults, quick to compare."""

    __slots__ = ()

    def __init__(self, flags: Any):
        super().__init__(flags)
        for name in [name for name, value in self._values.items() if value == flags.options[name].default]:
            self.discard(name)

    def __hash__(self) -> int:
        return hash(type(self))

    def __eq__(self, other: object) -> bool:
        return self._values == other._values if isinstance(other, _Flags) else super().__eq__(other)


class _Pipeline(CompilerBase):
    """numba's compilation pipeline without passes that kernels do not need."""

    def define_pipelines(self) -> list[PassManager]:
        manager, code = PassManager("kernel"), self.state.func_id.code
        has_inner = any(isinstance(one, CodeType) for one in code.co_consts)
        unneeded = [AnnotateTypes, InlineOverloads, *([] if has_inner else [InlineClosureLikes])]
        whole = DefaultPassBuilder.define_nopython_pipeline(self.state)
        manager.passes = [step for step in whole.passes if step[0] not in unneeded]
        manager.finalize()
        return [manager]


class _Compiled(CPUDispatcher):
    """A dispatcher without nested compile timers and flag-by-flag comparison."""

    _compiler: Any  # numba's, without types
    _cache: KernelCache
    _cache_hits: Any
    _cache_misses: Any
    _types_active_call: Any
    overloads: Any
    targetctx: Any

    def __init__(self, function: Callable, targetoptions: dict[str, Any]):
        super().__init__(function, targetoptions=targetoptions, pipeline_class=_Pipeline)
        self._compiler._customize_flags = _Flags

    def compile(self, sig: Any) -> Any:
        """Return the function compiled for types of arguments."""
        with global_compiler_lock, self._cache.turns(), self._compiling_counter:
            args, return_type = sigutils.normalize_signature(sig)
            if args in self.overloads:
                return self.overloads[args].entry_point
            compiled = self._cache.load_overload(sig, self.targetctx)
            if compiled is not None:
                self._cache_hits[sig] += 1
                self.targetctx.insert_user_function(compiled.entry_point, compiled.fndesc, [compiled.library])
                self.add_overload(compiled)
                return compiled.entry_point
            self._cache_misses[sig] += 1
            details = {"dispatcher": self, "args": args, "return_type": return_type}
            with event.trigger_event("numba:compile", data=details):
                compiled = self._compiler.compile(args, return_type)
                self.add_overload(compiled)
            self._cache.save_overload(sig, compiled)
            return compiled.entry_point


class Kernel(_Compiled):
    """A compiled function: `callee`, which other kernels call, and an entry to it for Python."""

    _kept: KernelCache | None

    def __init__(self, function: Callable, targetoptions: dict[str, Any]):
        super().__init__(function, targetoptions)
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
        """Return whether other processes can find the kernel by name."""
        module, name = self._names
        return getattr(sys.modules.get(module), name, None) is self

    def _compilation_chain_init_hook(self) -> None:
        """Load no extensions of numba yet. `KernelCache` loads them if it finds nothing."""

    def typeof_pyval(self, val: Any) -> Any:
        """Return numba's type of an argument; large tuples are given by their address."""
        found = shared(super().typeof_pyval(val))
        self._types_active_call.add(found)
        return found

    def _compile_for_args(self, *args: Any, **more: Any) -> Any:
        """Return the function for arguments. Finding their types is slow, so it counts as loading."""
        with event.trigger_event(LOADING):
            return super()._compile_for_args(*args, **more)  # type: ignore[misc]  # of C

    def compile(self, sig: Any) -> Any:
        """Return the function compiled for types of arguments."""
        known = self.overloads.get(sig) if isinstance(sig, tuple) else None
        if known is not None:  # as for every call whose arguments have to be converted
            return known.entry_point
        with uncollected():
            return super().compile(sig)

    @property
    def _cache(self) -> KernelCache:
        if self._kept is None:
            self._kept = KernelCache(self.py_func, "entry")
        return self._kept

    @_cache.setter
    def _cache(self, _: Any) -> None:
        self._kept = None

    @cached_property
    def callee(self) -> Any:
        """Return numba's dispatcher without an entry, for calls from other kernels."""
        made = _Callee(self.py_func, targetoptions={**self.targetoptions, "no_cpython_wrapper": True})
        made._cache = KernelCache(self.py_func, "callee")
        return made

    def get_call_template(self, args: Any, kws: Any) -> Any:
        """Return numba's template of a call from another kernel. It is the same for literal numbers."""
        return self.callee.get_call_template(
            tuple(map(_widened, args)), {name: _widened(one) for name, one in kws.items()}
        )

    def get_overload(self, sig: Any) -> Any:
        """Return numba's key for calls from another kernel."""
        args, _ = sigutils.normalize_signature(sig)
        if args not in self._keys:
            self._keys[args] = self._key(args)
        return self._keys[args]

    def _key(self, args: tuple) -> Any:
        compiled = self.callee.overloads[args]
        if not compiled.library.has_code:
            _code_of(compiled).add_function_attribute("alwaysinline")
        elif self._is_named:
            function, reload = self.offered(args)
            self.targetctx.insert_user_function(reload.symbol, function, [Elsewhere(reload)])
            return reload.symbol
        return compiled.entry_point

    @cached_property
    def _keys(self) -> dict[tuple, Any]:
        return {}

    def offered(self, args: tuple) -> tuple[Any, Reload]:
        """Compile or load the callee and register a reproducible symbol. The symbol is the same in every process.

        Returns
        -------
        numba's description of a function with that symbol, and its `Reload`
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
        """Compile the entry for Python without compiling the callee's code again."""
        if not self._is_named:
            return type(self._compiler).compile(self._compiler, args, return_type)
        self.callee.compile(args)
        compiled = self.callee.overloads[args]
        function, code, reload = compiled.fndesc, compiled.library, []
        if code.has_code:
            function, found = self.offered(args)
            code, reload = Elsewhere(found), [found]
        else:
            _code_of(compiled).add_function_attribute("alwaysinline")
        environment = Environment.from_fndesc(function)
        context = self.targetctx.subtarget(enable_nrt=True)  # arrays go to Python with their memory
        library = EntryLibrary(context.codegen(), function.qualname)
        library.enable_object_caching()
        library.add_linking_library(code)
        library.add_linking_library(rtsys.library)  # which counts references to arrays
        context.create_cpython_wrapper(
            library, function, environment, None, release_gil=self.targetoptions.get("nogil", False)
        )
        return compiled._replace(
            library=library,
            fndesc=function,
            environment=environment,
            entry_point=context.get_executable(library, function, environment),
            reload_init=reload or list(library._reload_init),
            metadata={},
        )


class Question:
    """A function replaced by a kernel chosen by its first argument's class.

    The argument is a named tuple. Uncompiled, the function itself runs.
    """

    is_compiling = False  # asked by numba, for recursion

    def __init__(self, function: Callable):
        self.function, self.answers = function, dict[type, Kernel]()
        self._numba_type_ = types.Dispatcher(self)  # type: ignore[type-var]  # which asks the methods below

    def __call__(self, *args: Any) -> Any:
        return self.function(*args)

    def answered_for(self, kind: type) -> Callable[[Kernel], Kernel]:
        """Return a decorator that registers the kernel for a named-tuple class."""

        def answer(kernel: Kernel) -> Kernel:
            self.answers[kind] = kernel
            return kernel

        return answer

    @property
    def nopython_signatures(self) -> list:
        """Return the kernels' signatures, for messages of numba."""
        return [signature for kernel in self.answers.values() for signature in kernel.nopython_signatures]

    def get_call_template(self, args: tuple, kws: dict) -> Any:
        """Return numba's template of a call from a kernel."""
        return self._of(args).get_call_template(args, kws)

    def get_overload(self, sig: Any) -> Any:
        """Return numba's key for calls from a kernel."""
        return self._of(sigutils.normalize_signature(sig)[0]).get_overload(sig)

    def _of(self, args: tuple) -> Kernel:
        return self.answers[args[0].instance_class]


class _Callee(_Compiled):
    """A kernel without an entry for Python, as other kernels call it."""

    def compile(self, sig: Any) -> Any:
        """Return the function compiled for types of arguments."""
        with global_compiler_lock, kernel_libraries(self.targetctx.codegen()):
            return super().compile(sig)


def _widened(one: Any) -> Any:
    return types.unliteral(one) if isinstance(one, types.IntegerLiteral | types.BooleanLiteral) else one


def _named(module: str, name: str) -> Kernel:
    return getattr(import_module(module), name)


@dataclass(frozen=True)
class Reload:
    """A callable that loads a kernel before cached code calls it.

    Attributes
    ----------
    kernel : kernel that is called
    args : types of its arguments
    symbol : symbol by which the code calls it
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
    """A stand-in that links a caller to a kernel's address only."""

    def __init__(self, reload: Reload):
        codegen = reload.kernel.targetctx.codegen()
        self._reload_init = {reload}
        self._nothing = llvm.parse_assembly(str(codegen._create_empty_module(reload.symbol)))

    def _ensure_finalized(self) -> None: ...

    def _get_module_for_linking(self) -> Any:
        return self._nothing


def _code_of(compiled: Any) -> Any:
    return compiled.library._get_module_for_linking().get_function(compiled.fndesc.llvm_func_name)


@kernel
def sort_by(keys: Any, order: Any, begin: int, end: int, spare: Any) -> None:
    """Sort a part of an order by keys; equal ones keep their order. numba's own sorts take seconds to compile.

    Parameters
    ----------
    keys : array, shape (n,), without NaN
    order : array of int, shape (n,), indices into `keys`; those from `begin` to `end` are sorted
    spare : array of int, shape (n,), memory
    """
    width = 1
    while width < end - begin:
        for low in range(begin, end, 2 * width):
            middle, high = min(low + width, end), min(low + 2 * width, end)
            i, j = low, middle
            for k in range(low, high):
                if j == high or (i < middle and keys[order[i]] <= keys[order[j]]):
                    spare[k] = order[i]
                    i += 1
                else:
                    spare[k] = order[j]
                    j += 1
        for k in range(begin, end):
            order[k] = spare[k]
        width *= 2


@kernel
def copy_to(source: Any, target: Any) -> None:
    """Copy a vector to a row of an array. Assignment to a slice would take seconds to compile."""
    for c in range(source.shape[0]):
        target[c] = source[c]

"""Machine code of kernels, made no more often than needed.

numba makes machine code of every function, and optimises it twice, so that reference counts cancel each other. Here
only functions called through their address become machine code; small ones stay as optimised LLVM code for their
callers. Functions without reference counts are optimised once.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from llvmlite.binding import create_new_function_pass_manager
from numba.core.codegen import CodeLibrary, JITCodeLibrary
from numba.core.environment import Environment

LARGE = 600  # lines of LLVM, of kernels that are called where they lie
UNRESOLVED, COUNTS, FOR_PYTHON = ".numba.unresolved$", "NRT_decref", "_ZN7cpython"


class OptionalCode(CodeLibrary):
    """A library that may have no machine code.

    Attributes
    ----------
    has_code : whether it has
    """

    has_code: bool

    @property
    def codegen(self) -> Any:
        """Return numba's owner of the library. Without machine code, it is one that receives no constants for it."""
        return self._codegen if self.has_code else _Nowhere(self._codegen)


class _Nowhere:
    def __init__(self, codegen: Any):
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, env_name: str, env: Any) -> None: ...


class KernelLibrary(OptionalCode, JITCodeLibrary):
    """The library of a function as kernels call it."""

    has_code = False
    _codegen: Any

    def add_ir_module(self, ir_module: Any) -> None:
        """Add code, except unused entries for C."""
        if ir_module.name != "cfunc_wrapper":
            super().add_ir_module(ir_module)

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = create_new_function_pass_manager(), self._codegen._pass_builder()
        passes.add_sroa_pass()  # the rest follows for the whole library; combining instructions
        passes.add_simplify_cfg_pass()  # between these two would leave loops that LLVM cannot vectorise
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        if any(function.name == COUNTS for function in self._final_module.functions):
            super()._optimize_final_module()
        else:
            passes, builder = self._codegen._module_pass_manager()
            passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self.has_code = self._is_called()
        if self.has_code:
            super()._finalize_final_module()
            for one in self._final_module.global_variables:
                if one.name in Environment._memo:  # constants of code that it took up
                    self._codegen.set_env(one.name, Environment._memo[one.name])
        else:
            self._finalize_dynamic_globals()
            self._verify_declare_only_symbols()
            self._finalized, self._compiled_object = True, b""

    def _is_called(self) -> bool:
        """Return whether code is called by address: large, recursive, or numba's own with an entry."""
        unresolved = [
            one.name for one in self._final_module.global_variables if one.name.startswith(UNRESOLVED)
        ]
        entries = [one.name for one in self._final_module.functions if one.name.startswith(FOR_PYTHON)]
        return bool(unresolved or entries) or str(self._final_module).count("\n") > LARGE

    def get_pointer_to_function(self, name: str) -> int:
        """Return the address of a function; 0 if it has none."""
        self._ensure_finalized()
        return super().get_pointer_to_function(name) if self.has_code else 0


class EntryLibrary(KernelLibrary):
    """The library of an entry for Python, called through its address."""

    def _is_called(self) -> bool:
        return True


@contextmanager
def kernel_libraries(codegen: Any) -> Iterator[None]:
    """Make numba create libraries of this kind in this context. One thread at a time may use it."""
    before, codegen._library_class = codegen._library_class, KernelLibrary
    try:
        yield
    finally:
        codegen._library_class = before

"""Functions compiled by numba: `kernel`, a decorator."""

from comove.compiled.kernels import kernel

__all__ = ["kernel"]

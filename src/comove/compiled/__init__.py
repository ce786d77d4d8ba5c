"""Functions compiled by numba: `kernel`, a decorator, and what kernels are made with."""

from comove.compiled.kernels import Question, copy_to, kernel

__all__ = ["Question", "copy_to", "kernel"]

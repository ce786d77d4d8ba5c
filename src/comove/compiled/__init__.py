"""Functions compiled by numba: the decorator `kernel` and its parts."""

from comove.compiled.kernels import Question, copy_to, kernel, sort_by

__all__ = ["Question", "copy_to", "kernel", "sort_by"]

"""Functions compiled by numba: `kernel`, a decorator, and what kernels are made with."""

from comove.compiled.copying import copy_to
from comove.compiled.kernels import Question, kernel

__all__ = ["Question", "copy_to", "kernel"]

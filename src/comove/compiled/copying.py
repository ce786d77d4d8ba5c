"""Copies between arrays in kernels: assignment to a slice or a row would take seconds to compile."""

from __future__ import annotations

from comove.arrays import Array
from comove.compiled.kernels import kernel


@kernel
def copy_to(source: Array, target: Array) -> None:
    """Copy a vector."""
    for c in range(source.shape[0]):
        target[c] = source[c]

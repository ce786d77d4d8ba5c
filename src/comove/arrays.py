"""Array types, products, and extreme values chosen independently of rounding.

End effectors, joints and obstacles that mirror each other give values that differ only in the last digit, and that
digit depends on the processor. Values that differ only by rounding count as equal here, and the first is returned.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

ROUNDING = 1e-9  # relative, by which two ways to compute the same may differ


def inner(a: Array, b: Array) -> Array:
    """Return inner products along the last axis; sums along a short axis take NumPy three times as long."""
    return np.einsum("...i,...i->...", a, b)


def listed(values: ArrayLike, decimals: int) -> str:
    """Return numbers as text like ``[0.5, 0, 0.3]``, without traces of rounding."""
    rounded = np.round(np.asarray(values, dtype=float), decimals) + 0.0  # one zero
    return f"[{', '.join(f'{value:.12g}' for value in rounded.tolist())}]"


def first_largest(values: ArrayLike) -> int:
    """Return the first index of the largest value, up to rounding; nan counts as largest."""
    values = np.asarray(values, dtype=float).ravel()
    best = int(np.argmax(values))
    if not np.isfinite(values[best]):
        return best
    size = np.abs(values).max()
    if not np.isfinite(size):
        size = np.abs(values[np.isfinite(values)]).max()
    return int(np.argmax(values >= values[best] - ROUNDING * size))


def first_least(values: ArrayLike) -> int:
    """Return the first index of the least value, up to rounding; nan counts as least."""
    return first_largest(-np.asarray(values, dtype=float))

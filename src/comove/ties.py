"""Which of several is largest: the first in order where only rounding would decide.

Hands, joints and obstacles that mirror each other are equally far off, but for the last digit, and that digit hangs
on the processor. What a message names, and what is decided, must not.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

ALIKE = 1e-9  # relative to the largest number of all


def first_largest(values: ArrayLike) -> int:
    """The first, in the flattened array, of those as large as the largest; nan counts as larger than all numbers."""
    values = np.asarray(values, dtype=float).ravel()
    best = int(np.argmax(values))
    if not np.isfinite(values[best]):
        return best
    finite = values[np.isfinite(values)]
    return int(np.argmax(values >= values[best] - ALIKE * np.abs(finite).max()))


def first_least(values: ArrayLike) -> int:
    """The first, in the flattened array, of those as small as the least; nan counts as smaller than all numbers."""
    return first_largest(-np.asarray(values, dtype=float))

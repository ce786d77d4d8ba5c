"""A clock that compiled loops look at, so that a budget holds inside them as well.

Kernels say how much they work, and after some milliseconds of it they look at the time. Once it is up, nothing is
free any more and loops end: whoever called them looks at the clock as well and ends the search. Before that the clock
changes nothing.
"""

from __future__ import annotations

import time

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

DEADLINE, LEFT, UP, LOOKS = range(4)  # columns of a clock
STRIDE = 20_000  # distances or the like between two looks at the time: some milliseconds


def clock_until(deadline: float = np.inf) -> Array:
    """A clock that is up at `deadline`, a time of `time.perf_counter` [s]."""
    clock = np.zeros(4)
    clock[LEFT] = STRIDE
    wind(clock, deadline)
    return clock


def wind(clock: Array, deadline: float) -> None:
    """Let a clock run until another deadline: time in which kernels are compiled puts it off."""
    clock[DEADLINE], clock[UP] = deadline, 0.0


@numba.njit(cache=True, error_model="numpy")
def worked(clock, work):
    """Count some work, look at the time if it is long ago; whether time is up."""
    clock[LEFT] -= work
    if clock[LEFT] < 0.0:
        with numba.objmode(now="float64"):
            now = time.perf_counter()
        clock[LEFT] = STRIDE
        clock[LOOKS] += 1.0
        if now > clock[DEADLINE]:
            clock[UP] = 1.0
    return clock[UP] > 0.0

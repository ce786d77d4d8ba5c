"""The clock of time budgets, which compiled loops read as well.

It is that on the wall, or, in the context of `processor_time`, that of this process: a budget then means the same
work whatever else the machine does.

Kernels count their work, and read the time after every few milliseconds of it. Once time is up, they report every
configuration as not free, so that their loops end; the caller checks the time as well and ends the search. Until then
the clock does not change any result.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar

import numba
import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel

Array = NDArray[np.float64]

DEADLINE, LEFT, UP, LOOKS = range(4)  # columns of a clock
STRIDE = 20_000  # computed distances, or as much work, between two readings of the time: some milliseconds


_seconds: ContextVar[Callable[[], float]] = ContextVar("seconds", default=time.perf_counter)


def now() -> float:
    """Return the time of the clock of budgets [s]."""
    return _seconds.get()()


@contextmanager
def processor_time() -> Iterator[None]:
    """Let budgets, and the times that solutions report, count processor time of this process in this context."""
    before = _seconds.set(time.process_time)
    try:
        yield
    finally:
        _seconds.reset(before)


def clock_until(deadline: float = np.inf) -> Array:
    """Return a clock that expires at `deadline`, a time of `now` [s]."""
    clock = np.zeros(4)
    clock[LEFT] = STRIDE
    wind(clock, deadline)
    return clock


def wind(clock: Array, deadline: float) -> None:
    """Set a new deadline and let the clock run again, as after a compilation that postpones the deadline."""
    clock[DEADLINE], clock[UP] = deadline, 0.0


@kernel
def worked(clock, work):
    """Add to the work counted, read the time if enough has been done since last, and return whether time is up."""
    clock[LEFT] -= work
    if clock[LEFT] < 0.0:
        with numba.objmode(at="float64"):
            at = now()
        clock[LEFT] = STRIDE
        clock[LOOKS] += 1.0
        if at > clock[DEADLINE]:
            clock[UP] = 1.0
    return clock[UP] > 0.0

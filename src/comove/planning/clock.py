"""The clock of budgets: processor time and a count of work.

Compiled loops read it as well. A budget bounds the processor time of this process with all its threads: other
programs and waiting cost nothing. Shares of a budget, and budgets that must give the same result on every machine,
are counts of work: computed distances, and for other steps as many distances as would take about as long.

Kernels add to the count, and read the time after every few milliseconds of work. Once the budget is spent, they
report every configuration as not free, so that their loops end; the caller checks the clock as well and ends the
search. Until then the clock does not change any result.
"""

from __future__ import annotations

import ctypes
import time
from dataclasses import dataclass, replace
from functools import partial
from operator import methodcaller

import llvmlite.binding as llvm
import numpy as np
from numba import types

from comove.arrays import Array
from comove.compiled import kernel

DEADLINE, LEFT, UP, LOOKS, WORK, MOST = range(6)  # columns of a clock
STRIDE = 20_000  # computed distances, or as much work, between two readings of the time: some milliseconds
A_SECOND = 4e7  # computed distances in about a second
ENOUGH = 10.0  # s, least budget that is advised


def now() -> float:
    """Return the processor time of this process [s]."""
    return time.process_time()


@dataclass(frozen=True)
class Budget:
    """The bounds of a search, which ends at the first one reached.

    Attributes
    ----------
    seconds : processor time [s]
    work : computed distances, or as much work, in units of about a second's; a search that it bounds gives the same
        result on every machine
    size : work of which stages get shares, in the same units; the smaller of the two bounds unless given
    given : the whole budget of which this one is a part, for messages [s]; None where it was no time
    option : how a larger one is given, for messages
    """

    seconds: float = np.inf
    work: float = np.inf
    size: float = np.nan
    given: float | None = None
    option: str = "--budget"

    def __post_init__(self) -> None:
        if np.isnan(self.size):
            object.__setattr__(self, "size", min(self.seconds, self.work))

    @classmethod
    def of(cls, budget: float | Budget, option: str = "--budget") -> Budget:
        """Return a number of seconds as a budget. A budget is returned unchanged."""
        if isinstance(budget, Budget):
            return budget
        return cls(float(budget), given=float(budget), option=option)

    @property
    def is_spent(self) -> bool:
        """Return whether nothing is left."""
        return self.seconds <= 0.0 or self.work <= 0.0

    def after(self, seconds: float, work: float = 0.0) -> Budget:
        """Return the rest of the budget after some seconds and work. The time spent does not change the size."""
        left = max(self.size - work, 0.0)
        return replace(self, seconds=self.seconds - seconds, work=self.work - work, size=left)

    def within(self, work: float) -> Budget:
        """Return the budget with another bound of the work besides."""
        return replace(self, work=min(self.work, work), size=min(self.size, work))

    @property
    def ran_out(self) -> str:
        """Return the message that the budget ran out, and how to continue."""
        if self.given is None:
            return "the search was ended before a motion was verified"
        return (
            f"the time budget of {self.given:g} s ran out before a motion was verified: "
            f"{self.option} {max(2.0 * self.given, ENOUGH):g} lets the search go on"
        )


# Kernels call it by its symbol. It runs no bytecode, in which Python would handle Ctrl-C and lose what that raises.
_reading = ctypes.CFUNCTYPE(ctypes.c_double)(partial(methodcaller("process_time"), time))
_SYMBOL = "comove.processor_time"
llvm.add_symbol(_SYMBOL, ctypes.cast(_reading, ctypes.c_void_p).value)
_processor_time = types.ExternalFunction(_SYMBOL, types.float64())


def clock_until(deadline: float = np.inf, work: float = np.inf) -> Array:
    """Return a clock that expires at a deadline or work. The deadline is a time of `now` [s]."""
    clock = np.zeros(6)
    clock[LEFT], clock[MOST] = STRIDE, work
    wind(clock, deadline)
    return clock


def wind(clock: Array, deadline: float) -> None:
    """Set a new deadline and restart the clock, as after a compilation."""
    clock[DEADLINE], clock[UP] = deadline, 0.0


@kernel
def worked(clock, work):
    """Add to the work counted; return whether time is up. The time is read only once in a while."""
    clock[LEFT] -= work
    clock[WORK] += work
    if clock[WORK] > clock[MOST]:
        clock[UP] = 1.0
    if clock[LEFT] < 0.0:
        clock[LEFT] = STRIDE
        clock[LOOKS] += 1.0
        if _processor_time() > clock[DEADLINE]:
            clock[UP] = 1.0
    return clock[UP] > 0.0

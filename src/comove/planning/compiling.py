"""The compilation of kernels, counted by the clock of budgets."""

from __future__ import annotations

from contextlib import AbstractContextManager

from comove.compiled import counting
from comove.compiled.counting import IN_ALL, Compiled, KernelCallback
from comove.planning.clock import now

__all__ = ["IN_ALL", "Compiled", "compiling"]


def compiling(
    tell: KernelCallback | None = None, compiled: Compiled | None = None
) -> AbstractContextManager[Compiled]:
    """Count the kernels compiled in a context, by the clock of budgets. See `comove.compiled.counting`."""
    return counting.compiling(tell, compiled, now)

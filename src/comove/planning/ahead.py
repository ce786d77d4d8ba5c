"""Plans of the next path, computed while the last one is smoothed.

Plans depend on what was known when they were begun, never on when they end: each set has its own generator of random
numbers, clock, and share of the work. A search without another core computes them when they are needed.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from comove.arrays import Array
from comove.planning.clock import DEADLINE, LEFT, MOST, UP, WORK, clock_until
from comove.planning.search import Search
from comove.processes import ALONE, n_processors

PAUSE = 0.02  # s, between two looks whether the search is over

Plan = tuple[Array, Array]
"""Movements to fit, as `fit` takes them, and where they end."""
Targets = Callable[[int, int, np.random.Generator], Plan | None]
"""A planner: what a number of failures, a number of nodes and a generator lead to; None for no path."""


@dataclass(eq=False)
class PlansAhead:
    """Plans that are begun before they are needed.

    Attributes
    ----------
    search : the search that needs them
    planner : function of a clock that returns a planner
    count : number of plans of a path
    """

    search: Search
    planner: Callable[[Array], Targets]
    count: int
    _begun: Callable[[float], list[Plan | None]] | None = field(default=None, init=False)
    _future: Future[list[Plan | None]] | None = field(default=None, init=False)

    @cached_property
    def clock(self) -> Array:
        """Return the planner's own clock."""
        return clock_until()

    @cached_property
    def _targets(self) -> Targets:
        return self.planner(self.clock)

    @property
    def are_begun(self) -> bool:
        """Return whether plans were begun that are not taken yet."""
        return self._begun is not None

    def begin(self, failures: int, max_nodes: int) -> None:
        """Begin the plans of the next path."""
        left = self.search.clock.array[MOST] - self.search.clock.array[WORK]
        rng = self.search.rng.spawn(1)[0]

        def plans(deadline: float) -> list[Plan | None]:
            self.clock[:] = clock_until(deadline, left)
            if deadline == np.inf:  # reading the time waits for the interpreter
                self.clock[LEFT] = np.inf
            return list(drawn(self._targets, self.count, failures, max_nodes, rng))

        self._begun = plans
        if n_processors() > 1 and ALONE not in os.environ:
            self._future = _started(plans)

    def taken(self) -> list[Plan | None] | None:
        """Return the plans that were begun; None if none were.

        The last of them is None if it failed.
        """
        if self._begun is None:
            return None
        if self._future is None:
            plans = self._begun(self.search.clock.array[DEADLINE])
        else:
            while not self._future.done():
                wait([self._future], PAUSE)
                if self.search.over():
                    self.clock[UP] = 1.0
            plans = self._future.result()
        self._begun = self._future = None
        self.search.clock.add_work(self.clock[WORK])
        return plans

    def close(self) -> None:
        """End plans that are not needed any more."""
        while self._future is not None and not self._future.done():
            self.clock[UP] = 1.0  # again, as a plan that only begins winds its clock
            wait([self._future], PAUSE)
        self._begun = self._future = None


def _started(plans: Callable[[float], list[Plan | None]]) -> Future[list[Plan | None]] | None:
    """Start plans without a deadline in a thread; None where no thread starts, as the interpreter ends.

    The thread is a daemon: those of executors hold the interpreter up, and none starts after the main thread's end.
    """
    future = Future[list[Plan | None]]()

    def work() -> None:
        try:
            future.set_result(plans(np.inf))
        except BaseException as error:
            future.set_exception(error)

    try:
        threading.Thread(target=work, daemon=True, name="comove-plans").start()
    except RuntimeError:
        return None
    return future


def drawn(
    targets: Targets, count: int, failures: int, max_nodes: int, rng: np.random.Generator
) -> Iterator[Plan | None]:
    """Yield `count` plans, or all up to the first that fails, None."""
    for _ in range(count):
        yield (plan := targets(failures, max_nodes, rng))
        if plan is None:
            return

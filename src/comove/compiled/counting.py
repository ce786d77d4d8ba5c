"""Counters of kernels compiled and loaded in a context, with times."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from numba.core import event

from comove.compiled.cache import LOADING

PACKAGE = "comove."
ONCE = "compiling, once after installation"
KernelCallback = Callable[[str], None]
Clock = Callable[[], float]


@dataclass
class Compiled:
    """Counters of compiled kernels so far.

    Attributes
    ----------
    kernels : number of kernels
    seconds : time that it took, and that it took to load others from the cache [s]
    """

    kernels: int = 0
    seconds: float = 0.0


IN_ALL = Compiled()  # what commands have watched in this process


class _Listener(event.Listener):
    """A listener that counts and reports compiled kernels, nested ones included."""

    def __init__(self, compiled: Compiled, tell: KernelCallback | None, clock: Clock):
        self.compiled, self.tell, self.clock = compiled, tell, clock
        self._depth, self._begun, self._told = 0, 0.0, False

    def on_start(self, event: event.Event) -> None:
        if self._depth == 0:
            self._begun, self._told = self.clock(), False
        self._depth += 1
        if event.kind == LOADING:
            return
        function = event.data["dispatcher"].py_func
        if not function.__module__.startswith(PACKAGE):
            return  # what Numba makes for our kernels
        self.compiled.kernels += 1
        if self.tell is not None:
            self._told = True
            self.tell(f"{function.__module__.removeprefix(PACKAGE)}.{function.__name__}")

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0:
            self.compiled.seconds += self.clock() - self._begun
            if self.tell is not None and self._told:
                self.tell("")


@contextmanager
def compiling(
    tell: KernelCallback | None = None, compiled: Compiled | None = None, clock: Clock = time.perf_counter
) -> Iterator[Compiled]:
    """Count the kernels compiled in this context, and measure the time.

    Parameters
    ----------
    tell : function that is called with the name of every kernel when its compilation begins, and with "" when all
        compilation has ended
    compiled : counters to add to, which the context yields; new ones unless given
    clock : function that returns the time [s]
    """
    compiled = Compiled() if compiled is None else compiled
    listener = _Listener(compiled, tell, clock)
    with event.install_listener("numba:compile", listener), event.install_listener(LOADING, listener):
        yield compiled


@dataclass(frozen=True)
class WarmUp:
    """A warm-up in progress.

    Attributes
    ----------
    kernels : about how many will be compiled
    workers : number of processes
    file : as long in bytes as kernels have been compiled
    """

    kernels: int
    workers: int
    file: Path

    @property
    def words(self) -> str:
        """Return a description of the progress."""
        return f"{ONCE}, on {self.workers} {'core' if self.workers == 1 else 'cores'}"

    @property
    def share(self) -> float:
        """Return the approximate share of compiled kernels."""
        with suppress(OSError):
            return min(self.file.stat().st_size / self.kernels, 0.99)
        return 0.99


Display = Callable[[WarmUp], AbstractContextManager]
displays: list[Display] = []


@contextmanager
def shown_by(display: Display) -> Iterator[None]:
    """Show warm-ups by a function in this context. Remaining jobs continue in the background afterwards."""
    displays.append(display)
    try:
        yield
    finally:
        displays.remove(display)

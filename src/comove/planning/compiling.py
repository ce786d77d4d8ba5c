"""What is compiled: once after installation, kernel by kernel, for a minute or two."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from numba.core import event
from numba.core.dispatcher import LiftedCode

PACKAGE = "comove."
KernelCallback = Callable[[str], None]


@dataclass
class Compiled:
    """What has been compiled so far.

    Attributes
    ----------
    kernels : how many
    seconds : how long it took [s]
    """

    kernels: int = 0
    seconds: float = 0.0


IN_ALL = Compiled()  # what commands have watched in this process


class _Listener(event.Listener):
    """Counts and tells; a kernel that needs others is compiled around them."""

    def __init__(self, compiled: Compiled, tell: KernelCallback | None):
        self.compiled, self.tell = compiled, tell
        self._depth, self._begun = 0, 0.0

    def on_start(self, event: event.Event) -> None:
        if not _counts(event):
            return
        if self._depth == 0:
            self._begun = time.perf_counter()
        self._depth += 1
        function = event.data["dispatcher"].py_func
        if not function.__module__.startswith(PACKAGE):
            return  # what Numba makes for our kernels
        self.compiled.kernels += 1
        if self.tell is not None:
            self.tell(f"{function.__module__.removeprefix(PACKAGE)}.{function.__name__}")

    def on_end(self, event: event.Event) -> None:
        if not _counts(event):
            return
        self._depth -= 1
        if self._depth == 0:
            self.compiled.seconds += time.perf_counter() - self._begun
            if self.tell is not None:
                self.tell("")


def _counts(event: event.Event) -> bool:
    """Not what is interpreted within a kernel: it is never cached, and takes no time to speak of."""
    return not isinstance(event.data["dispatcher"], LiftedCode)


@contextmanager
def compiling(tell: KernelCallback | None = None, compiled: Compiled | None = None) -> Iterator[Compiled]:
    """Watch what is compiled; what is loaded from the cache does not count.

    Parameters
    ----------
    tell : called with the name of every kernel when its turn comes, and with "" when nothing is compiled any more
    compiled : to which it is added, and which is given; begins empty unless given
    """
    compiled = Compiled() if compiled is None else compiled
    with event.install_listener("numba:compile", _Listener(compiled, tell)):
        yield compiled

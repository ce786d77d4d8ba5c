"""How those who wait for compiled kernels are shown that they do."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class WarmUp:
    """A warm-up in progress.

    Attributes
    ----------
    kernels : about how many will be compiled
    workers : number of processes
    """

    kernels: int
    workers: int
    file: Path

    @property
    def share(self) -> float:
        """Return about which share of the kernels has been compiled."""
        with suppress(OSError):
            return min(self.file.stat().st_size / self.kernels, 0.99)
        return 0.99


Display = Callable[[WarmUp], AbstractContextManager]
displays: list[Display] = []


@contextmanager
def shown_by(display: Display) -> Iterator[None]:
    """Let a function show warm-ups in this context, after which the jobs that are left go on in the background."""
    displays.append(display)
    try:
        yield
    finally:
        displays.remove(display)

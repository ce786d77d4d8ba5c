"""Progress bars on terminals, and a note on the warm-up elsewhere."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from comove.cli.app import since_process_start
from comove.cli.streams import terminal

_waited = 0.0  # s, for warm-ups


def time_spent() -> float:
    """Return the time since process start [s], without compilation of kernels."""
    from comove.compiled.counting import IN_ALL

    return since_process_start() - IN_ALL.seconds - _waited


@contextmanager
def progress_bar(budget: float | None = None, doing: str = "planning") -> Iterator[Any]:
    """Yield a progress callback for `solve`; None without a terminal.

    It shows generation, cost, constraint and best so far. Where kernels must be compiled first, a note with the
    expected time is shown.

    Parameters
    ----------
    budget : length of the bar, processor time [s]; without it, a bar is shown only during a warm-up
    doing : text shown before the first call of the callback
    """
    from comove.compiled.counting import IN_ALL, compiling, shown_by

    shown = _Bar(budget, doing) if sys.stderr.isatty() else _Line()
    with compiling(compiled=IN_ALL), shown_by(shown.warming_up):
        try:
            yield shown.progress
        finally:
            shown.close()


class _Line:
    """Progress display without a terminal, which notes compilation once."""

    progress = None

    @contextmanager
    def warming_up(self, state: Any) -> Iterator[None]:
        print(f"{state.words}: up to a minute that does not count", file=sys.stderr, flush=True)
        with _not_counted():
            yield

    def close(self) -> None:
        """Do nothing, as there is nothing to remove."""


class _Bar:
    """Bar of elapsed and processor time, restarted after a warm-up."""

    def __init__(self, budget: float | None, doing: str):
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self.budget, self.doing, self.begun = budget, doing, time.process_time()
        columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
        console = Console(file=terminal(), force_terminal=True)
        self.bar = Progress(*columns, console=console, transient=True)
        self.task = self.bar.add_task(doing, total=budget)
        if budget is not None:
            self.bar.start()

    @contextmanager
    def warming_up(self, state: Any) -> Iterator[None]:
        told, ended, begun = state.words, threading.Event(), time.monotonic()

        def follow() -> None:
            while not ended.wait(0.2):
                share = state.share
                left = (time.monotonic() - begun) * (1.0 / share - 1.0) if share > 0.0 else None
                more = "" if left is None else f" · about {left:.0f} s left"
                self.bar.update(self.task, completed=share, description=told + more)

        self.bar.reset(self.task, total=1.0, description=told)
        self.bar.start()
        follower = threading.Thread(target=follow, daemon=True)
        follower.start()
        try:
            with _not_counted():
                yield
        finally:
            ended.set()
            follower.join()
            self.begun = time.process_time()
            if self.budget is None:
                self.bar.stop()
            self.bar.reset(self.task, description=self.doing, total=self.budget)

    def progress(self, state: Any) -> None:
        self.bar.update(self.task, completed=time.process_time() - self.begun, description=state.words)

    def close(self) -> None:
        self.bar.stop()


@contextmanager
def _not_counted() -> Iterator[None]:
    global _waited
    begun = time.monotonic()
    try:
        yield
    finally:
        _waited += time.monotonic() - begun

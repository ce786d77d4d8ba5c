"""Output on standard error during long work: a progress bar on terminals, and a note on compilation in any case."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from comove.cli.app import since_process_start
from comove.cli.streams import terminal

ONCE = "compiling, once after installation"


def time_spent() -> float:
    """Return the time since this process began [s], without the time of compiling kernels."""
    from comove.compiled.counting import IN_ALL

    return since_process_start() - IN_ALL.seconds


@contextmanager
def progress_bar(budget: float | None = None, doing: str = "planning") -> Iterator[Any]:
    """Yield a callback for `solve` that shows generation, cost, constraint and best so far; None without a terminal.

    Parameters
    ----------
    budget : length of the bar, processor time [s]; without it, a bar is shown only during compilation
    doing : text shown before the first call of the callback
    """
    from comove.compiled.counting import IN_ALL, compiling

    shown = _Bar(budget, doing) if sys.stderr.isatty() else _Line()
    with compiling(shown.compiling, IN_ALL):
        try:
            yield shown.progress
        finally:
            shown.close()


class _Line:
    """A line that says once that kernels are being compiled; the progress display without a terminal."""

    progress = None
    said = False

    def compiling(self, kernel: str) -> None:
        if kernel and not _Line.said:
            _Line.said = True
            print(f"{ONCE}: up to a minute that does not count", file=sys.stderr, flush=True)

    def close(self) -> None:
        """Do nothing, as there is nothing to remove."""


class _Bar:
    """A bar that shows the elapsed time and fills with the processor time; it begins anew after a compilation."""

    def __init__(self, budget: float | None, doing: str):
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

        self.budget, self.doing, self.kernels, self.begun = budget, doing, 0, time.process_time()
        columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
        console = Console(file=terminal(), force_terminal=True)
        self.bar = Progress(*columns, console=console, transient=True)
        self.task = self.bar.add_task(doing, total=budget)
        if budget is not None:
            self.bar.start()

    def compiling(self, kernel: str) -> None:
        if not kernel:
            self.kernels, self.begun = 0, time.process_time()
            if self.budget is None:
                self.bar.stop()
            self.bar.reset(self.task, description=self.doing, total=self.budget)
            return
        self.kernels += 1
        description = f"{ONCE} · kernel {self.kernels}, {kernel}"
        if self.kernels == 1:
            self.bar.reset(self.task, total=None, description=description)
            self.bar.start()
        self.bar.update(self.task, description=description)

    def progress(self, state: Any) -> None:
        self.bar.update(self.task, completed=time.process_time() - self.begun, description=state.words)

    def close(self) -> None:
        self.bar.stop()

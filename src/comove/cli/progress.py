"""The progress bar; silent where standard error is no terminal."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def progress_bar(budget: float) -> Iterator:
    """A callback for `solve` that shows generation, cost, constraint and the best so far."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("planning", total=budget)

        def show(state) -> None:
            best = "none yet" if state.best is None else f"{state.best:.4f}"
            bar.update(
                task,
                completed=bar.tasks[0].elapsed or 0.0,
                description=f"{state.stage} · generation {state.generation} · cost {state.cost:.4f} · "
                f"constraint {state.violation:.2g} · best verified {best}",
            )

        yield show

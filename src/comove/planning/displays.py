"""The progress of a search as a line of text."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from comove.compiled.counting import WarmUp, shown_by
from comove.errors import OptionError
from comove.io.notebooks import NotebookLine, StreamLine, in_notebook
from comove.planning.clock import Budget, now
from comove.planning.compiling import Compiled, compiling
from comove.planning.solution import Progress, ProgressCallback

DELAY, PAUSE = 0.5, 0.2  # s, on the wall: before the first line, and between two


@contextmanager
def displayed(
    progress: ProgressCallback | bool | None, budget: float | Budget
) -> Iterator[ProgressCallback | Literal[False]]:
    """Yield the function that a search calls with its progress; False for none.

    Parameters
    ----------
    progress : function of the caller; or whether a line is shown, which None leaves to whether this is a notebook
    budget : budget of the search

    Raises
    ------
    OptionError
        If `progress` is none of these.
    """
    if progress is None:
        progress = in_notebook()
    if not isinstance(progress, bool):
        if not callable(progress):
            raise OptionError(f"progress = {progress!r}", way_out="give a function, True, False or None")
        yield progress
    elif not progress:
        yield False
    else:
        line = _Line(Budget.of(budget))
        with compiling(compiled=line.compiled), shown_by(line.warming_up):
            try:
                yield line.progress
            finally:
                line.close()


class _Line:
    """The line of one search."""

    def __init__(self, budget: Budget):
        self._line = NotebookLine() if in_notebook() else StreamLine()
        self._budget, self._begun, self._best = budget, now(), ""
        self._next = time.perf_counter() + DELAY
        self._is_shown = False
        self.compiled = Compiled()

    def progress(self, state: Progress) -> None:
        self._best = state.best_words
        left = self._budget.seconds - self._spent
        self._show(state.words + (f" · {max(left, 0.0):.0f} s left" if left < float("inf") else ""))

    @contextmanager
    def warming_up(self, state: WarmUp) -> Iterator[None]:
        self._show(state.words)
        begun = now()
        yield
        self.compiled.seconds += now() - begun

    def close(self) -> None:
        if self._is_shown:
            self._line.show(
                f"done in {self._spent:.1f} s of processor time{self._best and f' · {self._best}'}"
            )

    @property
    def _spent(self) -> float:
        return now() - self._begun - self.compiled.seconds

    def _show(self, text: str) -> None:
        at = time.perf_counter()
        if at >= self._next:
            self._next, self._is_shown = at + PAUSE, True
            self._line.show(text)

"""Detection of notebooks, and status lines for notebooks and terminals."""

from __future__ import annotations

import sys
from typing import Any


def in_notebook() -> bool:
    """Return whether the program runs in a notebook, not a terminal."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return hasattr(shell, "kernel")


class NotebookLine:
    """Line of text below the running cell, replaced by the next."""

    def __init__(self) -> None:
        self._handle: Any = None

    def show(self, text: str) -> None:
        """Replace the text shown."""
        from IPython.display import display

        data = {"text/plain": text}
        if self._handle is None:
            self._handle = display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)


class StreamLine:
    """Line on standard error, replaced by the next on a terminal."""

    def show(self, text: str) -> None:
        """Show a text."""
        print(f"{text:<79}", end="\r" if sys.stderr.isatty() else "\n", file=sys.stderr, flush=True)

"""Notebooks: whether this is one, and a line of text in it that changes."""

from __future__ import annotations

import sys
from typing import Any


def in_notebook() -> bool:
    """Return whether this runs in a notebook, which shows pages, and not in a terminal."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return hasattr(shell, "kernel")


class NotebookLine:
    """A line of text below the running cell of a notebook, replaced by the next one."""

    def __init__(self) -> None:
        self._handle: Any = None

    def show(self, text: str) -> None:
        """Show a text in place of the one before."""
        from IPython.display import display

        data = {"text/plain": text}
        if self._handle is None:
            self._handle = display(data, raw=True, display_id=True)
        else:
            self._handle.update(data, raw=True)


class StreamLine:
    """A line of text on standard error; on a terminal it is replaced by the next one."""

    def show(self, text: str) -> None:
        """Show a text."""
        print(f"{text:<79}", end="\r" if sys.stderr.isatty() else "\n", file=sys.stderr, flush=True)

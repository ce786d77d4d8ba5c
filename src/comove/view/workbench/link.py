"""Connection of a page to its planner process. The process is started with the page, gets the newest draft, and ends
with the page."""

from __future__ import annotations

import asyncio
import itertools
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from comove.processes import end_process, start_process
from comove.view.workbench.edits import Draft
from comove.view.workbench.protocol import Mailbox, Message, SearchTimes
from comove.view.workbench.shelf import Item

Answered = Callable[["Link", Message], None]


def on_loop(loop: asyncio.AbstractEventLoop, answered: Answered) -> Answered:
    """Return a function that passes answers to an event loop. The answers come from a link's thread."""

    def hand_over(link: Link, message: Message) -> None:
        with suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(answered, link, message)

    return hand_over


class Link:
    """A planner in a process of its own.

    Parameters
    ----------
    folder : folder to which paths in drafts are relative
    answered : function that is called with this link and every answer, from a thread of its own; with
        `{"kind": "ended"}` at last

    Attributes
    ----------
    asked, answered, solved : numbers of the newest draft that was sent, of the newest that was answered, and of the
        newest with a final answer; -1 before
    """

    def __init__(self, folder: Path, answered: Answered):
        self.folder, self._answered = folder, answered
        self.asked = self.answered = self.solved = -1
        self._numbers = itertools.count()
        self._mailbox = Mailbox()
        self._process, self._connection = start_process(
            "comove.view.workbench.worker",
            start_new_session=True,  # Ctrl-C ends the page, which ends this
        )
        for work in (self._write, self._read):
            threading.Thread(target=work, daemon=True).start()

    @property
    def pid(self) -> int:
        """Return the number of the process."""
        return self._process.pid

    def submit(
        self, draft: Draft, times: SearchTimes, *, dragging: bool = False, item: Item | None = None
    ) -> None:
        """Send a draft, which replaces the one before; answers name it by the number `asked`.

        Parameters
        ----------
        dragging : whether more will follow at once: a motion that is still verified is then good enough
        item : what of a result folder is wanted instead of a search
        """
        if item is not None:
            item = item.absolute()
        self.asked = self._put(
            "draft", folder=self.folder.absolute(), draft=draft, times=times, dragging=dragging, item=item
        )

    def run(self, draft: Draft) -> None:
        """Ask for a draft to be executed step by step; answers name it by the number `asked`."""
        self.asked = self._put("run", folder=self.folder.absolute(), draft=draft)

    def lead(self, obstacle: int, place: Sequence[float]) -> None:
        """Send the position to which an obstacle is dragged [m]."""
        self._put("lead", obstacle=obstacle, place=list(place))

    def halt(self) -> None:
        """Stop the run."""
        self._put("halt")

    def drop(self) -> None:
        """Return an unused number for an invalid scene. Answers to earlier drafts are thereby outdated."""
        self.asked = next(self._numbers)

    def save(self, of: int, target: Path, seed: int = 0) -> int:
        """Request that a draft's result is saved; return the request's number."""
        return self._put("save", of=of, target=target, seed=seed)

    def _put(self, kind: str, **told: Any) -> int:
        """Send a message; return its number."""
        number = next(self._numbers)
        self._mailbox.put({"kind": kind, "id": number, **told})
        return number

    def close(self) -> None:
        """End the process."""
        self._mailbox.close()
        threading.Thread(target=end_process, args=[self._process], daemon=True).start()

    def _write(self) -> None:
        while (message := self._mailbox.take()) is not None:
            with suppress(OSError):  # it has ended, which reading will tell
                self._connection.send(message)

    def _read(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._answered(self, self._connection.recv())
        self._connection.close()
        self._answered(self, {"kind": "ended", "id": -1})

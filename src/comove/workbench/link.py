"""The page's end of its planner: a process that is started, fed with the newest draft, and ended with the page."""

from __future__ import annotations

import itertools
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from comove.workbench.edits import Draft
from comove.workbench.protocol import Message, read_message, write_message
from comove.workbench.shelf import Item

BUDGET = 5.0  # s, after which a search takes the best motion so far
BUDGET_WITH_ARMS = 15.0  # s, likewise where arms follow
LEAVE = 1.0  # s, that the process has to end by itself

Answered = Callable[[Message], None]


class Link:
    """A planner in a process of its own.

    Parameters
    ----------
    folder : folder to which paths in drafts are relative
    answered : function that is called with every answer, from a thread of its own; with `{"kind": "ended"}` at last
    """

    def __init__(self, folder: Path, answered: Answered):
        self.folder, self._answered = folder, answered
        self._numbers = itertools.count()
        self._slot: Message | None = None
        self._queue: list[Message] = []
        self._changed = threading.Condition()
        self._closed = False
        # -P: a folder called comove where the page was started from must not be taken for the package
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-m", "comove.workbench.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,  # Ctrl-C ends the page, which ends this
        )
        for work in (self._write, self._read):
            threading.Thread(target=work, daemon=True).start()

    @property
    def pid(self) -> int:
        """Return the number of the process."""
        return self._process.pid

    def submit(
        self, draft: Draft, *, dragging: bool = False, budget: float = BUDGET, item: Item | None = None
    ) -> int:
        """Send a draft, which replaces the one before; return the number by which answers name it.

        Parameters
        ----------
        dragging : whether more will follow at once: a motion that is still verified is then good enough
        budget : time of the search [s]
        item : what of a result folder is wanted instead of a search
        """
        return self._put(
            self._header("draft", draft)
            | {
                "budget": budget,
                "dragging": dragging,
                "result": None if item is None or item.result is None else str(item.result.absolute()),
                "part": None if item is None else item.part.value,
            }
        )

    def _header(self, kind: str, draft: Draft) -> dict[str, Any]:
        return {
            "kind": kind,
            "id": next(self._numbers),
            "folder": str(self.folder.absolute()),
            "contents": draft.contents,
            "method": draft.method,
            "objective": draft.objective,
            "resemblance": draft.resemblance,
            "seed": draft.seed,
            "taught": draft.taught,
        }

    def run(self, draft: Draft) -> int:
        """Ask for a draft to be executed step by step; return the number by which answers name it."""
        return self._put(self._header("run", draft))

    def lead(self, obstacle: int, place: Sequence[float]) -> None:
        """Tell the run where an obstacle is led [m]."""
        self._put({"kind": "lead", "id": -1, "obstacle": obstacle, "place": list(place)})

    def halt(self) -> None:
        """End the run where it is."""
        self._put({"kind": "halt", "id": -1})

    def drop(self) -> int:
        """Take a number that no answer will have, as what is shown is no scene; answers to earlier drafts are old."""
        return next(self._numbers)

    def save(self, of: int, target: Path, seed: int = 0) -> int:
        """Ask for the result of a draft to be written into a folder; return the number of the answer."""
        number = next(self._numbers)
        return self._put({"kind": "save", "id": number, "of": of, "target": str(target), "seed": seed})

    def _put(self, header: dict[str, Any]) -> int:
        with self._changed:
            if header["kind"] == "draft":
                self._slot = Message(header)
            else:
                self._queue.append(Message(header))
            self._changed.notify()
        return header["id"]

    def close(self) -> None:
        """End the process."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        threading.Thread(target=self._end, daemon=True).start()

    def _end(self) -> None:
        with suppress(OSError, ValueError):
            self._process.terminate()
        try:
            self._process.wait(LEAVE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _write(self) -> None:
        stream = self._process.stdin
        while stream is not None:
            with self._changed:
                self._changed.wait_for(lambda: self._closed or self._queue or self._slot is not None)
                if self._closed:
                    return
                message = self._queue.pop(0) if self._queue else self._slot
                if message is self._slot:
                    self._slot = None
            if message is not None:
                with suppress(OSError, ValueError):
                    write_message(stream, message)

    def _read(self) -> None:
        stream = self._process.stdout
        while stream is not None:
            message = None
            with suppress(OSError, ValueError):
                message = read_message(stream)
            if message is None:
                break
            self._answered(message)
        self._answered(Message({"kind": "ended", "id": -1}))

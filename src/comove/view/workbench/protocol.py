"""Messages between the workbench and its planner, and where they wait at either end.

Both ends are processes of one program, which talk over a socket of their own; what passes is pickled, as between the
processes of a pool, and never read from a file.
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass
from typing import Any

Message = dict[str, Any]
"""A message: its "kind", the number "id" of the draft that it is about, and whatever belongs to the kind."""


@dataclass(frozen=True)
class SearchTimes:
    """Times that the planner of a page keeps to, so that a person who drags sees at once what comes of it.

    Attributes
    ----------
    budget : processor time after which a search takes the best motion so far [s]
    patience : that a search has to find its first motion although a newer draft waits [s]
    pause : between better motions that are sent [s]
    """

    budget: float = 5.0
    patience: float = 0.25
    pause: float = 0.4


class Mailbox:
    """A mailbox with one slot for drafts, where the newest replaces the one before; other messages queue.

    Attributes
    ----------
    draft : draft that waits; None where none does
    closed : whether nothing comes any more
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self.draft: Message | None = None
        self._others: deque[Message] = deque()
        self.closed = False

    def put(self, message: Message) -> None:
        """Add a message."""
        with self._changed:
            if message["kind"] == "draft":
                self.draft = message
            else:
                self._others.append(message)
            self._changed.notify()

    def close(self) -> None:
        """Note that nothing comes any more."""
        with self._changed:
            self.closed = True
            self._changed.notify()

    def take(self) -> Message | None:
        """Wait for a message and return it, drafts last; None once the mailbox is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed or self._others or self.draft is not None)
            if self.closed:
                return None
            if self._others:
                return self._others.popleft()
            message, self.draft = self.draft, None
            return message

"""Messages between the workbench and its planner, and their mailboxes.

Both ends are processes of one program that communicate over a socket of their own; messages are pickled, as between
the processes of a pool, and never read from a file.
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
    """Times of a page's planner, short enough for interactive dragging.

    Attributes
    ----------
    budget : processor time after which a search returns the best motion so far [s]
    patience : time for a search to find its first motion although a newer draft waits [s]
    pause : time between better motions that are sent [s]
    """

    budget: float = 5.0
    patience: float = 0.25
    pause: float = 0.4


class Mailbox:
    """Mailbox with a slot for the newest draft and a queue.

    Attributes
    ----------
    draft : waiting draft; None without one
    closed : whether no further message can arrive
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
        """Close the mailbox for further messages."""
        with self._changed:
            self.closed = True
            self._changed.notify()

    def take(self) -> Message | None:
        """Wait for a message and return it, drafts last. Return None once the mailbox is closed."""
        with self._changed:
            self._changed.wait_for(lambda: self.closed or self._others or self.draft is not None)
            if self.closed:
                return None
            if self._others:
                return self._others.popleft()
            message, self.draft = self.draft, None
            return message

"""Messages between the workbench and its planner: a header of JSON, and arrays, over a pair of pipes.

Both ends belong to one program, but nothing is executed that arrives: there are no pickled objects. At either end
messages wait in a `Mailbox`, in which a newer draft replaces the one before.
"""

from __future__ import annotations

import io
import json
import struct
import threading
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

HEAD = struct.Struct("<II")
"""Lengths of the header and of the arrays [bytes]."""


@dataclass(frozen=True, eq=False)
class Message:
    """A message: what it says, and arrays by name."""

    header: Mapping[str, Any]
    arrays: Mapping[str, Any] = field(default_factory=dict)


def write_message(stream: IO[bytes], message: Message) -> None:
    """Write a message to a pipe.

    Raises
    ------
    OSError
        If nobody reads it any more.
    """
    header = json.dumps(dict(message.header), allow_nan=True).encode()
    packed = io.BytesIO()
    if message.arrays:
        np.savez(packed, **message.arrays)
    arrays = packed.getvalue()
    stream.write(HEAD.pack(len(header), len(arrays)) + header + arrays)
    stream.flush()


def read_message(stream: IO[bytes]) -> Message | None:
    """Read a message from a pipe; None where the other end has closed it."""
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    n_header, n_arrays = HEAD.unpack(head)
    header, packed = stream.read(n_header), stream.read(n_arrays)
    if len(header) < n_header or len(packed) < n_arrays:
        return None
    arrays: dict[str, NDArray] = {}
    if n_arrays:
        with np.load(io.BytesIO(packed), allow_pickle=False) as archive:
            arrays = {name: archive[name] for name in archive.files}
    return Message(json.loads(header), arrays)


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
            if message.header["kind"] == "draft":
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

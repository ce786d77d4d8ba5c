"""Standard streams with exit codes of their own for failures.

A reader that closes the pipe early (`comove show DIR | head -1`) ends the command quietly; a full disk behind
standard output ends it with a message. Both exit codes differ from those of verification. Messages that cannot be
written to standard error are dropped, as the exit code tells the same.
"""

from __future__ import annotations

import io
import os
import re
import select
import sys
from typing import Any, TextIO

from comove.errors import letters

CLOSED_PIPE, FULL_OUTPUT = 141, 74
_IN, _OUT, _ERR = 0, 1, 2


class _Output(io.FileIO):
    """Standard output that ends the process with an exit code on failure."""

    def write(self, data: Any) -> int:
        while True:
            try:
                written = super().write(data)
            except BrokenPipeError:
                self._end(CLOSED_PIPE)
            except OSError as error:
                print(
                    f"error: standard output cannot be written: {error.strerror}; write to another place",
                    file=sys.stderr,
                )
                self._end(FULL_OUTPUT)
            if written is not None:
                return written
            select.select([], [self], [])  # a pipe that does not wait

    def _end(self, code: int) -> None:
        _to_nowhere(self.fileno())  # what is still in the buffer
        raise SystemExit(code)


class _Messages(io.FileIO):
    """Standard error that drops messages which cannot be written."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data) or 0
        except OSError:
            _to_nowhere(self.fileno())
            return len(data)


def guard_streams() -> None:
    """Replace standard output and standard error by guarded streams.

    Characters that the encoding lacks are written as `\\xe4` is, and those that command a terminal as `\\u001b` is. A
    stream that was closed from the start is connected to the null device, so that no file opened later takes its
    number.
    """
    for number in (_IN, _OUT, _ERR):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
    _TERMINAL[:] = [
        _text(_Messages(_ERR, "w", closefd=False), sys.stderr, line_buffering=True, kind=io.TextIOWrapper)
    ]
    sys.stderr = _text(_Messages(_ERR, "w", closefd=False), sys.stderr, line_buffering=True)
    sys.stdout = _text(_Output(_OUT, "w", closefd=False), sys.stdout, line_buffering=os.isatty(_OUT))


class _Plain(io.TextIOWrapper):
    """Text stream that escapes terminal control characters. It prints names and messages from untrusted files; an
    escape is written as in JSON, so that JSON stays valid."""

    def write(self, text: str) -> int:
        super().write(text if _HARMLESS.fullmatch(text) else _UNSAFE.sub(_escaped, letters(text)))
        return len(text)


_UNSAFE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u061c\u202a-\u202e\u2028\u2029\u2066-\u2069]")
_HARMLESS = re.compile("[\t\n\x20-\x7e]*")


def _escaped(found: re.Match[str]) -> str:
    return f"\\u{ord(found[0]):04x}"


def terminal() -> TextIO:
    """Return standard error without escapes, for comove's own drawing."""
    return _TERMINAL[0] if _TERMINAL else sys.stderr


_TERMINAL: list[TextIO] = []


def _text(
    raw: io.FileIO, before: TextIO | None, *, line_buffering: bool, kind: type[io.TextIOWrapper] = _Plain
) -> io.TextIOWrapper:
    return kind(
        io.BufferedWriter(raw),
        encoding=getattr(before, "encoding", None) or "utf-8",
        errors="backslashreplace",
        line_buffering=line_buffering,
        write_through=getattr(before, "write_through", False),
    )


def _to_nowhere(number: int) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, number)
    os.close(nowhere)

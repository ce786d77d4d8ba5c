"""Standard streams whose failures are not mistaken for a verdict.

A reader that closes the pipe early (`comove show DIR | head -1`) ends the command quietly; a full disk behind
standard output ends it with a message; both with exit codes of their own. Messages that cannot be written to standard
error are dropped, as the exit code tells the same.
"""

from __future__ import annotations

import io
import os
import select
import sys
from typing import Any, TextIO

CLOSED_PIPE, FULL_OUTPUT = 141, 74
_IN, _OUT, _ERR = 0, 1, 2


class _Output(io.FileIO):
    """Standard output whose failures end the process, with an exit code of their own."""

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

    Characters that the encoding lacks are written as `\\xe4` is. A stream that was closed from the start is connected
    to the null device, so that no file opened later takes its number.
    """
    for number in (_IN, _OUT, _ERR):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
    sys.stderr = _text(_Messages(_ERR, "w", closefd=False), sys.stderr, line_buffering=True)
    sys.stdout = _text(_Output(_OUT, "w", closefd=False), sys.stdout, line_buffering=os.isatty(_OUT))


def _text(raw: io.FileIO, before: TextIO | None, *, line_buffering: bool) -> io.TextIOWrapper:
    return io.TextIOWrapper(
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

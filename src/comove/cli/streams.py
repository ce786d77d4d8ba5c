"""Standard streams that can fail without being taken for a verdict.

A reader who has heard enough (`comove show DIR | head -1`) ends the command quietly, a full disk behind standard
output ends it with a sentence; both by exit codes of their own. What cannot be said on standard error is left unsaid:
the exit code says it too.
"""

from __future__ import annotations

import io
import os
import select
import sys

CLOSED_PIPE, FULL_OUTPUT = 141, 74
_IN, _OUT, _ERR = 0, 1, 2


class _Output(io.FileIO):
    """Standard output: what goes wrong with it ends the process, by its own exit code."""

    def write(self, data) -> int:
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
    """Standard error: what cannot be told is dropped."""

    def write(self, data) -> int:
        try:
            return super().write(data) or 0
        except OSError:
            _to_nowhere(self.fileno())
            return len(data)


def guard_streams() -> None:
    """Put guarded streams in the place of standard output and standard error.

    Whatever the encoding, what it lacks is written as `\\xe4` is. A stream that was closed from the start goes
    nowhere, so that no file that is opened later is taken for it.
    """
    for number in (_IN, _OUT, _ERR):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
    sys.stderr = _text(_Messages(_ERR, "w", closefd=False), sys.stderr, line_buffering=True)
    sys.stdout = _text(_Output(_OUT, "w", closefd=False), sys.stdout, line_buffering=os.isatty(_OUT))


def _text(raw: io.FileIO, before: io.TextIOBase | None, *, line_buffering: bool) -> io.TextIOWrapper:
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

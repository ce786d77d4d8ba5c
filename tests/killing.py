"""Processes that are killed as `kill -9` does, at a chosen step, and whether processes live."""

import os
import signal
import sys
import time
from pathlib import Path


def killed_at(step, watched, work, *arguments):
    """Let a process of its own work, and kill itself before the given line of the files that are watched.

    Returns
    -------
    bool, whether it came that far
    """
    child = os.fork()
    if child == 0:
        seen = 0

        def trace(frame, event, _):
            nonlocal seen
            if frame.f_code.co_filename not in watched:
                return None
            if event == "line":
                seen += 1
                if seen == step:
                    os.kill(os.getpid(), signal.SIGKILL)
            return trace

        try:
            sys.settrace(trace)
            work(*arguments)
        finally:
            sys.settrace(None)
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def alive(pid):
    """Whether a process has not ended yet."""
    try:
        return Path(f"/proc/{pid}/stat").read_bytes().rpartition(b")")[2].split()[0] != b"Z"
    except OSError:
        return False


def soon(condition, seconds=600.0):
    """Wait until something comes to pass."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.05)

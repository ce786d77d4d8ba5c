"""Priority of what must be in time. It is used under ROS's own Python as well."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from threading import Thread, get_native_id

PLAYING, COMMANDING, SIMULATING = 20, 15, 10  # of 99, in real time: the shorter the turn, the sooner
SWITCH = 5e-4  # s, after which another thread of Python takes its turn
TASKS = "/proc/self/task"  # a folder for each thread of this process, those of ROS included


def prioritise(threads: Iterable[int], value: int) -> None:
    """Let threads, by native numbers, come before ordinary programs.

    That is allowed where the user may set priorities, as ros2_control requires as well (it has 50). What they start
    does not inherit it.
    """
    for thread in threads:
        _set(thread, "SCHED_FIFO", value)


def prioritise_all(value: int) -> None:
    """Let this process come before ordinary programs. Its threads take short turns."""
    sys.setswitchinterval(SWITCH)
    if os.path.isdir(TASKS):
        prioritise((int(name) for name in os.listdir(TASKS)), value)


@contextmanager
def priority(value: int, threads: Sequence[Thread] = ()) -> Iterator[None]:
    """Let this thread and others come before ordinary programs, as a context."""
    numbers, interval = (
        [get_native_id(), *(thread.native_id or 0 for thread in threads)],
        sys.getswitchinterval(),
    )
    sys.setswitchinterval(SWITCH)
    prioritise(numbers, value)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        for number in numbers:
            _set(number, "SCHED_OTHER", 0)


def _set(thread: int, policy: str, value: int) -> None:
    try:
        os.sched_setscheduler(thread, getattr(os, policy) | os.SCHED_RESET_ON_FORK, os.sched_param(value))
    except (OSError, AttributeError):  # not allowed, or it has ended; another system than Linux
        return

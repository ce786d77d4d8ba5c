"""Worker processes with warm kernels and one numerical thread each.

A pool starts its own processes (`comove.processes.worker`) and communicates with each over a socket. If one is
killed, only its current task is affected, and another process replaces it. Programs that use a pool need no guard
around their main module, which the processes do not import.

Messages between the processes are pickled; they never leave the machine and are never read from a file.
"""

from __future__ import annotations

import math
import os
import pickle
import signal
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe, wait
from typing import Any, Generic, Self, TypeVar

from comove.errors import OptionError

Task = TypeVar("Task")
Made = TypeVar("Made")

ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
"""The environment of processes whose numerical libraries keep to one thread."""
ALONE = "COMOVE_COMPILE_ALONE"
"""Environment variable: where it is set, nothing on another core compiles, draws or plans for this process."""


def n_processors() -> int:
    """Return the number of cores available to this process.

    It is that of the machine where the system does not report it.
    """
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def start_process(module: str, **options: Any) -> tuple[subprocess.Popen[bytes], Connection]:
    """Start a module as a process; return it and a connection.

    The module gets the number of its end of the connection as its argument.

    Parameters
    ----------
    options : further arguments of `subprocess.Popen`
    """
    connection, theirs = Pipe()
    with theirs:
        # -P: a folder called comove where the program was started from must not be taken for the package
        command = [sys.executable, "-P", "-m", module, str(theirs.fileno())]
        process = subprocess.Popen(command, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, **options)
    return process, connection


def end_process(process: subprocess.Popen[Any], leave: float = 1.0) -> None:
    """Terminate a process, and kill it after `leave` [s]."""
    with suppress(OSError, ValueError):
        process.terminate()
    try:
        process.wait(leave)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


@dataclass(frozen=True)
class PoolSettings:
    """Settings of a pool.

    Attributes
    ----------
    poll : interval between checks for tasks that take too long [s]
    starts : number of successive processes that may die before they are ready
    """

    poll: float = 1.0
    starts: int = 5


@dataclass(frozen=True)
class TaskResult(Generic[Task, Made]):
    """Result of a task that has ended.

    Attributes
    ----------
    task : the task
    made : return value of the work; None if it failed
    error : exception that the work raised, in one line; empty if none
    refused : whether the work raised because of its input, not because of a defect
    killed : number of processes that were killed during the task
    late : whether its process was killed because the task took too long
    seconds : duration of the task [s]
    """

    task: Task
    made: Made | None = None
    error: str = ""
    refused: bool = False
    killed: int = 0
    late: bool = False
    seconds: float = 0.0


def run_tasks(
    work: Callable[[Task], Made],
    next_task: Callable[[], Task | None],
    *,
    workers: int,
    allowed: float = math.inf,
    settings: PoolSettings = PoolSettings(),
) -> Iterator[TaskResult[Task, Made]]:
    """Yield the results of tasks as they end, in any order.

    Processes start as tasks need them, and end with the iterator, also by Ctrl-C. They end within a second if this
    process is killed.

    Parameters
    ----------
    work : function of a task that can be pickled; it is sent to each process once
    next_task : function that returns the next task, None if there is none at present; it is asked again whenever a
        task has ended, so a task can be given back
    workers : number of processes
    allowed : time after which a task is stopped by killing its process [s]
    """
    if workers < 1:
        raise OptionError(f"workers = {workers}", key="workers", way_out="give 1 or more")
    crew: _Crew[Task, Made] = _Crew(_packed(work), workers, allowed, settings)
    try:
        while crew.employ(next_task):
            yield from crew.ended()
    finally:
        crew.close()


def _packed(work: object) -> bytes:
    """Pickle an object for another process, or raise `OptionError`."""
    try:
        if getattr(work, "__module__", "") == "__main__":
            raise ValueError(f"{work!r} belongs to the main program")
        return pickle.dumps(work)
    except Exception as error:  # whatever an object raises that cannot be pickled
        raise OptionError(
            f"the work cannot be sent to other processes: {error}",
            way_out="define functions and classes in a module of their own",
        ) from error


class _Process(Generic[Task]):
    """Process with its current task and the task's start time."""

    def __init__(self, work: bytes):
        self.process, self.connection = start_process(
            "comove.processes.worker",
            process_group=0,  # Ctrl-C ends this process, which ends that one
            env={**os.environ, **ONE_THREAD, ALONE: "1"},
        )
        self.ready = self.late = False
        self.task: Task | None = None
        self.since = math.inf
        with suppress(OSError):  # it is dead already, which reading will tell
            self.connection.send(sys.path)
            self.connection.send_bytes(work)

    def give(self, task: Task) -> None:
        """Send a task."""
        self.task, self.since = task, time.monotonic()
        with suppress(OSError):
            self.connection.send(task)

    def stop_if_late(self, allowed: float) -> None:
        """Kill the process if its task takes too long."""
        if self.ready and self.task is not None and time.monotonic() > self.since + allowed:
            self.late = True
            self.process.kill()

    def close(self) -> None:
        """End the process."""
        self.connection.close()
        end_process(self.process)


class _Crew(Generic[Task, Made]):
    """Processes of a pool."""

    def __init__(self, work: bytes, workers: int, allowed: float, settings: PoolSettings):
        self.work, self.workers, self.allowed, self.settings = work, workers, allowed, settings
        self.processes: dict[Connection, _Process[Task]] = {}
        self.back: deque[Task] = deque()
        self.died = 0

    def employ(self, next_task: Callable[[], Task | None]) -> bool:
        """Give tasks to idle processes; return whether any process has one."""
        while True:
            idle = next((p for p in self.processes.values() if p.task is None), None)
            if idle is None and len(self.processes) >= self.workers:
                return True
            task = self.back.popleft() if self.back else next_task()
            if task is None:
                return any(p.task is not None for p in self.processes.values())
            if idle is None:
                idle = _Process(self.work)
                self.processes[idle.connection] = idle
            idle.give(task)

    def ended(self) -> Iterator[TaskResult[Task, Made]]:
        """Yield the results of ended tasks; none if the poll times out."""
        poll = None if math.isinf(self.allowed) else self.settings.poll
        for connection in wait(list(self.processes), poll):
            process = self.processes[connection]  # type: ignore[index]
            try:
                kind, told = process.connection.recv()
            except (EOFError, OSError):
                yield from self._buried(process)
                continue
            if kind == "ready":
                process.ready, self.died, process.since = True, 0, time.monotonic()
            elif kind == "unable":
                raise OptionError(
                    f"the work cannot be taken over by other processes: {told}",
                    way_out="define functions and classes in a module that other processes can import",
                )
            elif (task := process.task) is not None:
                process.task, seconds = None, time.monotonic() - process.since
                if kind == "made":
                    yield TaskResult(task, told, seconds=seconds)
                else:
                    yield TaskResult(task, error=told, refused=kind == "refused", seconds=seconds)
        for process in self.processes.values():
            process.stop_if_late(self.allowed)

    def _buried(self, process: _Process[Task]) -> Iterator[TaskResult[Task, Made]]:
        """Remove a dead process, and yield its task as killed if begun."""
        del self.processes[process.connection]
        process.close()
        if process.task is None:
            return
        if process.ready:
            seconds = time.monotonic() - process.since
            yield TaskResult(process.task, killed=int(not process.late), late=process.late, seconds=seconds)
            return
        self.died += 1
        if self.died >= self.settings.starts:
            raise OptionError(
                f"{self.died} processes in a row ended before they were ready, the last with code "
                f"{process.process.returncode}",
                key="workers",
                way_out="see what they say above; more memory, or fewer workers, may help",
            )
        self.back.append(process.task)

    def close(self) -> None:
        """End all processes."""
        processes = list(self.processes.values())
        for process in processes:  # all at once, then one after the other
            with suppress(OSError):
                process.process.send_signal(signal.SIGTERM)
        for process in processes:
            process.close()
        self.processes.clear()


class Ahead(Generic[Task, Made]):
    """Process that loads modules before its tasks are known, as a context. It is ended at the end of the context.

    Parameters
    ----------
    work : function that can be pickled, of a task, or of None, which only prepares for one
    """

    def __init__(self, work: Callable[[Task | None], Made]) -> None:
        self._process: _Process[Task] = _Process(_packed(work))
        self._process.give(None)  # type: ignore[arg-type]  # of any task
        self._first: tuple[str, ...] = (
            "it is ready",
            "it is prepared",
        )  # answers before that to the first task

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.close()

    def work_on(self, task: Task) -> TaskResult[Task, Made]:
        """Send a task, and wait for its result."""
        self._process.give(task)
        awaited, self._first = (*self._first, "the task"), ()
        said = list[tuple[str, Any]]()
        with suppress(EOFError, OSError):
            for _ in awaited:
                said.append(self._process.connection.recv())
        kind, told = said[-1] if said else ("", None)
        if len(said) == len(awaited) and kind == "made":
            return TaskResult(task, told)
        return (
            TaskResult(task, error=str(told))
            if kind in ("unable", "failed", "refused")
            else TaskResult(task, killed=1)
        )

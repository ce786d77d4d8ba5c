"""Parallel processing of many small jobs on a few processes, each with one numerical thread."""

from __future__ import annotations

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from typing import TypeVar

from comove.processes import ONE_THREAD

Given = TypeVar("Given")
Made = TypeVar("Made")


def run_all(
    function: Callable[[Given], Made],
    jobs: Sequence[Given],
    *,
    processes: int,
    prepare: Callable[[], None],
    tell: Callable[[int], None] = lambda done: None,
) -> list[Made]:
    """Return the results of all jobs, in their order.

    Ctrl-C raises `KeyboardInterrupt` here at once; the processes are ended.

    Parameters
    ----------
    function : function of a job; it must belong to a module, because it is sent to other processes
    processes : number of processes
    prepare : function that each process calls first
    tell : function called with the number of jobs that are done
    """
    others = set(multiprocessing.active_children())
    with _one_thread():
        pool = ProcessPoolExecutor(
            processes, multiprocessing.get_context("spawn"), initializer=_begin, initargs=(prepare,)
        )
        try:
            futures: list[Future[Made]] = [pool.submit(function, job) for job in jobs]
            results = []
            for done, future in enumerate(futures, 1):
                results.append(future.result())
                tell(done)
            return results
        except BaseException:
            for child in set(multiprocessing.active_children()) - others:
                child.terminate()
            raise
        finally:
            pool.shutdown(cancel_futures=True)


def _begin(prepare: Callable[[], None]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent's business
    prepare()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Restrict processes that begin within the block to one numerical thread each."""
    before = {name: os.environ.get(name) for name in ONE_THREAD}
    os.environ.update(ONE_THREAD)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

"""The compilation of kernels, once after installation: counted, told, and shared between processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from numba.core import event
from numba.core.dispatcher import LiftedCode

from comove.planning.clock import now
from comove.processes import ALONE, n_processors

PACKAGE = "comove."
KernelCallback = Callable[[str], None]
CALL = """
import importlib, json, sys
module, function, arguments = sys.argv[1:]
getattr(importlib.import_module(module), function)(**json.loads(arguments))
"""


@dataclass
class Compiled:
    """Counts what has been compiled so far.

    Attributes
    ----------
    kernels : number of kernels
    seconds : time that it took [s]
    """

    kernels: int = 0
    seconds: float = 0.0


IN_ALL = Compiled()  # what commands have watched in this process


class _Listener(event.Listener):
    """A listener that counts and reports compiled kernels; the compilation of one may include that of others."""

    def __init__(self, compiled: Compiled, tell: KernelCallback | None):
        self.compiled, self.tell = compiled, tell
        self._depth, self._begun = 0, 0.0

    def on_start(self, event: event.Event) -> None:
        if not _counts(event):
            return
        if self._depth == 0:
            self._begun = now()
        self._depth += 1
        function = event.data["dispatcher"].py_func
        if not function.__module__.startswith(PACKAGE):
            return  # what Numba makes for our kernels
        self.compiled.kernels += 1
        if self.tell is not None:
            self.tell(f"{function.__module__.removeprefix(PACKAGE)}.{function.__name__}")

    def on_end(self, event: event.Event) -> None:
        if not _counts(event):
            return
        self._depth -= 1
        if self._depth == 0:
            self.compiled.seconds += now() - self._begun
            if self.tell is not None:
                self.tell("")


def _counts(event: event.Event) -> bool:
    """Return whether an event counts; code lifted out of a kernel, never cached and fast, does not."""
    return not isinstance(event.data["dispatcher"], LiftedCode)


@contextmanager
def compiling(tell: KernelCallback | None = None, compiled: Compiled | None = None) -> Iterator[Compiled]:
    """Count the kernels that are compiled in this context; kernels loaded from the cache do not count.

    Parameters
    ----------
    tell : function that is called with the name of every kernel when its compilation begins, and with "" when all
        compilation has ended
    compiled : counters to add to, which the context yields; new ones unless given
    """
    compiled = Compiled() if compiled is None else compiled
    with event.install_listener("numba:compile", _Listener(compiled, tell)):
        yield compiled


@contextmanager
def meanwhile(load: Callable[..., None], **arguments: Any) -> Iterator[None]:
    """Let another process load kernels as soon as this one has to compile any, and wait for it in the end.

    What the other process has compiled, this one finds in the cache on disk. Where there is a single processor core,
    this one does all by itself, later.

    Parameters
    ----------
    load, arguments : function of a module, and what it is called with: numbers, texts and truth values
    """
    others: list[subprocess.Popen] = []

    def begin(kernel: str) -> None:
        if kernel and not others:
            command = [
                sys.executable,
                "-P",
                "-c",
                CALL,
                load.__module__,
                load.__name__,
                json.dumps(arguments),
            ]
            none = subprocess.DEVNULL
            others.append(subprocess.Popen(command, stdin=none, stdout=none, stderr=none))

    able = sys.executable and ALONE not in os.environ and n_processors() > 1
    try:
        with compiling(begin if able else None):
            yield
        for other in others:
            other.wait()
    finally:
        for other in others:
            other.kill()  # a file that it leaves unfinished counts as missing
            other.wait()

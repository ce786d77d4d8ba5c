"""The compilation of kernels, once after installation: counted, told, and shared between processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from comove.compiled import counting
from comove.compiled.counting import IN_ALL, Compiled, KernelCallback
from comove.planning.clock import now
from comove.processes import ALONE, n_processors

__all__ = ["IN_ALL", "Compiled", "compiling", "meanwhile"]

CALL = """
import importlib, json, sys
module, function, arguments = sys.argv[1:]
getattr(importlib.import_module(module), function)(**json.loads(arguments))
"""


def compiling(
    tell: KernelCallback | None = None, compiled: Compiled | None = None
) -> AbstractContextManager[Compiled]:
    """Count the kernels that are compiled in a context, as `comove.compiled.counting`, by the clock of budgets."""
    return counting.compiling(tell, compiled, now)


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

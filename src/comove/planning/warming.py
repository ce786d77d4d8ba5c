"""The warm-up: small problems that need every kernel, solved after installation.

Processes on all cores solve them once. A job is such a problem, solved by the code that users call, so that nothing
lists kernels. A new kind of problem is a function that solves a small one, and a line in `JOBS`. A search waits for
the unfinished jobs that it needs; the others are finished in the background. A kernel that no job needs is compiled
when it is first called.
"""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import tempfile
import threading
from collections import deque
from collections.abc import Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from comove.compiled.cache import fcntl
from comove.compiled.counting import WarmUp, compiling, displays
from comove.compiled.finished import finish, finished, folder
from comove.errors import OptionError
from comove.processes import ALONE, n_processors, run_tasks

LOCK = "comove_warm_up.lock"


@dataclass(frozen=True)
class WarmUpJob:
    """A small problem.

    Attributes
    ----------
    home : module, and its function that solves the problem
    arguments : arguments of that function
    kernels : about how many are compiled for it, for progress alone
    needs : modules of extras without which there is no such problem
    """

    home: str
    arguments: Mapping[str, Any] = field(default_factory=dict)
    kernels: int = 20
    needs: tuple[str, ...] = ()

    @property
    def is_possible(self) -> bool:
        """Return whether all required modules are installed."""
        return all(find_spec(name) is not None for name in self.needs)

    def solve(self) -> None:
        """Solve the problem."""
        module, function = self.home.split(":")
        getattr(import_module(module), function)(**self.arguments)


_ROBOT = ("pinocchio", "coal")
JOBS: dict[str, WarmUpJob] = {
    "planar plans": WarmUpJob("comove.planning.kernels:plan_in", {"n_dims": 2}, 180),
    "planar motions": WarmUpJob("comove.planning.kernels:smooth_in", {"n_dims": 2}, 10),
    "spatial plans": WarmUpJob("comove.planning.kernels:plan_in", {"n_dims": 3}, 20),
    "spatial motions": WarmUpJob("comove.planning.kernels:smooth_in", {"n_dims": 3}, 10),
    "meshes": WarmUpJob("comove.planning.kernels:smooth_in", {"n_dims": 3, "meshes": True}, 30),
    "moving plans": WarmUpJob("comove.planning.kernels:plan_in", {"n_dims": 2, "moving": True}, 30),
    "executions": WarmUpJob("comove.control.kernels:execute", {}, 15),
    "robot motions": WarmUpJob("comove.robots.kernels:follow", {}, 130, _ROBOT),
    "robot plans": WarmUpJob("comove.robots.kernels:plan", {}, 25, _ROBOT),
    "robot plans, moving": WarmUpJob("comove.robots.kernels:plan", {"moving": True}, 20, _ROBOT),
    "robot executions": WarmUpJob("comove.robots.kernels:execute", {}, 65, _ROBOT),
}


_tried: set[str] = set()  # or known to be finished


def require(*names: str) -> None:
    """Wait until jobs are finished, or were tried in this process.

    Nothing is waited for where compiled kernels cannot be kept. The kernels of a job that fails, or of processes that
    cannot be started, are compiled when they are first called.
    """
    if _tried.issuperset(names):
        return
    _tried.update(finished())
    missing = [name for name in names if name not in _tried]
    if not missing or folder() is None:
        return
    _tried.update(missing)  # before, as a job may solve a problem that requires it
    if ALONE in os.environ or not sys.executable or fcntl is None:
        for name in missing:
            with suppress(Exception):
                JOBS[name].solve()
            finish(name)
        return
    with suppress(OSError, OptionError):
        warm_up(missing)
        if displays and unfinished():
            _go_on_in_background()


def _go_on_in_background() -> None:
    none = subprocess.DEVNULL
    # Not by -m: of what belongs to the main program, nothing can be sent to the processes of a pool.
    command = [sys.executable, "-P", "-c", f"from {__name__} import main; main()"]
    process = subprocess.Popen(command, stdin=none, stdout=none, stderr=none, start_new_session=True)
    threading.Thread(target=process.wait, daemon=True).start()  # else it stays a zombie when it has ended


def unfinished() -> list[str]:
    """Return the jobs that are possible and not finished."""
    done = finished()
    return [name for name, job in JOBS.items() if name not in done and job.is_possible]


def warm_up(names: list[str]) -> None:
    """Finish jobs in processes of their own, one per core at once."""
    with tempfile.TemporaryDirectory() as place:
        file, waiting = Path(place, "compiled"), deque(names)
        file.touch()
        workers = min(n_processors(), len(names))
        state = WarmUp(sum(JOBS[name].kernels for name in names), workers, file)
        with displays[-1](state) if displays else nullcontext():
            for ended in run_tasks(
                _Work(str(file)), lambda: waiting.popleft() if waiting else None, workers=workers
            ):
                if not ended.killed:  # what a job raises, whoever calls the same will be told
                    finish(ended.task)


@dataclass(frozen=True)
class _Work:
    """The work of a process on a job. A file grows by one byte for every compiled kernel."""

    file: str

    def __call__(self, name: str) -> None:
        gc.disable()  # the process only compiles; collections would visit all objects of the compiler again and again
        with compiling(self._tell):
            JOBS[name].solve()
        gc.collect()
        gc.freeze()

    def _tell(self, kernel: str) -> None:
        if kernel:
            with suppress(OSError), open(self.file, "ab") as file:
                file.write(b".")


def main() -> None:
    """Finish all jobs in the background. One process does so at a time."""
    place = folder()
    if place is None or fcntl is None:  # no Unix: what is missing is compiled when it is needed
        return
    with suppress(OSError), open(place / LOCK, "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        os.nice(10)
        if names := unfinished():
            warm_up(names)

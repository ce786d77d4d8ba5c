"""Runs of the benchmark, each in a worker process, none of them run twice, none of them lost.

A worker writes the row of a run itself, at its end. A driver starts the runs that are not in the store yet. So either
may be killed at any time: finished runs are in the store, and the same call continues. If a worker is killed, all
unfinished runs are run again, each alone; a run that has killed its worker `KILLS` times is marked, and the rest
continues.
"""

from __future__ import annotations

import os
import platform
import signal
import threading
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache, partial
from pathlib import Path
from types import FrameType
from typing import Any

from comove._version import __version__
from comove.errors import ExtraError, InputError, OptionError, ResultError
from comove.experiments.bench.sets import BenchScene
from comove.experiments.bench.store import Configuration, Figures, Machine, Run, RunStore
from comove.experiments.systems import System, SystemOutcome, SystemProblem, measured
from comove.primitives.dmp import DMP
from comove.processes import ONE_THREAD
from comove.scenes import demonstration_of
from comove.scenes.scene import Scene

KILLS = 3  # of workers, before a run is given up
TIMES, MORE = 3.0, 30.0  # budgets, and seconds more, after which a run is stopped
GRACE = 15.0  # s, that a run may take to stop by itself; then its process is killed
LOADING = 600.0  # s, more for compiling, once after installation
POLL = 1.0  # s


@dataclass(frozen=True)
class BenchJob:
    """A run that is to be done.

    Attributes
    ----------
    configuration : configuration of the run
    path : path of the scene's file
    system : the system that runs it
    allowed : time after which it is stopped [s]
    """

    configuration: Configuration
    path: Path
    system: System
    allowed: float


@dataclass(frozen=True)
class BenchProgress:
    """Holds the progress of a benchmark.

    Attributes
    ----------
    before : number of runs that were in the store at the beginning
    done : number of runs that are in the store now
    total : number of runs asked for
    """

    before: int
    done: int
    total: int


def jobs_of(
    scenes: list[BenchScene], systems: Mapping[str, System], seeds: int = 1, budget: float = 10.0
) -> list[BenchJob]:
    """Return the jobs for every scene with every system and the seeds from 0 on.

    Raises
    ------
    OptionError
        If seeds or budget are not positive.
    """
    if seeds < 1:
        raise OptionError(f"seeds = {seeds}", key="--seeds", way_out="give 1 or more")
    if not 0 < budget < float("inf"):
        raise OptionError(f"budget = {budget}", key="--budget", way_out="give a positive number of seconds")
    return [
        BenchJob(
            Configuration(
                scene.set, scene.name, scene.sha256, name, seed, float(budget), __version__, system.version
            ),
            scene.path,
            system,
            TIMES * budget + MORE,
        )
        for seed in range(seeds)
        for scene in scenes
        for name, system in systems.items()
    ]


def run_all(
    path: str | Path,
    jobs: list[BenchJob],
    workers: int = 1,
    tell: Callable[[BenchProgress], None] = lambda progress: None,
) -> BenchProgress:
    """Run the jobs that are not in a store yet.

    Parameters
    ----------
    path : path of the store, which is made if it does not exist
    workers : number of processes at a time
    tell : function called at the beginning and after every run

    Raises
    ------
    ExtraError
        If joblib is not installed.
    OptionError
        If there are no jobs or no workers.
    ResultError
        If another file is in the store's place, or it cannot be written.
    """
    if not jobs:
        raise OptionError("there is nothing to run", way_out="name a set and a system")
    if workers < 1:
        raise OptionError(f"workers = {workers}", key="--workers", way_out="give 1 or more")
    _loky()
    store = RunStore.create(path)
    _Driver(store, jobs, tell).run(workers)
    n = len(store.keys() & {job.configuration.key for job in jobs})
    return BenchProgress(n, n, len(jobs))


class _Driver:
    """A driver that hands out runs and watches the workers."""

    def __init__(self, store: RunStore, jobs: list[BenchJob], tell: Callable[[BenchProgress], None]):
        self.store, self.tell, self.total = store, tell, len(jobs)
        self.name = f"{os.getpid()}-{uuid.uuid4().hex}"
        store.plan(job.configuration for job in jobs)
        ended = store.keys()
        self.waiting = deque(job for job in jobs if job.configuration.key not in ended)
        self.suspects: deque[BenchJob] = deque()
        self.before = self.done = self.total - len(self.waiting)

    def run(self, workers: int) -> None:
        """Hand out runs until all are done."""
        self._tell()
        try:
            while self.waiting or self.suspects:
                if self.suspects:
                    self._hand_out(self.suspects, 1)
                else:
                    self._hand_out(self.waiting, min(workers, len(self.waiting)))
        finally:
            self.store.leave(self.name)

    def _tell(self) -> None:
        self.tell(BenchProgress(self.before, self.done, self.total))

    def _hand_out(self, queue: deque[BenchJob], workers: int) -> None:
        """Process a queue until it is empty or a worker is killed."""
        loky = _loky()
        self.store.leave(self.name)  # what was begun by workers that are gone
        under_way: dict[Any, BenchJob] = {}
        stopped: set[str] = set()
        executor = loky.ProcessPoolExecutor(
            workers, initializer=_begin_work, initargs=(os.getpid(),), env=ONE_THREAD
        )
        try:
            while queue or under_way:
                while len(under_way) < workers and (job := self._next(queue)):
                    future = executor.submit(_work, self.store, job, self.name)
                    under_way[future] = job
                if not under_way:  # all that is left is done by others
                    time.sleep(POLL)
                    continue
                ended, _ = loky.wait(under_way, timeout=POLL, return_when=loky.FIRST_COMPLETED)
                for future in ended:
                    failure = future.exception()
                    if isinstance(failure, loky.BrokenProcessPool):
                        raise failure
                    if isinstance(failure, ResultError):  # the store could not be written
                        raise failure
                    if failure is not None:  # it could not even be handed out
                        self.store.add(_run_of(under_way[future], "error", _told(failure)))
                    del under_way[future]
                    self.done += 1
                    self._tell()
                stopped |= self._stop_late(under_way.values())
        except loky.BrokenProcessPool:
            self._sort_out(list(under_way.values()), stopped)
        finally:
            executor.shutdown(wait=True, kill_workers=True)

    def _next(self, queue: deque[BenchJob]) -> BenchJob | None:
        """Return the first run that nobody else has done or is doing; runs under way elsewhere move to the end."""
        for _ in range(len(queue)):
            job = queue.popleft()
            key = job.configuration.key
            if self.store.has(key):
                self.done += 1
                self._tell()
            elif self.store.claim(
                key, self.name, os.getpid(), time.time() + LOADING, partial(_is_gone, job.allowed)
            ):
                return job
            else:
                queue.append(job)
        return None

    def _stop_late(self, jobs: Any) -> set[str]:
        """Kill the processes of runs that did not stop in time; return the keys of these runs."""
        known = {job.configuration.key: job for job in jobs}
        stopped = set()
        for key, pid, since in self.store.begun(self.name):
            if key in known and pid != os.getpid() and time.time() > since + known[key].allowed + GRACE:
                with suppress(ProcessLookupError):  # it has just gone by itself
                    os.kill(pid, signal.SIGKILL)
                    self.store.add(_run_of(known[key], "late", _late_text(known[key])))
                    stopped.add(key)
        return stopped

    def _sort_out(self, under_way: list[BenchJob], stopped: set[str]) -> None:
        """Sort the runs after a worker was killed: those that ended, those that may be the cause, those given up."""
        ended = self.store.keys()
        for job in under_way:
            key = job.configuration.key
            if key in ended:
                self.done += 1
            elif stopped:  # one was stopped for being late: the others have done nothing
                self.waiting.appendleft(job)
            elif (times := self.store.note_kill(key)) >= KILLS:
                self.store.add(_run_of(job, "killed", f"its process was killed {times} times"))
                self.done += 1
            else:
                self.suspects.append(job)
        self._tell()


def _is_gone(allowed: float, pid: int, since: float) -> bool:
    """Return whether a process of another driver no longer works on its run."""
    if time.time() > since + allowed + GRACE + POLL:
        return True
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    except PermissionError:  # another user's
        return False
    return False


def _loky() -> Any:
    try:
        from joblib.externals import loky
    except ImportError as error:
        raise ExtraError("a benchmark", "bench") from error
    return loky


def _begin_work(driver: int) -> None:
    """Prepare a worker: leave interrupts to its driver, and end the worker when the driver is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(POLL)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _work(store: RunStore, job: BenchJob, driver: str) -> None:
    """Run, judge and write one row."""
    key = job.configuration.key
    store.begin(key, driver, os.getpid(), time.time() + LOADING)
    started = datetime.now(UTC)
    try:
        status, message, outcome = _outcome(job, lambda: store.begin(key, driver, os.getpid(), time.time()))
    except _Late:
        status, message, outcome = "late", _late_text(job), None
    except InputError as error:  # a system says itself that it is not made for the scene
        status, message, outcome = "refused", str(error), None
    except (Exception, SystemExit) as error:  # whatever a system may throw
        status, message, outcome = "error", _told(error), None
    store.add(_run_of(job, status, message, started, outcome))


def _outcome(job: BenchJob, start_clock: Callable[[], None]) -> tuple[str, str, SystemOutcome | None]:
    c, scene = job.configuration, Scene.load(job.path)
    why = job.system.refuses(scene)
    if why:
        return "refused", why, None
    demonstration = demonstration_of(scene)
    if not (demonstration is None or isinstance(demonstration, DMP)):
        return "refused", "It begins from one movement, and the scene names several or one of poses.", None
    problem = SystemProblem(scene, demonstration, c.seed, c.budget)
    job.system.warm_up(problem)
    start_clock()
    with _alarm(job.allowed):
        outcome = measured(job.system, problem)
    if outcome is None:
        return "nothing", "it offered nothing", None
    return "verified" if outcome.verified else "not verified", "; ".join(outcome.reasons), outcome


class _Late(BaseException):
    """Signals that a run has used up its time; no system catches this exception."""


@contextmanager
def _alarm(seconds: float) -> Iterator[None]:
    """Raise `_Late` after this time, if the platform supports it."""
    if not hasattr(signal, "setitimer"):
        yield
        return

    def ring(signum: int, frame: FrameType | None) -> None:
        raise _Late

    before = signal.signal(signal.SIGALRM, ring)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def _late_text(job: BenchJob) -> str:
    return f"stopped after {job.allowed:g} s"


def _told(error: BaseException) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _run_of(
    job: BenchJob,
    status: str,
    message: str,
    started: datetime | None = None,
    outcome: SystemOutcome | None = None,
) -> Run:
    figures = Figures()
    history: tuple[tuple[float, float], ...] = ()
    if outcome is not None:
        figures = Figures(**{name: getattr(outcome, name) for name in vars(figures)})
        history = outcome.history
    when = (started or datetime.now(UTC)).isoformat(timespec="milliseconds")
    return Run(job.configuration, status, message, when, machine(), figures, history)


@lru_cache(maxsize=1)
def machine() -> Machine:
    """Return the description of the machine that runs this process."""
    cpu = platform.processor() or platform.machine()
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        text = ""
    models = [line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")]
    return Machine(models[0] if models else cpu, os.cpu_count() or 1, platform.python_version())

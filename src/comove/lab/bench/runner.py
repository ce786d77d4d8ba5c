"""Runs of the benchmark in a pool, none repeated or lost.

A row is written as its run ends, so everything may be killed at any time: the same call continues. A run that has
killed its process `KILLS` times is marked, and the rest continues.
"""

from __future__ import annotations

import os
import platform
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from comove._version import __version__
from comove.data.many import MORE, TIMES, lost, require_kernels
from comove.data.runner import StudyProgress, run_missing
from comove.dmp.dmp import DMP
from comove.errors import ComoveWarning, InputError, OptionError, SceneError
from comove.lab.bench.sets import BenchScene
from comove.lab.bench.store import Configuration, Figures, Machine, Run, RunStore
from comove.lab.systems import System, SystemOutcome, SystemProblem, measured, refusal
from comove.model import demonstration_of
from comove.model.scene import Scene
from comove.processes import TaskResult, run_tasks
from comove.processes.worker import told


@dataclass(frozen=True)
class BenchJob:
    """Run to be done.

    Attributes
    ----------
    configuration : configuration of the run
    path : path of the scene's file
    system : the system that runs it
    """

    configuration: Configuration
    path: Path
    system: System


def jobs_of(
    scenes: list[BenchScene], systems: Mapping[str, System], seeds: int = 1, budget: float = 10.0
) -> list[BenchJob]:
    """Return the jobs for all scenes, systems and seeds from 0.

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
        )
        for seed in range(seeds)
        for scene in scenes
        for name, system in systems.items()
    ]


def run_all(
    path: str | Path,
    jobs: list[BenchJob],
    workers: int = 1,
    tell: Callable[[StudyProgress], None] = lambda progress: None,
) -> StudyProgress:
    """Do the jobs that a run database lacks.

    Parameters
    ----------
    path : path of the database, which is made if it does not exist
    workers : number of processes at a time
    tell : function called at the beginning and after every run

    Raises
    ------
    OptionError
        If there are no jobs or no workers.
    ResultError
        If the path holds another file, another process writes to it, or it cannot be written.
    """
    if not jobs:
        raise OptionError("there is nothing to run", way_out="name a set and a system")
    if workers < 1:
        raise OptionError(f"workers = {workers}", key="--workers", way_out="give 1 or more")
    allowed = TIMES * max(job.configuration.budget for job in jobs) + MORE
    store = RunStore.create(path)
    with store.writer() as writer:
        writer.plan(job.configuration for job in jobs)
        there = store.keys()

        def keep(ended: TaskResult[BenchJob, Run]) -> bool:
            row = ended.made or _failed(ended)
            writer.add(row)
            return row.status == "verified"

        missing = [job for job in jobs if job.configuration.key not in there]
        require_kernels(_scenes(missing))
        return run_missing(
            missing,
            len(jobs),
            lambda next_job: run_tasks(run, next_job, workers=workers, allowed=allowed),
            note_kill=lambda job, kills: writer.note_kill(job.configuration.key, kills),
            keep=keep,
            tell=tell,
        )


def _scenes(jobs: list[BenchJob]) -> Iterator[Scene]:
    """Yield the readable scenes of jobs; other runs report the errors."""
    for path in dict.fromkeys(job.path for job in jobs):
        with suppress(SceneError), warnings.catch_warnings():
            warnings.simplefilter("ignore", ComoveWarning)
            yield Scene.load(path, check_ends=False)


def run(job: BenchJob) -> Run:
    """Do a job, verify it, and return its row despite any error."""
    started = datetime.now(UTC)
    try:
        status, message, outcome = _outcome(job)
    except InputError as error:  # a system says itself that it is not made for the scene
        status, message, outcome = "refused", str(error), None
    except (Exception, SystemExit) as error:  # whatever a system may throw
        status, message, outcome = "error", told(error), None
    return _row(job, status, message, started, outcome)


def _outcome(job: BenchJob) -> tuple[str, str, SystemOutcome | None]:
    c, scene = job.configuration, Scene.load(job.path)
    why = refusal(job.system, scene)
    if why:
        return "refused", why, None
    demonstration = demonstration_of(scene)
    if not (demonstration is None or isinstance(demonstration, DMP)):
        return "refused", "It begins from one movement, and the scene names several or one of poses.", None
    problem = SystemProblem(scene, demonstration, c.seed, c.budget)
    if scene.file.robot is None:
        outcome = measured(job.system, problem)
    else:
        from comove.lab.carried import carried  # robots are an extra

        outcome = carried(problem)
    if outcome is None:
        return "nothing", "it offered nothing", None
    return "verified" if outcome.verified else "not verified", "; ".join(outcome.reasons), outcome


def _failed(ended: TaskResult[BenchJob, Run]) -> Run:
    """Return the row of a run that was killed or never started."""
    status, reasons = lost(ended) if ended.killed or ended.late else ("error", (ended.error,))
    return _row(ended.task, status, reasons[0], datetime.now(UTC))


def _row(
    job: BenchJob, status: str, message: str, started: datetime, outcome: SystemOutcome | None = None
) -> Run:
    figures: Figures = Figures()
    history: tuple[tuple[float, float], ...] = ()
    if outcome is not None:
        figures = Figures(**{name: getattr(outcome, name) for name in vars(figures)})
        history = outcome.history
    when = started.isoformat(timespec="milliseconds")
    return Run(job.configuration, status, message, when, machine(), figures, history)


@lru_cache(maxsize=1)
def machine() -> Machine:
    """Return the description of this machine."""
    cpu = platform.processor() or platform.machine()
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        text = ""
    models = [line.split(":", 1)[1].strip() for line in text.splitlines() if line.startswith("model name")]
    return Machine(models[0] if models else cpu, os.cpu_count() or 1, platform.python_version())

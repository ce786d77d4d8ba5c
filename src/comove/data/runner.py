"""Runner of studies.

It sends the runs that a run database lacks to processes, and writes their rows. The database is the only state: a
run that was interrupted with its process or machine is repeated by the same call, and gives the same row, because a
run depends on its number alone. A run that has killed its process `KILLS` times is marked, and the rest continues.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypeVar

from comove.data.episode import Made
from comove.data.many import KILLS, MORE, TIMES, lost, require_kernels
from comove.data.runs import LONGEST, RUNS, StudyRun, StudyStore
from comove.errors import OptionError, ResultError
from comove.io.files import require_room, telling
from comove.model.scene import Scene
from comove.processes import TaskResult, run_tasks

Task = TypeVar("Task")
Result = TypeVar("Result")


class RunSource(Protocol):
    """Source of runs, each given by its number; it can be pickled."""

    @property
    def name(self) -> str:
        """Return the name of the study."""

    @property
    def total(self) -> int:
        """Return the number of runs."""

    @property
    def budget(self) -> float:
        """Return the time for each run [s]."""

    @property
    def described(self) -> dict[str, Any]:
        """Return the data that determine all runs, without their number."""

    def require(self) -> None:
        """Raise a `ComoveError` with advice if this process lacks a requirement."""

    def example_scenes(self) -> Iterable[Scene]:
        """Return scenes of all kinds that runs solve, where known before."""

    def key(self, number: int) -> str:
        """Return the key of a run."""

    def run(self, number: int) -> Made:
        """Do a run; return its row and verified motion, if any."""


@dataclass(frozen=True)
class Shard:
    """Part of a study: every `count`-th run from number `index` - 1."""

    index: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Parse a shard written as ``i/n``, with i from 1 to n."""
        first, slash, second = text.partition("/")
        if slash and first.isdigit() and second.isdigit() and 1 <= int(first) <= int(second):
            return cls(int(first), int(second))
        raise OptionError(
            f"'{text}' is no shard", key="--shard", way_out="write i/n, such as 1/4, with i from 1 to n"
        )

    def numbers(self, total: int) -> range:
        """Return the numbers of the runs of this part."""
        return range(self.index - 1, total, self.count)


@dataclass(frozen=True)
class StudyProgress:
    """Progress of a study, or of the shard that is run.

    Attributes
    ----------
    before, done, total : numbers of runs in the run database at the beginning and now, and of those planned
    verified : number of runs since the beginning whose motion was verified
    seconds : time since the beginning [s]
    """

    before: int
    done: int
    total: int
    verified: int = 0
    seconds: float = 0.0

    @property
    def rate(self) -> float:
        """Return the runs a second since the beginning [1/s]."""
        return (self.done - self.before) / self.seconds if self.seconds > 0 else 0.0

    @property
    def left(self) -> float | None:
        """Return the remaining time at this rate [s]; None at first."""
        return (self.total - self.done) / self.rate if self.rate > 0 else None


Run = Callable[[RunSource, Callable[[], int | None], float], Iterator[TaskResult[int, Made]]]
"""Function of the study, of the next number, and of the time allowed for a run [s], that yields runs as they end."""


def on_processes(workers: int) -> Run:
    """Return a runner on processes of this machine."""

    def run(
        study: RunSource, next_task: Callable[[], int | None], allowed: float
    ) -> Iterator[TaskResult[int, Made]]:
        study.require()
        require_kernels(study.example_scenes())
        return run_tasks(study.run, next_task, workers=workers, allowed=allowed)

    if workers < 1:
        raise OptionError(f"workers = {workers}", key="--workers", way_out="give 1 or more")
    return run


def run_study(
    study: RunSource,
    folder: str | Path,
    run: Run,
    *,
    shard: Shard = Shard(),
    tell: Callable[[StudyProgress], None] = lambda progress: None,
) -> StudyProgress:
    """Do the runs of a study that its run database lacks.

    Parameters
    ----------
    folder : folder of the study, which is made if it does not exist
    run : runner, such as `on_processes(2)`
    shard : part of the study that is run
    tell : function called at the beginning and after every run

    Raises
    ------
    ResultError
        If the folder holds something else, the study was edited since, another process uses it, or it cannot be
        written.
    ExtraError, OptionError
        If a requirement of the runs is missing here, or on the workers of a scheduler.
    """
    store, numbers = StudyStore.create(_prepared(Path(folder)) / RUNS), shard.numbers(study.total)
    with store.writer() as writer:
        store.describe(study.described, study.total)
        there = store.numbers()

        def keep(ended: TaskResult[int, Made]) -> bool:
            row, motion = ended.made or (_failed(study.key(ended.task), ended), None)
            writer.add(row, motion)
            return row.status == "verified"

        return run_missing(
            [number for number in numbers if number not in there],
            len(numbers),
            lambda next_task: run(study, next_task, TIMES * study.budget + MORE),
            note_kill=lambda number, kills: writer.note_kill(study.key(number), kills),
            keep=keep,
            tell=tell,
        )


def run_missing(
    missing: Iterable[Task],
    total: int,
    run: Callable[[Callable[[], Task | None]], Iterator[TaskResult[Task, Result]]],
    *,
    note_kill: Callable[[Task, int], int],
    keep: Callable[[TaskResult[Task, Result]], bool],
    tell: Callable[[StudyProgress], None],
) -> StudyProgress:
    """Do the runs that a run database lacks. A run that has killed its process is repeated after the others.

    Parameters
    ----------
    missing : the runs
    total : number of all runs, including those in the run database
    run : function of the next run that yields runs as they end
    note_kill : function of a run and of its number of new kills that returns its total of kills
    keep : function that writes a completed run, and returns whether its motion was verified
    tell : function called at the beginning and after every run
    """
    waiting = deque(missing)
    begun, before, verified = time.monotonic(), total - len(waiting), 0
    progress = StudyProgress(before, before, total)
    tell(progress)

    def next_run() -> Task | None:
        return waiting.popleft() if waiting else None

    for ended in run(next_run):
        if ended.killed and note_kill(ended.task, ended.killed) < KILLS:
            waiting.append(ended.task)
            continue
        verified += keep(ended)
        progress = StudyProgress(before, progress.done + 1, total, verified, time.monotonic() - begun)
        tell(progress)
    return progress


def _failed(key: str, ended: TaskResult[int, Made]) -> StudyRun:
    if ended.killed or ended.late:
        status, reasons = lost(ended)
        return StudyRun(key, ended.task, status=status, reason=reasons[0], seconds=ended.seconds)
    status = "refused" if ended.refused else "error"
    return StudyRun(key, ended.task, status=status, reason=ended.error[:LONGEST], seconds=ended.seconds)


def check_study_folder(folder: Path) -> None:
    """Check that a folder is missing, empty, or that of a study."""
    with telling(folder, "written", ResultError):
        if folder.exists() and not folder.is_dir():
            raise ResultError("it is a file", file=folder, way_out="name a folder")
        if folder.is_dir() and os.listdir(folder) and not (folder / RUNS).exists():
            raise ResultError(
                "the folder is not empty and holds no study", file=folder, way_out="name another or empty it"
            )


def _prepared(folder: Path, room: int = 20_000_000) -> Path:
    """Make the folder of a study, after `check_study_folder`; `room` [bytes] must be free."""
    check_study_folder(folder)
    with telling(folder, "written", ResultError):
        require_room(folder, ResultError, room)
        folder.mkdir(parents=True, exist_ok=True)
    return folder

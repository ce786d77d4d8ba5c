"""The runner of studies: it hands the runs that are missing in a store to processes, and writes their rows.

The store is the truth. A run that has ended is in it; whatever was under way when a process or the machine ended is
run again by the same call, and gives the same row, because a run depends on its number alone. A run that has killed
its process `KILLS` times is marked, and the rest goes on.
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
    """A source of runs, each by its number; it can be sent to other processes."""

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
        """Return what all runs follow from, in plain data, their number left out."""

    def require(self) -> None:
        """Make sure that runs can be done in this process, or raise a `ComoveError` with the way out."""

    def example_scenes(self) -> Iterable[Scene]:
        """Return scenes of all the kinds that runs solve, as far as they are known before."""

    def key(self, number: int) -> str:
        """Return the key of a run."""

    def run(self, number: int) -> Made:
        """Do a run; return its row, and its motion if it is verified."""


@dataclass(frozen=True)
class Shard:
    """A part of a study: every `count`-th run, from the one numbered `index` - 1 on."""

    index: int = 1
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> Shard:
        """Return the shard that is written as ``i/n``, with i from 1 to n."""
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
    """The progress of a study, or of its part that is run.

    Attributes
    ----------
    before, done, total : numbers of runs that were in the store at the beginning, are there now, and are asked for
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
        """Return the time that is left at this rate [s]; None before the first run has ended."""
        return (self.total - self.done) / self.rate if self.rate > 0 else None


Run = Callable[[RunSource, Callable[[], int | None], float], Iterator[TaskResult[int, Made]]]
"""Function of the study, of the next number, and of the time allowed for a run [s], that yields runs as they end."""


def on_processes(workers: int) -> Run:
    """Return the function that does runs on processes of this machine."""

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
    """Do the runs of a study that are not in the store of a folder yet.

    Parameters
    ----------
    folder : folder of the study, which is made if it does not exist
    run : what does the runs, such as `on_processes(2)`
    shard : the part of the study that is run
    tell : function called at the beginning and after every run

    Raises
    ------
    ResultError
        If the folder holds something else, the study was edited since, another process works on it, or it cannot be
        written.
    ExtraError, OptionError
        If something that the runs need is missing here, or on the workers of a scheduler.
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
    """Do the runs that a store lacks; one that has killed its process comes again after the others.

    Parameters
    ----------
    missing : the runs
    total : number of runs asked for, with those that are in the store
    run : function of the next run that yields runs as they end
    note_kill : function of a run, and of the processes that it has killed now, that returns how many it has in all
    keep : function that writes what has ended for good, and returns whether its motion was verified
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
    """Check that a folder can be that of a study: that it is none yet, empty, or a study's."""
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

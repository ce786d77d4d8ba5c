"""`study`, which runs scenes with methods and seeds and returns a table of what came out."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comove.data.runner import on_processes, run_study
from comove.data.runs import COLUMNS, RUNS, StudyRun, StudyStore
from comove.data.store import parquet_kinds
from comove.data.sweep import METHODS, ROBOT_METHODS, Sweep, SweptScene
from comove.errors import OptionError, near_name
from comove.io.parquet import write_parquet
from comove.model.files.keys import canonical
from comove.model.scene import Scene


@dataclass(frozen=True)
class StudyTable:
    """The runs of a study, a row each.

    Attributes
    ----------
    runs : the runs, by seed, then scene, then method
    """

    runs: tuple[StudyRun, ...]

    @property
    def columns(self) -> dict[str, list[Any]]:
        """Return the columns by name, as ``pandas.DataFrame`` and ``polars.DataFrame`` take them."""
        return {name: [getattr(run, name) for run in self.runs] for name in COLUMNS}

    def write_parquet(self, path: str | Path) -> None:
        """Write the table to a Parquet file.

        Raises
        ------
        ExtraError
            If pyarrow is not installed.
        ResultError
            If the file cannot be written.
        """
        write_parquet(path, self.columns, parquet_kinds(StudyStore.KINDS))


def study(
    scenes: Sequence[Scene],
    methods: Sequence[str] = ("comove",),
    seeds: int = 1,
    workers: int = 2,
    *,
    budget: float = 30.0,
    out: str | Path | None = None,
) -> StudyTable:
    """Run scenes with methods and seeds, each along the demonstration that it names, and return a table.

    Parameters
    ----------
    scenes
        Scenes with different names.
    methods
        Names of methods: comove, projection, paper, printed.
    seeds
        Number of runs of every scene with every method, with the seeds from 0 on.
    workers
        Number of processes.
    budget
        Time for each run [s].
    out
        Folder in which the runs are kept, so that the same call goes on where it was interrupted; none unless given.

    Raises
    ------
    OptionError
        If there is nothing to run, two scenes have one name, or a method is unknown.
    ResultError
        If `out` holds another study, or cannot be written.
    """
    names = [scene.name for scene in scenes]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise OptionError(f"two scenes are called {twice!r}", key="scenes", way_out="give each its own name")
    if not names or not methods or seeds < 1:
        raise OptionError("there is nothing to run", key="scenes", way_out="give scenes, methods and seeds")
    for name in methods:
        if name not in METHODS:
            raise OptionError(f"there is no method {name!r}", key="methods", way_out=near_name(name, METHODS))
        if name not in ROBOT_METHODS and any(scene.file.robot for scene in scenes):
            raise OptionError(
                f"by the method {name!r} no robot carries",
                key="methods",
                way_out=f"use {' or '.join(ROBOT_METHODS)}",
            )
    swept = tuple(SweptScene(s.name, s.folder, json.loads(canonical(s.file))) for s in scenes)
    sweep = Sweep("study", swept, tuple(methods), seeds=seeds, budget=budget)
    if out is not None:
        return _run(sweep, Path(out), workers)
    with tempfile.TemporaryDirectory() as folder:
        return _run(sweep, Path(folder), workers)


def _run(sweep: Sweep, folder: Path, workers: int) -> StudyTable:
    run_study(sweep, folder, on_processes(workers))
    wanted = range(sweep.total)
    return StudyTable(tuple(run for run in StudyStore.open(folder / RUNS).runs() if run.number in wanted))

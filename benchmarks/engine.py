"""Equality of a study's rows across runners, and their cost per run.

    python benchmarks/engine.py [--only same cost] [--study planar] [--runs 200]

A study of `examples/studies` is run by a bare loop, on one process and on two, in four parts that are merged, and by
two workers of a Dask scheduler. All tables are compared with those of the bare loop, but for the columns of times and
for runs that used up their budget. The table also shows the time of a run: processor time, which other work on the
machine hardly changes, and time on the wall, which it does; the start of processes is left out of both, by a second,
short run. The efficiency is the bare loop's processor time as a share of that. Then the same with runs that do
nothing, by which the engine's own time is seen.
"""

from __future__ import annotations

import argparse
import hashlib
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import astuple, dataclass, replace
from pathlib import Path

from generate import STUDIES, processor
from generate_work import Idle
from timing import on_one_thread, print_table

from comove.data import Shard, Study, StudyStore, on_processes, run_study
from comove.data.on_dask import on_dask
from comove.data.runner import RunSource
from comove.data.runs import RUNS, UNREPEATED, merge

PARTS = 4


def bare(study: RunSource, folder: Path) -> None:
    """Run a study in this process, and write its database last."""
    made = [study.run(number) for number in range(study.total)]
    folder.mkdir()
    store = StudyStore.create(folder / RUNS)
    with store.writer() as writer:
        for run, motion in made:
            writer.add(run, motion)


def in_parts(study: RunSource, folder: Path) -> None:
    """Run a study in shards, one after the other, and merge them."""
    parts = [folder.with_name(f"{folder.name}-{i}") for i in range(1, PARTS + 1)]
    for i, part in enumerate(parts, 1):
        run_study(study, part, on_processes(1), shard=Shard(i, PARTS))
    merge(parts, folder)


WAYS: dict[str, Callable[[RunSource, Path], object]] = {
    "a bare loop": bare,
    "1 process": lambda study, folder: run_study(study, folder, on_processes(1)),
    "2 processes": lambda study, folder: run_study(study, folder, on_processes(2)),
    f"{PARTS} parts, merged": in_parts,
    "Dask, 2 workers": lambda study, folder: run_study(study, folder, on_dask("local", 2)),
}


@dataclass(frozen=True)
class Cost:
    """Processor time and wall time [s]."""

    processor: float
    wall: float


def cost_of(way: str, study: RunSource, folder: Path) -> Cost:
    """Run a study; return its cost."""
    used, begun = processor(), time.perf_counter()
    WAYS[way](study, folder)
    return Cost(processor() - used, time.perf_counter() - begun)


def each(way: str, few: RunSource, many: RunSource, folder: Path) -> Cost:
    """Return the cost of a run without start-up. The runs of `many` stay in the folder."""
    short, whole = cost_of(way, few, folder.with_name(f"{folder.name}-few")), cost_of(way, many, folder)
    runs = many.total - few.total
    return Cost((whole.processor - short.processor) / runs, (whole.wall - short.wall) / runs)


def rows_in(folder: Path) -> tuple[dict[int, str], set[int]]:
    """Return checksums of a database's runs, by number. Return the runs that were cut short as well."""
    store = StudyStore.open(folder / RUNS)
    motions = {run.number: astuple(motion) for run, motion in store.motions()}
    motions |= {run.number: astuple(motion) for run, motion in store.motions("not delivered")}
    found, cut = {}, set()
    for run in store.runs():
        row = astuple(replace(run, **dict.fromkeys(UNREPEATED)))
        found[run.number] = hashlib.sha256(repr((row, motions.get(run.number))).encode()).hexdigest()
        if run.cut_short:
            cut.add(run.number)
    return found, cut


def same(name: str, runs: int, folder: Path) -> Iterable[list[object]]:
    """Yield a row of the table for each runner of a study."""
    few, many = (Study.load(STUDIES / f"{name}.yaml", episodes=n) for n in (2 * PARTS, runs))
    many.run(0)  # which loads the kernels of the bare loop
    first: dict[int, str] = {}
    alone = Cost(0.0, 0.0)
    for way in WAYS:
        out = folder / way.replace(" ", "-").replace(",", "")
        cost = each(way, few, many, out)
        rows, cut = rows_in(out)
        first, alone = first or rows, alone if first else cost
        told = [number for number in rows if number not in cut]
        equal = sum(rows[number] == first[number] for number in told)
        share = f"{100 * alone.processor / cost.processor:.0f} %"
        yield [way, len(rows), f"{equal}/{len(told)}", f"{cost.processor:.3f}", share, f"{cost.wall:.3f}"]


def cost(folder: Path, runs: int) -> Iterable[list[object]]:
    """Yield a row of the table for each runner of empty runs."""
    for way in WAYS:
        found = each(way, Idle(2 * PARTS), Idle(runs), folder / way.replace(" ", "-").replace(",", ""))
        yield [way, runs, f"{1000 * found.processor:.2f}", f"{1000 * found.wall:.2f}"]


def main() -> None:
    """Run, compare and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--only", choices=("same", "cost"), nargs="+", default=("same", "cost"))
    parser.add_argument("--study", choices=("planar", "spatial", "baxter"), default="planar")
    parser.add_argument("--runs", type=int, default=200)
    parser.add_argument("--idle", type=int, default=3000)
    options = parser.parse_args()
    on_one_thread()
    with tempfile.TemporaryDirectory() as folder:
        if "same" in options.only:
            (Path(folder) / "same").mkdir()
            header = [
                "run by",
                "runs",
                "rows as first",
                "processor, each [s]",
                "efficiency",
                "wall, each [s]",
            ]
            print_table(header, list(same(options.study, options.runs, Path(folder) / "same")))
        if "cost" in options.only:
            (Path(folder) / "cost").mkdir()
            header = ["run by", "runs that do nothing", "processor, each [ms]", "wall, each [ms]"]
            print_table(header, list(cost(Path(folder) / "cost", options.idle)))


if __name__ == "__main__":
    main()

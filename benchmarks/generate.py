"""Generation of episodes: rate, success, variety, size, and overhead.

    python benchmarks/generate.py [--study planar] [--episodes 1000] [--workers 1 2] [--effort quick]
    python benchmarks/generate.py --only many idle grown [--rows 1000000]

First, episodes of a study in `examples/studies`, with each number of processes, from kernels in the cache on disk to
the last row; the motions of all runs are compared, but not of those whose search used up its budget. Then
`solve_many`: what a scene takes beyond `solve`, in its process and in the calling one. Then runs that do
nothing, by which the runner's own time is seen. Last, a run database of as many rows: rows a second that are written,
and the time of a report. All times but one are of the processor, which other work on the machine hardly changes.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import tempfile
import time
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from generate_work import Idle, TimedWork, row_of
from timing import on_one_thread, print_table

from comove.data import Study, StudyStore, on_processes, report_of, run_study
from comove.data.many import SolvingWork
from comove.data.runs import RUNS
from comove.planning.effort import EFFORTS
from comove.processes import run_tasks

STUDIES = Path(__file__).parents[1] / "examples" / "studies"
PARTS = ("episodes", "many", "idle", "grown")
N_MANY, N_IDLE = (
    200,
    5000,
)  # scenes of `solve_many`; runs that do nothing, and rows that are written one by one


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--study", choices=("planar", "spatial", "baxter"), default="planar")
    parser.add_argument("--only", choices=PARTS, nargs="+", default=PARTS)
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--effort", choices=tuple(EFFORTS), default="normal")
    parser.add_argument("--rows", type=int, default=1_000_000)
    options = parser.parse_args()
    on_one_thread()
    with tempfile.TemporaryDirectory() as folder:
        if "episodes" in options.only:
            show(EPISODES, generated(options, Path(folder)))
        if "many" in options.only:
            show(MANY, [many()])
        if "idle" in options.only:
            show(IDLE, [idle(Path(folder), workers) for workers in options.workers])
        if "grown" in options.only:
            show(GROWN, [grown(Path(folder), options.rows)])


EPISODES = {
    "workers": "workers",
    "episodes": "episodes",
    "rate": "a second on the wall",
    "each": "of the processor",
    "seconds": "median run [s]",
    "verified": "verified",
    "rejected": "rejected draws",
    "bytes": "bytes each",
    "starts": "starts [m]",
    "paths": "paths [m]",
    "shapes": "shapes [m]",
    "classes": "classes",
    "entropy": "entropy [bit]",
    "cut": "cut short",
    "same": "same motions of the others",
}
MANY = {"scenes": "scenes", "solve": "solve [ms]", "beyond": "beyond it [ms]", "p90": "p90"}
IDLE = {"workers": "workers", "runs": "idle runs", "each": "each [ms]", "wall": "on the wall [ms]"}
GROWN = {"rows": "rows", "written": "written a second", "report": "report [s]", "bytes": "bytes a row"}


def show(header: dict[str, str], rows: Iterable[dict[str, Any]]) -> None:
    """Print a table."""
    print_table(list(header.values()), [[row[key] for key in header] for row in rows])
    print(flush=True)


def processor() -> float:
    """Return the processor time of this and its ended processes [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def generated(options: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield a row for each number of processes."""
    study = Study.load(STUDIES / f"{options.study}.yaml", episodes=options.episodes)
    study = replace(study, file=study.file.model_copy(update={"effort": options.effort}))
    first = None
    for count in options.workers:
        out = folder / f"out-{count}"
        begun, used = time.perf_counter(), processor()
        run_study(study, out, on_processes(count))
        seconds, used = time.perf_counter() - begun, processor() - used
        report = report_of(out)
        runs = list(StudyStore.open(out / RUNS).runs())
        motions = {run.number: run.motion_sha256 for run in runs if not run.cut_short}
        first = first or motions
        both = motions.keys() & first.keys()
        found = report.variety
        yield {
            "workers": count,
            "episodes": report.ended,
            "rate": f"{report.ended / seconds:.2f}",
            "each": f"{report.ended / used:.2f}",
            "seconds": f"{report.seconds:.3f}",
            "verified": f"{100 * report.verified_share:.2f} %",
            "rejected": f"{100 * report.rejected_share:.1f} %",
            "bytes": f"{report.bytes_each:.0f}",
            "starts": f"{found.starts:.3f}",
            "paths": f"{found.paths:.3f}",
            "shapes": f"{found.shapes:.3f}",
            "classes": len(found.classes),
            "entropy": f"{found.entropy:.2f}",
            "cut": report.cut_short,
            "same": f"{sum(motions[n] == first[n] for n in both)}/{len(both)}",
        }


def many() -> dict[str, Any]:
    """Return a scene's overhead in `solve_many`. It is the time beyond `solve`, in its process and in this one."""
    study = Study.load(STUDIES / "planar.yaml")
    tasks = iter([(number, study.draw(number).scene) for number in range(N_MANY)])
    working = run_tasks(TimedWork(SolvingWork()), lambda: next(tasks, None), workers=1)
    _, left, _ = next(working).made  # the process has started, and loaded the kernels
    beyond, inside, before = [], [], time.process_time()
    for ended in working:
        now, (begun, done, _) = time.process_time(), ended.made
        inside.append(done - begun)
        beyond.append(now - before + begun - left)
        before, left = now, done
    beyond.sort()
    return {
        "scenes": len(beyond),
        "solve": f"{1000 * statistics.median(inside):.1f}",
        "beyond": f"{1000 * statistics.median(beyond):.2f}",
        "p90": f"{1000 * beyond[int(0.9 * len(beyond))]:.2f}",
    }


def idle(folder: Path, workers: int) -> dict[str, Any]:
    """Return the time of an empty run, from first to last row. Its process's part is included."""
    times: list[float] = []
    used = processor()
    run_study(
        Idle(N_IDLE),
        folder / f"idle-{workers}",
        on_processes(workers),
        tell=lambda progress: times.append(time.perf_counter()),
    )
    return {
        "workers": workers,
        "runs": N_IDLE,
        "each": f"{1000 * (processor() - used) / N_IDLE:.3f}",
        "wall": f"{1000 * (times[-1] - times[1]) / (N_IDLE - 1):.3f}",
    }


def grown(folder: Path, rows: int) -> dict[str, Any]:
    """Return the write rate of a large database, and its report's time. Rows are written one by one at last."""
    out = folder / "grown"
    out.mkdir()
    store = StudyStore.create(out / RUNS)
    last = min(rows, N_IDLE)
    with store.writer() as writer:
        store.describe({}, rows)
        for number in range(rows - last):
            writer.add(row_of(number))
        begun = time.process_time()
        for number in range(rows - last, rows):
            writer.add(row_of(number))
        written = time.process_time() - begun
    begun = time.process_time()
    report = report_of(out)
    seconds = time.process_time() - begun
    return {
        "rows": report.ended,
        "written": f"{last / written:.0f}",
        "report": f"{seconds:.2f}",
        "bytes": f"{report.bytes_each:.0f}",
    }


if __name__ == "__main__":
    main()

"""Generated episodes: how many a second, how many verified, how various, how many bytes; what the runner costs.

    python benchmarks/generate.py [--episodes 1000] [--workers 1 2] [--rows 1000000]

First, episodes of `examples/studies/around_posts.yaml` (planar, three posts, a bar, four people's movements), with
each number of processes, from kernels in the cache on disk to the last row; the motions of all runs are compared, but
not of those whose search used up its budget. Then `solve_many`: what a scene takes beyond `solve` in its process.
Then runs that do nothing, by which the runner's own time is seen. Last, a store of as many rows: rows a second that
are written, and the time of a report.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import yaml
from generate_work import Idle, TimedWork, row_of
from timing import on_one_thread, print_table

from comove.processes import run_tasks
from comove.studies import Study, StudyStore, on_processes, report_of, run_study
from comove.studies.many import SolvingWork
from comove.studies.runs import RUNS

STUDY = Path(__file__).parents[1] / "examples" / "studies" / "around_posts.yaml"
N_MANY, N_IDLE = (
    200,
    5000,
)  # scenes of `solve_many`; runs that do nothing, and rows that are written one by one


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--episodes", type=int, default=1000)
    parser.add_argument("--workers", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--rows", type=int, default=1_000_000)
    options = parser.parse_args()
    on_one_thread()
    with tempfile.TemporaryDirectory() as folder:
        show(EPISODES, generated(Path(folder), options.episodes, options.workers))
        show(MANY, [many()])
        show(IDLE, [idle(Path(folder), workers) for workers in options.workers])
        show(GROWN, [grown(Path(folder), options.rows)])


EPISODES = {
    "workers": "workers",
    "episodes": "episodes",
    "rate": "a second",
    "seconds": "median [s]",
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
IDLE = {"workers": "workers", "runs": "idle runs", "each": "each [ms]"}
GROWN = {"rows": "rows", "written": "written a second", "report": "report [s]", "bytes": "bytes a row"}


def show(header: dict[str, str], rows: Iterable[dict[str, Any]]) -> None:
    """Print a table."""
    print_table(list(header.values()), [[row[key] for key in header] for row in rows])
    print(flush=True)


def generated(folder: Path, episodes: int, workers: list[int]) -> Iterator[dict[str, Any]]:
    """Yield a row for each number of processes."""
    contents = yaml.safe_load(STUDY.read_text(encoding="utf-8"))
    contents |= {
        "episodes": episodes,
        "scene": yaml.safe_load((STUDY.parent / contents["scene"]).read_text()),
    }
    (folder / "study.yaml").write_text(json.dumps(contents))
    study, first = Study.load(folder / "study.yaml"), None
    for count in workers:
        out = folder / f"out-{count}"
        begun = time.perf_counter()
        run_study(study, out, on_processes(count))
        seconds, report = time.perf_counter() - begun, report_of(out)
        runs = list(StudyStore.open(out / RUNS).runs())
        motions = {run.number: run.motion_sha256 for run in runs if not run.cut_short}
        first = first or motions
        both = motions.keys() & first.keys()
        found = report.variety
        yield {
            "workers": count,
            "episodes": report.ended,
            "rate": f"{report.ended / seconds:.2f}",
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
    """Return what a scene of `solve_many` takes beyond its work, on one process, from scenes to outcomes."""
    study = Study.load(STUDY)
    tasks = iter([(number, study.draw(number).scene) for number in range(N_MANY)])
    working = run_tasks(TimedWork(SolvingWork()), lambda: next(tasks, None), workers=1)
    next(working)  # the process has started, and loaded the kernels
    beyond, inside, before = [], [], time.perf_counter()
    for ended in working:
        now = time.perf_counter()
        inside.append(ended.made[0])
        beyond.append(now - before - inside[-1])
        before = now
    beyond.sort()
    return {
        "scenes": len(beyond),
        "solve": f"{1000 * statistics.median(inside):.1f}",
        "beyond": f"{1000 * statistics.median(beyond):.2f}",
        "p90": f"{1000 * beyond[int(0.9 * len(beyond))]:.2f}",
    }


def idle(folder: Path, workers: int) -> dict[str, Any]:
    """Return the time of a run that does nothing, from the first row to the last."""
    times: list[float] = []
    run_study(
        Idle(N_IDLE),
        folder / f"idle-{workers}",
        on_processes(workers),
        tell=lambda progress: times.append(time.perf_counter()),
    )
    return {"workers": workers, "runs": N_IDLE, "each": f"{1000 * (times[-1] - times[1]) / (N_IDLE - 1):.3f}"}


def grown(folder: Path, rows: int) -> dict[str, Any]:
    """Return how fast rows are written into a large store, each by itself at last, and the time of a report."""
    out = folder / "grown"
    out.mkdir()
    store = StudyStore.create(out / RUNS)
    last = min(rows, N_IDLE)
    with store.writer() as writer:
        store.describe({}, rows)
        writer.add_all(map(row_of, range(rows - last)))
        begun = time.perf_counter()
        for number in range(rows - last, rows):
            writer.add(row_of(number))
        written = time.perf_counter() - begun
    begun = time.perf_counter()
    report = report_of(out)
    seconds = time.perf_counter() - begun
    return {
        "rows": report.ended,
        "written": f"{last / written:.0f}",
        "report": f"{seconds:.2f}",
        "bytes": f"{report.bytes_each:.0f}",
    }


if __name__ == "__main__":
    main()

"""`comove bench run`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import INTERRUPTED, verb_of
from comove.cli.bench.app import bench_app, names_of


@verb_of(bench_app)
def run(
    out: Annotated[Path, typer.Option(help="File for the runs (SQLite); one that is there is gone on with.")],
    sets: Annotated[
        list[str], typer.Option(metavar="SET,...", help="Of: easy, hard, extreme; all unless given.")
    ] = ("easy", "hard", "extreme"),
    scenes: Annotated[
        int | None, typer.Option(metavar="N", help="Of every set, the first; all 50 unless given.")
    ] = None,
    systems: Annotated[
        list[str], typer.Option(metavar="SYSTEM,...", help="What runs; comove unless given.")
    ] = ("comove",),
    seeds: Annotated[
        int, typer.Option(metavar="N", help="Runs of every scene, with the seeds 0 to N-1.")
    ] = 1,
    budget: Annotated[float, typer.Option(help="Seconds a run.")] = 10.0,
    workers: Annotated[
        int, typer.Option(metavar="N", help="Runs at a time; more than one share the machine's memory.")
    ] = 1,
) -> int:
    """Run systems on the frozen sets of scenes; what is in the file already is not run again."""
    from comove.experiments.bench.runner import BenchProgress, jobs_of, run_all
    from comove.experiments.bench.sets import scenes_of
    from comove.experiments.registry import systems_named

    chosen = [scene for name in names_of(sets) for scene in scenes_of(name, scenes)]
    jobs = jobs_of(chosen, systems_named(names_of(systems)), seeds, budget)
    last = BenchProgress(0, 0, len(jobs))

    def tell(progress: BenchProgress) -> None:
        nonlocal last
        if progress.done == progress.before and progress.before:
            print(f"{progress.before} of {progress.total} runs were in {out} already", file=sys.stderr)
        if sys.stderr.isatty():
            print(f"\r{progress.done} of {progress.total} runs", end="", file=sys.stderr, flush=True)
        last = progress

    try:
        last = run_all(out, jobs, workers, tell)
    except KeyboardInterrupt:
        print(
            f"\ninterrupted: {last.done} of {last.total} runs are in {out}; the same command goes on",
            file=sys.stderr,
        )
        return INTERRUPTED
    if sys.stderr.isatty():
        print(file=sys.stderr)
    print(f"{out} holds all {last.total} runs; see: comove bench report {out} --out FOLDER")
    return 0

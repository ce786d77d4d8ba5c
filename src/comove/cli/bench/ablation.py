"""`comove bench ablation`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import INTERRUPTED, verb_of
from comove.cli.bench.app import bench_app


@verb_of(bench_app)
def ablation(
    out: Annotated[
        Path, typer.Option(help="Folder for runs.sqlite, which is gone on with, and ablation.md.")
    ],
    scenes: Annotated[int, typer.Option(metavar="N", help="Of the easy set, beside the paper's three.")] = 20,
    seeds: Annotated[int, typer.Option(metavar="N", help="Runs of every scene.")] = 10,
    budget: Annotated[float, typer.Option(help="Seconds a run.")] = 15.0,
    workers: Annotated[int, typer.Option(metavar="N", help="Runs at a time.")] = 1,
) -> int:
    """Leave out each repair of the paper's method by itself, and say what it is worth."""
    from comove.errors import ResultError
    from comove.experiments.bench.runner import jobs_of, run_all
    from comove.experiments.bench.store import RunStore
    from comove.experiments.paper.ablation import page, systems
    from comove.experiments.paper.ablation import scenes as scenes_of
    from comove.io.files import whole_file

    jobs, store = jobs_of(scenes_of(scenes), systems(), seeds, budget), out / "runs.sqlite"
    out.mkdir(parents=True, exist_ok=True)
    try:
        run_all(
            store,
            jobs,
            workers,
            lambda done: print(f"\r{done.done} of {done.total} runs", end="", file=sys.stderr, flush=True),
        )
    except KeyboardInterrupt:
        print(f"\ninterrupted: the runs so far are in {store}; the same command goes on", file=sys.stderr)
        return INTERRUPTED
    wanted = {job.configuration.key for job in jobs}
    runs = [run for run in RunStore.open(store).runs() if run.configuration.key in wanted]
    with whole_file(out / "ablation.md", ResultError) as file:
        file.write(page(runs, budget).encode())
    print(f"\npage: {out / 'ablation.md'}")
    return 0

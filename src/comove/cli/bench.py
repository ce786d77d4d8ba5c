"""Verbs of `comove bench`."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import sub_application, verb_of
from comove.cli.studies import telling_progress

group = sub_application(
    "bench", "Benchmark: draw scenes, run systems on frozen sets, report, export, measure scaling."
)

SETS = ["easy", "hard", "extreme"]
ALL_SETS = "easy, hard, extreme, robots-easy, robots-hard, robots-extreme"
SYSTEMS = ["comove"]
GROWTHS = ["manipulators", "basis", "steps", "obstacles", "difficulty"]

Store = Annotated[Path, typer.Argument(metavar="STORE", help="File of runs (SQLite).")]


def names_of(given: list[str]) -> list[str]:
    """Return the distinct names in repeated or comma-separated options."""
    return list(dict.fromkeys(name.strip() for text in given for name in text.split(",") if name.strip()))


@verb_of(group)
def draw(
    name: Annotated[str, typer.Argument(metavar="SET", help=f"One of: {ALL_SETS}.")],
    out: Annotated[Path, typer.Option(help="Folder for the scenes and their witnesses.")],
    count: Annotated[
        int | None, typer.Option(help="Scenes, in turn of every kind; as many as are frozen unless given.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers; the frozen sets have 0.")] = 0,
) -> int:
    """Sample scenes from the distribution of SET."""
    from comove.lab.bench.sets import draw_set

    count = draw_set(name, out, count, seed)
    print(f"{out} holds {count} scene{'' if count == 1 else 's'}, and witnesses that each can be solved")
    return 0


@verb_of(group)
def run(
    own: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[SCENE...]", help="Scenes of one's own, or folders of them, instead of sets."
        ),
    ] = None,
    *,
    out: Annotated[Path, typer.Option(help="File for the runs (SQLite); one that is there is gone on with.")],
    sets: Annotated[
        list[str] | None,
        typer.Option(metavar="SET,...", help=f"Of: {ALL_SETS}; the first three unless given."),
    ] = None,
    scenes: Annotated[
        int | None, typer.Option(metavar="N", help="Of every set, the first; all unless given.")
    ] = None,
    systems: Annotated[
        list[str], typer.Option(metavar="SYSTEM,...", help="What runs; comove unless given.")
    ] = SYSTEMS,
    seeds: Annotated[
        int, typer.Option(metavar="N", help="Runs of every scene, with the seeds 0 to N-1.")
    ] = 1,
    budget: Annotated[float, typer.Option(help="Seconds a run.")] = 10.0,
    workers: Annotated[
        int, typer.Option(metavar="N", help="Runs at a time; more than one share the machine's memory.")
    ] = 1,
) -> int:
    """Run systems on the frozen sets, or on SCENEs. Runs that the file holds already are not repeated."""
    from comove.lab.bench.runner import jobs_of, run_all
    from comove.lab.bench.sets import own_scenes, scenes_of
    from comove.lab.registry import systems_named

    named = names_of(sets if sets is not None else [] if own else SETS)
    chosen = [scene for name in named for scene in scenes_of(name, scenes)] + own_scenes(own or [])
    jobs = jobs_of(chosen, systems_named(names_of(systems)), seeds, budget)
    with telling_progress(out, len(jobs)) as tell:
        run_all(out, jobs, workers, tell)
    print(f"{out} holds all {len(jobs)} runs; see: comove bench report {out} --out FOLDER")
    return 0


@verb_of(group)
def report(
    store: Store, out: Annotated[Path, typer.Option(help="Folder for report.md and its pictures.")]
) -> int:
    """Report success, times, costs and missing runs of STORE."""
    from comove.io.folders import check_target
    from comove.lab.bench.report import CONTENTS, REPORT, write_report
    from comove.lab.bench.store import RunStore

    check_target(out, CONTENTS)
    write_report(RunStore.open(store), out)
    print(f"report: {out / REPORT}")
    return 0


@verb_of(group)
def export(
    store: Store, out: Annotated[Path, typer.Option(help="File for the table (Parquet); it is replaced.")]
) -> int:
    """Write the runs of STORE as a Parquet file, one row each."""
    from comove.lab.bench.store import RunStore

    count = RunStore.open(store).write_parquet(out)
    print(f"{out} holds {count} run{'' if count == 1 else 's'}")
    return 0


@verb_of(group)
def scaling(
    out: Annotated[Path, typer.Option(help="Folder for scaling.md and its picture.")],
    of: Annotated[
        list[str],
        typer.Option(
            metavar="WHAT,...",
            help="Of: manipulators, basis, steps, obstacles, difficulty; all unless given.",
        ),
    ] = GROWTHS,
    repeats: Annotated[int, typer.Option(help="Measurements of every point.")] = 7,
    no_solve: Annotated[
        bool, typer.Option("--no-solve", help="Leave out the times of whole solves.")
    ] = False,
) -> int:
    """Measure how solve times grow, and fit exponents."""
    from comove.processes import ONE_THREAD

    os.environ.update(
        ONE_THREAD
    )  # for libraries that are loaded from now on, like the workers of `bench run`
    from comove.lab.bench.scaling import REPORT, write_scaling

    write_scaling(out, names_of(of), repeats, solves=not no_solve)
    print(f"report: {out / REPORT}")
    return 0


@verb_of(group)
def ablation(
    out: Annotated[
        Path, typer.Option(help="Folder for runs.sqlite, which is gone on with, and ablation.md.")
    ],
    scenes: Annotated[int, typer.Option(metavar="N", help="Of the easy set, beside the paper's three.")] = 20,
    seeds: Annotated[int, typer.Option(metavar="N", help="Runs of every scene.")] = 10,
    budget: Annotated[float, typer.Option(help="Seconds a run.")] = 15.0,
    workers: Annotated[int, typer.Option(metavar="N", help="Runs at a time.")] = 1,
) -> int:
    """Measure the effect of each repair of the paper's method. Each repair is left out by itself."""
    from comove.errors import ResultError
    from comove.io.files import whole_file
    from comove.lab.bench.runner import jobs_of, run_all
    from comove.lab.bench.store import RunStore
    from comove.lab.paper.ablation import page, systems
    from comove.lab.paper.ablation import scenes as scenes_of

    jobs, store = jobs_of(scenes_of(scenes), systems(), seeds, budget), out / "runs.sqlite"
    out.mkdir(parents=True, exist_ok=True)
    with telling_progress(store, len(jobs)) as tell:
        run_all(store, jobs, workers, tell)
    wanted = {job.configuration.key for job in jobs}
    runs = [run for run in RunStore.open(store).runs() if run.configuration.key in wanted]
    with whole_file(out / "ablation.md", ResultError) as file:
        file.write(page(runs, budget).encode())
    print(f"page: {out / 'ablation.md'}")
    return 0

"""`comove bench scaling`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import verb_of
from comove.cli.bench.app import bench_app, names_of, on_one_thread


@verb_of(bench_app)
def scaling(
    out: Annotated[Path, typer.Option(help="Folder for scaling.md and its picture.")],
    of: Annotated[
        list[str],
        typer.Option(
            metavar="WHAT,...",
            help="Of: manipulators, basis, steps, obstacles, difficulty; all unless given.",
        ),
    ] = ("manipulators", "basis", "steps", "obstacles", "difficulty"),
    repeats: Annotated[int, typer.Option(help="Measurements of every point.")] = 7,
    no_solve: Annotated[
        bool, typer.Option("--no-solve", help="Leave out the times of whole solves.")
    ] = False,
) -> int:
    """Measure how the time grows with what is asked, and fit exponents."""
    on_one_thread()
    from comove.experiments.bench.scaling import REPORT, write_scaling

    write_scaling(out, names_of(of), repeats, solves=not no_solve)
    print(f"report: {out / REPORT}")
    return 0

"""`comove bench draw`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import verb_of
from comove.cli.bench.app import bench_app


@verb_of(bench_app)
def draw(
    name: Annotated[str, typer.Argument(metavar="SET", help="One of: easy, hard, extreme.")],
    out: Annotated[Path, typer.Option(help="Folder for the scenes and their witnesses.")],
    count: Annotated[int, typer.Option(help="Scenes; every other one is in space.")] = 50,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers; the frozen sets have 0.")] = 0,
) -> int:
    """Draw scenes as those of SET are drawn."""
    from comove.experiments.bench.sets import WITNESSES, draw_set

    draw_set(name, out, count, seed)
    print(f"{out} holds {count} scene{'' if count == 1 else 's'}, and in {WITNESSES} how each can be solved")
    return 0

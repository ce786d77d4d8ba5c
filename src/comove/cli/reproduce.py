"""`comove reproduce`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import VERIFIED, since_process_start, verb


@verb
def reproduce(
    out: Annotated[Path, typer.Option(help="Folder for the page and its figures.")] = Path("reproduced"),
    seeds: Annotated[int, typer.Option(help="Seeds in the large comparison; a few for a quick look.")] = 50,
    processes: Annotated[
        int | None, typer.Option(help="Runs at once; as many as there are cores unless given.")
    ] = None,
) -> int:
    """Reproduce all experiments of the paper on one page."""
    from comove.dmp.arguments import require_count
    from comove.io.folders import whole_folder
    from comove.lab.paper.claims import ClaimVerdict
    from comove.lab.paper.page import CONTENTS, PAGE
    from comove.lab.paper.page import reproduce as reproduce_all
    from comove.processes import n_processors

    processes = n_processors() if processes is None else processes
    require_count("--seeds", seeds)
    require_count("--processes", processes)

    def tell(words: str) -> None:
        print(f"{since_process_start():6.0f} s  {words}", file=sys.stderr)

    with whole_folder(out, CONTENTS) as draft:
        counts = reproduce_all(draft, seeds, processes=processes, tell=tell)
    print("\n".join(f"{counts[verdict]:3d} {verdict.value}" for verdict in ClaimVerdict))
    print(f"page: {out / PAGE}")
    return VERIFIED

"""`comove bench export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import verb_of
from comove.cli.bench.app import Store, bench_app


@verb_of(bench_app)
def export(
    store: Store, out: Annotated[Path, typer.Option(help="File for the table (Parquet); it is replaced.")]
) -> int:
    """Write the runs of STORE as a Parquet file, a row each."""
    from comove.experiments.bench.store import RunStore, export_parquet

    count = export_parquet(RunStore.open(store), out)
    print(f"{out} holds {count} run{'' if count == 1 else 's'}")
    return 0

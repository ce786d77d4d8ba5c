"""`comove bench report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import verb_of
from comove.cli.bench.app import Store, bench_app


@verb_of(bench_app)
def report(
    store: Store, out: Annotated[Path, typer.Option(help="Folder for report.md and its pictures.")]
) -> int:
    """Say what the runs of STORE show: success, times, costs, and what is missing."""
    from comove.experiments.bench.report import CONTENTS, REPORT, write_report
    from comove.experiments.bench.store import RunStore
    from comove.results import check_target

    check_target(out, CONTENTS)
    write_report(RunStore.open(store), out)
    print(f"report: {out / REPORT}")
    return 0

"""Everything: run, draw, judge the claims, write the page."""

from __future__ import annotations

import resource
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path

from comove.experiments.paper.claims import ClaimVerdict, judge_all
from comove.experiments.paper.figures import BAXTER, FIGURES, draw_all
from comove.experiments.paper.page import Effort, write_page
from comove.experiments.paper.runs import run_everything
from comove.experiments.paper.tables import all_runs
from comove.results import Contents

PAGE, FOLDER, RUNS = "paper.md", "paper", "runs.csv"
CONTENTS = Contents(
    "reproduction",
    frozenset({PAGE}),
    frozenset({PAGE, *(f"{FOLDER}/{name}" for name in (*FIGURES, *BAXTER.values(), RUNS))}),
)
"""Of the folder that is written."""


def reproduce(
    folder: Path, seeds: int, *, processes: int, tell: Callable[[str], None] = lambda words: None
) -> Counter[ClaimVerdict]:
    """Write the page, its figures and all runs into an existing folder; returns how often there is which verdict.

    Parameters
    ----------
    seeds : in the large comparison
    processes : runs at once
    tell : called with words on how far it is
    """
    started, before = time.perf_counter(), _processor_time()
    runs = run_everything(seeds, processes, tell)
    tell("pictures")
    draw_all(runs, folder / FOLDER)
    (folder / FOLDER / RUNS).write_text(all_runs(runs), encoding="utf-8")
    findings = judge_all(runs)
    effort = Effort(time.perf_counter() - started, _processor_time() - before, processes)
    (folder / PAGE).write_text(write_page(runs, findings, effort, FOLDER), encoding="utf-8")
    return Counter(finding.verdict for _, finding in findings)


def _processor_time() -> float:
    """Of this process and of those that it has begun and that have ended [s]."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)

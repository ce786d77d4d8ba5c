"""The whole reproduction: run, draw, judge the claims, write the page."""

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
from comove.io.folders import Contents

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
    """Write the page, its figures and all runs into an existing folder; return the number of claims by verdict.

    Parameters
    ----------
    seeds : number of seeds in the large comparison
    processes : number of runs at the same time
    tell : function called with words on the progress
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
    """Return the processor time of this process and of its ended children [s]."""
    usages = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(usage.ru_utime + usage.ru_stime for usage in usages)

"""The sub-application `comove bench`, and functions shared by its verbs."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import sub_application

bench_app = sub_application(
    "bench", "Benchmark: draw scenes, run systems on frozen sets, report, export, measure scaling."
)

Store = Annotated[Path, typer.Argument(metavar="STORE", help="File of runs (SQLite).")]


def on_one_thread() -> None:
    """Restrict libraries that are loaded from now on to one thread, like the workers of `comove bench run`."""
    from comove.experiments.workers import ONE_THREAD

    os.environ.update(ONE_THREAD)


def names_of(given: list[str]) -> list[str]:
    """Return the distinct names in options that may be repeated or hold several names with commas."""
    return list(dict.fromkeys(name.strip() for text in given for name in text.split(",") if name.strip()))

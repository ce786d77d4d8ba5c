"""The sub-application, and what its verbs share."""

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
    """Keep libraries that are loaded from now on to one thread, as the workers of `comove bench run` are."""
    from comove.experiments.workers import ONE_THREAD

    os.environ.update(ONE_THREAD)


def names_of(given: list[str]) -> list[str]:
    """Names as people write them, with commas between or one option each, each once."""
    return list(dict.fromkeys(name.strip() for text in given for name in text.split(",") if name.strip()))

"""The sub-application, and what its verbs share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import app

bench_app = typer.Typer(
    name="bench",
    help="Benchmark: draw scenes, run systems on frozen sets, report, export, measure scaling.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.add_typer(bench_app)

Store = Annotated[Path, typer.Argument(metavar="STORE", help="File of runs (SQLite).")]


@bench_app.callback()
def options() -> None:
    """Benchmark: draw scenes, run systems on frozen sets, report, export, measure scaling."""


THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")


def on_one_thread() -> None:
    """Keep libraries that are loaded from now on to one thread, as the workers of `comove bench run` are."""
    os.environ.update(dict.fromkeys(THREADS, "1"))


def names_of(given: list[str]) -> list[str]:
    """Names as people write them, with commas between or one option each, each once."""
    return list(dict.fromkeys(name.strip() for text in given for name in text.split(",") if name.strip()))

"""The sub-application, and what its verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import app

robot_app = typer.Typer(
    name="robot",
    help="Robots that carry the load: solve, simulate, export, send.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.add_typer(robot_app)

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of `comove robot solve`.")]


@robot_app.callback()
def options() -> None:
    """Robots that carry the load: solve, simulate, export, send."""

"""The sub-application, and what its verbs share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import app

library_app = typer.Typer(
    name="library",
    help="A folder of movement primitives: add, list, show, find, combine, remove.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
app.add_typer(library_app)

Folder = Annotated[Path, typer.Option(help="Folder of the library.")]
FOLDER = Path("library")


@library_app.callback()
def options() -> None:
    """A folder of movement primitives: add, list, show, find, combine, remove."""

"""The sub-application `comove library`, and options shared by its verbs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import sub_application

library_app = sub_application(
    "library", "A folder of movement primitives: add, list, show, find, combine, remove."
)

Folder = Annotated[Path, typer.Option(help="Folder of the library.")]
FOLDER = Path("library")

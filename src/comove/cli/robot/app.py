"""The sub-application `comove robot`, and options shared by its verbs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import sub_application

robot_app = sub_application("robot", "Robots that carry the load: solve, simulate, export, send.")

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of `comove robot solve`.")]

"""`comove report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import NOT_VERIFIED, VERIFIED, verb
from comove.cli.texts import say
from comove.errors import OptionError


@verb
def report(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Result folder.")],
    html: Annotated[Path, typer.Option(help="File for the page.")],
) -> int:
    """Write a result as one page with numbers and a playable motion."""
    from comove.io.files import require_target
    from comove.io.folders import require_folder
    from comove.view.workbench.recorded import write_page
    from comove.view.workbench.report import report_page
    from comove.view.workbench.server import viewer
    from comove.view.workbench.shelf import shelf_of

    viewer()
    require_folder(folder, "comove solve SCENE --out DIR")
    require_target(html, OptionError)
    page, playback = report_page(shelf_of([folder], Path.cwd()))
    write_page(html, page)
    say(f"{folder}: {playback.told}, {html} ({len(page) / 1e6:.1f} MB)")
    return VERIFIED if playback.holds else NOT_VERIFIED

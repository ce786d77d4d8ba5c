"""Pictures of a result, drawn by a process that loads Matplotlib while the search goes on."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from comove.errors import ComoveWarning

if TYPE_CHECKING:
    from comove.processes import Ahead
    from comove.view.figures import Pictures

    Drawer = Ahead[Pictures | None, dict[str, bytes]]


@contextmanager
def drawing_ahead(wanted: bool) -> Iterator[Drawer | None]:
    """Yield a process that prepares to draw; None where nothing is drawn, or there is no core for it."""
    from comove.processes import ALONE, Ahead, n_processors
    from comove.view.figures.pictures import drawn

    if not wanted or not sys.executable or ALONE in os.environ or n_processors() < 2:
        yield None
        return
    with Ahead(drawn) as drawer:
        yield drawer


def add_pictures(pictures: Pictures, folder: Path, identity: int, drawer: Drawer | None) -> None:
    """Draw pictures into a result folder that is whole without them, each as a whole; warn if they fail.

    Parameters
    ----------
    identity : of the folder (`comove.io.folders.identity_of`): another in its place gets none
    """
    from comove.io.folders import add_files
    from comove.view.figures.pictures import drawn

    if drawer is None:
        add_files(folder, drawn(pictures), identity)
        return
    found = drawer.work_on(pictures)
    if found.made is not None:
        add_files(folder, found.made, identity)
        return
    warnings.warn(
        f"{folder}: no pictures were drawn, as {found.error or 'the process that draws them was killed'}; the result "
        "is whole without them: give the command once more for pictures, or with --no-pictures",
        ComoveWarning,
        stacklevel=2,
    )

"""Drawing of results by a process that loads Matplotlib in advance."""

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
    """Yield a process that prepares to draw. Yield None where nothing is drawn, or there is no core for it."""
    from comove.processes import ALONE, Ahead, n_processors
    from comove.view.figures.pictures import drawn

    if not wanted or not sys.executable or ALONE in os.environ or n_processors() < 2:
        yield None
        return
    try:
        ahead = Ahead(drawn)
    except OSError:  # no more processes: the pictures are drawn here
        yield None
        return
    with ahead as drawer:
        yield drawer


def add_pictures(pictures: Pictures, folder: Path, identity: int, drawer: Drawer | None) -> None:
    """Draw pictures into a complete result folder; warn on failure.

    Parameters
    ----------
    identity : of the folder (`comove.io.folders.identity_of`): a folder that replaced it gets no pictures
    """
    from comove.io.folders import add_files
    from comove.view.figures.pictures import drawn

    made, reason = None, ""
    if drawer is None:
        try:
            made = drawn(pictures)
        except Exception as error:
            reason = f"{type(error).__name__}: {error}"
    else:
        found = drawer.work_on(pictures)
        made, reason = found.made, found.error or "the process that draws them was killed"
    if made is not None:
        add_files(folder, made, identity)
        return
    warnings.warn(
        f"{folder}: pictures could not be drawn ({reason}); the result is complete: give the command once more for "
        "pictures, or with --no-pictures",
        ComoveWarning,
        stacklevel=2,
    )

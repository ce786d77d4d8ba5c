"""`show`: a scene, a solution, a motion or a result folder, seen in a notebook or in a browser."""

from __future__ import annotations

import html
import sys
import tempfile
import webbrowser
from pathlib import Path
from typing import Any

from comove.workbench.playback import playback_of
from comove.workbench.recorded import page_of, write_page

HEIGHT = 480  # pixels, of a page in a notebook


def show(thing: Any, beside: Any = None) -> None:
    """Show something that moves: inside a notebook, or else as a page that is opened in a browser.

    Parameters
    ----------
    thing
        A scene, a solution of `comove.solve` or `comove.robots.carry`, a motion, the record of an execution, a result
        that was read, or the path of a scene file or result folder; what stands in a folder is judged anew.
    beside
        Another such thing, shown to the right of it and on the same clock.

    Raises
    ------
    TypeError
        If it is nothing of the kind.
    ExtraError
        If the viewer is not installed.
    """
    page = page_of(playback_of(thing), None if beside is None else playback_of(beside))
    if in_notebook():
        from IPython.display import HTML, display

        display(HTML(framed(page)))
        return
    path = Path(tempfile.mkdtemp(prefix="comove-")) / "page.html"
    write_page(path, page)
    if not webbrowser.open(path.as_uri()):
        print(f"there is no browser here; the page is {path}")


def in_notebook() -> bool:
    """Return whether this runs in a notebook, which shows pages, and not in a terminal."""
    ipython = sys.modules.get("IPython")
    shell = None if ipython is None else ipython.get_ipython()
    return hasattr(shell, "kernel")


def framed(page: str) -> str:
    """Return a page as part of another one, on which its scripts cannot act."""
    return (
        f'<iframe title="comove" sandbox="allow-scripts" srcdoc="{html.escape(page)}" width="100%" '
        f'height="{HEIGHT}" style="border:1px solid #ccc"></iframe>'
    )

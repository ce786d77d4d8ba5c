"""Playback as one offline page for any browser. `show` displays such a page in a notebook, or opens it in a
browser."""

from __future__ import annotations

import html
import tempfile
import webbrowser
from pathlib import Path
from typing import Any

import numpy as np

from comove._version import __version__
from comove.errors import OptionError
from comove.io.files import whole_file
from comove.io.notebooks import in_notebook
from comove.model.demonstration import demonstration_of
from comove.planning.solution import ProgressCallback
from comove.solving import solve
from comove.view.workbench.bodies import bodies_of, poses_of, robot_of
from comove.view.workbench.playback import Playback, playback_of, playback_of_item
from comove.view.workbench.server import start
from comove.view.workbench.shelf import Item, read_scene
from comove.view.workbench.stage import Stage, demonstrated

POLICY = "default-src 'unsafe-inline' 'unsafe-eval' data: blob:"
"""Of the page: nothing is loaded from anywhere."""
STYLE = (
    "position:fixed;top:12px;max-height:85vh;overflow:auto;padding:10px 14px;z-index:10;"
    "background:rgba(255,255,255,.9);border-radius:8px;box-shadow:0 1px 6px rgba(0,0,0,.2);"
    "font:13px/1.45 system-ui,sans-serif;color:#1a1a1a"
)


def show(thing: Any, beside: Any = None) -> None:
    """Show a scene or motion in a notebook or the browser.

    Parameters
    ----------
    thing
        A scene, a solution of `comove.solve`, a motion, the record of an execution, a result
        that was read, or the path of a scene file or result folder; the contents of folders are verified again.
    beside
        Another such thing, shown to the right of it and on the same clock.

    Raises
    ------
    TypeError
        If it is none of these.
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


def framed(page: str, height: int = 480) -> str:
    """Return a page as a sandboxed frame, `height` pixels high."""
    return (
        f'<iframe title="comove" sandbox="allow-scripts" srcdoc="{html.escape(page)}" width="100%" '
        f'height="{height}" style="border:1px solid #ccc"></iframe>'
    )


def played(
    item: Item, *, seed: int = 0, budget: float = 30.0, progress: ProgressCallback | None = None
) -> Playback:
    """Return a verified result folder, or a solved scene, for playback.

    Raises
    ------
    ResultError
        If the result cannot be read.
    ExtraError
        If the scene names a robot, and robots are not installed.
    """
    if item.result is not None:
        return playback_of_item(item)
    scene = read_scene(item.scene)
    robot, demonstration = robot_of(scene), demonstration_of(scene)
    wanted: dict[str, Any] = {"seed": seed, "budget": budget, "progress": progress}
    return playback_of(solve(scene, robot=robot or False, demonstration=demonstration, **wanted))


def page_of(playback: Playback, beside: Playback | None = None) -> str:
    """Return an HTML page for playback with its verification result.

    Parameters
    ----------
    beside : playback to the right of it, on the same clock

    Raises
    ------
    ExtraError
        If the viewer is not installed.
    """
    guarded = start()
    try:
        server = guarded.server
        stages = [_staged(Stage(server.scene, playback.scene), playback)]
        if beside is not None:
            stages.append(_staged(Stage.beside(stages[0], beside.scene), beside))
        position, look_at, up = stages[0].camera(stages[1] if beside is not None else None)
        server.initial_camera.position = tuple(position)
        server.initial_camera.look_at = tuple(look_at)
        server.initial_camera.up = tuple(up)
        clocks = [stage.recording.time for stage in stages if stage.recording is not None]
        time = max(clocks, key=lambda clock: float(clock[-1]), default=np.zeros(0))
        serializer = server.get_scene_serializer()
        for at, pause in zip(time.tolist(), np.diff(time, append=time[-1:]).tolist(), strict=True):
            for stage in stages:
                if stage.recording is not None:
                    stage.show(stage.recording.index_at(at))
            serializer.insert_sleep(pause)
        page: str = serializer.as_html()
    finally:
        guarded.stop()
    if beside is None:
        return _captioned(page, _caption(playback, "right:12px;max-width:22em"))
    pair = _caption(playback, "left:12px;max-width:15em"), _caption(beside, "right:12px;max-width:15em")
    return _captioned(page, *pair)


def _staged(stage: Stage, playback: Playback) -> Stage:
    """Return a stage with all elements of a playback drawn."""
    stage.draw_scene(demonstrated(playback.scene))
    if playback.robot is not None:
        stage.draw_robot(bodies_of(playback.robot), poses_of(playback.robot, playback.robot.home[None])[0])
    if playback.recording is not None:
        stage.draw_motion(playback.recording, pale=not playback.holds)
    stage.touches = playback.touches
    return stage


def _caption(playback: Playback, place: str) -> str:
    """Return a playback's verification as HTML, at a CSS position."""
    said = [f"{name}: {proved}{asked and f' (asked for: {asked})'}" for name, proved, asked in playback.rows]
    against = [f"verified against {words}" for words in playback.against[:1]] + list(playback.against[1:])
    lines = [*playback.reasons, *(said if playback.holds else []), *against, f"made by comove {__version__}"]
    body = "".join(f"<div>{html.escape(line)}</div>" for line in lines)
    title = html.escape(f"{playback.scene.name}: {playback.verdict}")
    return f'<details open style="{STYLE};{place}"><summary><b>{title}</b></summary>{body}</details>'


def _captioned(page: str, *captions: str) -> str:
    """Return the viewer's page with captions, title and content policy."""
    title = captions[0].partition("<b>")[2].partition("</b>")[0]
    policy = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
    page = page.replace("<title>Viser</title>", f"<title>{title}</title>", 1)
    head, body_tag = page.index("<head>") + len("<head>"), page.rindex("</body>")
    return f"{page[:head]}{policy}{page[head:body_tag]}{''.join(captions)}{page[body_tag:]}"


def write_page(path: Path, page: str) -> None:
    """Write a page to a file atomically.

    Raises
    ------
    OptionError
        If it cannot be written there.
    """
    with whole_file(path, OptionError) as file:
        file.write(page.encode())

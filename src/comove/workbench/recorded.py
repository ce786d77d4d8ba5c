"""What is played, as one page without server and network: it is played, paused and turned in any browser."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from comove._version import __version__
from comove.errors import OptionError
from comove.io.files import whole_file
from comove.planning import movements_of, solve
from comove.planning.solution import ProgressCallback
from comove.scenes.demonstration import demonstration_of
from comove.workbench.bodies import bodies_of, poses_of, robot_of
from comove.workbench.playback import Playback, playback_of, playback_of_item
from comove.workbench.server import start
from comove.workbench.shelf import Item, read_scene
from comove.workbench.stage import Stage, demonstrated

POLICY = "default-src 'unsafe-inline' 'unsafe-eval' data: blob:"
"""Of the page: nothing is loaded from anywhere."""
STYLE = (
    "position:fixed;right:12px;top:12px;max-width:22em;max-height:85vh;overflow:auto;padding:10px 14px;z-index:10;"
    "background:rgba(255,255,255,.9);border-radius:8px;box-shadow:0 1px 6px rgba(0,0,0,.2);"
    "font:13px/1.45 system-ui,sans-serif;color:#1a1a1a"
)


def played(
    item: Item, *, seed: int = 0, budget: float = 30.0, progress: ProgressCallback | None = None
) -> Playback:
    """Return what a result folder holds, judged anew, or the motion of a scene, solved now.

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
    if robot is None:
        return playback_of(solve(scene, demonstration=demonstration, **wanted))
    from comove.robots import carry

    return playback_of(carry(scene, robot, demonstration=movements_of(demonstration, scene), **wanted))


def page_of(playback: Playback) -> str:
    """Return an HTML page that plays, and says what is known of what it plays.

    Raises
    ------
    ExtraError
        If the viewer is not installed.
    """
    scene, recording, robot = playback.scene, playback.recording, playback.robot
    guarded = start()
    try:
        server = guarded.server
        stage = Stage(server.scene, scene)
        stage.draw_scene(demonstrated(scene))
        if robot is not None:
            stage.draw_robot(bodies_of(robot), poses_of(robot, robot.home[None])[0])
        position, look_at, up = stage.camera()
        server.initial_camera.position = tuple(position)
        server.initial_camera.look_at = tuple(look_at)
        server.initial_camera.up = tuple(up)
        if recording is not None:
            stage.draw_motion(recording, pale=not playback.holds)
        serializer = server.get_scene_serializer()
        if recording is not None:
            stage.touches = playback.touches
            for index, pause in enumerate(np.diff(recording.time, append=recording.time[-1:])):
                stage.show(index)
                serializer.insert_sleep(float(pause))
        page: str = serializer.as_html()
    finally:
        guarded.stop()
    return _captioned(page, _lines(playback))


def _lines(playback: Playback) -> list[str]:
    """Return the caption, line by line; the title first."""
    said = [f"{name}: {proved}{asked and f' (asked for: {asked})'}" for name, proved, asked in playback.rows]
    said = said if playback.holds else []
    title = f"{playback.scene.name}: {playback.verdict}"
    return [title, *playback.reasons, *said, f"made by comove {__version__}"]


def _captioned(page: str, lines: Sequence[str]) -> str:
    """Return the viewer's page with a title, a caption, and the policy that it loads nothing."""
    title, *rest = (html.escape(line) for line in lines)
    body = "".join(f"<div>{line}</div>" for line in rest)
    caption = f'<details open style="{STYLE}"><summary><b>{title}</b></summary>{body}</details>'
    policy = f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
    page = page.replace("<title>Viser</title>", f"<title>{title}</title>", 1)
    head, body_tag = page.index("<head>") + len("<head>"), page.rindex("</body>")
    return f"{page[:head]}{policy}{page[head:body_tag]}{caption}{page[body_tag:]}"


def write_page(path: Path, page: str) -> None:
    """Write a page to a file, whole or not at all.

    Raises
    ------
    OptionError
        If it cannot be written there.
    """
    with whole_file(path, OptionError) as file:
        file.write(page.encode())

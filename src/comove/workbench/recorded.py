"""A motion as one page that needs neither a server nor a network: it is played, paused and turned in any browser."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

from comove._version import __version__
from comove.coordination.motion import CoordinatedMotion
from comove.errors import OptionError
from comove.io.files import whole_file
from comove.planning import solve
from comove.planning.solution import ProgressCallback
from comove.results import filled_in, read_result, verify_result
from comove.results.solution import rebuild
from comove.scenes.demonstration import demonstration_of
from comove.verification.verify import Report
from comove.workbench.recording import RecordedMotion
from comove.workbench.server import start
from comove.workbench.shelf import Shelf, read_scene
from comove.workbench.stage import Stage, demonstrated
from comove.workbench.words import measures_of

POLICY = "default-src 'unsafe-inline' 'unsafe-eval' data: blob:"
"""Of the page: nothing is loaded from anywhere."""
STYLE = (
    "position:fixed;right:12px;top:12px;max-width:22em;max-height:85vh;overflow:auto;padding:10px 14px;z-index:10;"
    "background:rgba(255,255,255,.9);border-radius:8px;box-shadow:0 1px 6px rgba(0,0,0,.2);"
    "font:13px/1.45 system-ui,sans-serif;color:#1a1a1a"
)


def told(
    shelf: Shelf, *, seed: int = 0, budget: float = 30.0, progress: ProgressCallback | None = None
) -> tuple[CoordinatedMotion, Report, tuple[str, ...]]:
    """Return the motion of a shelf's result, judged anew, or of its scene, solved now; its measures, and reasons.

    Reasons tell why it is not verified; there are none if it is.

    Raises
    ------
    ResultError
        If the result cannot be read.
    """
    scene = read_scene(shelf.scenes[shelf.first])
    if shelf.result is None:
        solution = solve(
            scene, demonstration=demonstration_of(scene), seed=seed, budget=budget, progress=progress
        )
        return solution.attempt, solution.report, solution.reasons
    stored = read_result(shelf.result)
    scene = filled_in(scene, stored)
    verdict = verify_result(stored, scene)
    return rebuild(stored.arrays, scene), verdict.report, verdict.reasons


def motion_page(
    motion: CoordinatedMotion, recording: RecordedMotion, report: Report, reasons: Sequence[str] = ()
) -> str:
    """Return an HTML page with the recording of a motion, and what is proved of it.

    Parameters
    ----------
    reasons : why it is not verified

    Raises
    ------
    ExtraError
        If the viewer is not installed.
    """
    scene = motion.scene
    guarded = start()
    try:
        server = guarded.server
        stage = Stage(server.scene, scene)
        position, look_at, up = stage.camera()
        server.initial_camera.position = tuple(position)
        server.initial_camera.look_at = tuple(look_at)
        server.initial_camera.up = tuple(up)
        stage.draw_scene(demonstrated(scene))
        stage.draw_motion(recording, pale=bool(reasons))
        serializer = server.get_scene_serializer()
        step = float(recording.time[1])
        for index in range(len(recording.time)):
            stage.show(index)
            serializer.insert_sleep(step)
        page: str = serializer.as_html()
    finally:
        guarded.stop()
    return _captioned(page, _lines(motion, report, reasons))


def _lines(motion: CoordinatedMotion, report: Report, reasons: Sequence[str]) -> list[str]:
    """Return the caption of a motion, line by line; the title first."""
    scene = motion.scene
    if reasons:
        return [f"{scene.name}: not verified", *reasons]
    rows = measures_of(report.asdict(), scene, scene.duration)
    said = [f"{name}: {proved}{asked and f' (asked for: {asked})'}" for name, proved, asked in rows]
    return [f"{scene.name}: verified at every instant", *said, f"made by comove {__version__}"]


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

"""Report of a result as one page. It holds scene, figures, numbers, the meaning of verification, the command to
repeat it, and the motion."""

from __future__ import annotations

import html
import shlex
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from comove.model.scene import Scene
from comove.results.inputs import command_again
from comove.results.sealed import AGAIN, read_json
from comove.stored import ResultPart, Verification
from comove.view.figures.motion import draw_motion
from comove.view.figures.run import draw_run
from comove.view.figures.style import png_uri
from comove.view.workbench.playback import Playback, playback_of_verification, verification_of
from comove.view.workbench.recorded import POLICY, page_of
from comove.view.workbench.shelf import Shelf, parts_of

STYLE = (
    "body{font:15px/1.55 system-ui,sans-serif;color:#1a1a1a;max-width:62em;margin:2em auto;padding:0 1em}"
    "table{border-collapse:collapse}td,th{padding:.25em .9em .25em 0;text-align:left;border-bottom:1px solid #ddd}"
    "iframe{width:100%;height:34em;border:1px solid #ccc;border-radius:6px}img{max-width:100%}"
    "pre{background:#f4f5f7;padding:.7em 1em;border-radius:6px;overflow:auto}.no{color:#b3162a}.yes{color:#1d7a3c}"
)
MEANING = (
    "Verified means that an independent verifier, which shares no code with planner and optimiser, has bounded the "
    "exact curve of the motion between its samples: at every instant the whole payload and all end effectors keep at "
    "least the clearance stated from every obstacle and from the border of the workspace, every constraint holds "
    "within its tolerance, no limit is exceeded, and start and goal are reached. It covers what the scene holds, not "
    "obstacles that are elsewhere, nor a controller that does not follow."
)
DPI = 90
SAMPLED = "These measures hold at samples. Nothing is proved between them."


def report_page(shelf: Shelf) -> tuple[str, Playback]:
    """Verify a result again; return its HTML report and playback.

    Parameters
    ----------
    shelf : the result, as returned by `comove.view.workbench.shelf.shelf_of`

    Raises
    ------
    ResultError
        If there is no result, or it cannot be read.
    ExtraError
        If the viewer is not installed.
    """
    folder = shelf.item.result or shelf.folder
    found = parts_of(folder)  # a simulation besides is played by `comove view`
    part = next((part for part in found if part is not ResultPart.SIMULATION), found[0])
    verification = verification_of(folder, part, shelf.item.scene)
    playback = playback_of_verification(verification)
    summary, scene = read_json(folder / part.file, AGAIN), playback.scene
    head = ("at every instant", "proved") if playback.proved else ("at samples", "measured")
    parts = [
        f"<h1>{html.escape(scene.name)}</h1>",
        _verdict(playback),
        f'<iframe title="the motion" sandbox="allow-scripts" srcdoc="{html.escape(page_of(playback))}"></iframe>',
        f"<h2>{'What is proved' if playback.proved else 'What was measured'}</h2>",
        _table((*head, "asked for"), playback.rows),
        f"<p>{html.escape(MEANING if playback.proved else SAMPLED)}</p>",
        "<h2>The scene</h2>",
        _table(("what", "how many or how much"), _facts(scene)),
        _figure(verification),
        "<h2>How it was made, and how to repeat it</h2>",
        _table(("what", ""), _origin(summary)),
        f"<pre>{html.escape(_commands(folder))}</pre>",
    ]
    return _page(f"{scene.name}: comove", parts), playback


def _page(title: str, parts: Sequence[str]) -> str:
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8">'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">'
        f"<title>{html.escape(title)}</title><style>{STYLE}</style></head><body>{''.join(parts)}</body></html>"
    )


def _verdict(playback: Playback) -> str:
    against = "".join(f"<li>{html.escape(said)}</li>" for said in playback.against)
    if not playback.reasons:
        verdict = html.escape(playback.verdict[:1].upper() + playback.verdict[1:])
        return f'<p class="yes"><b>{verdict}</b>, anew from the files, against</p><ul>{against}</ul>'
    listed = "".join(f"<li>{html.escape(reason)}</li>" for reason in playback.reasons)
    return f'<p class="no"><b>Not verified</b></p><ul>{listed}</ul><p>It was verified against</p><ul>{against}</ul>'


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def row(cells: Sequence[str], tag: str) -> str:
        return "<tr>" + "".join(f"<{tag}>{html.escape(cell)}</{tag}>" for cell in cells) + "</tr>"

    return f"<table>{row(head, 'th')}{''.join(row(cells, 'td') for cells in rows)}</table>"


def _facts(scene: Scene) -> list[tuple[str, str]]:
    """Return the contents of a scene in words."""
    kinds = [obstacle.shape for obstacle in scene.file.obstacles]
    size = " x ".join(f"{side:g}" for side in scene.upper - scene.lower)
    load = "none" if scene.file.load is None else scene.file.load.shape
    return [
        ("workspace", f"{size} m"),
        ("obstacles", ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds)) or "none"),
        ("of these, moving", str(int(scene.moving.sum()))),
        ("load", load),
        ("hands", ", ".join(scene.manipulators)),
        ("duration", f"{scene.duration:g} s"),
    ]


def _figure(found: Verification) -> str:
    """Return a picture of the verified motion; none of robots' runs."""
    if found.motion is not None:
        figure = draw_motion(found.motion)
    elif found.record is not None:
        figure = draw_run(found.record)
    else:
        return ""
    caption = "The scene and the payload at several times."
    return f'<p><img alt="{caption}" src="{png_uri(figure, DPI)}"><br>{caption}</p>'


def _origin(summary: dict[str, Any]) -> list[tuple[str, str]]:
    keys = ("method", "seed", "version", "scene_sha256", "motion_sha256")
    return [(key.replace("_", " "), str(summary[key])) for key in keys if summary.get(key) is not None]


def _commands(folder: Path) -> str:
    name = shlex.quote(folder.resolve().name)
    verify, again = f"comove verify {name}", command_again(folder)
    return verify if again is None else f"{verify}\ncd {name}\n{again}"

"""Notebook display of scenes and results: picture and small table."""

from __future__ import annotations

import html
from collections.abc import Iterable, Sequence
from typing import Any

from matplotlib.figure import Figure

from comove.io.keys import counted
from comove.model.scene import Scene
from comove.planning.solution import Solution
from comove.stored import joint_rows, limits_row, motion_rows
from comove.verification.verify import VerifiedMotion
from comove.view.figures.motion import draw_motion, draw_scene
from comove.view.figures.pictures import arms_along
from comove.view.figures.style import png_uri

DPI = 60
"""Of pictures in notebooks [1/inch], which are as wide as the page."""


def as_html(thing: Any) -> str:
    """Return a picture and a small table as HTML for notebooks.

    Parameters
    ----------
    thing : a `Scene`, the result of `comove.solve`, or a `VerifiedMotion`

    Raises
    ------
    TypeError
        If it is none of these.
    """
    if isinstance(thing, Scene):
        return _page(thing.name, (), draw_scene(thing), _contents(thing))
    if isinstance(thing, VerifiedMotion):
        motion, report = thing.motion, thing.report
        return _page(_verdict(motion.scene, True), (), draw_motion(motion), _measures(motion.scene, report))
    if isinstance(thing, Solution):
        scene, joints = thing.attempt.scene, thing.joints
        title, rows = _verdict(scene, thing.verified), _measures(scene, thing.report)
        if joints is not None:
            title, rows = f"{title} ({joints.robot.name})", [*rows, *joint_rows(vars(joints.report))]
        return _page(title, thing.reasons, draw_motion(thing.attempt, arms=arms_along(joints)), rows)
    raise TypeError(f"{type(thing).__name__} has no picture; give a scene, a solution or a verified motion")


def _verdict(scene: Scene, verified: bool) -> str:
    return f"{scene.name}: {'verified at every instant' if verified else 'not verified'}"


def _measures(scene: Scene, report: Any) -> list[tuple[str, str, str]]:
    return motion_rows({**report.asdict(), "duration": scene.duration}, scene)


def _contents(scene: Scene) -> list[tuple[str, str]]:
    file = scene.file
    names = [scene.name_of(i) for i in range(len(file.obstacles))]
    few = [*names[:6], f"{len(names) - 6} more"] if len(names) > 6 else names
    return [
        ("dimension", str(scene.n_dims)),
        ("end effectors", ", ".join(scene.manipulators)),
        ("payload", "none" if file.load is None else file.load.shape),
        ("obstacles", ", ".join(few) or "none"),
        ("constraints", counted(file.constraints, "constraint")),
        ("duration", f"{scene.duration:g} s" if scene.is_timed else "open"),
        ("limits", "; ".join(limits_row(scene))),
    ]


def _page(title: str, reasons: Sequence[str], figure: Figure, rows: Iterable[Sequence[str]]) -> str:
    listed = "".join(f"<li>{html.escape(reason)}</li>" for reason in reasons)
    lines = "".join(
        f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
        f"<td style='text-align:left'>{html.escape(said)}</td></tr>"
        for name, said, *_ in rows
    )
    return (
        f"<div><b>{html.escape(title)}</b>{f'<ul>{listed}</ul>' if listed else ''}<br>"
        f"<img alt='{html.escape(title, quote=True)}' src='{png_uri(figure, DPI)}' style='max-width:100%'>"
        f"<table>{lines}</table></div>"
    )

"""A solution as a result folder: its files, and the pictures of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from comove.planning import Solution, carried_demonstration
from comove.results import write_solution
from comove.results.solution import SCENE
from comove.scenes.model import canonical
from comove.views.motion import draw_motion, draw_progress
from comove.views.style import save


def save_result(
    solution: Solution,
    folder: Path,
    *,
    wall_time_s: float,
    demonstration: Any = None,
) -> dict[str, Any]:
    """Write a solution, its scene and its pictures into an existing folder; return the contents of solution.json.

    Parameters
    ----------
    wall_time_s : time that the summary states for all of it [s]
    demonstration : movement that is drawn beside the motion
    """
    scene, motion = solution.scene, solution.attempt
    title = scene.name if solution.verified else f"{scene.name} (not verified)"
    carried = None if demonstration is None else carried_demonstration(demonstration, scene)
    save(draw_motion(motion, title=title, demonstration=carried), folder / "motion.png")
    save(draw_progress(motion), folder / "progress.png")
    (folder / SCENE).write_bytes(canonical(scene.file) + b"\n")
    return write_solution(solution, folder, wall_time_s)

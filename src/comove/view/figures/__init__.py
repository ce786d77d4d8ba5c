"""Pictures of primitives, motions and executions."""

from comove.view.figures.measures import Panel, draw_measures
from comove.view.figures.motion import (
    draw_episodes,
    draw_failures,
    draw_motion,
    draw_progress,
    draw_progress_side_by_side,
    draw_scene,
    draw_side_by_side,
)
from comove.view.figures.notebooks import as_html
from comove.view.figures.pipeline import draw_pipeline
from comove.view.figures.primitives import draw_library, draw_primitive
from comove.view.figures.results import save_result
from comove.view.figures.robots import draw_joints, draw_robot
from comove.view.figures.run import animate_run, draw_run
from comove.view.figures.style import save, save_picture

__all__ = [
    "Panel",
    "animate_run",
    "as_html",
    "draw_episodes",
    "draw_failures",
    "draw_joints",
    "draw_library",
    "draw_measures",
    "draw_motion",
    "draw_pipeline",
    "draw_primitive",
    "draw_progress",
    "draw_progress_side_by_side",
    "draw_robot",
    "draw_run",
    "draw_scene",
    "draw_side_by_side",
    "save",
    "save_picture",
    "save_result",
]

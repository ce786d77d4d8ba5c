"""Pictures of primitives, motions, runs and benchmarks; the only package here that imports matplotlib."""

from comove.views.benchmark import Growth, draw_cost_ratios, draw_growth, draw_shares
from comove.views.comparison import animate_comparison, draw_comparison
from comove.views.joints import draw_joints
from comove.views.measures import Panel, draw_measures
from comove.views.motion import (
    draw_motion,
    draw_progress,
    draw_progress_side_by_side,
    draw_side_by_side,
    save,
)
from comove.views.pipeline import draw_pipeline
from comove.views.primitives import draw_library, draw_primitive
from comove.views.run import animate_run, draw_run

__all__ = [
    "Growth",
    "Panel",
    "animate_comparison",
    "animate_run",
    "draw_comparison",
    "draw_cost_ratios",
    "draw_growth",
    "draw_joints",
    "draw_library",
    "draw_measures",
    "draw_motion",
    "draw_pipeline",
    "draw_primitive",
    "draw_progress",
    "draw_progress_side_by_side",
    "draw_run",
    "draw_shares",
    "draw_side_by_side",
    "save",
]

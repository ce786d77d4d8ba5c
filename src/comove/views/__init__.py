"""Pictures; the only room that imports matplotlib."""

from comove.views.joints import draw_joints
from comove.views.motion import draw_motion, draw_progress, draw_side_by_side, save
from comove.views.primitives import draw_library, draw_primitive

__all__ = [
    "draw_joints",
    "draw_library",
    "draw_motion",
    "draw_primitive",
    "draw_progress",
    "draw_side_by_side",
    "save",
]

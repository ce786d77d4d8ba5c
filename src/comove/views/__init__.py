"""Pictures; the only room that imports matplotlib."""

from comove.views.motion import draw_motion, draw_progress, draw_side_by_side, save

__all__ = ["draw_motion", "draw_progress", "draw_side_by_side", "save"]

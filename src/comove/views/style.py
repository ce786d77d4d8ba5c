"""Colours, figures without a window, and their files."""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from comove.errors import OptionError
from comove.io.files import whole_path

COLOURS = ("#2a7f3f", "#2456a4", "#b5541c", "#7a3e9d", "#0f7c80", "#8a6d1a", "#8c2f5a")
"""Colours of hands, coordinates, joints and series, in their order."""
START, GOAL, MOVING = "#2ca02c", "#d62728", "#8c564b"
"""Colours of starts, goals and moving obstacles."""
DPI = 110  # of pictures


def new_figure(width: float, height: float) -> Figure:
    """Return a figure without a window; sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as the suffix of `path` says, PNG at once: `savefig` would draw it once more, to lay it out."""
    if Path(path).suffix != ".png":
        figure.savefig(path, dpi=DPI)
        return
    figure.set_dpi(DPI)
    if layout := figure.get_layout_engine():
        layout.execute(figure)
        figure.set_layout_engine("none")
    FigureCanvasAgg(figure).print_png(path)


def save_picture(figure: Figure, path: Path) -> None:
    """Write a figure to a place of the user's choice, whole or not at all.

    Raises
    ------
    OptionError
        If it cannot be written there.
    """
    with whole_path(path, OptionError) as draft:
        save(figure, draft)


def draw_way(axes: Axes, path: NDArray, goal: NDArray, hand: int, label: str) -> None:
    """Draw the way of a hand with its start and its goal; arrays, shape (n_steps, n_axes) and (n_axes,) [m]."""
    axes.plot(*path.T, color=COLOURS[hand % len(COLOURS)], linewidth=1.6, label=label)
    axes.plot(*path[:1].T, "o", color=START, markersize=7, zorder=5)
    axes.plot(*goal[:, None], "s", color=GOAL, markersize=7, zorder=5)

"""Figures of measures with intervals, one panel for each measure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comove.arrays import Array
from comove.view.figures.style import COLOURS, new_figure

MARKERS = "osD^v"


@dataclass(frozen=True, eq=False)
class Panel:
    """One measure, drawn in one panel.

    Attributes
    ----------
    title : name of the measure, with its unit
    value, low, high : arrays, shape (n_series, n_groups), values and ends of their intervals; NaN for none
    floor : value at which lesser ones are drawn, on a logarithmic axis; None for a linear one
    """

    title: str
    value: Array
    low: Array
    high: Array
    floor: float | None = None


def draw_measures(
    panels: Sequence[Panel], series: Sequence[str], groups: Sequence[str], *, columns: int = 4
) -> Figure:
    """Draw one panel for each measure, with intervals as bars. Each series has a row, each group a colour.

    Parameters
    ----------
    series, groups : names of the series and of the groups
    columns : panels in a row
    """
    rows = -(-len(panels) // columns)
    figure = new_figure(13.2, rows * (0.34 * len(series) + 1.2) + 0.4)
    grid = figure.subplots(rows, columns, squeeze=False, sharey=True)
    for axes, panel in zip(grid.flat, panels, strict=False):
        _draw_panel(axes, panel, len(groups))
    for axes in grid.flat[len(panels) :]:
        axes.set_axis_off()
    grid[0, 0].set_ylim(len(series) - 0.5, -0.5)
    for axes in grid[:, 0]:
        axes.set_yticks(range(len(series)), series)
    handles = [
        grid[0, 0].plot([], [], MARKERS[g % len(MARKERS)], color=COLOURS[g % len(COLOURS)], label=name)[0]
        for g, name in enumerate(groups)
    ]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(groups), frameon=False)
    return figure


def _draw_panel(axes: Axes, panel: Panel, n_groups: int, spread: float = 0.24) -> None:
    """Draw a measure, with the marks of groups `spread` rows apart."""
    axes.set_title(panel.title, fontsize=10)
    if panel.floor is not None:
        axes.set_xscale("log")
    value, low, high = (
        np.maximum(x, panel.floor) if panel.floor is not None else x
        for x in (panel.value, panel.low, panel.high)
    )
    rows = np.arange(len(value))
    for row in rows:
        axes.axhspan(row - 0.5, row + 0.5, color="0.95" if row % 2 else "1.0", zorder=0, linewidth=0)
    for g in range(n_groups):
        at = rows + spread * (g - (n_groups - 1) / 2)
        colour = COLOURS[g % len(COLOURS)]
        axes.hlines(at, low[:, g], high[:, g], linewidth=2.2, alpha=0.5, color=colour)
        axes.plot(value[:, g], at, MARKERS[g % len(MARKERS)], markersize=4.5, color=colour)
    axes.grid(axis="x", alpha=0.3)
    axes.tick_params(labelsize=9)

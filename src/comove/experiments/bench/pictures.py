"""Pictures of benchmarks: share of runs solved by time, and ratios of cost."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from comove.views.motion import draw_legend
from comove.views.style import COLOURS, new_figure

Array = NDArray[np.float64]

STYLES = ("-", "--", "-.", ":")


def draw_shares(times: Mapping[str, Mapping[str, Array]]) -> Figure:
    """Draw the share of runs with a verified motion against time, one panel for each set (a cactus plot, turned).

    Parameters
    ----------
    times : by set and system, array, shape (n_runs,), time to the first verified motion, infinite if none [s]
    """
    finite = [t for of in times.values() for runs in of.values() for t in runs[np.isfinite(runs)]]
    least = max(1e-4, 0.5 * min(finite, default=0.0))  # below, no times are drawn
    figure = _draw_below(times, least, 1.5 * max(finite, default=1.0))
    for axes in figure.axes:
        axes.set(xscale="log", xlabel="time to the first verified motion [s]")
    return figure


def draw_cost_ratios(ratios: Mapping[str, Mapping[str, Array]]) -> Figure:
    """Draw the share of runs whose ratio of final cost to the best known cost is below a limit, one panel for each
    set.

    Parameters
    ----------
    ratios : by set and system, array, shape (n_runs,), ratios of cost, infinite where nothing is verified
    """
    largest = 10.0
    figure = _draw_below(ratios, 1.0, largest)
    for axes in figure.axes:
        axes.set(xscale="log", xlabel="final cost / best cost known", xlim=(0.98, largest))
        axes.set_xticks([1, 1.5, 2, 3, 5, 10], ["1", "1.5", "2", "3", "5", "10"])
        axes.minorticks_off()
    return figure


def _draw_below(values: Mapping[str, Mapping[str, Array]], least: float, most: float) -> Figure:
    """Draw the share of runs whose value is below a limit between `least` and `most`, one panel for each set."""
    names = list(dict.fromkeys(name for of in values.values() for name in of))
    figure = new_figure(4.2 * len(values) + 0.6, 4.0)
    panels = figure.subplots(1, len(values), squeeze=False, sharey=True)[0]
    for axes, (title, of) in zip(panels, values.items(), strict=True):
        for name, runs in of.items():
            ordered = np.sort(runs[runs <= most])
            share = np.arange(len(ordered) + 1) / len(runs)
            k = names.index(name)
            axes.step(
                np.concatenate([[least], np.maximum(ordered, least), [most]]),
                np.append(share, share[-1]),
                where="post",
                color=COLOURS[k % len(COLOURS)],
                linestyle=STYLES[k // len(COLOURS) % len(STYLES)],
                label=name,
            )
        axes.set(title=title, ylim=(-0.02, 1.02))
        axes.grid(alpha=0.25)
    panels[0].set_ylabel("share of runs")
    draw_legend(figure, min(5, max(1, len(names))))
    return figure

"""Picture of the steps to a verified motion (the paper's Figure 1)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from comove.dmp.demonstrations import Demonstration
from comove.dmp.dmp import DMP
from comove.model.motion import CoordinatedMotion
from comove.verification.verify import verify
from comove.view.figures.motion import draw_legend, draw_panel
from comove.view.figures.style import COLOURS, GOAL, START, new_figure


def draw_pipeline(
    demonstration: Demonstration, dmp: DMP, coordinated: CoordinatedMotion, optimised: CoordinatedMotion
) -> Figure:
    """Draw a demonstration, its primitive, and its coordinated and optimised motions.

    Parameters
    ----------
    demonstration, dmp : planar recording, and the primitive learned from it
    coordinated, optimised : motions of a planar scene
    """
    figure = new_figure(17.6, 5.2)
    panels = figure.subplots(1, 4)
    apart = (
        dmp.rollout(n_steps=demonstration.n_steps).position
        - demonstration.resampled(demonstration.n_steps).position
    )
    error = float(np.sqrt((apart**2).sum(axis=1).mean()))
    titles = [
        f"1. demonstration: {demonstration.name}\n{demonstration.n_steps} samples, {demonstration.duration:.1f} s",
        f"2. one DMP, {dmp.shape_weights.shape[1]} weights a dimension\n"
        f"{error:.2g} {demonstration.unit}s off (RMS)",
        "3. given to both hands, on one phase\n" + _verdict(coordinated),
        "4. optimised under the constraint\n" + _verdict(optimised),
    ]
    _draw_recording(panels[0], demonstration)
    _draw_primitive(panels[1], demonstration, dmp)
    for axes, motion in zip(panels[2:], (coordinated, optimised), strict=True):
        draw_panel(axes, motion, (0, 1))
    for axes, title in zip(panels, titles, strict=True):
        axes.set_title(title, fontsize=11)
    for axes in panels[:-1]:
        axes.annotate(
            "",
            xy=(1.13, 1.07),
            xytext=(1.03, 1.07),
            xycoords="axes fraction",
            arrowprops={"arrowstyle": "-|>", "linewidth": 1.8, "color": "0.3"},
            annotation_clip=False,
        )
    draw_legend(figure, columns=6)
    return figure


def _draw_recording(axes: Axes, demonstration: Demonstration, n_points: int = 60) -> None:
    points = demonstration.position[:: max(1, demonstration.n_steps // n_points)]
    axes.plot(*points.T, ".", color="0.35", markersize=5, label="samples")
    _draw_ends(axes, demonstration)


def _draw_primitive(axes: Axes, demonstration: Demonstration, dmp: DMP) -> None:
    axes.plot(*demonstration.position.T, color="0.75", linewidth=4, label="recorded")
    axes.plot(*dmp.rollout(n_steps=401).position.T, color=COLOURS[3], linewidth=1.6, label="primitive")
    _draw_ends(axes, demonstration)


def _draw_ends(axes: Axes, demonstration: Demonstration) -> None:
    axes.plot(*demonstration.start, "o", color=START, markersize=7, zorder=5)
    axes.plot(*demonstration.goal, "s", color=GOAL, markersize=7, zorder=5)
    unit = demonstration.unit
    axes.set(aspect="equal", adjustable="datalim", xlabel=f"x [{unit}]", ylabel=f"y [{unit}]")


def _verdict(motion: CoordinatedMotion) -> str:
    verdict = verify(motion)
    clearance = verdict.report.clearance_min
    if verdict.verified:
        return f"verified, clear by {1e3 * clearance:.1f} mm"
    return f"{-1e3 * clearance:.0f} mm into a wall" if clearance < 0 else "not verified"

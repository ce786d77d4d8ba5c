"""Picture and animation of compared methods (as in the paper's Figure 2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from comove.arrays import Array
from comove.lab.modulation.comparison import Compared
from comove.view.figures.motion import FINE, OFF, TOUCHES, MovingBorders, draw_frame, draw_standing, views_of
from comove.view.figures.run import load_lines, moving_scene
from comove.view.figures.style import COLOURS, MOVING, Mover, new_figure, write_gif

TITLES = {
    "no modulation": "no modulation",
    "own matrix each": "own matrix each",
    "nearest hand's matrix": "the nearest hand's matrix on all (the paper)",
    "same matrix on all": "the matrix of the nearest point",
    "obstacles seen only": "comove, obstacles seen only",
    "motions known": "comove, motions known",
}
MILLI = 1e3


@dataclass(frozen=True)
class FilmSettings:
    """Settings of the animation.

    Attributes
    ----------
    rate, most_frames : frames a second, and in all; where there would be more, it is faster than real time
    trail : duration of the path that is shown behind the end effectors [s]
    pause : time on the last frame [s]
    dpi : pixels an inch
    """

    rate: float = 8.0
    most_frames: int = 64
    trail: float = 1.5
    pause: float = 1.0
    dpi: int = 88


FILM = FilmSettings()


def draw_comparison(compared: Sequence[Compared], n_states: int = 11) -> Figure:
    """Draw all methods at numbered steps, with distance error and clearance."""
    figure, panels = _layout(compared, 3.1)
    for one, column in zip(compared, panels, strict=True):
        record, scene = one.record, one.record.scene
        steps = np.linspace(0, len(record.time) - 1, n_states).astype(int)
        for axes, view in zip(column, views_of(scene), strict=False):
            draw_standing(axes, scene, view)
            borders = MovingBorders(scene, view)
            for k, step in enumerate(steps):
                share = (k + 1) / n_states
                borders.draw(axes, record.table(step), 0.08 + 0.4 * share)
                lines = load_lines(scene, record.nodes[step][:, list(view)])
                axes.add_collection(
                    LineCollection(lines, colors=_tone(one, step), linewidths=1.3, alpha=0.35 + 0.6 * share)
                )
                if scene.n_dims == 2:
                    for center in record.obstacles[step][scene.moving]:
                        _number(axes, k, center[list(view)])
                    middle = record.nodes[step, : len(scene.manipulators)].mean(axis=0)
                    _number(axes, k, middle[list(view)], _tone(one, step))
            for hand in range(len(scene.manipulators)):
                path = record.nodes[:, hand][:, list(view)]
                axes.plot(*path.T, color=COLOURS[hand % len(COLOURS)], linewidth=1.4, zorder=1.5)
        errors, clearances = column[-2:]
        errors.plot(record.time, MILLI * one.distance_errors, color=OFF, linewidth=1.4)
        clearances.plot(record.time, MILLI * one.clearances, color=COLOURS[1], linewidth=1.4)
    return figure


def animate_comparison(compared: Sequence[Compared], path: Path, film: FilmSettings = FILM) -> None:
    """Write the comparison as an animated GIF in real time. It is faster where it is long."""
    figure, panels = _layout(compared, 2.0)
    last = _shown(compared)
    movers: list[Mover] = []
    for one, column in zip(compared, panels, strict=True):
        for axes, view in zip(column, views_of(one.record.scene), strict=False):
            draw_standing(axes, one.record.scene, view)
            movers.append(moving_scene(axes, one.record, view, trail=film.trail, tone=partial(_tone, one)))
        for axes, values, colour in (
            (column[-2], one.distance_errors, OFF),
            (column[-1], one.clearances, COLOURS[1]),
        ):
            movers.append(_moving_line(axes, one.record.time, MILLI * values, colour))
    n_frames = int(np.clip(last * film.rate, 2, film.most_frames))
    each = round(1000 * (max(last, 1.0) / n_frames if n_frames < film.most_frames else 1.0 / film.rate))
    durations = [each] * (n_frames - 1) + [each + round(1000 * film.pause)]
    write_gif(figure, movers, np.linspace(0.0, last, n_frames), path, durations, film.dpi)


def _layout(compared: Sequence[Compared], width: float) -> tuple[Figure, list[list[Axes]]]:
    """Build a column of panels for each method, `width` inches wide."""
    scene = compared[0].record.scene
    views, n = views_of(scene), len(compared)
    size = scene.upper - scene.lower
    heights = [*(size[up] / size[along] for along, up in views), 0.36, 0.36]
    figure = new_figure(width * n + 0.5, width * (sum(heights) + 0.42) + 0.5)
    grid = figure.subplots(len(heights), n, squeeze=False, height_ratios=heights)
    for k, one in enumerate(compared):
        verdict, fine = _verdict(one)
        grid[0, k].set_title(
            f"{TITLES[one.method]}\n{verdict}", fontsize=3 * width, color=FINE if fine else TOUCHES
        )
        for i, view in enumerate(views):
            axes = grid[i, k]
            draw_frame(axes, scene, view)
            for hand in range(len(scene.manipulators)):
                axes.plot(*scene.start[hand][list(view)], "o", color="#2ca02c", markersize=5, zorder=5)
                axes.plot(*scene.goal[hand][list(view)], "s", color="#d62728", markersize=5, zorder=5)
            if k:
                axes.set_ylabel("")
                axes.set_yticklabels([])
        _frame_of_values(
            grid[-2, k], compared, [c.distance_errors for c in compared], "distance error [mm]", k
        )
        _frame_of_values(grid[-1, k], compared, [c.clearances for c in compared], "clearance [mm]", k)
        grid[-2, k].set_xticklabels([])
        grid[-1, k].set_xlabel("time [s]")
    for axes in grid.flat:
        axes.tick_params(labelsize=2.4 * width)
        for label in (axes.xaxis.label, axes.yaxis.label):
            label.set_fontsize(2.6 * width)
    names = [
        Line2D([], [], color=COLOURS[i % len(COLOURS)], label=name)
        for i, name in enumerate(scene.manipulators)
    ]
    loads = [
        Line2D([], [], color=colour, linewidth=2, label=f"load{what}")
        for colour, what in ((FINE, ""), (OFF, ", a distance off"), (TOUCHES, ", touching"))
    ]
    moving = [Patch(color=MOVING, alpha=0.5, label="moving obstacle")] if scene.moving.any() else []
    handles = [*names, *loads, *moving]
    figure.legend(
        handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=2.8 * width
    )
    return figure, [list(column) for column in grid.T]


def _frame_of_values(
    axes: Axes, compared: Sequence[Compared], values: Sequence[Array], label: str, column: int
) -> None:
    """Set limits that all columns share; mark negative values in red."""
    least = MILLI * min(float(v.min()) for v in values)
    most = MILLI * max(float(v.max()) for v in values)
    pad = 0.08 * max(most - least, 1e-3)
    axes.set(xlim=(0.0, _shown(compared)), ylim=(least - pad, most + pad))
    axes.grid(alpha=0.25)
    if least < 0:
        axes.axhspan(least - pad, 0.0, color=TOUCHES, alpha=0.12, linewidth=0)
    if column:
        axes.set_yticklabels([])
    else:
        axes.set_ylabel(label)


def _verdict(one: Compared) -> tuple[str, bool]:
    """Return the faults or the result in words, and its success."""
    r, wrong = one.report, []
    if r.clearance_min < 0:
        wrong.append(f"{-MILLI * r.clearance_min:.0f} mm into something")
    if one.off.any():
        wrong.append(f"{MILLI * r.distance_error_max:.1f} mm off")
    if not one.arrived:
        wrong.append("does not arrive")
    if wrong:
        return ", ".join(wrong), False
    clear = f", clear by {MILLI * r.clearance_min:.0f} mm" if np.isfinite(r.clearance_min) else ""
    return f"there after {one.record.time[-1]:.1f} s{clear}", True


def _shown(compared: Sequence[Compared]) -> float:
    """Return the end of the drawn time [s]. It is the last arrival of a method, but at least the scene's duration."""
    ends = [c.record.time[-1] for c in compared if c.arrived]
    return float(max([*ends, compared[0].record.scene.duration]))


def _tone(one: Compared, step: int) -> str:
    return TOUCHES if one.touching[step] else OFF if one.off[step] else FINE


def _number(axes: Axes, step: int, place: Array, colour: str = FINE) -> None:
    """Write the number of every other step at its position."""
    if step % 2 == 0:
        ground = {"boxstyle": "circle,pad=0.12", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}
        x, y = place.tolist()
        axes.text(
            x, y, str(step), fontsize=6.5, color=colour, ha="center", va="center", bbox=ground, zorder=6
        )


def _moving_line(axes: Axes, time: Array, values: Array, colour: str) -> Mover:
    """Return the mover of a curve up to an instant [s]."""
    (line,) = axes.plot([], [], color=colour, linewidth=1.4, animated=True)

    def move(until: float) -> list[Artist]:
        n = int(np.searchsorted(time, until + 1e-9))
        line.set_data(time[:n], values[:n])
        return [line]

    return move

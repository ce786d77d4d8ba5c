"""Pictures and animations of executions among moving obstacles (the counterpart of the paper's Figure 2)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.animation import FuncAnimation, PillowWriter
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from comove.geometry.distances import CENTER
from comove.geometry.solids import N_CORNERS
from comove.scenes.scene import Scene
from comove.verification.record import Record
from comove.views.motion import draw_frame, draw_legend, views_of
from comove.views.shapes import hull_outline, outline
from comove.views.style import COLOURS, GOAL, MOVING, draw_way, new_figure

Array = NDArray[np.float64]

N_STATES, FRAME_RATE, MAX_FRAMES = 13, 15, 240
TRAIL = 1.0  # s, of the way that an animation shows behind the hands


def draw_run(record: Record, title: str | None = None) -> Figure:
    """Draw an execution: paths of the hands, the load and the obstacles at equal steps, later ones darker."""
    scene, views = record.scene, views_of(record.scene)
    figure = new_figure(5.4 * len(views) + 0.4, 6.2)
    for i, view in enumerate(views):
        axes = figure.add_subplot(1, len(views), i + 1)
        axes.set_title(title or scene.name)
        draw_frame(axes, scene, view)
        for k, step in enumerate(np.linspace(0, len(record.time) - 1, N_STATES).astype(int)):
            share = (k + 1) / N_STATES
            _draw_obstacles(axes, scene, record.obstacles[step], view, 0.1 + 0.35 * share, still=k == 0)
            _draw_load(axes, scene, record.nodes[step][:, list(view)], share)
        for hand, name in enumerate(scene.manipulators):
            draw_way(axes, record.nodes[:, hand][:, list(view)], scene.goal[hand][list(view)], hand, name)
    draw_legend(figure)
    return figure


def animate_run(record: Record, path: Path) -> None:
    """Write an execution as an animated GIF in real time, or faster where it is long."""
    scene, views = record.scene, views_of(record.scene)
    n_frames = int(np.clip(record.time[-1] * FRAME_RATE, 2, MAX_FRAMES))
    steps = np.linspace(0, len(record.time) - 1, n_frames).astype(int)
    trail = int(TRAIL / max(record.time[1] - record.time[0], 1e-9))
    figure = new_figure(4.4 * len(views) + 0.2, 4.8)
    panels = [figure.add_subplot(1, len(views), i + 1) for i in range(len(views))]

    def frame(step: int) -> None:
        for axes, view in zip(panels, views, strict=True):
            axes.clear()
            axes.set_title(f"{scene.name}, {record.time[step]:.1f} s")
            draw_frame(axes, scene, view)
            _draw_obstacles(axes, scene, record.obstacles[step], view, 0.6, still=True)
            _draw_load(axes, scene, record.nodes[step][:, list(view)], 1.0)
            for hand in range(len(scene.manipulators)):
                colour = COLOURS[hand % len(COLOURS)]
                way = record.nodes[max(0, step - trail) : step + 1, hand][:, list(view)]
                axes.plot(*way.T, color=colour, linewidth=1.4)
                axes.plot(*way[-1], "o", color=colour, markersize=5)
                axes.plot(*scene.goal[hand][list(view)], "s", color=GOAL, markersize=6, alpha=0.6)

    animation = FuncAnimation(figure, frame, frames=steps.tolist())
    animation.save(path, writer=PillowWriter(fps=FRAME_RATE), dpi=70)


def _draw_obstacles(
    axes: Axes, scene: Scene, centers: Array, view: tuple[int, int], alpha: float, still: bool
) -> None:
    solid = 1.0 if scene.n_dims == 2 else 0.35
    owners = scene.owners
    for row, center, moves in zip(scene.obstacles, centers[owners], scene.moving[owners], strict=True):
        if not moves and not still:
            continue
        row = row.copy()
        row[CENTER : CENTER + 3] = center
        colour = MOVING if moves else "0.62"
        axes.fill(
            *outline(row, view).T,
            facecolor=colour,
            edgecolor="0.25",
            linewidth=0.6,
            alpha=solid * (alpha if moves else 1.0),
        )


def load_lines(scene: Scene, nodes: Array) -> list[Array]:
    """Return the lines that draw a load, or the pairs of hands kept at a distance where there is none; each of shape
    (2, n).

    The outline of a solid that is not a box is one longer line.

    Parameters
    ----------
    nodes : array, shape (n_nodes, n), hands first, then corners of the load [m]
    """
    pairs = [e for e in scene.body.edges if e[0] != e[1]]
    solids, lines = scene.body.solids, []
    if solids.shape[1] == N_CORNERS:
        pairs += [(corners[i], corners[i ^ bit]) for corners in solids for i in range(8) for bit in (1, 2, 4)]
    else:
        around = [hull_outline(nodes[corners]) for corners in solids]
        lines = [np.concatenate([outline, outline[:1]]) for outline in around]
    if not len(solids):
        pairs = pairs or [(c.first, c.second) for c in scene.distances]
    return lines + [nodes[list(pair)] for pair in pairs]


def _draw_load(axes: Axes, scene: Scene, nodes: Array, share: float) -> None:
    lines = load_lines(scene, nodes)
    axes.add_collection(
        LineCollection(lines, colors="0.1", linewidths=1.2, alpha=0.25 + 0.75 * share, zorder=3)
    )

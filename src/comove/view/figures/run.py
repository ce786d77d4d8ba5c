"""Figures and animations of executions among moving obstacles. They are the counterpart of the paper's Figure 2."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from comove.arrays import Array
from comove.geometry.solids import N_CORNERS
from comove.model.scene import Scene
from comove.verification.record import Record
from comove.view.figures.motion import MovingBorders, draw_frame, draw_legend, draw_standing, views_of
from comove.view.figures.shapes import hull_outline, load_pairs
from comove.view.figures.style import COLOURS, GOAL, Mover, draw_way, new_figure, write_gif


def draw_run(record: Record, *, n_states: int = 13) -> Figure:
    """Draw an execution's paths, payload and obstacles at equal steps."""
    scene, views = record.scene, views_of(record.scene)
    figure = new_figure(5.4 * len(views) + 0.4, 6.2)
    for i, view in enumerate(views):
        axes = figure.add_subplot(1, len(views), i + 1)
        axes.set_title(scene.name)
        draw_frame(axes, scene, view)
        draw_standing(axes, scene, view)
        borders = MovingBorders(scene, view)
        for k, step in enumerate(np.linspace(0, len(record.time) - 1, n_states).astype(int)):
            share = (k + 1) / n_states
            borders.draw(axes, record.table(step), 0.1 + 0.35 * share)
            _draw_load(axes, scene, record.nodes[step][:, list(view)], share)
        for hand, name in enumerate(scene.manipulators):
            draw_way(axes, record.nodes[:, hand][:, list(view)], scene.goal[hand][list(view)], hand, name)
    draw_legend(figure)
    return figure


def animate_run(
    record: Record,
    path: Path,
    *,
    rate: float = 15.0,
    most_frames: int = 240,
    trail: float = 1.0,
    dpi: int = 70,
) -> None:
    """Write an execution as an animated GIF in real time. Long ones are faster.

    Parameters
    ----------
    rate, most_frames : frames a second [Hz], and their largest number
    trail : drawn duration of the paths behind the end effectors [s]
    """
    scene, views = record.scene, views_of(record.scene)
    n_frames = int(np.clip(record.time[-1] * rate, 2, most_frames))
    figure = new_figure(4.4 * len(views) + 0.2, 4.8)
    movers: list[Mover] = []
    for i, view in enumerate(views):
        axes = figure.add_subplot(1, len(views), i + 1)
        draw_frame(axes, scene, view)
        draw_standing(axes, scene, view)
        for hand in range(len(scene.manipulators)):
            place = scene.goal[hand][list(view)]
            axes.plot(*place, "s", color=GOAL, markersize=6, alpha=0.6)
        movers += [moving_scene(axes, record, view, trail=trail), _moving_title(axes, record)]
    shown = np.linspace(0.0, min(record.time[-1], n_frames / rate), n_frames + 1)
    durations = 10 * np.diff(np.round(100 * shown).astype(int))  # ms; a GIF counts in hundredths of a second
    times = np.linspace(0.0, record.time[-1], n_frames)
    write_gif(figure, movers, times, path, durations.tolist(), dpi)


def moving_scene(
    axes: Axes,
    record: Record,
    view: tuple[int, int],
    *,
    trail: float,
    tone: Callable[[int], str] = lambda step: "0.1",
) -> Mover:
    """Return the mover of obstacles, payload, end effectors and their trails. After the end of an execution, end
    effectors stay, and obstacles continue as the scene says.

    Parameters
    ----------
    trail : drawn duration of the paths [s]
    tone : colour of the payload by step
    """
    scene, (last, period) = record.scene, (len(record.time) - 1, record.time[1] - record.time[0])
    borders = MovingBorders(scene, view)
    shapes = borders.draw(axes, scene.obstacles, 0.6, edge="0.25")
    colours = [COLOURS[hand % len(COLOURS)] for hand in range(len(scene.manipulators))]
    ways = [axes.plot([], [], color=colour, linewidth=1.4)[0] for colour in colours]
    hands = [axes.plot([], [], "o", color=colour, markersize=5)[0] for colour in colours]
    load = LineCollection([], linewidths=1.6, zorder=3)
    axes.add_collection(load)
    artists: list[Artist] = [shapes, *ways, load, *hands]
    for artist in artists:
        artist.set_animated(True)

    def move(time: float) -> list[Artist]:
        step = min(last, round(time / period))
        over = time > record.time[-1] + period
        shapes.set_verts(borders.at(scene.obstacles_at(time) if over else record.table(step)))
        first, nodes = max(0, step - round(trail / period)), record.nodes[:, :, list(view)]
        for k, (way, hand) in enumerate(zip(ways, hands, strict=True)):
            way.set_data(*nodes[first : step + 1, k].T)
            hand.set_data(*nodes[step : step + 1, k].T)
        load.set_segments(load_lines(scene, nodes[step]))
        load.set_color(tone(step))
        return artists

    return move


def _moving_title(axes: Axes, record: Record) -> Mover:
    """Return the mover of a title with the time."""

    def told(time: float) -> str:
        return f"{record.scene.name}, {time:.1f} s"

    title = axes.set_title(told(record.time[-1]))  # which room is left for
    title.set_animated(True)

    def move(time: float) -> list[Artist]:
        title.set_text(told(time))
        return [title]

    return move


def load_lines(scene: Scene, nodes: Array) -> list[Array]:
    """Return the lines of a payload, arrays of shape (2, n). Without a payload they join end effectors kept at a
    distance. The outline of a solid that is not a box is one longer line.

    Parameters
    ----------
    nodes : array, shape (n_nodes, n), end effectors first, then corners of the payload [m]
    """
    pairs, solids, lines = load_pairs(scene), scene.body.solids, []
    if solids.shape[1] == N_CORNERS:
        pairs += [(corners[i], corners[i ^ bit]) for corners in solids for i in range(8) for bit in (1, 2, 4)]
    else:
        around = [hull_outline(nodes[corners]) for corners in solids]
        lines = [np.concatenate([outline, outline[:1]]) for outline in around]
    return lines + [nodes[list(pair)] for pair in pairs]


def _draw_load(axes: Axes, scene: Scene, nodes: Array, share: float) -> None:
    lines = load_lines(scene, nodes)
    axes.add_collection(
        LineCollection(lines, colors="0.1", linewidths=1.2, alpha=0.25 + 0.75 * share, zorder=3)
    )

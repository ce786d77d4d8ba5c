"""Figures of motions: the scene with payload states, objective and constraint."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure, FigureBase, SubFigure
from matplotlib.patches import Rectangle

from comove.arrays import Array
from comove.geometry.distances import CENTER
from comove.model.coordinates import load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.view.figures.shapes import hull_outline, load_pairs, outline
from comove.view.figures.style import ARM, COLOURS, MOVING, draw_way, new_figure

FINE, OFF, TOUCHES = "#1a1a1a", "#f08c00", "#e3111b"  # a load that is well, a distance off, in something
N_STATES = 26  # drawn along a motion
SMALL, HEADED = 2.2, 0.8  # size of a panel among many, and its room for titles and labels [inches]
BROKEN = 1e-12  # m, above rounding


def draw_scene(scene: Scene, *, duration: float = 5.0) -> Figure:
    """Draw an unsolved scene with the payload at start and goal.

    Parameters
    ----------
    duration : time for which moving obstacles are drawn where the scene's duration is open [s]
    """
    scene = scene if scene.is_timed else scene.timed(duration)
    views = views_of(scene)
    figure = new_figure(5.5 * len(views), 6.0)
    figure.suptitle(scene.name)
    coordinates = load_coordinates(scene)
    start, _, goal, _ = coordinates.boundary()
    nodes = coordinates.nodes(np.ascontiguousarray(np.stack([start, goal], axis=1)[None]))[0]
    tones = _tones(scene, nodes, np.array([0.0, scene.duration]))
    for i, view in enumerate(views):
        axes, columns = figure.add_subplot(1, len(views), i + 1), list(view)
        draw_frame(axes, scene, view)
        _draw_obstacles(axes, scene, view)
        _draw_load(axes, scene, nodes[:, :, columns], tones)
        for hand, name in enumerate(scene.manipulators):
            draw_way(axes, nodes[:1, hand][:, columns], scene.goal[hand][columns], hand, name)
    draw_legend(figure)
    return figure


def draw_motion(
    motion: CoordinatedMotion,
    *,
    title: str = "",
    demonstration: Array | None = None,
    arms: Sequence[Array] = (),
) -> Figure:
    """Draw a motion in its scene, with speed and acceleration below. End effectors' paths and the payload at equal
    steps are shown (the paper's Figure 6). A spatial scene is drawn in perspective, and along the three axes.

    Parameters
    ----------
    demonstration : array, shape (n_steps, n_manipulators, 2 or 3), [m], drawn dashed where given
    arms : arrays, shape (n_states, n_points, 3), one for each arm of a robot: its joints and its grasp frame [m]
    """
    views = views_of(motion.scene)
    figure = new_figure(*((6.0, 7.6) if len(views) == 1 else (16.5, 6.4)))
    figure.suptitle(title or motion.scene.name)
    parts: Any = figure.subfigures(2, 1, height_ratios=[5, 1.4])
    above, below = parts
    columns = len(views) + (len(views) > 1)
    for i, view in enumerate(views):
        axes = above.add_subplot(1, columns, columns - len(views) + i + 1)
        draw_panel(axes, motion, view, demonstration)
        _draw_arms(axes, arms, view)
    if len(views) > 1:
        from comove.view.figures.perspective import draw_perspective

        nodes = motion.coordinates.motion(motion.at(np.linspace(0.0, 1.0, N_STATES)))[0]
        draw_perspective(above, (1, columns, 1), motion, nodes, demonstration, arms)
    draw_legend(above)
    draw_rates(below, motion)
    return figure


def _draw_arms(axes: Axes, arms: Sequence[Array], view: tuple[int, int]) -> None:
    for i, arm in enumerate(arms):
        for k, state in enumerate(arm):
            label = "arms at equal times" if i == k == 0 else None
            axes.plot(*state[:, list(view)].T, **ARM, zorder=0.5, label=label)
        _show_whole(axes, arm[..., list(view)])


def draw_rates(figure: FigureBase, motion: CoordinatedMotion) -> None:
    """Draw speed and acceleration of the end effectors, side by side."""
    s, duration = np.linspace(0.0, 1.0, 401), motion.scene.duration
    _, *rates = motion.hands(s)
    for i, (rate, name) in enumerate(zip(rates, ("speed [m/s]", "acceleration [m/s²]"), strict=True)):
        axes = figure.add_subplot(1, 2, i + 1)
        for hand in range(rate.shape[1]):
            size = np.linalg.norm(rate[:, hand], axis=1) / duration ** (i + 1)
            axes.plot(s * duration, size, color=COLOURS[hand % len(COLOURS)], linewidth=1.2)
        axes.set(xlabel="time [s]", xlim=(0, duration))
        axes.set_title(name, loc="left", fontsize="medium")
        axes.set_ylim(bottom=0)
        axes.spines[["top", "right"]].set_visible(False)


def draw_side_by_side(
    motions: Sequence[CoordinatedMotion],
    titles: Sequence[str],
    demonstrations: Sequence[Array | None] | None = None,
    *,
    states: bool = True,
    columns: int | None = None,
) -> Figure:
    """Draw planar motions side by side (the paper's Figures 3, 4, 6).

    Parameters
    ----------
    demonstrations : one for each motion, as in `draw_motion`
    states : whether to draw the payload at equal steps, not the paths alone
    columns : motions in a row; all of them unless given
    """
    columns = columns or len(motions)
    rows = -(-len(motions) // columns)
    figure = new_figure(5.4 * columns + 0.4, 5.6 * rows + 0.6)
    for i, (motion, title) in enumerate(zip(motions, titles, strict=True)):
        axes = figure.add_subplot(rows, columns, i + 1)
        axes.set_title(title)
        draw_panel(axes, motion, (0, 1), demonstrations[i] if demonstrations else None, states=states)
    draw_legend(figure)
    return figure


def draw_failures(
    motions: Sequence[CoordinatedMotion], titles: Sequence[str], *, most_columns: int = 4
) -> Figure:
    """Draw motions that violate constraints, with their worst payload states.

    Of a spatial scene the first two axes are shown.
    """
    figure = draw_episodes(motions, titles, most_columns=most_columns)
    for axes, motion in zip(figure.axes, motions, strict=True):
        _draw_worst(axes, motion, (0, 1))
    draw_legend(figure, columns=3)
    return figure


def draw_episodes(
    motions: Sequence[CoordinatedMotion], titles: Sequence[str], *, most_columns: int = 6
) -> Figure:
    """Draw motions as a contact sheet, with payload states.

    Of a spatial scene the first two axes are shown, from above.
    """
    columns = min(most_columns, len(motions))
    rows = -(-len(motions) // columns)
    figure = new_figure(SMALL * columns + 0.4, (SMALL + HEADED) * rows + 0.4)
    for i, (motion, title) in enumerate(zip(motions, titles, strict=True)):
        axes = figure.add_subplot(rows, columns, i + 1)
        draw_panel(axes, motion, (0, 1))
        axes.set_title(title, fontsize="small")
        if i % columns:
            axes.set_ylabel("")
        if i + columns < len(motions):
            axes.set_xlabel("")
    return figure


def draw_panel(
    axes: Axes,
    motion: CoordinatedMotion,
    view: tuple[int, int],
    demonstration: Array | None = None,
    *,
    states: bool = True,
) -> None:
    """Draw one view of a motion."""
    scene, columns = motion.scene, list(view)
    draw_frame(axes, scene, view)
    _draw_obstacles(axes, scene, view)
    if states:
        s = np.linspace(0, 1, N_STATES)
        sparse = np.ascontiguousarray(motion.coordinates.motion(motion.at(s))[0])
        _draw_load(axes, scene, sparse[:, :, columns], _tones(scene, sparse, s * scene.duration))
    if demonstration is not None:
        for hand in range(demonstration.shape[1]):
            label = "demonstration, carried to each hand" if hand == 0 else None
            axes.plot(*demonstration[:, hand][:, columns].T, "--", color="0.45", linewidth=1, label=label)
    dense = motion.coordinates.motion(motion.at(np.linspace(0, 1, 401)))[0]
    for hand, name in enumerate(scene.manipulators):
        draw_way(axes, dense[:, hand][:, columns], scene.goal[hand][columns], hand, name)
    _show_whole(axes, dense[:, : len(scene.manipulators)][:, :, columns])


def draw_legend(figure: Figure | SubFigure, columns: int = 4) -> None:
    """Draw one legend for all panels."""
    labelled: dict[str, Artist] = {}
    for axes in figure.axes:
        handles, labels = axes.get_legend_handles_labels()
        labelled |= dict(zip(labels, handles, strict=True))
    labelled = {label: labelled[label] for label in sorted(labelled, key=lambda label: "load" in label)}
    figure.legend(
        list(labelled.values()), list(labelled), loc="outside lower center", ncols=columns, frameon=False
    )


def draw_progress(motion: CoordinatedMotion) -> Figure:
    """Draw objective and constraint along the motion (the paper's Figure 5)."""
    return draw_progress_side_by_side(
        [motion], [f"{motion.scene.name}: objective and constraint along the movement"]
    )


def draw_progress_side_by_side(
    motions: Sequence[CoordinatedMotion], titles: Sequence[str], *, velocity: float = 0.01
) -> Figure:
    """Draw objective and constraint along several motions, on the same axes.

    Parameters
    ----------
    velocity : weight of the velocities in the objective, as in `planning.PaperCost`
    """
    figure = new_figure(5.6 * len(motions) + 1.6, 5.4)
    panels = figure.subplots(2, len(motions), sharex=True, sharey="row", squeeze=False)
    reach = 0.0
    for motion, title, (upper, lower) in zip(motions, titles, panels.T, strict=True):
        upper.set_title(title)
        _draw_objective(upper, motion, velocity)
        reach = max(reach, _draw_constraint(lower, motion))
    if reach > 0:
        panels[1, 0].set_ylim(-1.3 * reach, 1.9 * reach)  # with room for the legend
    for axes in panels[:, 1:].flat:
        axes.set_ylabel("")
    return figure


def _draw_objective(axes: Axes, motion: CoordinatedMotion, weight: float) -> None:
    scene = motion.scene
    s = np.linspace(0.0, 1.0, 801)
    position, velocity, _ = motion.hands(s)
    to_goal = ((position - scene.goal) ** 2).sum(axis=(1, 2))
    effort = weight * (velocity**2).sum(axis=(1, 2))
    time = s * scene.duration
    axes.plot(time, to_goal + effort, color=COLOURS[1], label="objective, terms of goal and velocity")
    axes.plot(time, to_goal, "--", color="0.4", linewidth=1, label="distance to the goal, squared [m²]")
    axes.set_ylabel("objective")
    axes.legend(frameon=False)


def _draw_constraint(axes: Axes, motion: CoordinatedMotion) -> float:
    """Draw the distance errors; return the axis limit to either side [m]."""
    scene = motion.scene
    s = np.linspace(0.0, 1.0, 801)
    position, reach = motion.hands(s)[0], 0.0
    for c in scene.distances:
        apart = np.linalg.norm(position[:, c.first] - position[:, c.second], axis=1)
        names = scene.manipulators[c.first], scene.manipulators[c.second]
        axes.plot(
            s * scene.duration, apart - c.distance, label=f"|{names[0]} − {names[1]}| − {c.distance:g} m"
        )
        reach = max(reach, float(np.abs(apart - c.distance).max()))
    if scene.distances:
        # Down to rounding errors the axis would show noise: open it to the tolerance at the least.
        tolerance = max(max(c.tolerance for c in scene.distances), 1e-12)
        reach = max(reach, tolerance)
        axes.axhspan(-tolerance, tolerance, color="0.9", zorder=0, label="tolerance")
        axes.legend(loc="upper right", ncols=2, frameon=False)
    axes.set(xlabel="time [s]", ylabel="constraint violation [m]")
    return reach


def views_of(scene: Scene) -> tuple[tuple[int, int], ...]:
    """Return the planes in which a scene is drawn."""
    return ((0, 1),) if scene.n_dims == 2 else ((0, 1), (0, 2), (1, 2))


def draw_frame(axes: Axes, scene: Scene, view: tuple[int, int]) -> None:
    """Draw the workspace."""
    low, high = scene.lower[list(view)], scene.upper[list(view)]
    pad = 0.02 * float((high - low).max())
    axes.set(
        xlim=(low[0] - pad, high[0] + pad),
        ylim=(low[1] - pad, high[1] + pad),
        aspect="equal",
        xlabel=f"{'xyz'[view[0]]} [m]",
        ylabel=f"{'xyz'[view[1]]} [m]",
    )
    axes.add_patch(Rectangle(tuple(low), *(high - low), fill=False, edgecolor="0.3", linewidth=1))


def _draw_obstacles(axes: Axes, scene: Scene, view: tuple[int, int]) -> None:
    """Draw obstacles, moving ones at several times with their paths. Later ones are darker."""
    draw_standing(axes, scene, view)
    if not scene.moving.any():
        return
    borders = MovingBorders(scene, view)
    for share in np.linspace(0.0, 1.0, 9).tolist():
        borders.draw(axes, scene.obstacles_at(share * scene.duration), 0.08 + 0.3 * share)
    paths = scene.offsets(np.linspace(0.0, scene.duration, 201))[:, scene.moving]
    for start, path in zip(scene.centers[scene.moving], paths.swapaxes(0, 1), strict=True):
        axes.plot(*(start + path)[:, list(view)].T, ":", color=MOVING, linewidth=1)


def draw_standing(axes: Axes, scene: Scene, view: tuple[int, int]) -> None:
    """Draw the static obstacles, in space as projections along the view."""
    solid = 1.0 if scene.n_dims == 2 else 0.35
    for mesh in np.flatnonzero(~scene.moving[scene.surfaces.owner]):
        _draw_triangles(axes, scene.surfaces.of(int(mesh))[:, :, list(view)])
    for row in scene.obstacles[~scene.moving[scene.owners] & scene.convex_rows]:
        axes.fill(*outline(row, view).T, facecolor="0.62", edgecolor="0.25", linewidth=0.6, alpha=solid)


class MovingBorders:
    """Borders of the moving obstacles in one view, computed once."""

    def __init__(self, scene: Scene, view: tuple[int, int]):
        self._scene, self._view, self._rows = scene, view, np.flatnonzero(scene.moving[scene.owners])
        self._borders = [outline(scene.obstacles[row], view) for row in self._rows]
        self._opacity = 1.0 if scene.n_dims == 2 else 0.35

    def at(self, table: Array) -> list[Array]:
        """Return the borders of moving obstacles, shape (n_points, 2), by poses."""
        scene, center = self._scene, [CENTER + axis for axis in self._view]
        turns = scene.turning[scene.owners]
        return [
            outline(table[row], self._view)
            if turns[row]
            else border + table[row, center] - scene.obstacles[row, center]
            for row, border in zip(self._rows, self._borders, strict=True)
        ]

    def draw(self, axes: Axes, table: Array, alpha: float, edge: str = MOVING) -> PolyCollection:
        """Draw the moving obstacles of a table; return the artist."""
        shapes = PolyCollection(
            self.at(table), facecolor=MOVING, edgecolor=edge, linewidth=0.6, alpha=alpha * self._opacity
        )
        axes.add_collection(shapes)
        return shapes


def _draw_triangles(axes: Axes, triangles: Array) -> None:
    """Draw the projection of a mesh, shape (n, 3, 2). It is darker where triangles overlap."""
    axes.add_collection(
        PolyCollection(list(triangles), facecolors="0.62", alpha=0.2, edgecolors="none", rasterized=True)
    )


def _tones(scene: Scene, nodes: Array, time: Array) -> list[str]:
    """Return the payload's colours by contact and distance violation.

    Parameters
    ----------
    nodes : array, shape (n_states, n_nodes, 3), positions of the nodes [m]
    time : array, shape (n_states,), times of the states [s]
    """
    touches, off = scene.clearances(nodes, time) < 0.0, _excesses(scene, nodes) > BROKEN
    return [TOUCHES if t else OFF if o else FINE for t, o in zip(touches, off, strict=True)]


def _excesses(scene: Scene, nodes: Array) -> Array:
    """Return states' largest distance error minus its tolerance [m]."""
    found = [c.error(nodes, scene.n_dims) - c.tolerance for c in scene.distances]
    return np.max(found, axis=0) if found else np.zeros(len(nodes))


def _draw_worst(axes: Axes, motion: CoordinatedMotion, view: tuple[int, int], n_states: int = 801) -> None:
    """Draw the payload at deepest penetration and largest distance error."""
    scene, s = motion.scene, np.linspace(0.0, 1.0, n_states)
    nodes = motion.coordinates.motion(motion.at(s))[0]
    depths = -scene.clearances(nodes, s * scene.duration)
    excesses = _excesses(scene, nodes)
    bars = load_pairs(scene) or [(c.first, c.second) for c in scene.distances]
    for values, tone, what in (
        (excesses, OFF, "load, where a distance is most off"),
        (depths, TOUCHES, "load, where it is deepest in something"),
    ):
        worst = int(np.argmax(values))
        if values[worst] <= BROKEN:
            continue
        state = nodes[worst][:, list(view)]
        for i, (first, second) in enumerate(bars):
            label = what if i == 0 else None
            axes.plot(*state[[first, second]].T, color=tone, linewidth=3.5, zorder=6, label=label)


def _show_whole(axes: Axes, ways: Array, wider: float = 0.5) -> None:
    """Widen the axes where end effectors leave the workspace.

    Parameters
    ----------
    ways : array, shape (n_steps, n_hands, 2), their paths [m]
    wider : largest extension on a side, as a share of the workspace
    """
    for limits, place, least, most in (
        (axes.get_xlim(), axes.set_xlim, ways[..., 0].min(), ways[..., 0].max()),
        (axes.get_ylim(), axes.set_ylim, ways[..., 1].min(), ways[..., 1].max()),
    ):
        size = limits[1] - limits[0]
        pad, reach = 0.02 * size, wider * size
        low, high = min(limits[0], least - pad), max(limits[1], most + pad)
        place(max(low, limits[0] - reach), min(high, limits[1] + reach))


def _draw_load(axes: Axes, scene: Scene, nodes: Array, tones: Sequence[str]) -> None:
    """Draw the payload at states of shape (n_states, n_nodes, 2)."""
    solids = scene.body.solids
    bars = load_pairs(scene)
    outlines = [hull_outline(state[corners]) for state in nodes for corners in solids]
    edges = [tone for tone in tones for _ in solids]
    axes.add_collection(
        PolyCollection(
            outlines, facecolors=(0.35, 0.35, 0.35, 0.02), edgecolors=edges, linewidths=0.7, zorder=3
        )
    )
    lines = [state[list(edge)] for state in nodes for edge in bars]
    colours = [tone for tone in tones for _ in bars]
    axes.add_collection(LineCollection(lines, colors=colours, linewidths=1.1, alpha=0.75, zorder=3))
    for tone, what in ((FINE, "load"), (OFF, "load, a distance off"), (TOUCHES, "load, touching")):
        if tone in tones and (bars or len(solids)):
            axes.plot([], [], color=tone, linewidth=2, label=what)
    for hand in range(len(scene.manipulators)):
        axes.plot(*nodes[:, hand].T, "o", color=COLOURS[hand % len(COLOURS)], markersize=2.6, zorder=4)

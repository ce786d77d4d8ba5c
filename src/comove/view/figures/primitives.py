"""Figures of movement primitives: one in detail, or a library."""

from __future__ import annotations

from collections.abc import Iterable
from math import ceil, sqrt
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp import DMP, Primitive, Variant
from comove.dmp.demonstrations import Demonstration
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.dmp.system import gaussians, mollifiers, von_mises
from comove.trajectory import Trajectory
from comove.view.figures.style import GOAL, START, new_figure

COLOURS = ("#2456a4", "#b5541c", "#0f7c80", "#7a3e9d", "#8a6d1a", "#2a7f3f", "#3c3c3c")
RECORDED: dict[str, Any] = {"color": "0.62", "linewidth": 4.0, "solid_capstyle": "round"}
CURVE: dict[str, Any] = {"linewidth": 1.6}
N_STEPS = 401


def draw_primitive(
    primitive: Primitive | DMP | PoseDMP,
    demonstration: Demonstration | None = None,
    *,
    goals: ArrayLike | None = None,
    title: str = "",
) -> Figure:
    """Draw a primitive: its fit, other goals, coordinates, speed, and forcing functions.

    Parameters
    ----------
    primitive : the primitive; for poses, positions are drawn, and the orientation instead of the forcing functions
    demonstration : recording to which it was fitted, drawn below it, with the distance between the two
    goals : array, shape (n_goals, n_dims), goals to which it is generalised; some around its own unless given
    title : title; the primitive's name unless given
    """
    dmp, unit = _movement(primitive), _unit(primitive, demonstration)
    name = title or (primitive.name if isinstance(primitive, Primitive) else "movement primitive")
    figure = new_figure(12.0, 7.2)
    what = "period" if dmp.variant is Variant.RHYTHMIC else "duration"
    figure.suptitle(
        f"{name}   ({dmp.variant}, {dmp.weights.shape[1]} weights a dimension, {what} {dmp.duration:.3g} s)"
    )
    (path, other, distance), (coordinates, speed, last) = figure.subplots(2, 3)
    played = _played(dmp, 0.0 if demonstration is None else demonstration.duration)
    view = _view(played)
    _draw_fit(path, dmp, view, demonstration, unit)
    _draw_goals(other, dmp, view, _goals(dmp, view, goals), unit)
    if demonstration is not None:
        _draw_distance(distance, dmp, demonstration, unit)
    else:
        _draw_acceleration(distance, dmp, unit)
    _draw_coordinates(coordinates, dmp, played, demonstration, unit)
    _draw_speed(speed, played, demonstration, unit)
    poses = primitive.followed if isinstance(primitive, Primitive) else primitive
    if isinstance(poses, PoseDMP):
        _draw_orientation(last, poses, demonstration)
    else:
        _draw_forcing(last, dmp)
    for axes in (coordinates, speed, last, distance):
        axes.spines[["top", "right"]].set_visible(False)
        axes.margins(x=0.02)
    _legend(figure, path)
    return figure


def draw_library(primitives: Iterable[Primitive], *, title: str = "library", most: int = 120) -> Figure:
    """Draw a contact sheet of the first `most` movements. Each has its duration and fit error."""
    primitives = list(primitives)
    shown = primitives[:most]
    rows = max(1, ceil(len(shown) / min(max(1, ceil(sqrt(1.5 * len(shown)))), 8)))
    columns = max(1, ceil(len(shown) / rows))  # the fewest, so that rows are full
    figure = new_figure(max(4.5, 1.75 * columns), 2.3 * rows + 0.8)
    more = f", the first {most} are shown" if len(primitives) > most else ""
    count = f"{len(primitives)} movement{'s' if len(primitives) != 1 else ''}"
    figure.suptitle(f"{title}: {count}{more}")
    cells = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, primitive in zip(cells, shown, strict=False):
        _thumbnail(axes, primitive)
    for axes in cells[len(shown) :]:
        axes.set_visible(False)
    if shown:
        _legend(figure, cells[0])
    return figure


def _thumbnail(axes: Axes, primitive: Primitive) -> None:
    dmp = primitive.positions
    played = dmp.rollout(n_steps=201)
    view = _view(played)
    axes.plot(*_seen(played, view), color=COLOURS[0], **CURVE)
    _mark(axes, dmp, view, size=5)
    axes.margins(0.12)
    if len(view) == 2:
        _square(axes)
    axes.set_box_aspect(1.0)
    axes.set(xticks=[], yticks=[])
    axes.spines[:].set_color("0.8")
    axes.set_title(_short(primitive.name, 18), fontsize=9)
    names = ", ".join(_axis(i, dmp.n_dims) for i in view) + " · " if dmp.n_dims > 2 else ""
    learned = primitive.provenance
    error = "" if learned is None else f"\nfit error {learned.error_rms:.2g} {_short(primitive.unit, 10)}"
    axes.set_xlabel(f"{names}{dmp.duration:.3g} s{error}", fontsize=7.5)


def _draw_fit(
    axes: Axes, dmp: DMP, view: tuple[int, ...], demonstration: Demonstration | None, unit: str
) -> None:
    title = "movement"
    if demonstration is not None:
        missed = np.linalg.norm(dmp.at(demonstration.time).position - demonstration.position, axis=1)
        title = f"fit: error {np.sqrt((missed**2).mean()):.2g} {unit} (rms)"
        axes.plot(*_seen(demonstration, view), label="recording", **RECORDED)
    axes.plot(*_seen(_played(dmp), view), color=COLOURS[0], label="primitive", **CURVE)
    _mark(axes, dmp, view, size=7)
    _frame(axes, dmp, view, unit)
    axes.set_title(title)


def _draw_goals(axes: Axes, dmp: DMP, view: tuple[int, ...], goals: Array, unit: str) -> None:
    colours = colormaps["viridis"](np.linspace(0.05, 0.9, max(len(goals), 1)))
    for goal, colour in zip(goals, colours, strict=True):
        there = dmp.towards(goal=goal)
        axes.plot(*_seen(_played(there), view), color=colour, linewidth=1.1)
        axes.plot(*_end(there, view), "s", color=colour, markersize=4.5)
    axes.plot(*_seen(_played(dmp), view), color="0.1", **CURVE)
    _mark(axes, dmp, view, size=7)
    _frame(axes, dmp, view, unit)
    axes.set_title("other centres" if dmp.variant is Variant.RHYTHMIC else "other goals")


def _draw_distance(axes: Axes, dmp: DMP, demonstration: Demonstration, unit: str) -> None:
    missed = np.linalg.norm(dmp.at(demonstration.time).position - demonstration.position, axis=1)
    axes.plot(demonstration.time, missed, color=COLOURS[0], linewidth=1.2)
    root = float(np.sqrt((missed**2).mean()))
    axes.axhline(
        root, color=COLOURS[1], linestyle="--", linewidth=1.2, label=f"root mean square {root:.2g} {unit}"
    )
    axes.set(title="distance from the recording", xlabel="time [s]", ylabel=f"distance [{unit}]")
    axes.set_ylim(0.0, 1.25 * max(float(missed.max()), 1e-300))
    axes.legend(frameon=False, loc="upper right")


def _draw_coordinates(
    axes: Axes, dmp: DMP, played: Trajectory, demonstration: Demonstration | None, unit: str
) -> None:
    for i, column in enumerate(played.position.T):
        if demonstration is not None:
            axes.plot(demonstration.time, demonstration.position[:, i], **RECORDED)
        axes.plot(played.time, column, color=COLOURS[i % len(COLOURS)], label=_axis(i, dmp.n_dims), **CURVE)
    axes.set(xlabel="time [s]", ylabel=f"position [{unit}]")
    named = 1 < dmp.n_dims <= 7  # a legend of more would have no room
    if dmp.n_dims <= 3 or not named:
        axes.set_title("coordinates", loc="left" if dmp.n_dims in (2, 3) else "center")
    if named:
        _name_curves(axes, dmp.n_dims)


def _draw_speed(axes: Axes, played: Trajectory, demonstration: Demonstration | None, unit: str) -> None:
    if demonstration is not None:
        pace = np.gradient(demonstration.position, demonstration.time, axis=0)
        axes.plot(demonstration.time, np.linalg.norm(pace, axis=1), **RECORDED)
    axes.plot(played.time, np.linalg.norm(played.velocity, axis=1), color=COLOURS[0], **CURVE)
    axes.set(title="speed", xlabel="time [s]", ylabel=f"speed [{unit}/s]")
    axes.set_ylim(bottom=0.0)


def _draw_acceleration(axes: Axes, dmp: DMP, unit: str) -> None:
    acceleration = np.linalg.norm(dmp.curve.knots[2], axis=1) / dmp.duration**2
    time = np.linspace(0.0, dmp.duration, len(acceleration))
    axes.plot(time, acceleration, color=COLOURS[0], **CURVE)
    axes.set(title="acceleration", xlabel="time [s]", ylabel=f"acceleration [{unit}/s²]")
    axes.set_ylim(bottom=0.0)


def _draw_orientation(axes: Axes, dmp: PoseDMP, demonstration: Demonstration | None) -> None:
    """Draw the primitive's quaternions, and the recording's with fitting signs."""
    if demonstration is not None and demonstration.orientation is not None:
        recorded = demonstration.orientation
        fitted = dmp.at(demonstration.time).orientation
        signs = np.where((fitted * recorded).sum(axis=1, keepdims=True) < 0.0, -1.0, 1.0)
        axes.plot(demonstration.time, signs * recorded, **RECORDED)
    played = dmp.at(np.linspace(0.0, dmp.duration, N_STEPS))
    for name, column, colour in zip("wxyz", played.orientation.T, COLOURS, strict=False):
        axes.plot(played.time, column, color=colour, label=name, **CURVE)
    axes.set(xlabel="time [s]", ylabel="quaternion")
    axes.set_title("orientation", loc="left")
    _name_curves(axes, 4)


def _draw_forcing(axes: Axes, dmp: DMP) -> None:
    """Draw the basis functions of the forcing term. There are two (or one) more than weights, for the ends."""
    n_basis = dmp.weights.shape[1]
    if dmp.variant is Variant.RHYTHMIC:
        psi, formula = von_mises(n_basis + 1), "ψ(t)"
    else:
        kernels = mollifiers if dmp.variant is Variant.DMP_PLUS_PLUS else gaussians
        psi, formula = kernels(n_basis + 2, dmp.phase), "ψ(x) x"
    time = np.linspace(0.0, dmp.duration, len(psi))
    for i, column in enumerate(psi.T):
        seen = column > 1e-3 * column.max()
        colour = COLOURS[i % 3]
        axes.plot(time, np.where(seen, column, np.nan), color=colour, linewidth=1.0)
        axes.fill_between(time, np.where(seen, column, 0.0), color=colour, alpha=0.08, linewidth=0)
    axes.set(title="forcing functions", xlabel="time [s]", ylabel=formula)
    axes.set_ylim(bottom=0.0)


def _goals(dmp: DMP, view: tuple[int, ...], goals: ArrayLike | None) -> Array:
    """Return the given goals, or some around the primitive's own. Their distance is in proportion to its extent."""
    if goals is not None:
        return np.atleast_2d(np.asarray(goals, dtype=float))
    extent = float(np.ptp(_played(dmp).position, axis=0).max()) or 1.0
    if dmp.n_dims == 1:
        return dmp.goal + extent * np.array([-0.6, -0.4, -0.2, 0.2, 0.4, 0.6])[:, None]
    reach = 1.2 if dmp.variant is Variant.RHYTHMIC else 0.35
    angles = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
    around = np.zeros((8, dmp.n_dims))
    around[:, view] = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return dmp.goal + reach * extent * around


def _played(dmp: DMP, until: float = 0.0) -> Trajectory:
    """Return the movement, a rhythmic one for two periods. It is longer where `until` [s] requires it."""
    end = max(2 * dmp.duration, until) if dmp.variant is Variant.RHYTHMIC else dmp.duration
    return dmp.at(np.linspace(0.0, end, N_STEPS * max(1, round(end / dmp.duration))))


def _view(played: Trajectory) -> tuple[int, ...]:
    """Return the one or two coordinates of the largest range."""
    farthest = np.argsort(-np.ptp(played.position, axis=0), kind="stable")[:2]
    return tuple(sorted(farthest.tolist()))


def _seen(played: Trajectory | Demonstration, view: tuple[int, ...]) -> tuple[Array, Array]:
    """Return abscissa and ordinate: two coordinates, or time and one."""
    if len(view) == 1:
        return played.time, played.position[:, 0]
    return played.position[:, view[0]], played.position[:, view[1]]


def _end(dmp: DMP, view: tuple[int, ...]) -> Array:
    return np.array([dmp.duration, dmp.goal[0]] if len(view) == 1 else dmp.goal[list(view)])[:, None]


def _mark(axes: Axes, dmp: DMP, view: tuple[int, ...], size: float) -> None:
    start = np.array([0.0, dmp.start[0]] if len(view) == 1 else dmp.start[list(view)])[:, None]
    goal = "centre" if dmp.variant is Variant.RHYTHMIC else "goal"
    axes.plot(*start, "o", color=START, markersize=size, zorder=6, label="start")
    axes.plot(*_end(dmp, view), "s", color=GOAL, markersize=size, zorder=5, label=goal)


def _frame(axes: Axes, dmp: DMP, view: tuple[int, ...], unit: str) -> None:
    if len(view) == 1:
        axes.set(xlabel="time [s]", ylabel=f"position [{unit}]")
        return
    names = [f"{_axis(i, dmp.n_dims)} [{unit}]" for i in view]
    axes.set(xlabel=names[0], ylabel=names[1])
    _square(axes)


def _square(axes: Axes) -> None:
    """Make both scales equal in a square with fixed limits."""
    limits = np.array([axes.get_xlim(), axes.get_ylim()])
    middle, reach = limits.mean(axis=1), np.ptp(limits, axis=1).max() / 2
    axes.set(xlim=middle[0] + [-reach, reach], ylim=middle[1] + [-reach, reach])
    axes.set_aspect("equal", adjustable="box")


def _name_curves(axes: Axes, count: int) -> None:
    axes.legend(
        frameon=False,
        ncols=count,
        loc="lower right",
        bbox_to_anchor=(1.02, 1.0),
        borderaxespad=0.1,
        handlelength=0.8,
        handletextpad=0.4,
        columnspacing=0.8,
    )


def _axis(i: int, n_dims: int) -> str:
    return "xyz"[i] if n_dims <= 3 else f"y{i + 1}"


def _legend(figure: Figure, axes: Axes) -> None:
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)


def _movement(primitive: Primitive | DMP | PoseDMP) -> DMP:
    dmp = primitive.followed if isinstance(primitive, Primitive) else primitive
    if isinstance(dmp, ProMP):
        return dmp.mean
    return dmp.translation if isinstance(dmp, PoseDMP) else dmp


def _unit(primitive: Primitive | DMP | PoseDMP, demonstration: Demonstration | None) -> str:
    if isinstance(primitive, Primitive):
        return primitive.unit
    return "m" if demonstration is None else demonstration.unit


def _short(text: str, length: int) -> str:
    return text if len(text) <= length else f"{text[: length - 1]}…"

"""Colours, offscreen figures, and files of pictures and films."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from comove.errors import OptionError
from comove.io.files import whole_path

COLOURS = ("#2a7f3f", "#2456a4", "#b5541c", "#7a3e9d", "#0f7c80", "#8a6d1a", "#8c2f5a")
"""Colours of hands, coordinates, joints and series, in their order."""
START, GOAL, MOVING = "#2ca02c", "#d62728", "#8c564b"
"""Colours of starts, goals and moving obstacles."""
ARM: dict[str, Any] = {"color": "#8f97a3", "linewidth": 2.4, "alpha": 0.6, "marker": "o", "markersize": 3.0}
"""How the arms of robots are drawn, as lines."""
Mover = Callable[[float], list[Artist]]
"""A function that brings artists, which are animated, to a time [s] and returns them in the order of drawing."""


def new_figure(width: float, height: float) -> Figure:
    """Return an offscreen figure; sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def save(figure: Figure, path: str | Path, *, dpi: int = 110) -> None:
    """Write a figure as the path's suffix says, a PNG by `png`."""
    if Path(path).suffix != ".png":
        figure.savefig(path, dpi=dpi)
        return
    Path(path).write_bytes(png(figure, dpi=dpi))


def png(figure: Figure, *, dpi: int = 110) -> bytes:
    """Return a figure as a PNG. `savefig` would draw it once more, to lay it out."""
    figure.set_dpi(dpi)
    if layout := figure.get_layout_engine():
        layout.execute(figure)
        figure.set_layout_engine("none")
    picture = BytesIO()
    FigureCanvasAgg(figure).print_png(picture)
    return picture.getvalue()


def png_uri(figure: Figure, dpi: int) -> str:
    """Return a figure as the source of an image in HTML."""
    return f"data:image/png;base64,{base64.b64encode(png(figure, dpi=dpi)).decode('ascii')}"


def save_picture(figure: Figure, path: Path) -> None:
    """Write a figure to a path of the user, atomically.

    Raises
    ------
    OptionError
        If it cannot be written there.
    """
    with whole_path(path, OptionError) as draft:
        save(figure, draft)


def draw_way(axes: Axes, path: NDArray, goal: NDArray, hand: int, label: str) -> None:
    """Draw an end effector's path with start and goal. Arrays, shape (n_steps, n_axes) and (n_axes,) [m]."""
    axes.plot(*path.T, color=COLOURS[hand % len(COLOURS)], linewidth=1.6, label=label)
    axes.plot(*path[:1].T, "o", color=START, markersize=7, zorder=5)
    axes.plot(*goal[:, None], "s", color=GOAL, markersize=7, zorder=5)


def write_gif(
    figure: Figure,
    movers: Sequence[Mover],
    times: NDArray,
    path: Path,
    durations: Sequence[int],
    dpi: int,
    *,
    n_tones: int = 128,
) -> None:
    """Write a looping animated GIF. Static artists are drawn once, moving ones for every frame.

    Parameters
    ----------
    times : array, shape (n_frames,) [s]
    durations : display time of each frame [ms]
    n_tones : colours of the whole film
    """
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    background, images = canvas.copy_from_bbox(figure.bbox), []
    for time in times:
        canvas.restore_region(background)
        for mover in movers:
            for artist in mover(float(time)):
                artist.axes.draw_artist(artist)  # type: ignore[union-attr]  # all have axes
        images.append(np.asarray(canvas.buffer_rgba())[:, :, :3].copy())
    # One palette for all frames: what does not change costs nothing. An octree keeps the colours of thin lines.
    some = np.concatenate([images[0], images[len(images) // 2], images[-1]])
    tones = Image.fromarray(some).quantize(n_tones, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    frames = [Image.fromarray(image).quantize(palette=tones, dither=Image.Dither.NONE) for image in images]
    frames[0].save(
        path,
        format="GIF",
        save_all=True,
        append_images=frames[1:],
        duration=list(durations),
        loop=0,
        optimize=True,
    )

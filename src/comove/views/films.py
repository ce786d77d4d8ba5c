"""Films of figures: what stands is drawn once, and what moves for every frame."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

Array = NDArray[np.float64]

Mover = Callable[[float], list[Artist]]
"""A function that brings artists, which are animated, to a time [s] and returns them in the order of drawing."""
N_TONES = 128  # colours of a film


def write_gif(
    figure: Figure, movers: Sequence[Mover], times: Array, path: Path, durations: Sequence[int], dpi: int
) -> None:
    """Write an animated GIF that repeats itself.

    Parameters
    ----------
    times : array, shape (n_frames,) [s]
    durations : how long each frame is shown [ms]
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
    tones = Image.fromarray(some).quantize(N_TONES, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
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

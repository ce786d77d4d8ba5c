"""Films: MP4 by ffmpeg, where there is one, else GIF by Pillow."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable
from itertools import chain
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]

GIF_RATE = 12.5  # pictures a second of a GIF at most


def encoder() -> str | None:
    """The ffmpeg that comes with imageio-ffmpeg, else the system's, None where there is none."""
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return shutil.which("ffmpeg")


def write_film(pictures: Iterable[Picture], path: Path, rate: float, ffmpeg: str | None) -> None:
    """Write pictures, arrays of shape (height, width, 3), as a film of `rate` pictures a second.

    Parameters
    ----------
    path : ends with .mp4 where there is an encoder, with .gif where there is none
    ffmpeg : the encoder
    """
    if ffmpeg is None:
        _write_gif(pictures, path, rate)
    else:
        _write_mp4(pictures, path, rate, ffmpeg)


def _write_mp4(pictures: Iterable[Picture], path: Path, rate: float, ffmpeg: str) -> None:
    pictures = iter(pictures)
    first = next(pictures)
    height, width = first.shape[:2]
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{rate:g}", "-i", "-"]
    wanted = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "23", "-movflags", "+faststart"]
    command = [ffmpeg, "-y", "-loglevel", "error", *given, "-an", *wanted, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            for picture in chain([first], pictures):
                process.stdin.write(picture.tobytes())
        except BrokenPipeError:
            pass
        _, said = process.communicate()
    if process.returncode:
        raise OSError(f"ffmpeg: {said.decode(errors='replace').strip().splitlines()[-1:]}")


def _write_gif(pictures: Iterable[Picture], path: Path, rate: float) -> None:
    from PIL import Image

    every = max(1, round(rate / GIF_RATE))
    frames = [Image.fromarray(picture).quantize(64) for picture in list(pictures)[::every]]
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=round(1000 * every / rate), loop=0)

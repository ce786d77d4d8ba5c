"""Writer of films: MP4 by ffmpeg, where there is one, else GIF by Pillow."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterable
from itertools import chain, islice
from pathlib import Path

from PIL import Image

from comove.errors import ResultError
from comove.io.files import whole_path

GIF_RATE = 12.5  # pictures a second of a GIF at most


def encoder() -> str | None:
    """Return the ffmpeg that comes with imageio-ffmpeg, else the system's, None where there is none."""
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return shutil.which("ffmpeg")


def write_film(pictures: Iterable[Image.Image], path: Path, rate: float, ffmpeg: str | None) -> None:
    """Write pictures of one size as a film.

    Parameters
    ----------
    path : path of the file, an MP4 if there is an encoder, else a GIF
    rate : pictures a second
    ffmpeg : path of the encoder; None writes a GIF

    Raises
    ------
    ResultError
        If the file cannot be written.
    """
    with whole_path(path, ResultError) as draft:
        if ffmpeg is None:
            _write_gif(pictures, draft, rate)
        else:
            _write_mp4(pictures, draft, rate, ffmpeg)


def _write_mp4(pictures: Iterable[Image.Image], path: Path, rate: float, ffmpeg: str) -> None:
    pictures = iter(pictures)
    first = next(pictures)
    size = f"{first.width}x{first.height}"
    given = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", size, "-r", f"{rate:g}", "-i", "-", "-an"]
    wanted = ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "23", "-movflags", "+faststart", "-f", "mp4"]
    command = [ffmpeg, "-y", "-loglevel", "error", *given, *wanted, str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        try:
            for picture in chain([first], pictures):
                process.stdin.write(picture.tobytes())
        except BrokenPipeError:
            pass  # what it has to say comes below
        _, said = process.communicate()
    if process.returncode:
        reason = said.decode(errors="replace").strip().splitlines()[-1:] or ["it failed"]
        raise ResultError(
            f"ffmpeg: {reason[0]}", file=path, way_out="remove that ffmpeg to get a GIF instead"
        )


def _write_gif(pictures: Iterable[Image.Image], path: Path, rate: float) -> None:
    every = max(1, round(rate / GIF_RATE))
    frames = [picture.quantize(64) for picture in islice(pictures, 0, None, every)]
    pause = round(1000 * every / rate)  # ms
    frames[0].save(path, format="GIF", save_all=True, append_images=frames[1:], duration=pause, loop=0)

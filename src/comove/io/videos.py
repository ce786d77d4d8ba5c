"""Encoding of pictures as videos: H.264 in MP4, by PyAV."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from fractions import Fraction
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from comove.io.files import installed

Picture = NDArray[np.uint8]

PIXELS = "yuv420p"


def require_videos() -> Any:
    """Import and return PyAV."""
    return installed("av", "video of cameras", "video")


def encode(
    pictures: Iterable[Sequence[Picture]],
    files: Sequence[str | IO[bytes]],
    rate: float,
    *,
    encoder: dict[str, str],
    container: dict[str, str] | None = None,
) -> None:
    """Write the pictures of several cameras as one video per camera.

    Parameters
    ----------
    pictures : at each instant an array of shape (height, width, 3) for each camera
    files : paths, or files open for writing, one for each camera
    rate : pictures a second [Hz]
    encoder, container : options of the encoder, and of MP4 files
    """
    av = require_videos()
    with ExitStack() as stack:
        outputs = [stack.enter_context(av.open(file, "w", format="mp4", options=container)) for file in files]
        streams: list[Any] = []
        for seen in pictures:
            if not streams:
                streams = [_stream(output, seen[0].shape, rate, encoder) for output in outputs]
            for output, stream, picture in zip(outputs, streams, seen, strict=True):
                output.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        for output, stream in zip(outputs, streams, strict=True):
            output.mux(stream.encode())


def _stream(output: Any, shape: tuple[int, ...], rate: float, encoder: dict[str, str]) -> Any:
    stream = output.add_stream("libx264", rate=Fraction(rate).limit_denominator(1000), options=encoder)
    stream.height, stream.width = shape[:2]
    stream.pix_fmt = PIXELS
    return stream

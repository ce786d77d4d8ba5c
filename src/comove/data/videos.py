"""Videos of episodes: H.264 in MP4, one file a camera.

Every second picture is a key picture, so that a policy's loader need not decode many to see one, and none refers to
a later one, so that videos are joined without encoding them again.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from comove.errors import ResultError
from comove.io.videos import Picture, encode, require_videos

CODEC = "h264"
OPTIONS = {"crf": "20", "g": "2", "bf": "0", "preset": "medium", "threads": "1"}
"""Of the encoder: on one thread, so that the same pictures give the same bytes."""


def encoded(pictures: Iterable[Sequence[Picture]], count: int, rate: int) -> list[bytes]:
    """Encode the pictures of several cameras; return a video of each.

    Parameters
    ----------
    pictures : at each instant an array of shape (height, width, 3) for each camera
    count : number of cameras
    rate : pictures a second [Hz]
    """
    files = [io.BytesIO() for _ in range(count)]
    encode(pictures, files, rate, encoder=OPTIONS)
    return [file.getvalue() for file in files]


@dataclass(frozen=True, eq=False)
class Video:
    """Video of an episode.

    Attributes
    ----------
    content : bytes of the file
    name : its name, for messages
    store : path of the run database that it comes from, for messages
    """

    content: bytes
    name: str
    store: Path | None = None

    @cached_property
    def pictures(self) -> Picture:
        """Return all pictures; array, shape (n_steps, height, width, 3).

        Raises
        ------
        ResultError
            If the video was damaged.
        """
        av = require_videos()
        try:
            with av.open(io.BytesIO(self.content)) as container:
                decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
                return np.stack(decoded)
        except (av.FFmpegError, ValueError, IndexError) as error:
            raise ResultError(
                f"{self.name} cannot be decoded: {error}",
                file=self.store,
                way_out="copy the store again, or generate the episode again in a new folder",
            ) from error

    def packets(self) -> Iterator[Any]:
        """Yield the encoded pictures in order, one packet each."""
        with require_videos().open(io.BytesIO(self.content)) as container:
            yield from (packet for packet in container.demux(video=0) if packet.dts is not None)


class VideoFile:
    """File of several videos, joined without encoding them again."""

    def __init__(self, path: Path, first: Video, rate: int):
        self._container = require_videos().open(str(path), "w", format="mp4")
        self._template, self.size, self.n_pictures, self._rate = _header(first), 0, 0, rate
        with require_videos().open(io.BytesIO(first.content)) as source:
            self._stream = self._container.add_stream_from_template(source.streams.video[0])
        self._stream.time_base = Fraction(1, rate)

    def takes(self, video: Video) -> bool:
        """Return whether a video has the file's encoding and header."""
        return _header(video) == self._template

    def add(self, video: Video) -> None:
        """Append a video."""
        for packet in video.packets():
            packet.stream = self._stream
            packet.time_base = Fraction(1, self._rate)
            packet.pts = packet.dts = self.n_pictures
            packet.duration = 1
            self._container.mux(packet)
            self.n_pictures += 1
        self.size += len(video.content)

    def close(self) -> None:
        """Complete the file."""
        self._container.close()


def _header(video: Video) -> tuple[bytes, int, int]:
    with require_videos().open(io.BytesIO(video.content)) as container:
        context = container.streams.video[0].codec_context
        return bytes(context.extradata or b""), context.width, context.height

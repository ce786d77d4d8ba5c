"""The clock by which a page plays its motions."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class PlayerSettings:
    """Settings of a page's clock.

    Attributes
    ----------
    frame : time between states while playing [s]
    pointed : frames after which the plots' line follows, as every move of it sends the whole plot
    end_pause : pause at the end before playing begins again [s]
    """

    frame: float = 1 / 30
    pointed: int = 6
    end_pause: float = 0.7


class Player:
    """The clock of what is shown.

    Parameters
    ----------
    end : function that returns the last instant that can be played [s]; None where nothing can be
    show : function that shows an instant [s], and points at it in the plots or not

    Attributes
    ----------
    time : the instant that is shown [s]
    pace : multiple of true time
    playing : whether it goes on
    closed : whether it has ended for good
    """

    def __init__(
        self,
        end: Callable[[], float | None],
        show: Callable[[float, bool], None],
        settings: PlayerSettings,
    ):
        self._end, self._show, self._settings = end, show, settings
        self.time, self.pace, self.playing, self.closed = 0.0, 1.0, True, False
        self._task: asyncio.Task[None] | None = None

    def start(self, loop: asyncio.AbstractEventLoop) -> None:
        """Begin to play, on an event loop."""
        self._task = loop.create_task(self._play())

    async def _play(self) -> None:
        frame, settings = 0, self._settings
        while not self.closed:
            await asyncio.sleep(settings.frame)
            end = self._end()
            if end is None or not self.playing:
                continue
            self.time += settings.frame * self.pace
            if self.time > end + settings.end_pause * self.pace:
                self.time = 0.0
            frame += 1
            self._show(min(self.time, end), frame % settings.pointed == 0)

    def close(self) -> None:
        """End for good."""
        self.closed = True
        if self._task is not None:
            self._task.cancel()

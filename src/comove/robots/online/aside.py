"""Search for trajectories in a process of its own.

Control steps go on beside it: a thread would share Python's lock with them, and they must be in time.
"""

from __future__ import annotations

from concurrent.futures import Future, ThreadPoolExecutor
from typing import Self

from comove.errors import RobotError
from comove.processes import Ahead
from comove.robots.online.pilot import Choice, Pilot, Wish


class SearchProcess:
    """Process that searches trajectories for a pilot, as a context.

    Parameters
    ----------
    pilot : the pilot, ready for a run; its copy in the process has the same roadmap
    """

    def __init__(self, pilot: Pilot):
        self._process: Ahead[Wish, Choice | None] = Ahead(_Search(pilot))
        self._thread = ThreadPoolExecutor(1)  # waits for the process

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.__exit__()
        self._thread.shutdown()

    def submit(self, wish: Wish) -> Future[Choice]:
        """Return a trajectory that will be found. It raises `RobotError` if the process ends."""
        return self._thread.submit(self._asked, wish)

    def _asked(self, wish: Wish) -> Choice:
        answer = self._process.work_on(wish)
        if answer.made is None:
            raise RobotError(
                f"the search for another way has ended: {answer.error or 'its process was killed'}",
                way_out="begin again from where the robot stands",
            )
        return answer.made


class _Search:
    """Search of a pilot's copy, which can be sent."""

    def __init__(self, pilot: Pilot):
        self._pilot = pilot

    def __call__(self, wish: Wish | None) -> Choice | None:
        """Return what is found; of None, only load kernels."""
        if wish is None:
            self._pilot.load()
            return None
        return self._pilot.found(wish)

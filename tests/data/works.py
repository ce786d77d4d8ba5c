"""Work for processes, which has to be in a module that they can import."""

import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from comove.data.runs import StoredMotion, StudyRun
from comove.data.variety import N_PATH
from comove.errors import OptionError


@dataclass(frozen=True)
class FakeStudy:
    """Runs that need no solver; some of them kill their process, raise, or write into a log that they began."""

    total: int = 20
    name: str = "fake"
    budget: float = 1.0
    salt: int = 0
    pause: float = 0.0
    log: Path | None = None
    killers: tuple[int, ...] = ()
    raisers: tuple[int, ...] = ()

    @property
    def described(self):
        return {"salt": self.salt, "nested": {"list": [1, 2]}}

    def require(self):
        """Need nothing."""

    def example_scenes(self):
        """Solve none."""
        return ()

    def key(self, number):
        return f"{self.salt}-{number:08d}"

    def run(self, number):
        if self.log is not None:
            with open(self.log, "a", encoding="utf-8") as log:
                log.write(f"{number}\n")
        if number in self.killers:
            os.kill(os.getpid(), signal.SIGKILL)
        if number in self.raisers:
            raise OptionError(f"not {number}", way_out="another")
        time.sleep(self.pause)
        run = StudyRun(
            self.key(number), number, "scene", status="verified", cost=float(number) ** 0.5, seed=number
        )
        path = np.full((N_PATH, 2), number, dtype="<f4").tobytes()
        return run, StoredMotion(run.key, b"scene", bytes([number % 256]) * 50, path)

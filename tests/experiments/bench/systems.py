"""Systems that wait, fail, or kill their process, for tests of the runner."""

from __future__ import annotations

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path

from comove.experiments.bench.sets import scenes_of
from comove.experiments.systems import N_SAMPLES, System


@dataclass(frozen=True)
class Witnessed(System):
    """Offers the scene's witness, after a while."""

    name: str = "witnessed"
    pause: float = 0.0

    def run(self, problem, offers):
        time.sleep(self.pause)
        offers.take(witness(problem.scene).hands(N_SAMPLES)[:, :, : problem.scene.n_dims], 0.5)


@dataclass(frozen=True)
class Logged(Witnessed):
    """Writes into a log what it runs, and waits until a file beside it is there."""

    name: str = "logged"

    def run(self, problem, offers):
        log = Path(os.environ["RUNS_LOG"])
        with log.open("a", encoding="utf-8") as file:
            file.write(f"{problem.scene.name}\n")
        while not log.with_name("go").exists():
            time.sleep(0.05)
        super().run(problem, offers)


@dataclass(frozen=True)
class Killer(Witnessed):
    """Kills its own process on one scene."""

    name: str = "killer"

    def run(self, problem, offers):
        if problem.scene.name == "planar-01":
            os.kill(os.getpid(), signal.SIGKILL)
        super().run(problem, offers)


@dataclass(frozen=True)
class Thrower(System):
    """Fails, refuses, or offers nothing."""

    name: str = "thrower"

    def refuses(self, scene):
        return "it is in space" if scene.n_dims == 3 else ""

    def run(self, problem, offers):
        if problem.scene.name == "planar-00":
            raise ValueError("no idea\nreally")
        if problem.scene.name == "planar-01":
            sys.exit("gone")


@dataclass(frozen=True)
class Sleeper(System):
    """Never ends; `deaf` ones do not hear when they are told to."""

    name: str = "sleeper"
    deaf: bool = False

    def run(self, problem, offers):
        if self.deaf:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM, signal.SIGTERM})
        while True:
            time.sleep(0.05)


def witness(scene):
    """Of a scene of the set easy."""
    return next(s for s in scenes_of("easy") if s.name == scene.name).witness(scene)


SYSTEMS = {
    "witnessed": Witnessed(),
    "slow": Witnessed("slow", 0.4),
    "logged": Logged(),
    "filler": Witnessed("filler"),
    "killer": Killer(),
    "thrower": Thrower(),
    "sleeper": Sleeper(),
    "deaf": Sleeper("deaf", True),
}

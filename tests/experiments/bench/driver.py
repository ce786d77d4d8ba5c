"""Drives a few runs with systems of its own: python driver.py STORE WORKERS SYSTEM... [for tests to kill]."""

from __future__ import annotations

import os
import resource
import signal
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

from comove.experiments.bench import runner
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
    """Writes into a log what it runs."""

    name: str = "logged"
    pause: float = 0.2

    def run(self, problem, offers):
        with open(os.environ["RUNS_LOG"], "a", encoding="utf-8") as log:
            log.write(f"{problem.scene.name}\n")
        super().run(problem, offers)


@dataclass(frozen=True)
class Filler(Witnessed):
    """Leaves no room on the disk, as far as its process is concerned."""

    name: str = "filler"

    def run(self, problem, offers):
        resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))
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
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})
        while True:
            time.sleep(0.05)


def witness(scene):
    """Of a scene of the set easy."""
    return next(s for s in scenes_of("easy") if s.name == scene.name).witness(scene)


SYSTEMS = {
    "witnessed": Witnessed(),
    "slow": Witnessed("slow", 0.4),
    "logged": Logged(),
    "filler": Filler(),
    "killer": Killer(),
    "thrower": Thrower(),
    "sleeper": Sleeper(),
    "deaf": Sleeper("deaf", True),
}


def drive(path, workers, names, n_scenes=4):
    """Run the first scenes of the easy set."""
    systems = {name: SYSTEMS[name] for name in names}
    jobs = runner.jobs_of(scenes_of("easy", n_scenes), systems, budget=0.1)
    jobs = [replace(job, allowed=0.8) for job in jobs]
    return runner.run_all(path, jobs, workers, lambda p: print(p.done, flush=True))


if __name__ == "__main__":
    runner.GRACE = 0.5
    print(drive(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))

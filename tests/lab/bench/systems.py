"""Systems that succeed, fail, or kill their process, for tests of the runner."""

from __future__ import annotations

import os
import signal
import sys
from dataclasses import dataclass

from comove.lab.bench.sets import scenes_of
from comove.lab.systems import N_SAMPLES, System
from tests.lab.bench.witnesses import witness_of


@dataclass(frozen=True)
class Witnessed(System):
    """Offers the scene's witness."""

    name: str = "witnessed"

    def run(self, problem, offers):
        offers.take(witness(problem.scene).hands(N_SAMPLES)[:, :, : problem.scene.n_dims], 0.5)


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


def witness(scene):
    """Of a scene of the set easy."""
    return witness_of(next(s for s in scenes_of("easy") if s.name == scene.name), scene)

"""Drives a few runs of systems that misbehave: python -m tests.experiments.bench.driver STORE WORKERS SYSTEM..."""

import resource
import sys
from pathlib import Path

from comove.experiments.bench import runner
from comove.experiments.bench.sets import scenes_of
from tests.experiments.bench.systems import SYSTEMS


def drive(path, workers, names, n_scenes=4):
    """Run the first scenes of the easy set."""
    systems = {name: SYSTEMS[name] for name in names}
    jobs = runner.jobs_of(scenes_of("easy", n_scenes), systems, budget=0.1)
    if "filler" in names:  # no room is left on the disk, as far as this process is concerned
        resource.setrlimit(resource.RLIMIT_FSIZE, (2048, 2048))
    allowed = 6.0 if {"sleeper", "deaf"} & set(names) else None
    return runner.run_all(path, jobs, workers, lambda p: print(p.done, flush=True), allowed=allowed)


if __name__ == "__main__":
    print(drive(Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]))

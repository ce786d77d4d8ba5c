"""Memory growth over thousands of searches, and hours of control.

    python benchmarks/long_runs.py [--solves 10000] [--robot-solves 300] [--hours 3] [--parts 10]

Every search has a new scene: an example whose obstacles are moved a little. The control loop holds a bar before a
goal that an obstacle crosses for ever, so that it waits, dodges and plans anew, 100 times a second. Memory is what
the process has resident at even parts of a run. The command fails if it grows by more than `GROWTH` from the middle
of a run to its end: caches are full by then. Drags: `python -m benchmarks.workbench --memory`.
"""

from __future__ import annotations

import argparse
import gc
import json
import os
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from timing import memory_of, on_one_thread, print_table

import comove
from comove.control import Functions

GROWTH = 5.0  # MB, in the second half of a run
SCENES = Path(comove.__file__).parent / "examples"
ROBOTS = Path(__file__).parents[1] / "examples" / "robots"
SHIFT = 0.005  # m, by which obstacles are moved at most


def main() -> None:
    """Run everything, print memory, and fail where it grows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--solves", type=int, default=10_000)
    parser.add_argument("--robot-solves", type=int, default=300)
    parser.add_argument("--hours", type=float, default=3.0, help="simulated hours of the control loop")
    parser.add_argument("--parts", type=int, default=10)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    planar = [SCENES / f"{name}.yaml" for name in ("wide", "narrow", "window", "triangle")]
    runs = {
        "searches of hands": (searches(planar, 0.1), asked.solves),
        "searches of two UR10": (searches([ROBOTS / "two_ur10.yaml"], 2.0), asked.robot_solves),
        "control steps": (steps(), round(asked.hours * 3600 * 100)),
    }
    rows, grown = [], False
    for name, (run, count) in runs.items():
        memory = []
        for k in range(count):
            next(run)
            if (k + 1) % max(1, count // asked.parts) == 0:
                gc.collect()
                memory.append(memory_of(os.getpid()))
        growth = memory[-1] - memory[len(memory) // 2] if memory else 0.0
        grown |= growth > GROWTH
        rows.append([name, count, " ".join(f"{x:.0f}" for x in memory), f"{growth:.1f}"])
    print_table(["run", "number", "memory [MB]", "second half [MB]"], rows)
    sys.exit(grown)


def searches(files: list[Path], budget: float) -> Iterator[bool]:
    """Solve one scene after the other, with changing obstacles."""
    rng = np.random.default_rng(0)
    while True:
        for file in files:
            data = json.loads(comove.Scene.load(file).file.model_dump_json(exclude_none=True))
            for obstacle in data.get("obstacles", []):
                obstacle["center"] = [x + float(rng.uniform(-SHIFT, SHIFT)) for x in obstacle["center"]]
            try:
                scene = comove.Scene.from_dict(data, folder=file.parent)
            except comove.SceneError:  # an obstacle is where the payload starts
                continue
            yield comove.solve(scene, budget=budget, seed=int(rng.integers(1000))).verified


def steps() -> Iterator[None]:
    """Step endlessly before a goal that an obstacle keeps crossing."""
    hands = [{"name": n, "start": [0.1, y], "goal": [0.9, y]} for n, y in (("left", 0.6), ("right", 0.4))]
    scene = comove.Scene.from_dict(
        {
            "name": "crossed",
            "duration": 4.0,
            "workspace": {"lower": [0, 0], "upper": [1, 1]},
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": hands,
            "limits": {"speed": 0.5, "acceleration": 2.0},
            "obstacles": [
                {
                    "shape": "circle",
                    "center": [0.9, 0.1],
                    "radius": 0.05,
                    "motion": {"circle": {"radius": 0.2, "period_s": 4.0}},
                }
            ],
        }
    )
    loop = comove.Executor(scene, Functions.of_motions(scene))
    while True:
        loop.step()
        yield


if __name__ == "__main__":
    on_one_thread()
    main()

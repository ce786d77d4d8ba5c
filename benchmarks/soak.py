"""A million control steps: does anything break, leak or drift?

    python benchmarks/soak.py                   # 10^6 steps, about ten minutes
    python benchmarks/soak.py --steps 100000

A bar waits in the open for a goal that an obstacle never leaves, while others go round and come by, seen but not
known. Every thousand steps what happened is judged as any execution is, and memory and time are taken.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np

from comove.execution import Executor, Functions
from comove.planning import SceneKind, load_kernels
from comove.scenes import Scene
from comove.verification.record import Record, verify_execution

WINDOW = 1000


def endless(n_dims: int) -> Scene:
    """Four obstacles go round; one of them comes to stand on the goal."""
    up = [0.5][: n_dims - 2]
    around = [([0.62, 0.5], 0.12, 7.0), ([0.85, 0.5], 0.35, 11.0), ([0.3, 0.2], 0.1, 5.0)]
    obstacles = [
        {
            "shape": "sphere",
            "radius": 0.05,
            "center": center + up,
            "motion": {"circle": {"radius": r, "period_s": p}},
        }
        for center, r, p in around
    ]
    way = {"waypoints": [[0.9, 0.1, *up], [0.88, 0.5, *up]], "times": [0.0, 2.0]}
    obstacles.append({"shape": "sphere", "radius": 0.08, "center": [0.9, 0.1, *up], "motion": way})
    hands = [
        {"name": n, "start": [0.15, y, *up], "goal": [0.85, y, *up]}
        for n, y in (("left", 0.4), ("right", 0.6))
    ]
    return Scene.from_dict(
        {
            "name": "endless",
            "duration": 5.0,
            "workspace": {"lower": [0] * n_dims, "upper": [1] * n_dims},
            "obstacles": obstacles,
            "load": {"shape": "bar", "length": 0.2},
            "manipulators": hands,
            "limits": {"speed": 0.5, "acceleration": 2.0},
        }
    )


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--dimensions", type=int, choices=(2, 3), default=2)
    options = parser.parse_args()
    scene = endless(options.dimensions)
    load_kernels(SceneKind(options.dimensions, moving=True))
    executor = Executor(scene, Functions.of_motions(scene))
    error, clearance, memory, control, begun = 0.0, np.inf, [], [], time.perf_counter()
    for k in range(options.steps // WINDOW):
        first, poses = executor.time, [executor.poses]
        for _ in range(WINDOW):
            executor.step()
            poses.append(executor.poses)
        instants = first + np.arange(WINDOW + 1) * executor.pace.period
        record = Record(
            scene,
            instants,
            np.array([p.center for p in poses]),
            np.array([p.quaternion for p in poses]),
            scene.obstacles[:, 1:4] + scene.offsets(instants),
            scene.obstacle_sagittas(instants),
        )
        report = verify_execution(record)
        error, clearance = max(error, report.distance_error_max), min(clearance, report.clearance_min)
        control.append(np.median(executor.log.control[-WINDOW:]))
        memory.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        if (k + 1) % max(1, options.steps // WINDOW // 10) == 0:
            print(
                f"{(k + 1) * WINDOW:>9} steps, {time.perf_counter() - begun:.0f} s: distance error {error:.1e} m, "
                f"clearance {1e3 * clearance:.2f} mm, step {1e3 * control[-1]:.3f} ms, memory {memory[-1]:.0f} MB",
                flush=True,
            )
    print(
        f"\nleast clearance {1e3 * clearance:.2f} mm, distance error at most {error:.1e} m, control step "
        f"{1e3 * control[0]:.3f} -> {1e3 * control[-1]:.3f} ms, memory {memory[0]:.0f} -> {memory[-1]:.0f} MB"
    )


if __name__ == "__main__":
    main()

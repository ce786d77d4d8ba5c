"""Processor time of one cloud of points by step.

The steps are thinning, tracking, covering, and querying the spheres.

    python benchmarks/clouds.py
    python benchmarks/clouds.py --points 100000

Ten balls or discs move through the workspace.
"""

from __future__ import annotations

import argparse
import time

import numpy as np
from timing import print_table

from comove.control import Clouds, Scanner
from comove.control.safety.twists import nodes_of, poses_of
from comove.lab.examples import scene_contents
from comove.model import Scene

N_BODIES, PERIOD = 10, 0.05  # s


def empty_scene(n_dims: int) -> Scene:
    """Return a bar in an empty square or cube."""
    ends = [np.array([[x, y, 0.5][:n_dims] for y in (0.4, 0.6)]) for x in (0.05, 0.95)]
    return Scene.from_dict(scene_contents("empty", [1.0] * n_dims, [], {"shape": "bar", "length": 0.2}, ends))


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=10_000)
    parser.add_argument("--clouds", type=int, default=40)
    options = parser.parse_args()
    rows = []
    for n_dims in (2, 3):
        scene, rng = empty_scene(n_dims), np.random.default_rng(0)
        observer = Clouds(scene, Scanner())
        nodes = nodes_of(scene, poses_of(scene, "start"))
        way = rng.standard_normal((N_BODIES, options.points // N_BODIES, n_dims))
        body = 0.06 * way / np.linalg.norm(way, axis=2, keepdims=True)
        center, velocity = (
            rng.uniform(0.2, 0.8, (N_BODIES, 1, n_dims)),
            rng.uniform(-0.1, 0.1, (N_BODIES, 1, n_dims)),
        )
        taken, asked = [], []
        for k in range(options.clouds):
            now = k * PERIOD
            points = (center + now * velocity + body).reshape(-1, n_dims)
            points = points + 0.002 * rng.standard_normal(points.shape)
            observer.carried(now, nodes)
            begun = time.thread_time()
            observer.update(points, now)
            taken.append(1e3 * (time.thread_time() - begun))
            begun = time.thread_time()
            seen = observer.observe(now + 0.01)
            asked.append(1e3 * (time.thread_time() - begun))
        taken, asked = taken[3:], asked[3:]
        times = f"{np.median(taken):.1f}", f"{np.quantile(taken, 0.9):.1f}", f"{np.median(asked):.2f}"
        rows.append([n_dims, options.points, len(seen.margin), *times])
    head = [
        "dimensions",
        "points",
        "spheres",
        "cloud, median [ms]",
        "90 % within [ms]",
        "spheres asked for [ms]",
    ]
    print_table(head, rows)


if __name__ == "__main__":
    main()

"""A bar among 150 thin walls: times beside OMPL's RRT-Connect.

    pip install 'comove[bench]'; python benchmarks/walls.py [--scenes 10] [--seed 1]

Walls are randomly rotated, 2 cm thick and up to 0.4 m wide, in a cube of 3 m (in the plane, sixty of them in a
square). comove's default is timed to its first verified motion, to the first whose objective is within 1 % of the
last one's, and in all; OMPL until its path, given a time law from rest to rest, is offered, which is then verified.
Medians, and the most [s].
"""

from __future__ import annotations

import argparse
import time
import warnings

import numpy as np
from timing import Watch, on_one_thread, print_table

import comove
from comove.errors import InputError
from comove.lab.registry import PEERS
from comove.lab.systems import SystemProblem, measured

SIDE, THICK, WIDTH = 3.0, 0.02, (0.05, 0.4)  # m
COUNTS = {2: 60, 3: 150}
BUDGET = 30.0  # s


def main() -> None:
    """Sample, solve and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=10)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    rows = []
    for n_dims in COUNTS:
        scenes = [drawn(n_dims, np.random.default_rng([asked.seed, n_dims, i])) for i in range(asked.scenes)]
        comove.solve(scenes[0])  # compiles
        own, peer = zip(*map(timed, scenes), strict=True)
        where = f"{COUNTS[n_dims]} walls, " + ("plane" if n_dims == 2 else "space")
        for name, figures in (("comove", own), ("OMPL RRT-Connect", peer)):
            verified, *times = np.array(figures).T
            told = [f"{np.median(t):.2f}, {t.max():.2f}" if np.isfinite(t).all() else "-" for t in times]
            rows.append([where, name, f"{int(verified.sum())} of {len(verified)}", *told])
    print_table(("scenes", "system", "verified", "first s", "converged s", "all s"), rows)


def timed(scene: comove.Scene) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return success and seconds of comove and of OMPL."""
    watch, begun = Watch(), time.perf_counter()
    solution = comove.solve(scene, budget=BUDGET, progress=watch)
    whole = time.perf_counter() - begun
    first = solution.effort.first_verified
    own = solution.verified, np.inf if first is None else first, watch.converged(), whole
    found = measured(PEERS["ompl-rrtconnect-raw"], SystemProblem(scene, budget=BUDGET))
    if found is None:
        return own, (False, np.inf, np.inf, BUDGET)
    return own, (found.verified, found.seconds, found.seconds, found.seconds)


def drawn(n_dims: int, rng: np.random.Generator) -> comove.Scene:
    """Sample a scene with a bar of 0.3 m across corners."""
    start, goal, half = np.full(n_dims, -0.15), np.full(n_dims, SIDE + 0.15), np.zeros(n_dims)
    half[0] = 0.15
    while True:
        walls = []
        for _ in range(COUNTS[n_dims]):
            size = rng.uniform(*WIDTH, n_dims)
            size[rng.integers(n_dims)] = THICK
            wall = {"shape": "box", "center": rng.uniform(0.0, SIDE, n_dims).tolist(), "size": size.tolist()}
            if n_dims == 2:
                wall["rotation_deg"] = float(rng.uniform(0.0, 180.0))
            else:
                turn = rng.normal(size=4)
                wall["quaternion_wxyz"] = (turn / np.linalg.norm(turn)).tolist()
            walls.append(wall)
        hands = [
            {"name": name, "start": (start + side * half).tolist(), "goal": (goal + side * half).tolist()}
            for name, side in (("left", -1.0), ("right", 1.0))
        ]
        data = {
            "name": "walls",
            "duration": 20.0,
            "workspace": {"lower": [-0.4] * n_dims, "upper": [SIDE + 0.4] * n_dims},
            "obstacles": walls,
            "load": {"shape": "bar", "length": 0.3, "radius": 0.01},
            "manipulators": hands,
        }
        try:
            return comove.Scene.from_dict(data)
        except InputError:
            continue  # a wall at an end


if __name__ == "__main__":
    main()

"""Cost and benefit of effort levels: verified scenes, time and jerk.

    python benchmarks/effort.py SCENES [SCENES ...] [--seed 0] [--budget 30]

SCENES are folders of `comove bench draw`, or scene files. Times are processor times of `comove.solve`. Jerk is that
of all end effectors, squared: the geometric mean of its ratios to "normal" on scenes that both verify.
"""

from __future__ import annotations

import argparse
import time
import warnings
from pathlib import Path

import numpy as np
from timing import print_table

import comove
from comove.lab.bench.sets import own_scenes
from comove.planning import LeastJerk
from comove.planning.convex.costs import jerk_cost
from comove.planning.effort import EFFORTS


def main() -> None:
    """Solve every scene with every effort and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scenes", type=Path, nargs="+")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--budget", type=float, default=30.0)
    asked = parser.parse_args()
    warnings.simplefilter("ignore")
    rows = []
    for place in asked.scenes:
        scenes = [one.load() for one in own_scenes([place])]
        comove.solve(scenes[0], seed=asked.seed, budget=asked.budget)
        tried = {
            effort: [outcome(scene, effort, asked.seed, asked.budget) for scene in scenes]
            for effort in EFFORTS
        }
        for effort, outcomes in tried.items():
            verified, jerk, seconds = np.array(outcomes).T
            both = (verified > 0) & (np.array(tried["normal"])[:, 0] > 0)
            ratio = (
                np.exp(np.log(jerk[both] / np.array(tried["normal"])[both, 1]).mean())
                if both.any()
                else np.nan
            )
            found = f"{int(verified.sum())}/{len(scenes)}"
            times = f"{1e3 * np.median(seconds):.0f}", f"{seconds.sum():.1f}"
            rows.append([place.name, effort, found, *times, f"{ratio:.3f}"])
    print_table(["scenes", "effort", "verified", "median [ms]", "all [s]", "jerk to normal"], rows)


def outcome(scene: comove.Scene, effort: str, seed: int, budget: float) -> tuple[bool, float, float]:
    """Return success, jerk and processor time [s] of a scene."""
    begun = time.process_time()
    solution = comove.solve(scene, seed=seed, budget=budget, effort=effort)
    return solution.verified, jerk_cost(solution.attempt, LeastJerk(), None), time.process_time() - begun


if __name__ == "__main__":
    main()

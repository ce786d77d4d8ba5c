"""Success, time and quality of comove by set of scenes.

Sets (`--sets`, all unless given): random planar scenes, bars and triangles in space (`random_scenes.py`), and the
example scenes under many seeds of the solver. A name that ends in ``-no-planner`` turns the planner off, one in
``-paper`` uses the paper's method. For random sets `--first-seed` chooses the scenes (the
solver's own seed is 0); for examples it is the first seed of the solver.

Columns: motions verified; time to the first verified motion (from scene in memory and kernels loaded) and
total time of `solve`; evaluations; the cost J; then the worst of the verified motions: certified clearance, and at
100 Hz samples the error of any distance constraint, the miss of an end, and the speed at the end.
Unverified runs count as infinite in the times to the first motion.

To repeat: ``pip install comove``, ``python benchmarks/suite.py [--sets planar wide] [--count 20] [--json FILE]``.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.resources import files
from math import inf
from pathlib import Path
from statistics import median

import numpy as np
from random_scenes import planar_scene, spatial_bar_scene, spatial_triangle_scene
from timing import number, on_one_thread, print_table, quantile

import comove
from comove.lab.evolution import Paper
from comove.model import recording_of

Problem = tuple[comove.Scene, int]
Row = dict[str, str | int | float | None]

NO_PLANNER, PAPER = "-no-planner", "-paper"
HEADER = {
    "set": "set",
    "verified": "verified",
    "first_median_s": "first [ms]",
    "first_p90_s": "p90",
    "first_max_s": "max",
    "total_median_s": "total [ms]",
    "total_max_s": "max",
    "evaluations_median": "evaluations",
    "evaluations_max": "max",
    "cost_median": "J median",
    "clearance_min": "clearance [mm]",
    "distance_error_max": "distance error [m]",
    "end_error_max": "end error [m]",
    "end_speed_max": "end speed [m/s]",
}


@dataclass(frozen=True)
class SceneSet:
    """Scenes of one row.

    Attributes
    ----------
    count : default number of problems
    problem : function that returns the scene and the solver's seed of an index
    """

    count: int
    problem: Callable[[int], Problem]


def drawn(draw: Callable[[int], comove.Scene], count: int) -> SceneSet:
    """Return random scenes, each solved once."""
    return SceneSet(count, lambda index: (draw(index), 0))


def example(name: str) -> SceneSet:
    """Return one example scene, solved with many seeds."""
    return SceneSet(
        20, lambda index: (comove.Scene.load(str(files("comove") / "examples" / f"{name}.yaml")), index)
    )


SETS = {
    "planar": drawn(planar_scene, 100),
    "planar-no-planner": drawn(planar_scene, 100),
    "central": drawn(partial(planar_scene, central=True), 100),
    "central-no-planner": drawn(partial(planar_scene, central=True), 100),
    "bars": drawn(spatial_bar_scene, 50),
    "triangles": drawn(spatial_triangle_scene, 20),
    "wide": example("wide"),
    "narrow": example("narrow"),
    "complex": example("complex"),
    "wide-no-planner": example("wide"),
    "narrow-no-planner": example("narrow"),
    "complex-no-planner": example("complex"),
    "wide-paper": example("wide"),
    "narrow-paper": example("narrow"),
    "complex-paper": example("complex"),
    "window": example("window"),
    "triangle": example("triangle"),
}


def solutions(name: str, count: int | None, first: int, budget: float) -> Iterator[comove.Solution]:
    """Solve a set's scenes one after the other, as `comove solve`."""
    chosen = SETS[name]
    for index in range(first, first + (count or chosen.count)):
        scene, seed = chosen.problem(index)
        taught = recording_of(scene)
        yield comove.solve(
            scene,
            demonstration=None if taught is None else comove.DMP.fit(taught),
            seed=seed,
            planner=not name.endswith(NO_PLANNER),
            method=Paper() if name.endswith(PAPER) else None,
            budget=budget,
        )


def errors_at_samples(solution: comove.Solution) -> tuple[float, float, float]:
    """Return errors computed from the samples alone. They are the largest distance error [m], end error [m], and
    final speed [m/s]."""
    scene, samples = solution.scene, solution.trajectory
    apart = [
        np.linalg.norm(samples.position[:, c.first] - samples.position[:, c.second], axis=1) - c.distance
        for c in scene.distances
    ]
    ends = samples.position[[0, -1]] - np.stack([scene.start, scene.goal])
    speed = np.linalg.norm(samples.velocity[-1], axis=-1)
    distance_error = np.abs(apart).max() if apart else 0.0
    return float(distance_error), float(np.linalg.norm(ends, axis=-1).max()), float(speed.max())


def row(name: str, solved: list[comove.Solution]) -> Row:
    """Return the figures of one set, in SI units. They are None where there is none (nothing verified, or
    infinite)."""
    good = [solution for solution in solved if solution.verified]
    first = [solution.effort.first_verified if solution.verified else inf for solution in solved]
    total = [solution.effort.seconds for solution in solved]
    result: Row = {
        "set": name,
        "n": len(solved),
        "n_verified": len(good),
        "unverified": ", ".join(f"{s.scene.name} (seed {s.seed})" for s in solved if not s.verified),
        "first_median_s": median(first),
        "first_p90_s": quantile(first, 0.9),
        "first_max_s": max(first),
        "total_median_s": median(total),
        "total_max_s": max(total),
        "evaluations_median": median(solution.effort.evaluations for solution in solved),
        "evaluations_max": max(solution.effort.evaluations for solution in solved),
    }
    if good:
        distance_errors, end_errors, end_speeds = zip(*map(errors_at_samples, good), strict=True)
        result |= {
            "cost_median": median(solution.cost.total for solution in good),
            "clearance_min": min(solution.report.clearance_min for solution in good),
            "distance_error_max": max(distance_errors),
            "end_error_max": max(end_errors),
            "end_speed_max": max(end_speeds),
        }
    return {key: None if value == inf else value for key, value in result.items()}


def cell(key: str, row: Row) -> str:
    """Return one figure as in the table."""
    if key == "set":
        return str(row["set"])
    if key == "verified":
        return f"{row['n_verified']}/{row['n']}"
    value = row.get(key)
    if value is None:
        return "-"
    return number(float(value) * (1e3 if key.endswith("_s") or key == "clearance_min" else 1.0))


def main() -> None:
    """Measure and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument(
        "--sets", nargs="+", choices=SETS, default=list(SETS), metavar="SET", help=", ".join(SETS)
    )
    parser.add_argument("--count", type=int, help="scenes or seeds a set")
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--budget", type=float, default=30.0, help="seconds a scene")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows, in SI units, too")
    options = parser.parse_args()

    rows = [
        row(name, list(solutions(name, options.count, options.first_seed, options.budget)))
        for name in options.sets
    ]
    print_table(list(HEADER.values()), [[cell(key, r) for key in HEADER] for r in rows])
    if options.json:
        options.json.write_text(json.dumps(rows, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    on_one_thread()
    main()

"""Closeness of motions to demonstrations: 30 LASA shapes, two end effectors.

    python benchmarks/following.py [--shapes 30] [--seed 72]

Scenes: narrow, wide, and five easy planar samples with this seed. Rows: least jerk with its default resemblance, and
the paper's cost with a resemblance of 10. Columns, medians over shapes and scenes: verified; mean distance of end
effectors from the demonstration over the path from start to goal; mean angle between their velocity and the
demonstration's (where both move); the largest jerk more than 5 cm away from everything, over the demonstration's
own; acceleration over that of the straight motion of least jerk; seconds.
"""

from __future__ import annotations

import argparse
import warnings

import numpy as np
from timing import on_one_thread, print_table

import comove
from comove import LeastJerk, PaperCost
from comove.dmp.demonstrations import lasa_names
from comove.geometry.distances import configuration_distance
from comove.lab.bench.sets import SETS
from comove.lab.examples import example_path
from comove.planning import carried_demonstration
from comove.planning.resemblance import followed

N_STEPS = 401
FREE = 0.05  # m from everything
STRAIGHT = 10 / np.sqrt(3)  # peak acceleration of minimum jerk over one metre in one second [m/s^2]
TRIED = {"least jerk": LeastJerk(), "paper, resemblance 10": PaperCost(resemblance=10.0)}
HEADER = (
    "scenes",
    "objective",
    "verified",
    "off / way",
    "direction",
    "jerk, free",
    "95 %",
    "acceleration",
    "s",
)


def main() -> None:
    """Solve and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--shapes", type=int, default=30)
    parser.add_argument("--seed", type=int, default=72)
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    scenes = {name: [comove.Scene.load(example_path(name))] for name in ("narrow", "wide")}
    drawn = [SETS["easy"].draw(2 * i, asked.seed)[0] for i in range(5)]
    scenes["easy"] = [comove.Scene.from_dict(data) for data in drawn]
    primitives = [
        comove.DMP.fit(comove.Demonstration.from_lasa(name)) for name in lasa_names()[: asked.shapes]
    ]
    rows = []
    for words, group in scenes.items():
        for name, objective in TRIED.items():
            figures = np.array([measured(scene, dmp, objective) for scene in group for dmp in primitives])
            passed = figures[:, 0] > 0
            off, angle, jerk, acceleration, spent = np.nanmedian(figures[passed, 1:], axis=0)
            rows.append(
                [
                    words,
                    name,
                    f"{int(passed.sum())} of {len(passed)}",
                    f"{100 * off:.1f} %",
                    f"{angle:.0f} deg",
                    f"{jerk:.2f}",
                    f"{np.nanquantile(figures[passed, 3], 0.95):.2f}",
                    f"{acceleration:.1f}",
                    f"{spent:.2f}",
                ]
            )
            print_table(HEADER, rows[-1:])
    print()
    print_table(HEADER, rows)


def measured(scene: comove.Scene, dmp: comove.DMP, objective: LeastJerk | PaperCost) -> tuple[float, ...]:
    """Return the figures of a solution. They are verified, distance over the path, angle [deg], jerk ratio in free
    parts, acceleration ratio, and seconds."""
    solution = comove.solve(scene, demonstration=dmp, objective=objective, budget=20.0)
    motion, s = solution.attempt, np.linspace(0.0, 1.0, N_STEPS)
    _, _, acceleration = motion.hands(s)
    carried = carried_demonstration(dmp, scene)
    near, taught = followed(motion, carried), resampled(carried[..., : scene.n_dims])
    way = np.linalg.norm(scene.goal - scene.start, axis=1).max()
    free = (
        np.array([clearance_of(scene, nodes) for nodes in motion.coordinates.motion(motion.at(s))[0]]) > FREE
    )
    jerk = np.linalg.norm(np.gradient(acceleration, s, axis=0), axis=2).max(axis=1)
    own = np.linalg.norm(third(taught, s), axis=2).max()
    return (
        float(solution.verified),
        float(near.distance / way),
        float(np.degrees(near.direction)),
        float(jerk[free].max() / own) if free.any() else np.nan,
        float(np.linalg.norm(acceleration, axis=2).max() / (STRAIGHT * way)),
        solution.effort.seconds,
    )


def resampled(taught: np.ndarray) -> np.ndarray:
    """Return a demonstration at the even times of motions."""
    from scipy.interpolate import CubicSpline

    return CubicSpline(np.linspace(0, 1, len(taught)), taught)(np.linspace(0, 1, N_STEPS))


def third(taught: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return third derivatives, without the ends, where demonstrations may move."""
    jerk = np.gradient(np.gradient(np.gradient(taught, s, axis=0), s, axis=0), s, axis=0)
    return jerk[4:-4]


def clearance_of(scene: comove.Scene, nodes: np.ndarray) -> float:
    """Return the clearance of one configuration of a bar [m]."""
    body = scene.body
    return configuration_distance(nodes, body.edges, body.radii, scene.obstacles, *scene.workspace)[0]


if __name__ == "__main__":
    main()

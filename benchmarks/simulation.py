"""Verified motions in MuJoCo: Baxter's stick by grasp and perturbation.

    python benchmarks/simulation.py [--perturbed 20]

`examples/baxter/gap_30.yaml` is solved once (seed 0). Rows: each grasp as planned, at twice the pace (the same path
in half the time, unverified), and perturbed by seeds 0 to N - 1, of which the worst is shown: friction, mass, gains,
the payload's place in the end effectors, and a push. Columns: distance of the payload from its goal, lag behind its
plan, slip in an end effector, error of the end effectors' distance, internal force, and delivery.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from timing import number, on_one_thread, print_table

from comove import solve
from comove.model import Scene, demonstration_of
from comove.planning import SceneKind, load_kernels
from comove.robots import JointMotion, Robot
from comove.sim import GRASPS, Execution, Perturbation, simulate

SCENE = Path(__file__).parents[1] / "examples" / "baxter" / "gap_30.yaml"
SHOWN = {
    "end_error": ("end error [mm]", 1e3),
    "lag_max": ("lag [mm]", 1e3),
    "distance_error_max": ("distance error [mm]", 1e3),
    "slip_max": ("slip [mm]", 1e3),
    "internal_force_max": ("internal force [N]", 1.0),
}


def main() -> None:
    """Solve, simulate and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--perturbed", type=int, default=20, help="Perturbations of every grasp.")
    count = parser.parse_args().perturbed
    on_one_thread()
    scene, robot = Scene.load(SCENE), Robot.load("baxter")
    load_kernels(SceneKind.of(scene))
    found = solve(scene, robot=robot, demonstration=demonstration_of(scene))
    if not found.verified:
        raise SystemExit(f"{SCENE.name} was not solved: {'; '.join(found.reasons)}")
    rows = []
    for name, kind in GRASPS.items():
        grasp = kind()
        planned = simulate(found.joints.attempt, scene, robot, grasp)
        hurried = simulate(at_pace(found.joints.attempt, 2.0), scene, robot, grasp)
        drawn = [
            Perturbation.drawn(np.random.default_rng(seed), len(robot.joint_names)) for seed in range(count)
        ]
        perturbed = [simulate(found.joints.attempt, scene, robot, grasp, one) for one in drawn]
        rows.append([name, "as planned", *worst([planned]), number(planned.steps_per_second, 3)])
        rows.append([name, "at twice the pace", *worst([hurried]), ""])
        rows.append([name, f"perturbed, worst of {count}", *worst(perturbed), ""])
    print_table(["grasp", "", *(title for title, _ in SHOWN.values()), "delivered", "steps/s"], rows)


def at_pace(motion: JointMotion, pace: float) -> JointMotion:
    """Return the same joints, `pace` times as fast."""
    return JointMotion(motion.time / pace, motion.joint_names, motion.position)


def worst(executions: Sequence[Execution]) -> list[str]:
    """Return the largest of every measure, and the delivered count."""
    told = [
        number(factor * max(e.measures[key] for e in executions), 2) for key, (_, factor) in SHOWN.items()
    ]
    return [*told, f"{sum(e.delivered for e in executions)} of {len(executions)}"]


if __name__ == "__main__":
    main()

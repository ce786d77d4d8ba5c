"""Robots carry the load: every example solved with several seeds, approached from home and left, played in MuJoCo.

    python benchmarks/robots.py                          # all of it
    python benchmarks/robots.py --seeds 3 --only solve   # less of it
    python benchmarks/robots.py --seeds 5 --seed 410 --scenes g1 pr2
    python benchmarks/robots.py --only solve --open      # each as fast as its arms can

Times are from the scene's file to the first and to the last verified joint motion, in seconds on the wall and of the
processor, which other work on the machine hardly changes; imports, compiling and the robot itself are apart.
Distances of the hands are computed by Pinocchio from the joints alone.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from pathlib import Path

import numpy as np
from timing import print_head, print_row

from comove import solve
from comove.errors import RobotError, SceneError
from comove.model import Scene, demonstration_of
from comove.model.motion import CoordinatedMotion
from comove.planning import SceneKind
from comove.planning.solution import Progress
from comove.robots import Robot, RobotCarrier, VerifiedJointMotion, plan_transfers
from comove.robots.kernels import load_robot_kernels
from comove.sim import Friction, Perturbation, Weld, simulate

EXAMPLES = Path(__file__).parents[1] / "examples"
SCENES = sorted([*EXAMPLES.glob("baxter/*.yaml"), *EXAMPLES.glob("robots/*.yaml")])
PERTURBED = ("gap_30", "gap_20")
N_PERTURBED = 20


@lru_cache
def robot_of(path: Path) -> Robot:
    """The robot of a scene, ready: its meshes are read, its links are known, and its kernels are compiled."""
    scene = Scene.load(path)
    robot = Robot.load(scene.file.robot)
    load_robot_kernels(SceneKind.of(scene))
    for choice in scene.alternatives:
        with suppress(SceneError):  # another grasp may do
            RobotCarrier(robot, choice).require_reach()
    return robot


def solved(path: Path, seed: int, timed: bool = True) -> tuple[VerifiedJointMotion | None, dict[str, float]]:
    """One run from the file, in the duration that it gives or in an open one, and what was measured."""
    robot = robot_of(path)
    begun, used, first = time.perf_counter(), time.process_time(), [np.nan, np.nan]

    def told(progress: Progress) -> None:
        if np.isnan(first[0]) and progress.best is not None:
            first[:] = time.perf_counter() - begun, time.process_time() - used

    scene, heard = Scene.load(path), list[VerifiedJointMotion]()
    wanted = {"demonstration": demonstration_of(scene), "seed": seed, "progress": told, "found": heard.append}
    found = solve(scene if timed else scene.timed(None), robot=robot, **wanted)
    seconds, processor = time.perf_counter() - begun, time.process_time() - used
    joints, report = found.joints.attempt, found.joints.report
    return found.joints.motion, {
        "seconds": seconds,
        "processor": processor,
        "first": first[0],
        "first processor": first[1],
        "first lasts": heard[0].joints.duration if heard else np.nan,
        "lasts": joints.duration,
        "J": found.cost.total,
        "taught": np.nan if found.followed is None else found.followed.distance,
        "distance": distance_error(robot, scene, joints.position),
        "margin": report.joint_margin_min,
        "speed": report.velocity_ratio_max,
        "torque": report.torque_ratio_max,
        "links": min(report.clearance_scene, report.clearance_load, report.clearance_self),
        "load": found.report.clearance_min,
    }


def distance_error(robot: Robot, scene: Scene, joints: np.ndarray) -> float:
    """Largest departure of the hands' distances from what they are at the start, at all samples [m]."""
    arms = [robot.arm(name) for name in scene.manipulators]
    hands = np.array([[robot.tool_pose(q, arm)[:3, 3] for arm in arms] for q in joints])
    apart = np.linalg.norm(hands[:, :1] - hands[:, 1:], axis=-1)
    planned = np.linalg.norm(scene.start[:1] - scene.start[1:], axis=-1)
    return float(np.abs(apart - planned).max())


def table_of_solves(
    scenes: list[Path], seeds: range, timed: bool
) -> Iterator[tuple[Path, VerifiedJointMotion]]:
    """Print a row a scene; gives the motion of the first seed."""
    print_head(
        [
            *("scene", "verified", "first [s]", "of the processor", "all [s]", "of the processor"),
            *("the first lasts [s]", "the last [s]", "J", "from what was taught [m]", "distance error [m]"),
            *("margin [rad]", "speed", "torque", "links [mm]", "load [mm]"),
        ]
    )
    times = []
    for path in scenes:
        runs = [solved(path, seed, timed) for seed in seeds]
        measures = {key: np.array([m[key] for _, m in runs]) for key in runs[0][1]}
        times.append(measures["seconds"])
        times_of = "first", "first processor", "seconds", "processor", "first lasts", "lasts"
        print_row(
            [
                *(path.stem, f"{sum(v is not None for v, _ in runs)}/{len(seeds)}"),
                *(f"{np.nanmedian(measures[name]):.2f}" for name in times_of),
                *(f"{np.median(measures[name]):.3f}" for name in ("J", "taught")),
                *(f"{measures['distance'].max():.1e}", f"{measures['margin'].min():.3f}"),
                *(f"{measures[name].max():.2f}" for name in ("speed", "torque")),
                *(f"{1e3 * measures[name].min():.1f}" for name in ("links", "load")),
            ]
        )
        if (motion := next((v for v, _ in runs if v is not None), None)) is not None:
            yield path, motion
    print(f"\nmedian of all: {np.median(np.concatenate(times)):.2f} s\n")


def row(name: str, execution) -> None:
    """Print what a simulation measured."""
    m = execution.measures
    slip = "-" if m["slip_max"] is None else f"{1e3 * m['slip_max']:.2f}"
    print_row(
        [
            *(name, "yes" if execution.delivered else "no", f"{1e3 * m['end_error']:.2f}"),
            *(f"{1e3 * m['distance_error_max']:.3f}", slip, f"{m['internal_force_max']:.1f}"),
            *(f"{1e3 * m['lag_max']:.2f}", len(execution.contacts), f"{execution.steps_per_second:.0f}"),
        ]
    )


def table_of_simulations(motions: list[tuple[Path, VerifiedJointMotion]]) -> None:
    """Print a row a simulation."""
    print_head(
        [
            *("simulation", "delivered", "end [mm]", "distance [mm]", "slip [mm]"),
            *("inner force [N]", "lag [mm]", "contacts", "steps/s"),
        ]
    )
    for path, motion in motions:
        row(f"{path.stem}, weld", simulate(motion.joints, motion.scene, motion.robot, Weld()))
        if path.parent.name == "baxter":
            row(f"{path.stem}, friction", simulate(motion.joints, motion.scene, motion.robot, Friction()))
    for path, motion in motions:
        if path.stem not in PERTURBED:
            continue
        for grasp in (Weld(), Friction()):
            runs = []
            for seed in range(N_PERTURBED):
                drawn = Perturbation.drawn(np.random.default_rng(seed), len(motion.robot.joint_names))
                runs.append(simulate(motion.joints, motion.scene, motion.robot, grasp, drawn))
            name = f"{path.stem}, {type(grasp).__name__.lower()}, perturbed, worst of {N_PERTURBED}"
            worst = {
                key: max(run.measures[key] or 0.0 for run in runs)
                for key in ("end_error", "distance_error_max", "slip_max", "internal_force_max", "lag_max")
            }
            print_row(
                [
                    *(name, f"{sum(run.delivered for run in runs)}/{N_PERTURBED}"),
                    *(f"{1e3 * worst['end_error']:.2f}", f"{1e3 * worst['distance_error_max']:.3f}"),
                    *(f"{1e3 * worst['slip_max']:.2f}", f"{worst['internal_force_max']:.1f}"),
                    *(f"{1e3 * worst['lag_max']:.2f}", sum(len(run.contacts) for run in runs), ""),
                ]
            )
        joints, _ = RobotCarrier(motion.robot, motion.scene).track(CoordinatedMotion.straight(motion.scene))
        for grasp in (Weld(), Friction()):
            name = f"{path.stem}, {type(grasp).__name__.lower()}, straight line"
            row(name, simulate(joints, motion.scene, motion.robot, grasp))


def table_of_transfers(motions: list[tuple[Path, VerifiedJointMotion]]) -> None:
    """Print a row a scene: whether a way from home to the grasp, and one home, was found and passed verification."""
    ways_last = "approach lasts [s]", "release lasts [s]"
    print_head(["from home and back", "found", "of the processor [s]", *ways_last, "why not"])
    for path, motion in motions:
        begun, found, lasts, why = time.process_time(), "yes", (np.nan, np.nan), ""
        try:
            ways = plan_transfers(motion)
            lasts = ways.approach.duration, ways.release.duration
        except RobotError as error:
            found, why = "no", str(error)
        used = time.process_time() - begun
        print_row([path.stem, found, f"{used:.2f}", *(f"{x:.1f}" for x in lasts), why])
    print()


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--scenes", nargs="+", help="names of scenes; all of them unless given")
    parser.add_argument("--only", choices=("solve", "transfers", "simulate"))
    parser.add_argument("--open", action="store_true", help="leave out the durations that scenes give")
    options = parser.parse_args()
    warnings.simplefilter("ignore")
    scenes = [path for path in SCENES if options.scenes is None or path.stem in options.scenes]
    for path in scenes:
        robot_of(path)
    count = options.seeds if options.only in (None, "solve") else 1
    motions = list(table_of_solves(scenes, range(options.seed, options.seed + count), not options.open))
    if options.only in (None, "transfers"):
        table_of_transfers(motions)
    if options.only in (None, "simulate"):
        table_of_simulations(motions)


if __name__ == "__main__":
    main()

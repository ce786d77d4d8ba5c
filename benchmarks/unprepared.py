"""From URDFs that nobody prepared to a load that MuJoCo delivers: how long it takes, and what goes wrong.

    python benchmarks/unprepared.py
    python benchmarks/unprepared.py --seed 3 --robots talos kinova

Each is done as a newcomer would: `comove robot new` proposes a description, which is taken as it is; a bar is put
between the hands, as far apart as they are at home, and a scene is drawn about that place as those of `comove bench
draw robots-easy` are, with one or two obstacles, which stand beside the way; hands are turned on the bar by the
quarters with which they reach most. `carry` solves it, and MuJoCo plays the joints, perturbed, hands welded to the
bar. All models are those of example-robot-data, which `comove[robot]` installs; none of them comes with comove as a
robot. `--more URDF...` adds models of one's own, each a robot with two arms.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
import warnings
from contextlib import suppress
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
from timing import on_one_thread

from comove.errors import ComoveError, SceneError
from comove.experiments.bench.robot_drawing import RobotDraft, drawn
from comove.experiments.bench.workplaces import ROBOT_DIFFICULTIES, Workplace
from comove.experiments.carried import executed
from comove.planning import SceneKind
from comove.robots import Robot, RobotCarrier, carry
from comove.robots.kernels import load_robot_kernels
from comove.scenes import Scene
from comove.simulators import Weld

ROBOTS = {
    "two_ur3": ["package://ur_description/urdf/ur3_joint_limited_robot.urdf"] * 2,
    "two_kinova": ["package://kinova_description/robots/kinova.urdf"] * 2,
    "two_z1": ["package://z1_description/urdf/z1.urdf"] * 2,
    "two_so100": ["package://so_arm_description/urdf/so100.urdf"] * 2,
    "panda_and_xarm7": [
        "package://panda_description/urdf/panda.urdf",
        "package://xarm_description/urdf/xarm7.urdf",
    ],
    "tiago_dual": ["package://tiago_description/robots/tiago_dual.urdf"],
    "talos": ["package://talos_data/robots/talos_reduced.urdf"],
    "icub": ["package://icub_description/robots/icub_reduced.urdf"],
    "romeo": ["package://romeo_description/urdf/romeo.urdf"],
    "alex": ["package://alex_description/urdf/alex_nub_hands.urdf"],
}
APART = {"two_so100": 0.3, "two_z1": 0.5, "two_ur3": 0.5, "two_kinova": 0.7, "panda_and_xarm7": 0.8}  # m
SIZES = (1.0, 0.5)  # of the place, in what is tried first
QUARTERS = (0.0, 90.0, 180.0, -90.0)  # degrees, of a hand on the bar
N_DRAFTS = 80  # for each size
MASS = 0.1  # kg
BESIDE = replace(
    ROBOT_DIFFICULTIES["robots-easy"], in_the_way=0, spare=0.012
)  # small places have little room


def workplace(robot: Robot, path: Path, size: float) -> Workplace:
    """Return a place about the hands at home, and a bar as long as they are apart there, 0.15 to 0.6 m.

    Hands are turned on it by the quarters with which they reach most of some draws.
    """
    home = {name: robot.tool_pose(robot.home, robot.arm(name))[:3, 3] for name in ("left", "right")}
    hands = sorted(home, key=lambda name: -home[name][1])
    first, second = (home[name] for name in hands)
    middle = 0.5 * (first + second)
    length = round(float(np.clip(np.linalg.norm(first - second), 0.15, 0.6)), 3)
    aside = np.array([0.3 * length, 0.55 * length, 0.03]) + size * np.array([0.12, 0.15, 0.1])
    lower, upper = (tuple(np.round(middle + side * aside, 3).tolist()) for side in (-1, 1))
    turned = [
        Workplace(
            str(path), lower, upper, length, 0.01, MASS, dict(zip(hands, turns, strict=True)), tuple(hands)
        )
        for turns in product(QUARTERS, repeat=2)
    ]
    return max(turned, key=lambda place: reached(robot, place))


def reached(robot: Robot, place: Workplace, n_drafts: int = 16) -> int:
    """Return in how many of some drafts the hands reach the start."""
    rng, count = np.random.default_rng(0), 0
    for _ in range(n_drafts):
        with suppress(SceneError):
            scene = Scene.from_dict(RobotDraft("reached", BESIDE, place, rng).data())
            _ = RobotCarrier(robot, scene).starts
            count += 1
    return count


def carried(name: str, urdfs: list[str], folder: Path, seed: int) -> tuple[list[float], str]:
    """Return the seconds to a description, a scene, a verified motion and a simulation, and what went wrong."""
    path, seconds = folder / f"{name}.yaml", list[float]()

    def passed() -> None:
        seconds.append(time.perf_counter() - begun - sum(seconds))

    begun = time.perf_counter()
    command = ["robot", "new", *urdfs, "--out", str(path), "--apart", str(APART.get(name, 0.8))]
    told = subprocess.run([sys.executable, "-m", "comove", *command], capture_output=True, text=True)
    passed()
    if not path.exists():
        return seconds, told.stderr.strip().replace(str(folder), "")
    try:
        robot = Robot.load(path)
        data, why = None, ""
        for size in SIZES:
            try:
                place = workplace(robot, path, size)
                data, _ = drawn(name, BESIDE, place, [seed, 9], N_DRAFTS)
                break
            except SceneError as error:
                why = str(error)
        passed()
        if data is None:
            return seconds, why
        found = carry(Scene.from_dict(data), robot, seed=seed)
        passed()
        if found.motion is None:
            return seconds, "; ".join(found.solution.reasons or found.verdict.reasons)
        execution = executed(found.motion, Weld(), seed)
        passed()
        return seconds, "; ".join(execution.reasons) or "delivered"
    except ComoveError as error:
        return seconds, str(error).replace(str(folder), "")


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", choices=ROBOTS, default=list(ROBOTS))
    parser.add_argument("--more", nargs="+", default=[], metavar="URDF", help="of your own, with two arms")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    on_one_thread()
    warnings.simplefilter("ignore")
    os.environ.setdefault("MUJOCO_GL", "disable")
    load_robot_kernels(SceneKind(3))
    wanted = {name: ROBOTS[name] for name in asked.robots} | {Path(u).stem: [u] for u in asked.more}
    print("| robot | description [s] | scene [s] | carry [s] | simulation [s] | minutes | what came of it |")
    print("|---|---|---|---|---|---|---|", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name, urdfs in wanted.items():
            seconds, outcome = carried(name, urdfs, Path(folder), asked.seed)
            shown = [f"{value:.1f}" for value in seconds] + ["-"] * (4 - len(seconds))
            print(f"| {name} | {' | '.join(shown)} | {sum(seconds) / 60:.1f} | {outcome} |", flush=True)


if __name__ == "__main__":
    main()

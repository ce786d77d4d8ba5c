"""From URDFs that nobody prepared to a load that MuJoCo delivers: how long it takes, and what goes wrong.

    python benchmarks/unprepared.py
    python benchmarks/unprepared.py --seed 3 --robots talos two_kinova
    python benchmarks/unprepared.py --others                # 18 more

Each is done as a newcomer would, by four commands, and takes what is proposed as it is: `comove robot new`, `scene`,
`solve` and `simulate`, the last one perturbed, hands welded to the bar. All models are those of example-robot-data,
which `comove[robot]` installs; none of them comes with comove as a robot. `--more URDF...` adds models of one's own,
each a robot with two arms, or two with a + between them, which stand side by side.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from timing import on_one_thread, print_head, print_row

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
OTHERS = {
    "centauro": ["package://centauro_description/urdf/centauro.urdf"],
    "simple_humanoid": ["package://simple_humanoid_description/urdf/simple_humanoid.urdf"],
    "humanoid_classical": ["package://simple_humanoid_description/urdf/simple_humanoid_classical.urdf"],
    "human": ["package://human_description/robots/human.urdf"],
    "alex_sake_hands": ["package://alex_description/urdf/alex_sake_hands.urdf"],
    "alex_psyonic_hands": ["package://alex_description/urdf/alex_psyonic_hands.urdf"],
    "romeo_small": ["package://romeo_description/urdf/romeo_small.urdf"],
    "romeo_laas_small": ["package://romeo_description/urdf/romeo_laas_small.urdf"],
    "talos_full": ["package://talos_data/robots/talos_full_v2.urdf"],
    "talos_full_box": ["package://talos_data/robots/talos_full_v2_box.urdf"],
    "g1_with_hands": ["package://g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf"],
    "icub_full": ["package://icub_description/robots/icub.urdf"],
    "two_ur5_grippers": ["package://ur_description/urdf/ur5_gripper.urdf"] * 2,
    "two_ur3_grippers": ["package://ur_description/urdf/ur3_gripper.urdf"] * 2,
    "two_tiago": ["package://tiago_description/robots/tiago.urdf"] * 2,
    "tiago_and_panda": [
        "package://tiago_description/robots/tiago_no_hand.urdf",
        "package://panda_description/urdf/panda.urdf",
    ],
    "two_b1_z1": ["package://b1_description/urdf/b1-z1.urdf"] * 2,
    "two_anymal_kinova": ["package://anymal_b_simple_description/robots/anymal-kinova.urdf"] * 2,
}
FAILURE = re.compile(r"^error|to be mended|NOT VERIFIED")  # of lines that say what went wrong
APART = {"two_so100": 0.3, "two_z1": 0.5, "two_ur3": 0.5, "two_kinova": 0.7, "panda_and_xarm7": 0.8}  # m


def delivered(name: str, urdfs: list[str], folder: Path, seed: int) -> tuple[list[float], str]:
    """Return the seconds of each command, and what came of it: what the first one that fails says."""
    robot, scene, carried = folder / f"{name}.yaml", folder / f"{name}-scene.yaml", folder / name
    commands = (
        ["new", *urdfs, "--out", robot, "--apart", APART.get(name, 0.8)],
        ["scene", robot, "--out", scene, "--seed", seed],
        ["solve", scene, "--out", carried, "--seed", seed],
        ["simulate", carried, "--seed", seed, "--no-pictures"],
    )
    seconds = list[float]()
    for command in commands:
        begun = time.perf_counter()
        told = subprocess.run(
            [sys.executable, "-m", "comove", "robot", *map(str, command)], capture_output=True, text=True
        )
        seconds.append(time.perf_counter() - begun)
        if told.returncode and not (carried / "simulation.json").exists():
            lines = (told.stdout + told.stderr).replace(str(folder), "").splitlines()
            return seconds, "; ".join(line.strip() for line in lines if FAILURE.search(line))
    summary = json.loads((carried / "simulation.json").read_text(encoding="utf-8"))
    return seconds, "delivered" if summary["delivered"] else "; ".join(summary["reasons"])


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", choices=ROBOTS | OTHERS, default=[])
    parser.add_argument("--others", action="store_true", help="18 others in place of the ten")
    parser.add_argument("--more", nargs="+", default=[], metavar="URDF", help="of your own, or URDF+URDF")
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    on_one_thread()
    os.environ.setdefault("MUJOCO_GL", "disable")
    wanted = {name: (ROBOTS | OTHERS)[name] for name in asked.robots}
    wanted |= {Path(urdfs).stem: urdfs.split("+") for urdfs in asked.more}
    wanted = wanted or (OTHERS if asked.others else ROBOTS)
    print_head(["robot", "new [s]", "scene [s]", "solve [s]", "simulate [s]", "minutes", "what came of it"])
    with tempfile.TemporaryDirectory() as folder:
        for name, urdfs in wanted.items():
            seconds, outcome = delivered(name, urdfs, Path(folder), asked.seed)
            shown = [f"{value:.1f}" for value in seconds] + ["-"] * (4 - len(seconds))
            print_row([name, *shown, f"{sum(seconds) / 60:.1f}", outcome])


if __name__ == "__main__":
    main()

"""Third-party robot models to a delivered payload: time and faults.

    python benchmarks/unprepared.py                                  # the set-ups of example-robot-data
    python benchmarks/unprepared.py --packages FOLDER... --seed 77   # all set-ups of `SETUPS`
    python benchmarks/unprepared.py --robots talos two_kinova

Each is processed as by a newcomer, with all proposals unchanged: `comove robot convert` where the model is
MuJoCo's own, then `new`, `scene`, `solve` and `simulate`, the last one perturbed, end effectors welded to the bar.
None of the models comes with comove as a robot. Those of example-robot-data come with `comove[robot]`; the others are
searched in the folders of `--packages`, such as a venv's ``site-packages`` and ``share``:

    pip install --no-deps dexmate-urdf fourier-robot-descriptions airo-models icub-models openarm-mujoco gym-aloha \
        armar jvrc-description gb-robot-models robosuite mani-skill

A set-up whose package is in none of them is skipped with a note. The motion of every one that is verified is held
against the limits of the raw file, soft ones included, read here without comove's code: the last column.
`--more FILE...` adds models of one's own, each a robot with two arms, or two with a + between them.
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
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml
from scipy.interpolate import CubicSpline
from timing import on_one_thread, peer, print_head, print_row


@dataclass(frozen=True)
class Setup:
    """Models of a set-up, and distance between their bases [m]. Models are paths in a folder of packages or
    ``package://``."""

    models: tuple[str, ...]
    apart: float = 0.8
    package: str = "example-robot-data"


def _two(model: str, apart: float, package: str = "example-robot-data") -> Setup:
    return Setup((model, model), apart, package)


_SUITE = "robosuite/models/assets/robots"
SETUPS = {
    "two_gen3": _two(f"{_SUITE}/kinova3/robot.xml", 0.8, "robosuite"),
    "vega": Setup(("dexmate_urdf/robots/humanoid/vega_1/vega_1_gripper.urdf",), package="dexmate-urdf"),
    "openarm": Setup(("openarm_mujoco/v2/openarm_bimanual.xml",), package="openarm-mujoco"),
    "two_panda_v2": _two("mani_skill/assets/robots/panda/panda_v2.urdf", 0.8, "mani-skill"),
    "two_fetch": _two("mani_skill/assets/robots/fetch/fetch.urdf", 1.0, "mani-skill"),
    "three_ur5": Setup(("package://ur_description/urdf/ur5_robot.urdf",) * 3, 0.8),
    "two_iiwa": _two(f"{_SUITE}/iiwa/robot.xml", 0.8, "robosuite"),
    "tiago_dual": Setup(("package://tiago_description/robots/tiago_dual.urdf",)),
    "gr1": Setup(
        ("fourier_robot_descriptions/assets/urdf/gr1t2.urdf",), package="fourier-robot-descriptions"
    ),
    "two_ur5e": _two("airo_models/arms/ur5e/ur5e.urdf", 0.8, "airo-models"),
    "icub": Setup(("iCub/robots/iCubGazeboV2_5/model.urdf",), package="icub-models"),
    "aloha": Setup(("gym_aloha/assets/bimanual_viperx_transfer_cube.xml",), package="gym-aloha"),
    "armar6": Setup(("armar/description/urdf/armar6.urdf",), package="armar"),
    "jvrc": Setup(("jvrc_description/urdf/jvrc1.urdf",), package="jvrc-description"),
    "gene01": Setup(("gb_robot_models/robots/gene01_0/model.urdf",), package="gb-robot-models"),
    "gr3": Setup(("fourier_robot_descriptions/assets/urdf/gr3.urdf",), package="fourier-robot-descriptions"),
    "qinglong": Setup(
        ("fourier_robot_descriptions/assets/urdf/qinglong.urdf",), package="fourier-robot-descriptions"
    ),
    "mobile_pandas": Setup(
        ("mani_skill/assets/robots/panda/mobile_panda_dual_arm.urdf",), package="mani-skill"
    ),
    "two_sawyer": _two(f"{_SUITE}/sawyer/robot.xml", 1.0, "robosuite"),
    "alex": Setup(("package://alex_description/urdf/alex_nub_hands.urdf",)),
}
OTHERS = {
    "two_ur3": _two("package://ur_description/urdf/ur3_joint_limited_robot.urdf", 0.5),
    "two_kinova": _two("package://kinova_description/robots/kinova.urdf", 0.7),
    "two_z1": _two("package://z1_description/urdf/z1.urdf", 0.5),
    "two_so100": _two("package://so_arm_description/urdf/so100.urdf", 0.3),
    "panda_and_xarm7": Setup(
        ("package://panda_description/urdf/panda.urdf", "package://xarm_description/urdf/xarm7.urdf")
    ),
    "talos": Setup(("package://talos_data/robots/talos_reduced.urdf",)),
    "icub_reduced": Setup(("package://icub_description/robots/icub_reduced.urdf",)),
    "romeo": Setup(("package://romeo_description/urdf/romeo.urdf",)),
    "centauro": Setup(("package://centauro_description/urdf/centauro.urdf",)),
    "simple_humanoid": Setup(("package://simple_humanoid_description/urdf/simple_humanoid.urdf",)),
    "human": Setup(("package://human_description/robots/human.urdf",)),
    "alex_sake_hands": Setup(("package://alex_description/urdf/alex_sake_hands.urdf",)),
    "alex_psyonic_hands": Setup(("package://alex_description/urdf/alex_psyonic_hands.urdf",)),
    "romeo_small": Setup(("package://romeo_description/urdf/romeo_small.urdf",)),
    "talos_full": Setup(("package://talos_data/robots/talos_full_v2.urdf",)),
    "g1_with_hands": Setup(("package://g1_description/urdf/g1_29dof_with_hand_rev_1_0.urdf",)),
    "two_ur5_grippers": _two("package://ur_description/urdf/ur5_gripper.urdf", 0.8),
    "two_tiago": _two("package://tiago_description/robots/tiago.urdf", 0.8),
    "tiago_and_panda": Setup(
        (
            "package://tiago_description/robots/tiago_no_hand.urdf",
            "package://panda_description/urdf/panda.urdf",
        )
    ),
    "two_b1_z1": _two("package://b1_description/urdf/b1-z1.urdf", 0.8),
    "two_anymal_kinova": _two("package://anymal_b_simple_description/robots/anymal-kinova.urdf", 0.8),
}
FAILURE = re.compile(r"^error|to be mended|NOT VERIFIED")  # of lines that say what went wrong
ROUNDING = 1e-9  # rad and m, and share of a velocity limit


def found_in(model: str, folders: list[Path]) -> str | None:
    """Return a model's path for the commands; None where none exists."""
    if "://" in model or Path(model).is_file():
        return model
    return next((str(folder / model) for folder in folders if (folder / model).is_file()), None)


def delivered(name: str, models: list[str], apart: float, folder: Path, seed: int) -> tuple[float, str, str]:
    """Return the commands' seconds, the result or failure, and kept limits."""
    robot, scene, carried = folder / f"{name}.yaml", folder / f"{name}-scene.yaml", folder / name
    begun, urdfs, around = time.perf_counter(), list[str](), list[str]()
    commands = []
    for model in dict.fromkeys(models):
        if model.endswith(".xml"):
            converted = folder / f"{name}-{Path(model).stem}"
            commands.append(["convert", model, "--out", converted])
            around = ["--obstacles", f"{converted / Path(model).stem}-obstacles.yaml"]
    urdfs = [
        str(folder / f"{name}-{Path(model).stem}" / f"{Path(model).stem}.urdf")
        if model.endswith(".xml")
        else model
        for model in models
    ]
    commands += [
        ["new", *urdfs, "--out", robot, "--apart", apart],
        ["scene", robot, "--out", scene, "--seed", seed],
        ["solve", scene, "--out", carried, "--seed", seed],
        ["simulate", carried, "--perturbed", seed, "--no-pictures"],
    ]
    outcome = ""
    for command in commands:
        if command[0] in ("new", "scene") and around and Path(around[1]).exists():
            command += around
        told = subprocess.run(
            [sys.executable, "-m", "comove", "robot", *map(str, command)], capture_output=True, text=True
        )
        if told.returncode and not (carried / "simulation.json").exists():
            lines = (told.stdout + told.stderr).replace(str(folder), "").splitlines()
            said = [line.strip() for line in lines if FAILURE.search(line)] or lines[-1:]
            outcome = f"{command[0]}: {'; '.join(said)}"
            break
    else:
        summary = json.loads((carried / "simulation.json").read_text(encoding="utf-8"))
        outcome = "delivered" if summary["delivered"] else "; ".join(summary["reasons"])
    seconds = time.perf_counter() - begun
    kept = (
        raw_limits_kept(models, robot, carried / "joints.npz") if (carried / "joints.npz").exists() else "-"
    )
    return seconds, outcome, kept


def raw_limits(model: str) -> dict[str, tuple[float, float, float]]:
    """Return a file's joint limits by name. They are least and largest position, and largest velocity."""
    found = dict[str, tuple[float, float, float]]()
    if model.endswith(".xml"):
        compiled = peer("mujoco").MjModel.from_xml_path(model)
        for k in range(compiled.njnt):
            if compiled.jnt_limited[k]:
                found[compiled.joint(k).name] = (*compiled.jnt_range[k].tolist(), np.inf)
        return found
    if model.startswith("package://"):
        share = Path(peer("cmeel_pth").__file__).parent / "cmeel.prefix/share/example-robot-data/robots"
        model = str(share / model.removeprefix("package://"))
    text = Path(model).read_text(encoding="utf-8")
    bound = "".join(f' xmlns:{name}="{name}"' for name in ("drake", "xacro") if f"xmlns:{name}" not in text)
    for joint in ET.fromstring(re.sub(r"<robot\b", f"<robot{bound}", text, count=1).encode()).iter("joint"):
        limit, soft = joint.find("limit"), joint.find("safety_controller")
        if limit is None or joint.get("type") not in ("revolute", "prismatic", "continuous"):
            continue
        lower, upper = -np.inf, np.inf
        if joint.get("type") != "continuous":
            lower, upper = (float(limit.get(key, 0.0)) for key in ("lower", "upper"))
            if soft is not None and {"soft_lower_limit", "soft_upper_limit"} <= set(soft.attrib):
                lower = max(lower, float(soft.get("soft_lower_limit", 0.0)))
                upper = min(upper, float(soft.get("soft_upper_limit", 0.0)))
        speed = float(limit.get("velocity", 0.0)) or np.inf
        if lower < upper:
            found[joint.get("name", "")] = lower, upper, speed
    return found


def raw_limits_kept(models: list[str], robot: Path, joints: Path) -> str:
    """Return in words whether a motion keeps the raw files' limits."""
    prefixes = [part.get("prefix", "") for part in yaml.safe_load(robot.read_text())["models"]]
    limits = {
        prefix + name: values
        for prefix, model in zip(prefixes, models, strict=True)
        for name, values in raw_limits(model).items()
    }
    with np.load(joints) as stored:
        names, time_, position = stored["joint_names"].tolist(), stored["time"], stored["position"]
    curve = CubicSpline(time_, position, bc_type="clamped")
    fine = np.concatenate(
        [np.linspace(a, b, 50, endpoint=False) for a, b in zip(time_[:-1], time_[1:], strict=True)]
    )
    known = [k for k, name in enumerate(names) if name in limits]
    lower, upper, speed = np.array([limits[names[k]] for k in known]).T
    at = np.concatenate([curve(fine)[:, known], position[:, known]])
    margin = float(np.minimum(at - lower, upper - at).min())
    share = float((np.abs(curve(fine, 1)[:, known]) / speed).max())
    of_speed = f", {share:.0%} of the velocity" if np.isfinite(speed).any() else ""
    told = f"{len(known)} of {len(names)} joints, {margin:.2g} to the nearest{of_speed}"
    return f"{'kept' if margin >= -ROUNDING and share <= 1 + ROUNDING else 'BROKEN'}: {told}"


def main() -> None:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="+", choices=SETUPS | OTHERS, default=[])
    parser.add_argument("--others", action="store_true", help="the others, of example-robot-data")
    parser.add_argument("--packages", nargs="+", type=Path, default=[], metavar="FOLDER")
    parser.add_argument("--more", nargs="+", default=[], metavar="FILE", help="of your own, or FILE+FILE")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--keep", type=Path, help="folder in which all that is written stays")
    asked = parser.parse_args()
    on_one_thread()
    os.environ.setdefault("MUJOCO_GL", "disable")
    wanted = {name: (SETUPS | OTHERS)[name] for name in asked.robots}
    wanted |= {Path(files).stem: Setup(tuple(files.split("+")), package="yours") for files in asked.more}
    wanted = wanted or (OTHERS if asked.others else SETUPS)
    print_head(["set-up", "package", "minutes", "what came of it", "limits of the raw file"])
    done, tried = 0, 0
    with tempfile.TemporaryDirectory() as temporary:
        folder = asked.keep or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        for name, setup in wanted.items():
            found = [found_in(model, asked.packages) for model in setup.models]
            models = [model for model in found if model is not None]
            if len(models) < len(found):
                print_row(
                    [name, setup.package, "-", "skipped: its package is in no folder of --packages", "-"]
                )
                continue
            seconds, outcome, kept = delivered(name, models, setup.apart, folder, asked.seed)
            tried, done = tried + 1, done + (outcome == "delivered")
            print_row([name, setup.package, f"{seconds / 60:.1f}", outcome, kept])
            sys.stdout.flush()
    print(f"\n{done} of {tried} delivered, seed {asked.seed}")


if __name__ == "__main__":
    main()

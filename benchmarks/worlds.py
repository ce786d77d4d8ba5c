"""What comove finds in the worlds of others: robosuite, gym-aloha and OpenArm.

    python benchmarks/worlds.py [NAME ...]

Every world is read in two states, by seeds 0 and 1, in a new cache. A line has arms with joints; free bodies with
parts; obstacles, and on how many a body rests; gaps of open and closed grippers; how far and by how much the tool is
off the site between the fingers, where there is one; the largest distance of tools from where MuJoCo has them, in ten
random configurations; pairs of links that touch now and are left out; pairs that touch though they are compared; and
processor times of the first and the second state.

They need packages that comove does not bring along: ``pip install comove[sim] 'mujoco<3.8' termcolor
opencv-python-headless``, ``pip install --no-deps robosuite``; gym-aloha with dm_control 1.0.38; openarm-mujoco.
MuJoCo 3.8 folds the Robotiq gripper of robosuite's UR5e. What is not installed is left out, and told.
"""

from __future__ import annotations

import argparse
import logging
import os
import tempfile
import time
import xml.etree.ElementTree as ET
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from timing import print_head, print_row

from comove.robots.proposal.bodies import pairs_of, touching
from comove.sim.engine import engine
from comove.tasks import World

HEADER = (
    *("world", "arms", "bodies", "obstacles", "open, closed [mm]", "off the site", "off MuJoCo [mm]"),
    *("left out", "touch", "first [s]", "second [s]"),
)
SITES = ("grip_site",)  # ends of names of sites between fingers
LIFT = "TwoArmLift"
N_CONFIGURATIONS = 10


def suite(task: str, robots: str | list[str], seed: int, **more: Any) -> tuple[Any, Any]:
    """Return model and data of a robosuite environment."""
    import robosuite

    logging.getLogger("robosuite_logs").setLevel(logging.ERROR)
    env = robosuite.make(
        task,
        robots=robots,
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        seed=seed,
        **more,
    )
    env.reset()
    return env.sim.model._model, env.sim.data._data


def aloha(task: str, seed: int) -> tuple[Any, Any]:
    """Return model and data of gym-aloha at the start of an episode."""
    from gym_aloha import constants, utils

    mujoco = engine()
    model = mujoco.MjModel.from_xml_path(str(constants.ASSETS_DIR / f"bimanual_viperx_{task}.xml"))
    data = mujoco.MjData(model)
    sample = utils.sample_box_pose if task == "transfer_cube" else utils.sample_insertion_pose
    data.qpos[:] = np.concatenate([constants.START_ARM_POSE, *np.atleast_2d(sample(seed))])
    return model, data


def openarm(seed: int) -> tuple[Any, Any]:
    """Return model and data of OpenArm's demonstration; its arms are moved at random by a little."""
    from openarm_mujoco.v2 import openarm_demo_xml

    mujoco = engine()
    model = mujoco.MjModel.from_xml_path(openarm_demo_xml())
    data = mujoco.MjData(model)
    for joint in range(model.njnt if seed else 0):
        if "_joint" in model.joint(joint).name and "finger" not in model.joint(joint).name:
            data.qpos[model.jnt_qposadr[joint]] = np.mean(model.jnt_range[joint])
    return model, data


def opposed(*robots: str, task: str = LIFT) -> Callable[[int], tuple[Any, Any]]:
    """Return a robosuite task for two robots that face each other."""
    return lambda seed: suite(task, list(robots), seed, env_configuration="opposed")


WORLDS: dict[str, Callable[[int], tuple[Any, Any]]] = {
    "lift-panda": opposed("Panda", "Panda"),
    "lift-panda-parallel": lambda seed: suite(LIFT, ["Panda"] * 2, seed, env_configuration="parallel"),
    "lift-ur5e": opposed("UR5e", "UR5e"),
    "lift-iiwa": opposed("IIWA", "IIWA"),
    "lift-sawyer": opposed("Sawyer", "Sawyer"),
    "lift-baxter": lambda seed: suite(LIFT, "Baxter", seed),
    "lift-panda-ur5e": opposed("Panda", "UR5e"),
    "handover-panda": opposed("Panda", "Panda", task="TwoArmHandover"),
    "transport-panda": opposed("Panda", "Panda", task="TwoArmTransport"),
    "peg-panda": opposed("Panda", "Panda", task="TwoArmPegInHole"),
    "aloha-cube": partial(aloha, "transfer_cube"),
    "aloha-insertion": partial(aloha, "insertion"),
    "openarm": openarm,
}


def read(model: Any, data: Any) -> tuple[World, float]:
    """Return a world, and the processor time of reading it [s]."""
    begun = time.process_time()
    world = World.from_mujoco(model, data)
    return world, time.process_time() - begun


def pose(position: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """Return a homogeneous matrix."""
    found = np.eye(4)
    found[:3, 3], found[:3, :3] = position, rotation.reshape(3, 3)
    return found


def off_sites(world: World, data: Any) -> list[str]:
    """Return how far tools are from the sites between their fingers, and how their approach is turned from theirs."""
    found, model, robot = [], world.model, world.robot
    engine().mj_forward(model, data)
    q = world.joints_of(data)
    for arm in robot.arms:
        palm = model.body(arm.tip).id
        for site in range(model.nsite):
            body = int(model.site_bodyid[site])
            if model.site(site).name.endswith(SITES) and model.body_weldid[body] == model.body_weldid[palm]:
                grip = pose(data.site_xpos[site], data.site_xmat[site])
                apart = np.linalg.inv(grip) @ robot.tool_pose(q, arm)
                angle = np.rad2deg(np.arccos(np.clip(apart[2, 2], -1.0, 1.0)))
                found.append(f"{1e3 * np.linalg.norm(apart[:3, 3]):.1f} mm {angle:.1f}°")
    return list(dict.fromkeys(found))


def off_mujoco(world: World) -> float:
    """Return the largest distance of tools from where MuJoCo has them [m]."""
    mujoco, model, robot, rng = engine(), world.model, world.robot, np.random.default_rng(0)
    state, worst = mujoco.MjData(model), 0.0
    held = world.robot.description.posture
    for joint, value in held.items():
        state.qpos[model.joint(joint).qposadr[0]] = value
    for _ in range(N_CONFIGURATIONS):
        q = rng.uniform(robot.lower, robot.upper)
        state.qpos[world.addresses] = q
        mujoco.mj_forward(model, state)
        for arm in robot.arms:
            body = model.body(arm.tip).id
            expected = pose(state.xpos[body], state.xmat[body]) @ arm.tool
            worst = max(worst, float(np.abs(expected - robot.tool_pose(q, arm)).max()))
    return worst


def row_of(name: str) -> list[str]:
    """Return the line of a world."""
    model, data = WORLDS[name](0)
    world, first = read(model, data)
    second = read(*WORLDS[name](1))[1]
    robot = world.robot
    hit = touching(robot, robot.home[None])[0]
    touch = sorted({pair for pair, hits in zip(pairs_of(robot), hit, strict=True) if hits})
    srdf = robot.description.models[0].srdf
    left_out = 0
    if srdf is not None:
        pairs = ET.parse(world.folder / srdf).getroot().findall("disable_collisions")
        left_out = sum(pair.get("reason") == "Default" for pair in pairs)
    gaps = {f"{1e3 * g.width_open:.1f}, {1e3 * g.width_closed:.1f}" for g in world.grippers.values()}
    return [
        name,
        ", ".join(f"{arm.name} {len(arm.columns)}" for arm in robot.arms),
        ", ".join(f"{body.name} {len(body.parts)}" for body in world.bodies.values()) or "-",
        f"{len(world.obstacles)}, {sum(bool(one.get('support')) for one in world.obstacles)}",
        "; ".join(sorted(gaps)) or "-",
        "; ".join(off_sites(world, data)) or "-",
        f"{1e3 * off_mujoco(world):.1e}",
        str(left_out),
        ", ".join(f"{a} + {b}" for a, b in touch) or "-",
        f"{first:.2f}",
        f"{second:.2f}",
    ]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("worlds", nargs="*", metavar="NAME", help=f"of {', '.join(WORLDS)}; all unless given")
    chosen = parser.parse_args().worlds or list(WORLDS)
    if unknown := [name for name in chosen if name not in WORLDS]:
        parser.error(f"no world '{unknown[0]}'; known: {', '.join(WORLDS)}")
    missing = []
    with tempfile.TemporaryDirectory() as folder:
        os.environ["XDG_CACHE_HOME"] = str(Path(folder))
        print_head(HEADER)
        for name in chosen:
            try:
                print_row(row_of(name))
            except (
                ImportError,
                AttributeError,
                AssertionError,
            ) as error:  # of packages that do not fit MuJoCo
                missing.append(f"{name}: {type(error).__name__} {error}")
    for line in missing:
        print(f"left out: {line}")


if __name__ == "__main__":
    main()

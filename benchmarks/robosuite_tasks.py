"""Tasks of robosuite for two arms, planned by comove and played through the environments' own controllers.

    python benchmarks/robosuite_tasks.py                                  # TwoArmLift, two Pandas opposed, 20 seeds
    python benchmarks/robosuite_tasks.py panda-parallel ur5e iiwa sawyer baxter panda+ur5e --seeds 20
    python benchmarks/robosuite_tasks.py --task handover

Needs robosuite (1.5) with a MuJoCo from 3.4 to 3.7: with 3.8 its Robotiq grippers do not close, with 3.12 it does not
run. Columns: success as `env._check_success()` says at the end; seeds planned, all of them verified; median of the
processor time of reading the world, whose robot is known by then, and of planning; largest difference of the joints
from their commands; reasons why others were not planned, or failed though they were.
"""

from __future__ import annotations

import argparse
import logging
import time
from collections import Counter
from statistics import median

import numpy as np
from timing import number, print_table

from comove.errors import ComoveError
from comove.tasks import Grasp, Task, World

ROBOTS = {
    "panda": ["Panda", "Panda"],
    "ur5e": ["UR5e", "UR5e"],
    "iiwa": ["IIWA", "IIWA"],
    "sawyer": ["Sawyer", "Sawyer"],
    "baxter": ["Baxter"],
    "panda+ur5e": ["Panda", "UR5e"],
}
RATE, LIFT, STIFFNESS = 20, 0.2, 1000.0  # Hz, m, 1/s^2 of the environment's joint controllers
SETTLING, HOLDING = 15, 10  # control steps with open grippers before the task, and after it


def environment(task: str, name: str, seed: int):
    """Return robosuite's environment of a task with controllers of absolute joint positions."""
    import robosuite
    from robosuite.controllers import load_composite_controller_config

    logging.getLogger("robosuite_logs").setLevel(logging.ERROR)
    names, _, way = name.partition("-")
    robots = ROBOTS[names]
    configs = []
    for robot in robots:
        config = load_composite_controller_config(robot=robot)
        part = {"type": "JOINT_POSITION", "input_type": "absolute", "kp": STIFFNESS, "damping_ratio": 1.0}
        part |= {"input_max": 1, "input_min": -1, "output_max": 1, "output_min": -1, "interpolation": None}
        part |= {"ramp_ratio": 0.2, "impedance_mode": "fixed", "gripper": {"type": "GRIP"}}
        config["body_parts"] = {arm: part for arm in config["body_parts"] if arm in ("right", "left")}
        configs.append(config)
    one = len(robots) == 1
    env = robosuite.make(
        task,
        robots=robots[0] if one else robots,
        controller_configs=configs[0] if one else configs,
        has_renderer=False,
        has_offscreen_renderer=False,
        use_camera_obs=False,
        control_freq=RATE,
        horizon=100_000,
        ignore_done=True,
        seed=seed,
        **({} if one else {"env_configuration": way or "opposed"}),
    )
    env.reset()
    return env


def lift(world: World) -> Task:
    """Return the task of lifting the pot: what a user writes."""
    pot = world.body("pot_root")
    held = {"tilt_deg": (-40.0, 40.0), "flip": True}
    hands = [world.robot.tool_pose(world.robot.home, arm)[:2, 3] for arm in world.robot.arms]
    handles = [(pot.pose @ pot.sites[f"pot_handle{k}"])[:2, 3] for k in range(2)]
    crossed = np.linalg.norm(hands[0] - handles[0]) > np.linalg.norm(hands[0] - handles[1])
    sites = ["pot_handle0", "pot_handle1"][:: -1 if crossed else 1]
    task = Task(world)
    task.approach(
        **{arm.name: Grasp(pot, site, **held) for arm, site in zip(world.robot.arms, sites, strict=True)}
    )
    task.close(time=1.0)
    task.carry(pot, shift=[0.0, 0.0, LIFT], upright=True, time=4.0)
    return task


def handover(world: World) -> Task:
    """Return the task of handing the hammer over, whose handle is along z, with the head at the end."""
    hammer = world.body("hammer_root")
    side = np.sign(hammer.pose[2, 1])  # what was up stays up
    between = np.eye(4)
    between[:3, :3] = np.column_stack([[side, 0.0, 0.0], [0.0, 0.0, side], [0.0, -1.0, 0.0]])
    between[:3, 3] = 0.0, -0.02, 1.02
    held = {"along": [0.0, 0.0, 1.0], "tilt_deg": (-60.0, 60.0), "flip": True}
    task = Task(world)
    task.approach(robot0=Grasp(hammer, position=[0.0, side * 0.008, 0.05], **held))  # off the table
    task.close(time=1.0)
    task.carry(hammer, to=between)
    task.hand_over(hammer, robot1=Grasp(hammer, position=[0.0, 0.0, -0.06], **held))
    task.carry(hammer, shift=[0.0, 0.1, 0.05])
    return task


TASKS = {"lift": ("TwoArmLift", lift), "handover": ("TwoArmHandover", handover)}


def actions(env, world: World):
    """Return a function from joints and closed grippers by arm to the environment's action."""
    model = env.sim.model._model
    by_qpos = dict(zip(world.addresses.tolist(), range(len(world.addresses)), strict=True))

    def action(joints: np.ndarray, closed: dict[str, bool]) -> np.ndarray:
        found = []
        for robot in env.robots:
            parts = {}
            for arm in robot.arms:
                columns = [
                    by_qpos[int(model.joint(j).qposadr[0])]
                    for j in robot.robot_model.arm_joints
                    if len(robot.arms) == 1 or j.split("_", 1)[1].startswith(arm)
                ]
                owner = next(
                    a.name for a in world.robot.arms if set(columns) <= set(np.asarray(a.columns).tolist())
                )
                parts[arm] = joints[columns]
                parts[f"{arm}_gripper"] = np.array([1.0 if closed[owner] else -1.0])
            found.append(robot.create_action_vector(parts))
        return np.concatenate(found)

    return action


def run(task: str, name: str, seed: int) -> tuple[bool, float, float, float, str]:
    """Run a seed; return success, times of reading and planning [s], largest lag [rad], and what went wrong."""
    environment_of, task_in = TASKS[task]
    env = environment(environment_of, name, seed)
    world = World.from_mujoco(env.sim)
    opened = {arm.name: False for arm in world.robot.arms}
    action = actions(env, world)
    for _ in range(SETTLING):
        env.step(action(world.robot.home, opened))
    begun = time.process_time()
    read = np.nan
    try:
        world = World.from_mujoco(env.sim)
        read = time.process_time() - begun
        plan = task_in(world).solve(budget=30.0, seed=seed)
    except ComoveError as error:
        return False, read, np.nan, np.nan, str(error)
    took, lag = time.process_time() - begun - read, 0.0
    ahead = 0.5 / RATE
    for command in plan.stream(RATE):
        q, rate, bend = plan.derivatives(min(command.time + ahead, plan.duration))
        env.step(action(q + 2.0 * rate / np.sqrt(STIFFNESS) + bend / STIFFNESS, dict(command.closed)))
        lag = max(
            lag,
            float(
                np.abs(
                    world.joints_of(env.sim.data)
                    - plan.derivatives(min(command.time + 2 * ahead, plan.duration))[0]
                ).max()
            ),
        )
    for _ in range(HOLDING):
        env.step(action(plan.derivatives(plan.duration)[0], dict(command.closed)))
    success = bool(env._check_success())
    return success, read, took, lag, "" if success else "planned, and failed"


def main() -> None:
    """Run and print."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("robots", nargs="*", default=["panda"])
    parser.add_argument("--task", choices=TASKS, default="lift")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--first", type=int, default=1000, help="first seed")
    options = parser.parse_args()
    rows = []
    for name in options.robots:
        runs = []
        for seed in range(options.first, options.first + options.seeds):
            runs.append(run(options.task, name, seed))
            print(name, seed, *runs[-1], flush=True)
        told = Counter(one[4][:60].splitlines()[0] for one in runs if one[4])
        done = [one for one in runs if np.isfinite(one[2])]
        rows.append(
            [
                name,
                f"{sum(one[0] for one in runs)} of {len(runs)}",
                str(len(done)),
                number(float(np.nanmedian([one[1] for one in runs]))),
                number(median(one[2] for one in done)) if done else "",
                number(max(one[3] for one in done)) if done else "",
                "; ".join(f"{n} x {why}" for why, n in told.most_common(2)),
            ]
        )
    print_table(["robots", "success", "planned", "read [s]", "plan [s]", "lag [rad]", "else"], rows)


if __name__ == "__main__":
    main()

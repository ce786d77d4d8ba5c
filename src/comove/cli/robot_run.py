"""`comove robot run`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli import options as o
from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, verb_of
from comove.cli.robot import GraspName, RobotName, group, robot_named
from comove.errors import OptionError

LONGEST = 4.0  # times the plan's duration, that a run may last unless it is said


@verb_of(group)
def run(
    scene: o.SceneFile,
    out: Annotated[Path, typer.Option(help="Folder for the record.")],
    robot: RobotName = None,
    seed: o.Seed = 0,
    rate: Annotated[float, typer.Option(help="Control steps in a second [Hz], from 50 to 500.")] = 250.0,
    grasp: GraspName = "weld",
    perturbed: Annotated[
        int | None,
        typer.Option(
            min=0, help="Draw friction, mass, gains and the load's place in the hands from this seed."
        ),
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(
            help="Seconds of simulated time that the run may last; 4 times the plan's unless given."
        ),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print robot_run.json and nothing else.")] = False,
) -> int:
    """Let a robot carry SCENE's load in MuJoCo, step by step among obstacles that move, record and judge it."""
    import numpy as np

    from comove.cli.progress import progress_bar, time_spent
    from comove.cli.texts import robot_run_text
    from comove.io.folders import check_target, whole_folder
    from comove.planning import SceneKind
    from comove.results import RESULT
    from comove.robots.kernels import load_robot_kernels
    from comove.robots.online.executor import JointExecutor, OnlineSettings
    from comove.scenes import Scene
    from comove.simulators import GRASPS, Perturbation
    from comove.simulators.live import run_live
    from comove.simulators.live_record import judge_run, write_robot_run
    from comove.views import draw_joints, save

    o.require_one_of(grasp, tuple(GRASPS), "grasp")
    if not 50.0 <= rate <= 500.0:
        raise OptionError(f"{rate:g} Hz are not possible", key="--rate", way_out="give 50 to 500")
    if budget is not None:
        o.check_budget(budget)
    check_target(out, RESULT)
    loaded = Scene.load(scene)
    carrier, _ = robot_named(robot, loaded, scene)
    with progress_bar():
        load_robot_kernels(SceneKind.of(loaded))
        executor = JointExecutor(loaded, carrier, seed=seed, settings=OnlineSettings(period=1.0 / rate))
        drawn = None
        if perturbed is not None:
            drawn = Perturbation.drawn(np.random.default_rng(perturbed), len(carrier.joint_names))
        record = run_live(executor, budget or LONGEST * executor.plan.scene.duration, GRASPS[grasp](), drawn)
        report = judge_run(record)
    with whole_folder(out, RESULT) as draft:
        title = f"{loaded.name}, {carrier.name}, online" + (
            "" if not report.reasons else " (not as it should)"
        )
        save(draw_joints(carrier, record.motion, title=title), draft / "joints.png")
        summary = write_robot_run(draft, record, report, executor.log, seed=seed, wall_time_s=time_spent())
    if json:
        print((out / "robot_run.json").read_text(encoding="utf-8"), end="")
    else:
        print(robot_run_text(summary, out))
    if record.interrupted:
        return INTERRUPTED
    return NOT_VERIFIED if report.reasons else VERIFIED

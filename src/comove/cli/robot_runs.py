"""Online runs of robots in MuJoCo, by `comove run`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from comove.cli import options as o
from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, command_words
from comove.errors import OptionError

if TYPE_CHECKING:
    from comove.model import Scene

RUN_LONGEST = 4.0  # times the plan's duration, that a run may last unless it is said
LEAST_RATE, USUAL_RATE, LARGEST_RATE = 50.0, 250.0, 500.0  # Hz, of control steps


@dataclass(frozen=True)
class SimulatedRun:
    """Options of a robot's simulated run.

    Attributes
    ----------
    rate : control rate [Hz]
    grasp : name of the grasp
    perturbed : seed of the perturbation; None for none
    budget : limit of simulated time [s]; None for `RUN_LONGEST` times the plan's duration
    pictures, film : whether a sheet of pictures, and a film, are drawn
    """

    rate: float = USUAL_RATE
    grasp: str = "weld"
    perturbed: int | None = None
    budget: float | None = None
    pictures: bool = True
    film: bool = False


def run_joints(
    loaded: Scene,
    scene: Path,
    out: Path,
    robot: str | None,
    how: SimulatedRun,
    *,
    seed: int,
    json: bool,
) -> int:
    """Run a robot in MuJoCo, record and verify the run. Return the exit code.

    Parameters
    ----------
    loaded, scene : the scene, and its file
    out : folder for the record
    robot : name or description; that of the scene unless given
    """
    import numpy as np

    from comove.cli.progress import progress_bar, time_spent
    from comove.cli.texts import robot_run_text
    from comove.io.folders import check_target, whole_folder
    from comove.model.resting import require_no_rest
    from comove.planning import SceneKind
    from comove.results import RESULT
    from comove.results.inputs import write_inputs
    from comove.robots.kernels import load_robot_kernels
    from comove.robots.online.executor import JointExecutor, OnlineSettings
    from comove.sim import GRASPS, Perturbation
    from comove.sim.engine import engine
    from comove.sim.live import run_live, steps_of
    from comove.sim.live_record import judge_run
    from comove.sim.pictures import FilmedRun
    from comove.sim.robot_runs import write_robot_run
    from comove.sim.settings import PLAN
    from comove.view.figures import Joints, draw_joints, save

    o.require_one_of(how.grasp, tuple(GRASPS), "grasp")
    if not LEAST_RATE <= how.rate <= LARGEST_RATE:
        raise OptionError(
            f"{how.rate:g} Hz are not possible",
            key="--rate",
            way_out=f"give {LEAST_RATE:g} to {LARGEST_RATE:g}",
        )
    if how.budget is not None:
        o.check_budget(how.budget)
    check_target(out, RESULT)
    settings, hold = OnlineSettings(period=1.0 / how.rate), GRASPS[how.grasp]()
    carrier, named = o.robot_named(robot, loaded, scene)
    engine()
    steps_of(settings.period)
    o.require_carried(carrier, loaded.standing(), scene)
    hold.moving([carrier.arm(name) for name in loaded.manipulators])
    with progress_bar():
        require_no_rest(loaded.require_free_ends())
        load_robot_kernels(SceneKind.of(loaded), "robot executions")
        executor = JointExecutor(loaded, carrier, seed=seed, settings=settings)
        drawn = None
        if how.perturbed is not None:
            drawn = Perturbation.drawn(np.random.default_rng(how.perturbed), len(carrier.joint_names))
        longest = how.budget or RUN_LONGEST * executor.plan.scene.duration
        record = run_live(executor, longest, hold, drawn)
        report = judge_run(record)
    with whole_folder(out, RESULT) as draft:
        failed = " (not as it should)" if report.reasons else ""
        title = f"{loaded.name}, {carrier.name}, online{failed}"
        save(draw_joints(Joints.of(carrier, record.motion), title=title), draft / "joints.png")
        summary = write_robot_run(
            draft, record, report, executor.log, seed=seed, wall_time_s=time_spent(), source=named
        )
        write_inputs(draft, loaded, files=carrier.files, command=command_words())
        if len(record.time) > 1 and (how.pictures or how.film):
            filmed = FilmedRun.of(record, GRASPS[how.grasp](), drawn or PLAN)
            from comove.cli.simulate import draw_robot_pictures

            draw_robot_pictures(filmed, draft, "robot_run", how.pictures, how.film)
    if json:
        print((out / "robot_run.json").read_text(encoding="utf-8"), end="")
    else:
        print(robot_run_text(summary, out))
    if record.interrupted:
        return INTERRUPTED
    return NOT_VERIFIED if report.reasons else VERIFIED

"""What `comove solve` and `comove run` do for a scene that names a robot: its joints are planned and verified."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from comove.cli import options as o
from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, command_words
from comove.cli.texts import say
from comove.errors import ComoveError, InputError, OptionError, RobotError
from comove.methods import OF_ROBOTS

if TYPE_CHECKING:
    from comove.robots import Robot, RobotSolution
    from comove.scenes import Scene
    from comove.sim.pictures import Filmed

RUN_LONGEST = 4.0  # times the plan's duration, that a run may last unless it is said
LEAST_RATE, USUAL_RATE, LARGEST_RATE = 50.0, 250.0, 500.0  # Hz, of control steps


@dataclass(frozen=True)
class Wanted:
    """Options of a robot's motion.

    Attributes
    ----------
    method, objective, resemblance, weights, library, demonstration : options of `comove solve`
    around : present joints, and which of approach and release there must be
    """

    method: str = "comove"
    objective: str | None = None
    resemblance: float | None = None
    weights: str | None = None
    library: Path | None = None
    demonstration: Path | None = None
    around: o.ApproachOptions = field(default_factory=o.ApproachOptions)


@dataclass(frozen=True)
class SimulatedRun:
    """Options of a robot's simulated run.

    Attributes
    ----------
    rate : control steps in a second [Hz]
    grasp : name of the grasp
    perturbed : seed of the perturbation; None for none
    budget : simulated time that it may last [s]; None for `RUN_LONGEST` times the plan's duration
    pictures, film : whether a sheet of pictures, and a film, are drawn
    """

    rate: float = USUAL_RATE
    grasp: str = "weld"
    perturbed: int | None = None
    budget: float | None = None
    pictures: bool = True
    film: bool = False


def names_robot(scene: Scene, robot: str | None, hands_alone: bool) -> bool:
    """Return whether a robot's joints are looked at: where the scene or the command names one.

    Raises
    ------
    OptionError
        If the command names a robot, and the hands alone.
    """
    if hands_alone and robot is not None:
        raise OptionError("a robot, and the hands alone", key="--hands-alone", way_out="give one of the two")
    return not hands_alone and (robot is not None or scene.file.robot is not None)


def solve_joints(
    loaded: Scene,
    scene: Path,
    out: Path,
    robot: str | None,
    wanted: Wanted,
    *,
    seed: int,
    budget: float,
    json: bool,
) -> int:
    """Find a motion that a robot can carry out, verify its joints, save and draw it; return the exit code.

    Parameters
    ----------
    loaded, scene : the scene, and its file
    out : folder for the result
    robot : name or description; what the scene says unless given
    """
    from comove.cli.progress import progress_bar, time_spent
    from comove.cli.solve import exit_code, load_views
    from comove.cli.texts import in_rows, joints_text, summary_text
    from comove.io.folders import check_target, whole_folder
    from comove.planning import SceneKind, check_method, movements_of
    from comove.results import RESULT
    from comove.robots import carry
    from comove.robots.kernels import load_robot_kernels
    from comove.robots.present import read_present

    chosen = o.method_named(wanted.method, OF_ROBOTS)
    smooth = wanted.method == "comove"
    o.check_budget(budget)
    check_target(out, RESULT)
    objective = o.objective_of(wanted.objective, wanted.resemblance, wanted.weights, loaded, smooth)
    carrier, named = robot_named(robot, loaded, scene)
    around = wanted.around
    present = None if around.present is None else read_present(around.present, carrier)
    with progress_bar(budget) as progress:
        check_method(loaded, chosen, objective)
        _require_carried(carrier, loaded.alternatives[0], scene)
        library, taught = o.movement_given(
            loaded, scene, wanted.demonstration, wanted.library, wanted.resemblance
        )
        movements, source = movements_of(taught, loaded), None
        loaded.require_free_ends()
        load_robot_kernels(SceneKind.of(loaded), beside=load_views)
        if library is not None:
            source, taught = o.from_library(library, loaded, chosen, seed, budget)
            movements = movements_of(taught, loaded)
        try:
            found = carry(
                loaded,
                carrier,
                demonstration=movements,
                seed=seed,
                method=None if smooth else chosen,
                budget=budget,
                progress=progress,
                objective=objective,
                present=present,
                approach=around.approach or around.transfers,
                release=around.release or around.transfers,
            )
        except InputError as error:
            at_fault = around.present if error.key == "present" else scene
            error.file = error.file or at_fault or scene
            raise
    from comove.view.figures import save_robot_result

    solution = found.solution
    with whole_folder(out, RESULT) as draft:
        summary = save_robot_result(
            found,
            draft,
            wall_time_s=time_spent(),
            demonstration=movements,
            source=named,
            command=command_words(),
        )
    if json:
        print((out / "solution.json").read_text(encoding="utf-8"), end="")
        return exit_code(solution) or (NOT_VERIFIED if found.without else VERIFIED)
    print(summary_text(summary, out, scene=solution.scene))
    print(joints_text(carrier.name, vars(found.report)))
    rows = [] if source is None else [("demonstration", f"{source} of {wanted.library}")]
    rows.append(("joint motion", f"{out / 'joints.npz'}, drawn in {out / 'joints.png'}"))
    print(*in_rows([*rows, *_transfer_rows(found)]), sep="\n")
    for reason in found.without:
        say(f"  - {reason}")
    return exit_code(solution) or (NOT_VERIFIED if found.without else VERIFIED)


def _transfer_rows(found: RobotSolution) -> list[tuple[str, str]]:
    """Return in words which of approach and release were found, and how long they take."""
    planned, where = found.transfers, "home" if found.present is None else "the present joints"
    rows = []
    if planned is not None and planned.approach is not None:
        rows.append(("approach", f"{planned.approach.duration:.2f} s, from {where}"))
    if planned is not None and planned.release is not None:
        rows.append(("release", f"{planned.release.duration:.2f} s, to home"))
    return [*rows, *([("missing", "what was asked for and not found:")] if found.without else [])]


def _require_carried(robot: Robot, choice: Scene, scene: Path) -> None:
    """Refuse a scene that no robot carries, or not this one; `choice` is the scene with one of its grasps."""
    from comove.robots import RobotCarrier

    try:
        RobotCarrier(robot, choice)
    except InputError as error:
        error.file = error.file or scene
        raise


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
    """Let a robot carry a scene's load in MuJoCo, step by step, record and verify it; return the exit code.

    Parameters
    ----------
    loaded, scene, out, robot : as of `solve_joints`
    """
    import numpy as np

    from comove.cli.progress import progress_bar, time_spent
    from comove.cli.texts import robot_run_text
    from comove.io.folders import check_target, whole_folder
    from comove.planning import SceneKind
    from comove.results import RESULT
    from comove.results.inputs import write_inputs
    from comove.robots.kernels import load_robot_kernels
    from comove.robots.online.executor import JointExecutor, OnlineSettings
    from comove.scenes.resting import require_no_rest
    from comove.sim import GRASPS, Perturbation
    from comove.sim.engine import engine
    from comove.sim.live import run_live, steps_of
    from comove.sim.live_record import judge_run
    from comove.sim.pictures import FilmedRun
    from comove.sim.robot_runs import write_robot_run
    from comove.sim.settings import PLAN
    from comove.view.figures import draw_joints, save

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
    carrier, named = robot_named(robot, loaded, scene)
    engine()
    steps_of(settings.period)
    _require_carried(carrier, loaded.standing().alternatives[0], scene)
    hold.moving([carrier.arm(name) for name in loaded.manipulators])
    with progress_bar():
        require_no_rest(loaded.require_free_ends())
        load_robot_kernels(SceneKind.of(loaded))
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
        save(draw_joints(carrier, record.motion, title=title), draft / "joints.png")
        summary = write_robot_run(
            draft, record, report, executor.log, seed=seed, wall_time_s=time_spent(), source=named
        )
        write_inputs(draft, loaded, files=carrier.files, command=command_words())
        if len(record.time) > 1 and (how.pictures or how.film):
            filmed = FilmedRun.of(record, GRASPS[how.grasp](), drawn or PLAN)
            draw_robot_pictures(filmed, draft, "robot_run", how.pictures, how.film)
    if json:
        print((out / "robot_run.json").read_text(encoding="utf-8"), end="")
    else:
        print(robot_run_text(summary, out))
    if record.interrupted:
        return INTERRUPTED
    return NOT_VERIFIED if report.reasons else VERIFIED


def draw_robot_pictures(filmed: Filmed, folder: Path, name: str, pictures: bool, film: bool) -> None:
    """Draw a sheet of pictures, and a film, into a folder; warn where nothing can be drawn."""
    from comove.sim.pictures import draw_film, draw_sheet

    try:
        if pictures:
            draw_sheet(filmed, folder / f"{name}.png")
        if film:
            draw_film(filmed, folder / f"{name}.mp4")
    except ComoveError as error:  # the result counts without them
        say(f"warning: no pictures: {error}", file=sys.stderr)


def robot_named(name: str | None, scene: Scene, file: Path) -> tuple[Robot, str | Path]:
    """Return the robot named by the command line, or else by the scene, and its description's name or path."""
    from comove.robots import Robot, bundled_robots, find_description

    named = name if name is not None else scene.file.robot
    if named is None:
        raise RobotError(
            "neither the scene nor the command names a robot",
            file=file,
            key="robot",
            way_out=f"add robot: NAME to the scene or give --robot; bundled: {', '.join(bundled_robots())}",
        )
    try:
        path = find_description(named, None if name is not None else file.parent)
    except RobotError as error:
        error.file, error.key = (file, "robot") if name is None else (error.file, "--robot")
        raise
    return Robot.load(path), named if named in bundled_robots() else path

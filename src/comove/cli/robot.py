"""The verbs of `comove robot`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, command_words, sub_application, verb_of
from comove.cli.texts import say
from comove.errors import ComoveError, InputError, OptionError, ResultError, RobotError

if TYPE_CHECKING:
    from comove.robots import Robot
    from comove.scenes import Scene

group = sub_application("robot", "Robots that carry the load: solve, simulate, export, send.")

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of `comove robot solve`.")]
RobotName = Annotated[
    str | None,
    typer.Option(help="A bundled robot's name, or a description (YAML); what SCENE says unless given."),
]
GraspName = Annotated[str, typer.Option(help="How the hands hold the load: weld, connect, friction.")]
RUN_LONGEST = 4.0  # times the plan's duration, that a run may last unless it is said
METHODS = ("comove", "paper", "task-priority")
FORMATS = ("baxter-csv", "csv", "npz", "rosbag1", "rosbag2", "mcap")
PARTS = ("carry", "approach", "release")


@verb_of(group)
def solve(
    scene: o.SceneFile,
    out: o.ResultFolder,
    robot: RobotName = None,
    seed: o.Seed = 0,
    method: Annotated[str, typer.Option(help=f"One of: {', '.join(METHODS)}.")] = "comove",
    budget: o.Budget = 30.0,
    objective: Annotated[
        str | None,
        typer.Option(help="As of 'comove solve'; 'least-jerk' unless SCENE or this says something else."),
    ] = None,
    resemblance: Annotated[
        float | None, typer.Option(help="How near to the demonstration, as of 'comove solve'.")
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(metavar="GOAL,VELOCITY,OBSTACLE", help="Weights of equation (4) for 'paper'."),
    ] = None,
    library: Annotated[
        Path | None,
        typer.Option(
            help="Folder of primitives: the one that suits SCENE best is taken for its demonstration; "
            "the method 'paper' combines several for one hand."
        ),
    ] = None,
    *,
    limits: o.SceneLimits,
    json: o.AsJson = False,
) -> int:
    """Find a motion for SCENE that a robot can carry out, judge its joints, save and draw it."""
    from comove.cli.progress import progress_bar, time_spent
    from comove.cli.solve import exit_code, load_views
    from comove.cli.texts import in_rows, joints_text, summary_text
    from comove.io.folders import check_target, whole_folder
    from comove.planning import SceneKind, movements_of
    from comove.primitives import Library
    from comove.results import RESULT
    from comove.robots import carry
    from comove.robots.kernels import load_robot_kernels
    from comove.scenes import Scene, demonstration_of

    chosen = o.method_named(method, METHODS)
    smooth = method == "comove"
    o.check_budget(budget)
    check_target(out, RESULT)
    with progress_bar(budget) as progress:
        loaded = Scene.load(scene, limits.changes)
        load_robot_kernels(SceneKind.of(loaded), beside=load_views)
        wanted = o.objective_of(objective, resemblance, weights, loaded, smooth)
        carrier, named = robot_named(robot, loaded, scene)
        source, demonstration = None, demonstration_of(loaded)
        if library is not None:
            source, demonstration = o.from_library(Library(library), loaded, chosen, seed, budget)
        movements = movements_of(demonstration, loaded)
        o.require_demonstration(resemblance, movements, scene)
        try:
            found = carry(
                loaded,
                carrier,
                demonstration=movements,
                seed=seed,
                method=None if smooth else chosen,
                budget=budget,
                progress=progress,
                objective=wanted,
            )
        except InputError as error:
            error.file = error.file or scene
            raise
    from comove.views import save_robot_result

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
        return exit_code(solution)
    print(summary_text(summary, out))
    print(joints_text(carrier.name, found.report.asdict()))
    rows = [] if source is None else [("demonstration", f"{source} of {library}")]
    rows.append(("joint motion", f"{out / 'joints.npz'}, drawn in {out / 'joints.png'}"))
    print(*in_rows(rows), sep="\n")
    return exit_code(solution)


@verb_of(group)
def simulate(
    folder: Folder,
    grasp: GraspName = "weld",
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            help="Draw friction, mass, gains, the load's place in the hands and a push from this seed; "
            "as planned unless given.",
        ),
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Draw a sheet of pictures.")] = True,
    film: Annotated[bool, typer.Option("--film", help="Draw a film as well (MP4, or GIF).")] = False,
) -> int:
    """Play the motion in DIR with MuJoCo: servos, contacts, slip, forces on the load."""
    import numpy as np

    from comove.cli.texts import in_rows, simulation_text
    from comove.io.files import require_target
    from comove.robots import verified_motion
    from comove.simulators import (
        GRASPS,
        Perturbation,
        draw_film,
        draw_sheet,
        simulate,
        write_simulation,
    )

    o.require_one_of(grasp, tuple(GRASPS), "grasp")
    motion = verified_motion(folder)
    require_target(folder / "simulation.npz", ResultError)
    robot = motion.robot
    drawn = None if seed is None else Perturbation.drawn(np.random.default_rng(seed), len(robot.joint_names))
    execution = simulate(motion.joints, motion.scene, robot, GRASPS[grasp](), drawn)
    summary = write_simulation(execution, folder, seed=seed)
    print(simulation_text(summary, folder))
    if pictures or film:
        try:
            if pictures:
                draw_sheet(execution, folder / "simulation.png")
                print(*in_rows([("pictures", str(folder / "simulation.png"))]))
            if film:
                print(*in_rows([("film", str(draw_film(execution, folder / "simulation.mp4")))]))
        except ComoveError as error:  # what was simulated counts without them
            say(f"warning: no pictures: {error}", file=sys.stderr)
    return VERIFIED if summary["delivered"] else NOT_VERIFIED


@verb_of(group)
def export(
    folder: Folder,
    format: Annotated[
        str | None,
        typer.Option(help=f"One of: {', '.join(FORMATS)}; baxter-csv for a Baxter, else csv, unless given."),
    ] = None,
    rate: Annotated[float, typer.Option(help="Samples a second, 20 or more.")] = 100.0,
    transfers: Annotated[
        bool | None,
        typer.Option(
            help="Also the motions from home to the grasp and from there home; unless said, where there are any."
        ),
    ] = None,
) -> int:
    """Judge the motion in DIR anew and write it there in a format that robots play."""
    from comove.export import FORMATS as KINDS
    from comove.export import check_export, export, usual_format
    from comove.robots import plan_transfers, verified_motion

    if format is not None:
        o.require_one_of(format, FORMATS, "format")
    motion = verified_motion(folder)
    kind = usual_format(motion) if format is None else KINDS[format]
    check_export(motion, folder, kind, rate=rate, transfers=transfers is not False)
    planned = None
    try:
        planned = None if transfers is False else plan_transfers(motion)
    except RobotError as error:
        if transfers:
            raise
        say(f"warning: the carry alone is exported: {error}", file=sys.stderr)
    written = export(motion, folder, kind, rate=rate, transfers=planned)
    say(f"{motion.scene.name}, {motion.robot.name}: verified, exported for {kind.what}")
    for path in written:
        say(f"  {path}")
    return 0


@verb_of(group)
def send(
    folder: Folder,
    part: Annotated[str, typer.Option(help=f"One of: {', '.join(PARTS)}.")] = "carry",
    start_tolerance: Annotated[
        float, typer.Option(help="How far a joint may be from the motion's start [rad].")
    ] = 0.01,
    path_tolerance: Annotated[
        float, typer.Option(help="How far a joint may be from the motion while it runs [rad].")
    ] = 0.2,
    timeout: Annotated[float, typer.Option(help="How long to wait for the robot [s].")] = 5.0,
) -> int:
    """Judge the motion in DIR anew and let a robot play it over ROS 1, both arms in step."""
    from comove.export import Ros1Client, SendError, Tolerances, send
    from comove.robots import plan_transfers, verified_motion

    o.require_one_of(part, PARTS, "part")
    given = {"--start-tolerance": start_tolerance, "--path-tolerance": path_tolerance, "--timeout": timeout}
    for option, value in given.items():
        if not 0 < value < float("inf"):
            raise OptionError(f"{value} is not possible", key=option, way_out="give a positive number")
    tolerances = Tolerances(start=start_tolerance, path=path_tolerance, connect=timeout)
    motion = verified_motion(folder)
    transfers = None if part == "carry" else plan_transfers(motion)
    try:
        with Ros1Client() as client:
            outcome = send(client, motion, part=part, transfers=transfers, tolerances=tolerances)
    except SendError as error:
        if error.outcome is None:  # nothing has moved
            raise
        say(f"stopped: {error}", file=sys.stderr)
        return NOT_VERIFIED
    say(
        f"{motion.scene.name}: {part} done, arms {1e3 * outcome.apart:.0f} ms apart at the end, "
        f"{outcome.deviation:.3g} rad from the motion at most"
    )
    return VERIFIED


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
    from comove.results.inputs import write_inputs
    from comove.robots.kernels import load_robot_kernels
    from comove.robots.online.executor import JointExecutor, OnlineSettings
    from comove.scenes import Scene
    from comove.simulators import GRASPS, Perturbation
    from comove.simulators.live import run_live
    from comove.simulators.live_record import judge_run
    from comove.simulators.robot_runs import write_robot_run
    from comove.views import draw_joints, save

    o.require_one_of(grasp, tuple(GRASPS), "grasp")
    if not 50.0 <= rate <= 500.0:
        raise OptionError(f"{rate:g} Hz are not possible", key="--rate", way_out="give 50 to 500")
    if budget is not None:
        o.check_budget(budget)
    check_target(out, RESULT)
    loaded = Scene.load(scene)
    carrier, named = robot_named(robot, loaded, scene)
    with progress_bar():
        load_robot_kernels(SceneKind.of(loaded))
        executor = JointExecutor(loaded, carrier, seed=seed, settings=OnlineSettings(period=1.0 / rate))
        drawn = None
        if perturbed is not None:
            drawn = Perturbation.drawn(np.random.default_rng(perturbed), len(carrier.joint_names))
        record = run_live(
            executor, budget or RUN_LONGEST * executor.plan.scene.duration, GRASPS[grasp](), drawn
        )
        report = judge_run(record)
    with whole_folder(out, RESULT) as draft:
        title = f"{loaded.name}, {carrier.name}, online" + (
            "" if not report.reasons else " (not as it should)"
        )
        save(draw_joints(carrier, record.motion, title=title), draft / "joints.png")
        summary = write_robot_run(
            draft, record, report, executor.log, seed=seed, wall_time_s=time_spent(), source=named
        )
        write_inputs(draft, loaded, files=carrier.files, command=command_words())
    if json:
        print((out / "robot_run.json").read_text(encoding="utf-8"), end="")
    else:
        print(robot_run_text(summary, out))
    if record.interrupted:
        return INTERRUPTED
    return NOT_VERIFIED if report.reasons else VERIFIED


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

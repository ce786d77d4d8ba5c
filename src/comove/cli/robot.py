"""The verbs of `comove robot`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, sub_application, verb_of
from comove.cli.texts import say
from comove.errors import OptionError, ResultError, RobotError
from comove.methods import OF_ROBOTS

group = sub_application("robot", "Robots that carry the load: solve, simulate, export, send.")

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of `comove robot solve`.")]
RobotName = Annotated[
    str | None,
    typer.Option(help="A bundled robot's name, or a description (YAML); what SCENE says unless given."),
]
GraspName = Annotated[str, typer.Option(help="How the hands hold the load: weld, connect, friction.")]
FORMATS = ("baxter-csv", "csv", "npz", "rosbag1", "rosbag2", "mcap")
PARTS = ("carry", "approach", "release")


@verb_of(group)
def solve(
    scene: o.SceneFile,
    out: o.ResultFolder,
    robot: RobotName = None,
    seed: o.Seed = 0,
    method: Annotated[str, typer.Option(help=f"One of: {', '.join(OF_ROBOTS)}.")] = "comove",
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
    """Find a motion for SCENE that a robot can carry out, verify its joints, save and draw it; as 'comove solve'."""
    from comove.cli.joints import Wanted, solve_joints
    from comove.cli.progress import progress_bar
    from comove.scenes import Scene

    o.check_budget(budget)
    with progress_bar():
        loaded = Scene.load(scene, limits.changes, check_ends=False)
    wanted = Wanted(method, objective, resemblance, weights, library)
    return solve_joints(loaded, scene, out, robot, wanted, seed=seed, budget=budget, json=json)


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
    *,
    trusted: o.Trusted,
) -> int:
    """Play the motion in DIR with MuJoCo: servos, contacts, slip, forces on the load."""
    import numpy as np

    from comove.cli.joints import draw_robot_pictures
    from comove.cli.texts import simulation_text
    from comove.io.files import require_target
    from comove.simulators import GRASPS, Perturbation, simulate, write_simulation

    o.require_one_of(grasp, tuple(GRASPS), "grasp")
    motion = trusted.verified(folder)
    require_target(folder / "simulation.npz", ResultError)
    robot = motion.robot
    drawn = None if seed is None else Perturbation.drawn(np.random.default_rng(seed), len(robot.joint_names))
    execution = simulate(motion.joints, motion.scene, robot, GRASPS[grasp](), drawn)
    summary = write_simulation(execution, folder, seed=seed)
    draw_robot_pictures(execution, folder, "simulation", pictures, film)
    print(simulation_text(summary, folder))
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
    *,
    trusted: o.Trusted,
) -> int:
    """Judge the motion in DIR anew and write it there in a format that robots play."""
    from comove.cli.texts import in_rows
    from comove.export import FORMATS as KINDS
    from comove.export import check_export, export, usual_format
    from comove.results.words import gripper_rows
    from comove.robots import plan_transfers

    if format is not None:
        o.require_one_of(format, FORMATS, "format")
    motion = trusted.verified(folder)
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
    for row in in_rows(gripper_rows(motion.report.without_gripper)):
        say(row)
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
    *,
    trusted: o.Trusted,
) -> int:
    """Judge the motion in DIR anew and let a robot play it over ROS 1, both arms in step."""
    from comove.export import Ros1Client, SendError, Tolerances, send
    from comove.robots import plan_transfers

    o.require_one_of(part, PARTS, "part")
    given = {"--start-tolerance": start_tolerance, "--path-tolerance": path_tolerance, "--timeout": timeout}
    for option, value in given.items():
        if not 0 < value < float("inf"):
            raise OptionError(f"{value} is not possible", key=option, way_out="give a positive number")
    tolerances = Tolerances(start=start_tolerance, path=path_tolerance, connect=timeout)
    motion = trusted.verified(folder)
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
    pictures: Annotated[bool, typer.Option(help="Draw a sheet of pictures.")] = True,
    film: Annotated[bool, typer.Option("--film", help="Draw a film as well (MP4, or GIF).")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print robot_run.json and nothing else.")] = False,
) -> int:
    """Let a robot carry SCENE's load in MuJoCo, step by step among obstacles that move; as 'comove run'."""
    from comove.cli.joints import SimulatedRun, run_joints
    from comove.cli.progress import progress_bar
    from comove.scenes import Scene

    with progress_bar():
        loaded = Scene.load(scene, check_ends=False)
    how = SimulatedRun(rate, grasp, perturbed, budget, pictures, film)
    return run_joints(loaded, scene, out, robot, how, seed=seed, json=json)

"""The verbs of `comove robot`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli.app import NOT_VERIFIED, VERIFIED, sub_application, verb_of
from comove.cli.texts import say
from comove.errors import OptionError, ResultError
from comove.methods import OF_ROBOTS

if TYPE_CHECKING:
    from comove.robots import VerifiedJointMotion
    from comove.robots.present import Joints
    from comove.robots.transfers import Transfers

group = sub_application("robot", "Robots that carry the load: solve, simulate, export, send.")

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Result folder of `comove robot solve`.")]
RobotName = Annotated[
    str | None,
    typer.Option(help="A bundled robot's name, or a description (YAML); what SCENE says unless given."),
]
GraspName = Annotated[str, typer.Option(help="How the hands hold the load: weld, connect, friction.")]
FORMATS = ("baxter-csv", "csv", "npz", "rosbag1", "rosbag2", "mcap")
PARTS = ("carry", "approach", "release")
CARRY = PARTS[0]


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
    around: o.ApproachOptions,
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
    wanted = Wanted(method, objective, resemblance, weights, library, around=around)
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
    from comove.sim import GRASPS, Perturbation, simulate, write_simulation

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
            help="Also the motions to the grasp and from there home, both or neither; unless said, those found."
        ),
    ] = None,
    approach: Annotated[bool, typer.Option("--approach", help="Also the motion to the grasp.")] = False,
    release: Annotated[bool, typer.Option("--release", help="Also the motion from the grasp home.")] = False,
    present: o.PresentFile = None,
    *,
    trusted: o.Trusted,
) -> int:
    """Verify the motion in DIR anew and write it there in a format that robots play."""
    from comove.cli.texts import in_rows
    from comove.robots.transfers import possible_transfers
    from comove.ros import FORMATS as KINDS
    from comove.ros import check_export, export, usual_format
    from comove.stored import gripper_rows

    if format is not None:
        o.require_one_of(format, FORMATS, "format")
    if transfers is not None and (approach or release):
        key = "--approach" if approach else "--release"
        raise OptionError(
            "--transfers is both, --no-transfers neither", key=key, way_out="leave one of the options out"
        )
    strict = bool(transfers or approach or release)
    both = transfers or (transfers is None and not strict)
    approach, release = both or approach, both or release
    _require_approach(present, approach)
    motion = trusted.verified(folder)
    kind = usual_format(motion) if format is None else KINDS[format]
    parts = [CARRY, *(["approach"] if approach else []), *(["release"] if release else [])]
    check_export(motion, folder, kind, rate=rate, parts=parts)
    planned: Transfers | None = None
    if len(parts) > 1:
        begin = _present(folder, motion, present)
        planned, errors = possible_transfers(motion, approach=approach, release=release, present=begin)
        for error in errors.values():
            if strict:
                raise error
            what = (
                "the carry alone is exported" if planned is None else "one of approach and release is missing"
            )
            say(f"warning: {what}: {error}", file=sys.stderr)
    written = export(motion, folder, kind, rate=rate, transfers=planned)
    say(f"{motion.scene.name}, {motion.robot.name}: verified, exported for {kind.what}")
    for row in in_rows(gripper_rows(motion.report.without_gripper)):
        say(row)
    for path in written:
        say(f"  {path}")
    return 0


def _require_approach(present: Path | None, approach: bool) -> None:
    """Refuse present joints where no approach begins at them."""
    if present is not None and not approach:
        raise OptionError(
            "no approach is asked for, which would begin there", key="--present", way_out="leave it out"
        )


def _present(folder: Path, motion: VerifiedJointMotion, file: Path | None) -> Joints | None:
    """Return the joints at which the approach begins: those of a file, or else those of the result folder."""
    from comove.robots.present import read_present, stored_present

    return stored_present(folder, motion.robot) if file is None else read_present(file, motion.robot)


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
    present: o.PresentFile = None,
    *,
    trusted: o.Trusted,
) -> int:
    """Verify the motion in DIR anew and let a robot play it over ROS 1, both arms in step."""
    from comove.robots import plan_transfers
    from comove.ros import Ros1Client, SendError, Tolerances, send

    o.require_one_of(part, PARTS, "part")
    given = {"--start-tolerance": start_tolerance, "--path-tolerance": path_tolerance, "--timeout": timeout}
    for option, value in given.items():
        if not 0 < value < float("inf"):
            raise OptionError(f"{value} is not possible", key=option, way_out="give a positive number")
    _require_approach(present, part == "approach")
    tolerances = Tolerances(start=start_tolerance, path=path_tolerance, connect=timeout)
    motion = trusted.verified(folder)
    transfers = None
    if part != CARRY:
        transfers = plan_transfers(
            motion,
            approach=part == "approach",
            release=part == "release",
            present=_present(folder, motion, present),
        )
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

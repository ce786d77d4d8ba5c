"""`comove solve`."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from comove.cli import options as o
from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, command_words, refuse_robot_options, verb
from comove.cli.drawing import add_pictures, drawing_ahead
from comove.cli.texts import HANDS_ALONE, in_rows, joints_text, pictures_row, say, summary_text
from comove.errors import InputError, OptionError
from comove.methods import METHODS, OF_ROBOTS

if TYPE_CHECKING:
    from comove.model import Scene
    from comove.planning import Solution
    from comove.robots import JointSolution


class ObstacleMode(StrEnum):
    """Treatment of obstacles: hard constraints, or a term of objective (4)."""

    constraint = "constraint"
    cost = "cost"


@verb
def solve(
    scene: o.SceneFile,
    out: o.ResultFolder,
    seed: o.Seed = 0,
    method: Annotated[
        str,
        typer.Option(
            help=f"One of: {', '.join(METHODS)}; with a robot one of: {', '.join(OF_ROBOTS)}.",
        ),
    ] = "comove",
    no_planner: Annotated[
        bool, typer.Option("--no-planner", help="Do not start from a planned path; without a robot.")
    ] = False,
    budget: o.Budget = 30.0,
    obstacles: Annotated[
        ObstacleMode,
        typer.Option(help="Obstacles as hard constraints, or as a cost only; constraints with a robot."),
    ] = ObstacleMode.constraint,
    objective: Annotated[
        str | None,
        typer.Option(
            help="What the motion shall be best in: 'least-jerk' is smooth, 'least-time' as fast as limits allow, "
            "'paper' is equation (4). What SCENE says unless given, else 'least-jerk'; 'least-time' where SCENE has "
            "neither duration nor demonstration; 'paper' for other methods, with --no-planner and --obstacles cost."
        ),
    ] = None,
    weights: Annotated[
        str | None,
        typer.Option(
            metavar="GOAL,VELOCITY,OBSTACLE",
            help="Weights of equation (4) for 'paper'; 1,0.01,10 unless given.",
        ),
    ] = None,
    resemblance: Annotated[
        float | None,
        typer.Option(
            help="How near to the demonstration: between 0 and 1 for 'least-jerk' (0.7 unless given), its weight in "
            "the cost for 'paper' (0 unless given)."
        ),
    ] = None,
    library: Annotated[
        Path | None,
        typer.Option(
            help="Folder of primitives: the one that suits SCENE best is taken for its demonstration; "
            "the methods 'single' and 'paper' combine several."
        ),
    ] = None,
    demonstration: Annotated[
        Path | None,
        typer.Option(
            help="A recording, a folder of recordings of one movement (lasa:SHAPE:all), or a primitive, instead of "
            "what SCENE says. Of several recordings the motion keeps to what they agree in."
        ),
    ] = None,
    effort: Annotated[
        o.EffortMode,
        typer.Option(
            help="How hard the search tries to better a verified motion: 'quick' makes one path smooth, 'normal' "
            "several, 'thorough' three times as many."
        ),
    ] = o.EffortMode.normal,
    robot: o.RobotName = None,
    hands_alone: o.HandsAlone = False,
    *,
    around: o.ApproachOptions,
    limits: o.SceneLimits,
    json: o.AsJson = False,
    no_pictures: Annotated[bool, typer.Option("--no-pictures", help="Draw no pictures.")] = False,
) -> int:
    """Find a verified motion for SCENE, save it and draw it. If SCENE names a robot, its joint motion is found
    too."""
    o.require_one_of(method, tuple(METHODS), "method")
    o.check_budget(budget)
    if limits.duration is not None and objective == "least-time":
        raise OptionError(
            "a duration, and the least one",
            key="--duration",
            way_out="give one of --duration and --objective",
        )
    if demonstration is not None and library is not None:
        raise OptionError(
            "a demonstration, and a library", key="--demonstration", way_out="give one of the two"
        )
    with drawing_ahead(not no_pictures) as drawer:
        import comove
        from comove.cli.progress import progress_bar, time_spent
        from comove.dmp import ProMP
        from comove.io.folders import check_target, identity_of, whole_folder
        from comove.model import Scene
        from comove.planning import SceneKind, check_method, load_kernels, movements_of
        from comove.results import RESULT
        from comove.view.figures import Pictures, save_result

        hard = obstacles is ObstacleMode.constraint
        smooth = method == "comove" and not no_planner and hard
        check_target(out, RESULT)
        with progress_bar():
            loaded = Scene.load(scene, limits.changes, check_ends=False)
        arms: Any = False  # none
        source: str | Path | None = None
        of_robot: dict[str, Any] = {}
        if o.names_robot(loaded, robot, hands_alone):
            _require_joints(robot or loaded.file.robot, method, no_planner, hard)
            arms, source = o.robot_named(robot, loaded, scene)
            of_robot = around.wanted(arms)
        else:
            refuse_robot_options(
                "no robot's joints are looked at, which it needs",
                "name a robot by --robot, without --hands-alone, or leave it out",
            )
        chosen = o.method_named(method)
        wanted = o.objective_of(objective, resemblance, weights, loaded, smooth)
        with progress_bar(budget) as progress:
            part = chosen.scene_of(loaded)
            check_method(part, chosen, wanted, planner=not no_planner, hard=hard)
            if arms:
                o.require_carried(arms, loaded, scene)
            known, taught = o.movement_given(loaded, scene, demonstration, library, resemblance)
            movements, named = movements_of(taught, part), ""
            loaded.require_free_ends()
            if known is not None and method == "single":
                from comove.lab.compared import Single

                chosen = Single(movements=known)
            elif known is not None:
                load_kernels(SceneKind.of(loaded))
                named, taught = o.from_library(known, loaded, chosen, seed, budget)
                movements = movements_of(taught, part)
            try:
                solution = comove.solve(
                    loaded,
                    robot=arms,
                    demonstration=taught if isinstance(taught, ProMP) else movements,
                    seed=seed,
                    method=None if arms and smooth else chosen,
                    planner=not no_planner,
                    budget=budget,
                    objective=wanted,
                    obstacles=obstacles.value,
                    effort=effort.value,
                    progress=progress,
                    **of_robot,
                )
            except InputError as error:
                if arms:
                    at_fault = around.present if error.key == "present" else scene
                    error.file = error.file or at_fault or scene
                raise
        with whole_folder(out, RESULT) as draft:
            summary = save_result(
                solution,
                draft,
                wall_time_s=time_spent(),
                source=source,
                command=command_words(),
                pictures=False,
            )
            identity = identity_of(draft)
        if json:
            print((out / "solution.json").read_text(encoding="utf-8"), end="", flush=True)
        else:
            _say_solution(solution, summary, out, loaded, f"{named} of {library}" if named else "")
        if not no_pictures:
            drawn = movements if arms or not smooth or solution.followed is not None else None
            add_pictures(Pictures.of(solution, drawn), out, identity, drawer)
    if not json and (rows := in_rows(pictures_row(out, "motion", "progress", "joints"))):
        say(*rows)
    return exit_code(solution)


def _say_solution(
    solution: Solution, summary: Mapping[str, Any], out: Path, asked: Scene, named: str
) -> None:
    """Print the summary of a solution and of its joint motion."""
    is_alone = solution.joints is None and solution.verified and asked.file.robot is not None
    print(summary_text(summary, out, HANDS_ALONE if is_alone else "", solution.scene))
    rows = [("demonstration", named)] if named else []
    if asked.file.choices is not None:
        from comove.arrays import listed
        from comove.model.files.upgrade import held_at

        held = (f"{name} at {listed(at, 4)}" for name, at in held_at(solution.scene.file).items())
        rows += [("grasps taken", ", ".join(held))]
    if solution.joints is not None:
        print(joints_text(solution.joints.robot.name, vars(solution.joints.report)))
        rows += [("joint motion", str(out / "joints.npz")), *_transfer_rows(solution.joints)]
    if rows:
        print(*in_rows(rows), sep="\n")
    for reason in () if solution.joints is None else solution.joints.without:
        say(f"  - {reason}")
    sys.stdout.flush()


def _require_joints(named: str | None, method: str, no_planner: bool, hard: bool) -> None:
    """Refuse options with which a robot's joints cannot be found."""
    way_out = "leave it out, or look at the --hands-alone"
    if method not in OF_ROBOTS:
        raise OptionError(
            f"the method '{method}' moves hands alone, and the robot is '{named}'",
            key="--method",
            way_out=f"use {', '.join(OF_ROBOTS)}, or look at the --hands-alone",
        )
    if no_planner:
        raise OptionError(f"the joints of '{named}' need a planned path", key="--no-planner", way_out=way_out)
    if not hard:
        raise OptionError(
            f"obstacles are constraints of the robot '{named}'", key="--obstacles", way_out=way_out
        )


def _transfer_rows(found: JointSolution) -> list[tuple[str, str]]:
    """Return rows on the approach and release that were found."""
    planned, where = found.transfers, "home" if found.present is None else "the present joints"
    rows = []
    if planned is not None and planned.approach is not None:
        rows.append(("approach", f"{planned.approach.duration:.2f} s, from {where}"))
    if planned is not None and planned.release is not None:
        rows.append(("release", f"{planned.release.duration:.2f} s, to home"))
    return [*rows, *([("missing", "what was asked for and not found:")] if found.without else [])]


def exit_code(solution: Solution) -> int:
    """Return the exit code of a solution."""
    if solution.interrupted:
        return INTERRUPTED
    missing = solution.joints is not None and solution.joints.without
    return VERIFIED if solution.verified and not missing else NOT_VERIFIED

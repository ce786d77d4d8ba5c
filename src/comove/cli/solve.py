"""`comove solve`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli import options as o
from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, command_words, verb
from comove.cli.texts import HANDS_ALONE
from comove.errors import OptionError
from comove.methods import METHODS, OF_ROBOTS

if TYPE_CHECKING:
    from comove.planning import Solution
    from comove.scenes import Scene


class ObstacleMode(StrEnum):
    """The ways in which obstacles enter: as hard constraints, or as a term of the objective (4)."""

    constraint = "constraint"
    cost = "cost"


@verb
def solve(
    scene: o.SceneFile,
    out: o.ResultFolder,
    seed: o.Seed = 0,
    method: Annotated[str, typer.Option(help=f"One of: {', '.join(METHODS)}.")] = "comove",
    no_planner: Annotated[
        bool, typer.Option("--no-planner", help="Do not start from a planned path.")
    ] = False,
    budget: o.Budget = 30.0,
    obstacles: Annotated[
        ObstacleMode, typer.Option(help="Obstacles as hard constraints, or as a cost only.")
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
            "the method 'single' combines several."
        ),
    ] = None,
    demonstration: Annotated[
        Path | None,
        typer.Option(
            help="A recording, a folder of recordings of one movement (lasa:SHAPE:all), or a primitive, instead of "
            "what SCENE says. Of several recordings the motion keeps to what they agree in."
        ),
    ] = None,
    robot: Annotated[
        str | None,
        typer.Option(
            help="The robot whose joints carry it out: a bundled one's name, or a description (YAML); what SCENE "
            "says unless given."
        ),
    ] = None,
    hands_alone: Annotated[
        bool,
        typer.Option(
            "--hands-alone",
            help="Look at the hands alone, though SCENE names a robot: no joint is verified then.",
        ),
    ] = False,
    *,
    around: o.ApproachOptions,
    limits: o.SceneLimits,
    json: o.AsJson = False,
) -> int:
    """Find a verified motion for SCENE, and the joints of the robot that it names, save it and draw it."""
    from comove.cli.joints import Wanted, names_robot, solve_joints
    from comove.cli.progress import progress_bar, time_spent
    from comove.cli.texts import in_rows, summary_text
    from comove.dmp import ProMP
    from comove.io.folders import check_target, whole_folder
    from comove.planning import SceneKind, check_method, load_kernels, movements_of, solve
    from comove.results import RESULT
    from comove.scenes import Scene

    o.require_one_of(method, tuple(METHODS), "method")
    o.check_budget(budget)
    smooth = method == "comove" and not no_planner and obstacles is ObstacleMode.constraint
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
    check_target(out, RESULT)
    with progress_bar():
        loaded = Scene.load(scene, limits.changes, check_ends=False)
    if names_robot(loaded, robot, hands_alone):
        _require_joints(loaded, robot, method, no_planner, obstacles)
        how = Wanted(method, objective, resemblance, weights, library, demonstration, around)
        return solve_joints(loaded, scene, out, robot, how, seed=seed, budget=budget, json=json)
    if around.given:
        raise OptionError(
            "no robot's joints are looked at, which it needs",
            key=around.given[0],
            way_out="name a robot by --robot, without --hands-alone, or leave it out",
        )
    chosen = o.method_named(method)
    wanted = o.objective_of(objective, resemblance, weights, loaded, smooth)
    hard = obstacles is ObstacleMode.constraint
    with progress_bar(budget) as progress:
        part = chosen.scene_of(loaded)
        check_method(part, chosen, wanted, planner=not no_planner, hard=hard)
        known, taught = o.movement_given(loaded, scene, demonstration, library, resemblance)
        movements, source = movements_of(taught, part), None
        loaded.require_free_ends()
        load_kernels(SceneKind.of(loaded), beside=load_views)
        if known is not None and method == "single":
            from comove.lab.compared import Single

            chosen = Single(movements=known)
        elif known is not None:
            source, taught = o.from_library(known, loaded, chosen, seed, budget)
            movements = movements_of(taught, part)
        solution = solve(
            loaded,
            demonstration=taught if isinstance(taught, ProMP) else movements,
            seed=seed,
            method=chosen,
            planner=not no_planner,
            budget=budget,
            objective=wanted,
            obstacles=obstacles.value,
            progress=progress,
        )
    from comove.view.figures import save_result

    with whole_folder(out, RESULT) as draft:
        drawn = None if smooth and solution.followed is None else movements
        summary = save_result(
            solution, draft, wall_time_s=time_spent(), demonstration=drawn, command=command_words()
        )
    if json:
        print((out / "solution.json").read_text(encoding="utf-8"), end="")
    else:
        verdict = HANDS_ALONE if solution.verified and loaded.file.robot is not None else ""
        print(summary_text(summary, out, verdict, loaded))
        if source is not None:
            print(*in_rows([("demonstration", f"{source} of {library}")]))
    return exit_code(solution)


def _require_joints(
    loaded: Scene, robot: str | None, method: str, no_planner: bool, obstacles: ObstacleMode
) -> None:
    """Refuse options by which a robot's joints cannot be found."""
    named, way_out = robot or loaded.file.robot, "leave it out, or look at the --hands-alone"
    if method not in OF_ROBOTS:
        raise OptionError(
            f"the method '{method}' moves hands alone, and the robot is '{named}'",
            key="--method",
            way_out=f"use {', '.join(OF_ROBOTS)}, or look at the --hands-alone",
        )
    if no_planner:
        raise OptionError(f"the joints of '{named}' need a planned path", key="--no-planner", way_out=way_out)
    if obstacles is not ObstacleMode.constraint:
        raise OptionError(
            f"obstacles are constraints of the robot '{named}'", key="--obstacles", way_out=way_out
        )


def load_views() -> None:
    """Load what pictures of a result need, so that a search does not wait for it."""
    from comove.view.figures import draw_joints, draw_motion  # noqa: F401


def exit_code(solution: Solution) -> int:
    """Return the exit code that tells of a solution."""
    if solution.interrupted:
        return INTERRUPTED
    return VERIFIED if solution.verified else NOT_VERIFIED

"""`comove robot solve`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, verb_of
from comove.cli.changes import Acceleration, Clearance, Duration, Jerk, Speed, changes_of
from comove.cli.robot.app import robot_app

SAVING = 2.0  # s, kept back from the budget for the files and pictures
METHODS = ("comove", "paper")


@verb_of(robot_app)
def solve(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).")],
    out: Annotated[Path, typer.Option(help="Folder for the result.")],
    robot: Annotated[
        str | None,
        typer.Option(help="A bundled robot's name, or a description (YAML); what SCENE says unless given."),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0,
    method: Annotated[str, typer.Option(help=f"One of: {', '.join(METHODS)}.")] = "comove",
    budget: Annotated[
        float,
        typer.Option(
            help="Seconds after which the best so far is taken; compiling, once after installation, is apart."
        ),
    ] = 30.0,
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
    duration: Duration = None,
    speed: Speed = None,
    acceleration: Acceleration = None,
    jerk: Jerk = None,
    clearance: Clearance = None,
    json: Annotated[bool, typer.Option("--json", help="Print solution.json and nothing else.")] = False,
) -> int:
    """Find a motion for SCENE that a robot can carry out, judge its joints, save and draw it."""
    from comove.cli.progress import progress_bar
    from comove.cli.robot.report import joints_text, of_scene, robot_named
    from comove.cli.show import summary_text
    from comove.cli.solve import (
        LIBRARY_SHARE,
        budget_left,
        check_budget,
        from_library,
        method_named,
        objective_of,
        require_taught,
        write_result,
    )
    from comove.planning import load_kernels, movements_of
    from comove.primitives import Library
    from comove.results import check_target, whole_folder
    from comove.robots import carry, write_joints
    from comove.scenes import Scene, demonstration_of
    from comove.views import draw_joints, save

    chosen = method_named(method, METHODS)
    smooth = method == "comove"
    check_budget(budget)
    check_target(out)
    with progress_bar(budget) as progress:
        loaded = Scene.load(scene, changes_of(duration, speed, acceleration, jerk, clearance))
        wanted = objective_of(objective, resemblance, weights, loaded, smooth)
        carrier, named = robot_named(robot, loaded, scene)
        source, taught = None, demonstration_of(loaded)
        if library is not None:
            source, taught = from_library(Library(library), loaded, chosen, seed, LIBRARY_SHARE * budget)
        dmp = movements_of(taught, loaded)
        require_taught(resemblance, dmp, scene)
        load_kernels(loaded.n_dims, bool(loaded.moving.any()))
        with of_scene(scene):
            found = carry(
                loaded,
                carrier,
                demonstration=dmp,
                seed=seed,
                method=None if smooth else chosen,
                budget=budget_left(budget, SAVING, loaded),
                progress=progress,
                objective=wanted,
            )
    solution = found.solution
    with whole_folder(out) as draft:
        summary = write_result(solution, draft, dmp)
        write_joints(draft, found.joints, found.verdict, carrier, solution.attempt, source=named)
        title = f"{loaded.name}, {carrier.name}" + ("" if solution.verified else " (not verified)")
        save(draw_joints(carrier, found.joints, title=title), draft / "joints.png")
    if json:
        print((out / "solution.json").read_text(encoding="utf-8"), end="")
    else:
        print(summary_text(summary, out))
        print(joints_text(carrier.name, found.report.asdict()))
        if source is not None:
            print(f"  {'demonstration':24s}{source} of {library}")
        print(f"  {'joint motion':24s}{out / 'joints.npz'}, drawn in {out / 'joints.png'}")
    if solution.interrupted:
        return INTERRUPTED
    return VERIFIED if solution.verified else NOT_VERIFIED

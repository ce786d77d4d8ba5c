"""`comove solve`."""

from __future__ import annotations

import time
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, verb
from comove.errors import OptionError, near_name

SAVING = 1.2  # s, kept back from the budget for files and pictures
DRAWING = 0.002  # s, for every obstacle drawn
SLOWEST = 4.0  # times as long as processor time that it is expected to take
METHODS = ("comove", "projection", "paper")
COMPARED = ("unconstrained", "leader-follower", "speed-scaled", "task-priority", "single")


class ObstacleMode(StrEnum):
    """How obstacles enter: as hard constraints, or as a term of the objective (4)."""

    constraint = "constraint"
    cost = "cost"


@verb
def solve(
    scene: Annotated[Path, typer.Argument(metavar="SCENE", help="Scene file (YAML).")],
    out: Annotated[Path, typer.Option(help="Folder for the result.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of all random numbers.")] = 0,
    method: Annotated[str, typer.Option(help=f"One of: {', '.join((*METHODS, *COMPARED))}.")] = "comove",
    no_planner: Annotated[
        bool, typer.Option("--no-planner", help="Do not start from a planned path.")
    ] = False,
    budget: Annotated[
        float,
        typer.Option(
            help="Seconds after which the best so far is taken; compiling, once after installation, is apart."
        ),
    ] = 30.0,
    obstacles: Annotated[
        ObstacleMode, typer.Option(help="Obstacles as hard constraints, or as a cost only.")
    ] = ObstacleMode.constraint,
    objective: Annotated[
        str | None,
        typer.Option(
            help="What the motion shall be best in: 'least-jerk' is smooth, 'paper' is equation (4). The former "
            "unless given; the latter for other methods, with --no-planner and --obstacles cost."
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
    json: Annotated[bool, typer.Option("--json", help="Print solution.json and nothing else.")] = False,
) -> int:
    """Find a verified motion for SCENE, save it and draw it."""
    from comove.cli.progress import progress_bar
    from comove.planning import best_movement, load_kernels, solve
    from comove.primitives import Library
    from comove.results import check_target, whole_folder
    from comove.scenes import Scene
    from comove.scenes.model import canonical
    from comove.views import draw_motion  # noqa: F401  what the pictures need is loaded before the search

    chosen = method_named(method)
    check_budget(budget)
    smooth = method == "comove" and not no_planner and obstacles is ObstacleMode.constraint
    wanted = objective_named(objective or ("least-jerk" if smooth else "paper"), resemblance)
    check_target(out)
    with progress_bar(budget) as progress:
        loaded = Scene.load(scene)
        chosen_movement = None
        if library is not None and method == "single":
            chosen = replace(chosen, movements=Library(library))
        elif library is not None:
            source = loaded.file.demonstration
            plane = None if source is None else source.plane
            chosen_movement = best_movement(Library(library), loaded, plane=plane, budget=0.25 * budget).best
        dmp = loaded.taught if chosen_movement is None else chosen_movement.dmp
        if resemblance and dmp is None:
            raise OptionError(
                "the scene has no demonstration to resemble",
                file=scene,
                key="--resemblance",
                way_out="add a demonstration to the scene",
            )
        load_kernels(loaded.n_dims, bool(loaded.moving.any()))
        solution = solve(
            loaded,
            demonstration=dmp,
            seed=seed,
            method=chosen,
            planner=not no_planner,
            budget=budget_left(budget, SAVING, loaded),
            objective=wanted,
            obstacles=obstacles.value,
            progress=progress,
        )
    with whole_folder(out) as draft:
        summary = write_result(solution, draft, None if smooth and solution.followed is None else dmp)
        if solution.scene is not loaded:  # what was judged, so that `comove verify` can judge it again
            (draft / "scene.json").write_bytes(canonical(solution.scene.file) + b"\n")
    if json:
        print((out / "solution.json").read_text(encoding="utf-8"), end="")
    else:
        from comove.cli.show import summary_text

        print(summary_text(summary, out))
        if chosen_movement is not None:
            print(f"  demonstration           {chosen_movement.name} of {library}")
    if solution.interrupted:
        return INTERRUPTED
    return VERIFIED if solution.verified else NOT_VERIFIED


def budget_left(budget: float, saving: float, scene) -> float:
    """What is left of a budget for the search [s], half of it at least.

    Kept back is what saving takes, more where there is much to draw and where others use the machine as well.
    """
    from comove.cli.progress import time_spent

    spent = time_spent()
    slower = min(max(spent / time.process_time(), 1.0), SLOWEST)
    return max(0.5 * budget, budget - spent - slower * (saving + DRAWING * len(scene.obstacles)))


def check_budget(budget: float) -> None:
    """Refuse a budget that is no time."""
    if not 0 < budget < float("inf"):
        raise OptionError(f"budget = {budget}", key="--budget", way_out="give a positive number of seconds")


def objective_named(name: str, resemblance: float | None):
    """The objective of a name, with a resemblance to the demonstration where one was given."""
    from comove.planning import LeastJerk, PaperCost

    objectives = {"paper": PaperCost, "least-jerk": LeastJerk}
    if name not in objectives:
        raise OptionError(
            f"unknown objective '{name}'", key="--objective", way_out=near_name(name, objectives)
        )
    try:
        return objectives[name]() if resemblance is None else objectives[name](resemblance=resemblance)
    except OptionError as error:
        raise OptionError(error.message, key="--resemblance", way_out=error.way_out) from None


def method_named(name: str):
    """The method object of a name."""
    from comove.planning import Comove, Paper, Projection
    from comove.planning.compared import LeaderFollower, Single, SpeedScaled, TaskPriority, Unconstrained

    kinds = (Comove, Projection, Paper, Unconstrained, LeaderFollower, SpeedScaled, TaskPriority, Single)
    methods = {kind.name: kind for kind in kinds}
    if name not in methods:
        raise OptionError(f"unknown method '{name}'", key="--method", way_out=near_name(name, methods))
    return methods[name]()


def write_result(solution, folder: Path, dmp=None) -> dict:
    """Files and pictures of a solution; returns the contents of solution.json."""
    from comove.cli.progress import time_spent
    from comove.planning import carried_demonstration
    from comove.results import write_solution
    from comove.views import draw_motion, draw_progress, save

    scene, motion = solution.scene, solution.attempt
    title = scene.name if solution.verified else f"{scene.name} (not verified)"
    taught = None if dmp is None else carried_demonstration(dmp, scene)
    save(draw_motion(motion, title=title, demonstration=taught), folder / "motion.png")
    save(draw_progress(motion), folder / "progress.png")
    return write_solution(solution, folder, time_spent())

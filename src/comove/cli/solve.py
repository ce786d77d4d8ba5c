"""`comove solve`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from comove.cli.app import INTERRUPTED, NOT_VERIFIED, VERIFIED, verb
from comove.cli.changes import Acceleration, Clearance, Duration, Jerk, Speed, changes_of
from comove.errors import OptionError, near_name

if TYPE_CHECKING:
    from comove.planning.method import Method
    from comove.primitives import DMP, Library
    from comove.scenes import Scene

SAVING = 1.2  # s, kept back from the budget for files and pictures
DRAWING = 0.002  # s, for every obstacle drawn
LIBRARY_SHARE = 0.25  # of the budget, for what comes from a library
SLOWEST = 4.0  # times as long as processor time that it is expected to take
METHODS = ("comove", "projection", "paper", "printed")
COMPARED = ("unconstrained", "leader-follower", "speed-scaled", "task-priority", "single")


class ObstacleMode(StrEnum):
    """The ways in which obstacles enter: as hard constraints, or as a term of the objective (4)."""

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
    duration: Duration = None,
    speed: Speed = None,
    acceleration: Acceleration = None,
    jerk: Jerk = None,
    clearance: Clearance = None,
    json: Annotated[bool, typer.Option("--json", help="Print solution.json and nothing else.")] = False,
) -> int:
    """Find a verified motion for SCENE, save it and draw it."""
    from comove.cli.progress import progress_bar
    from comove.planning import load_kernels, movements_of, solve
    from comove.primitives import Library
    from comove.results import check_target, whole_folder
    from comove.scenes import Scene, demonstration_of
    from comove.scenes.model import canonical
    from comove.views import draw_motion  # noqa: F401  what the pictures need is loaded before the search

    chosen = method_named(method)
    check_budget(budget)
    smooth = method == "comove" and not no_planner and obstacles is ObstacleMode.constraint
    if duration is not None and objective == "least-time":
        raise OptionError(
            "a duration, and the least one",
            key="--duration",
            way_out="give one of --duration and --objective",
        )
    check_target(out)
    with progress_bar(budget) as progress:
        changes = changes_of(duration, speed, acceleration, jerk, clearance)
        loaded = Scene.load(scene, changes)
        wanted = objective_of(objective, resemblance, weights, loaded, smooth)
        if library is not None and method == "single":
            chosen = replace(chosen, movements=Library(library))
        solved = chosen.scene_of(loaded)
        source, taught = None, demonstration_of(loaded)
        if library is not None and method != "single":
            source, taught = from_library(Library(library), loaded, chosen, seed, LIBRARY_SHARE * budget)
        dmp = movements_of(taught, solved)
        require_taught(resemblance, dmp, scene)
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
        if changes or solution.scene is not loaded:  # what was judged
            (draft / "scene.json").write_bytes(canonical(solution.scene.file) + b"\n")
    if json:
        print((out / "solution.json").read_text(encoding="utf-8"), end="")
    else:
        from comove.cli.show import summary_text

        print(summary_text(summary, out))
        if source is not None:
            print(f"  demonstration           {source} of {library}")
    if solution.interrupted:
        return INTERRUPTED
    return VERIFIED if solution.verified else NOT_VERIFIED


def from_library(library: Library, scene: Scene, method: Method, seed: int, budget: float) -> tuple[str, DMP]:
    """Return a description of the movement that a library offers for a scene, and the movement itself.

    The paper's pipeline (III) combines several movements for one hand in the environment, after [6], and gives the
    result to all hands; the paper's methods get this movement. Other methods get the single movement that suits best.
    """
    from comove.experiments.compared.single import alone
    from comove.planning import Paper, Printed, best_movement, combine

    taught = scene.file.demonstration
    plane = None if taught is None else taught.plane
    if isinstance(method, (Paper, Printed)):
        found = combine(library, alone(scene), seed=seed, budget=budget, plane=plane)
        if found.interrupted:
            raise KeyboardInterrupt
        return f"a combination of {', '.join(found.names)}", found.dmp
    best = best_movement(library, scene, plane=plane, budget=budget).best
    return best.name, best.dmp


def require_taught(resemblance: float | None, dmp: object, scene: Path) -> None:
    """Raise if a resemblance is given but there is no demonstration."""
    if resemblance and dmp is None:
        raise OptionError(
            "the scene has no demonstration to resemble",
            file=scene,
            key="--resemblance",
            way_out="add a demonstration to the scene",
        )


def budget_left(budget: float, saving: float, scene) -> float:
    """Return the part of a budget that is left for the search [s], at least half of it.

    The time for saving is kept back; it is longer if there is much to draw, or if others use the machine as well.
    """
    from comove.cli.progress import time_spent

    spent = time_spent()
    slower = min(max(spent / time.process_time(), 1.0), SLOWEST)
    return max(0.5 * budget, budget - spent - slower * (saving + DRAWING * len(scene.obstacles)))


def check_budget(budget: float) -> None:
    """Raise if a budget is not a positive, finite time."""
    if not 0 < budget < float("inf"):
        raise OptionError(f"budget = {budget}", key="--budget", way_out="give a positive number of seconds")


def objective_of(name: str | None, resemblance: float | None, weights: str | None, scene, smooth: bool):
    """Return the objective named by the command line, or else by the scene; None if `solve` shall choose.

    Parameters
    ----------
    smooth : whether the method finds smooth motions; otherwise smooth objectives of the scene are ignored
    """
    from comove.planning import LeastJerk, LeastTime, PaperCost
    from comove.planning.objectives import objective_of_scene

    kinds = {"least-jerk": LeastJerk, "least-time": LeastTime, "paper": PaperCost}
    if name is not None and name not in kinds:
        raise OptionError(f"unknown objective '{name}'", key="--objective", way_out=near_name(name, kinds))
    said = objective_of_scene(scene.file.objective)
    if not smooth and not isinstance(said, PaperCost):
        said = None
    if name is not None and not isinstance(said, kinds[name]):
        said = kinds[name]()
    if resemblance is not None or weights is not None:
        said = said or (LeastJerk() if smooth and weights is None else PaperCost())
    if weights is not None:
        if not isinstance(said, PaperCost):
            raise OptionError(
                "they belong to equation (4)", key="--weights", way_out="give --objective paper as well"
            )
        said = replace(said, **_weights(weights))
    if resemblance is None:
        return said
    if isinstance(said, LeastTime):
        raise OptionError(
            "least time looks at no demonstration", key="--resemblance", way_out="leave one of the two out"
        )
    try:
        return replace(said, resemblance=resemblance)
    except OptionError as error:
        raise OptionError(error.message, key="--resemblance", way_out=error.way_out) from None


def _weights(text: str) -> dict[str, float]:
    """Return the weights of equation (4) by name."""
    try:
        goal, velocity, obstacle = map(float, text.split(","))
    except ValueError:
        raise OptionError(
            f"'{text}' is not three numbers", key="--weights", way_out="write them as 1,0.01,10"
        ) from None
    return {"goal": goal, "velocity": velocity, "obstacle": obstacle}


def method_named(name: str, known: Sequence[str] = (*METHODS, *COMPARED)) -> Method:
    """Return the method with the given name, one of those `known`."""
    from comove.experiments.compared import LeaderFollower, Single, SpeedScaled, TaskPriority, Unconstrained
    from comove.planning import Comove, Paper, Printed, Projection

    own = (Comove, Projection, Paper, Printed)
    compared = (Unconstrained, LeaderFollower, SpeedScaled, TaskPriority, Single)
    methods = {kind.name: kind for kind in (*own, *compared) if kind.name in known}
    if name not in methods:
        raise OptionError(f"unknown method '{name}'", key="--method", way_out=near_name(name, methods))
    return methods[name]()


def write_result(solution, folder: Path, dmp=None) -> dict:
    """Write the files and pictures of a solution; return the contents of solution.json."""
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

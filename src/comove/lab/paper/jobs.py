"""Single runs of the reproduction: a method on a scene, from a movement."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from comove.dmp import DMP
from comove.dmp.operations import in_space
from comove.lab.compared import LeaderFollower, Single, SpeedScaled, TaskPriority, Unconstrained
from comove.lab.evolution import Paper, Printed, Projection
from comove.lab.examples import example
from comove.lab.paper.measures import Along, Measures, follow, measure
from comove.model import Scene
from comove.model.motion import CoordinatedMotion
from comove.planning import Comove, PaperCost, SceneKind, load_kernels, solve
from comove.planning.method import Method

PLANE = "xy"  # in which planar movements are laid into spatial scenes


@dataclass(frozen=True)
class Contender:
    """Method in the comparison, with its conditions.

    Attributes
    ----------
    method : method that solves the scenes
    planner : whether it may start from a planned path
    random : whether its result depends on the seed
    acceleration : limit of acceleration in its scenes and their verification [m/s^2]; None for the scene's own
    """

    method: Method
    planner: bool = True
    random: bool = True
    acceleration: float | None = None


CONTENDERS = {
    "comove": Contender(Comove()),
    "comove, 1 m/s²": Contender(Comove(), acceleration=1.0),
    "comove without planner": Contender(Comove(), planner=False),
    "projection": Contender(Projection()),
    "paper": Contender(Paper()),
    "unconstrained [22]": Contender(Unconstrained()),
    "leader-follower [7]": Contender(LeaderFollower(), random=False),
    "speed-scaled [8]": Contender(SpeedScaled()),
    "task-priority [5]": Contender(TaskPriority(), random=False),
}
"""Those of the large table, by the names in it."""

OTHERS = {
    "single [6]": Contender(Single()),
    "printed": Contender(Printed()),
    "paper without schedules": Contender(Paper(narrowing=False, growing=False)),
    "paper, 4 basis functions": Contender(Paper(n_basis=4)),
    "paper, 16 basis functions": Contender(Paper(n_basis=16)),
    "paper, 32 basis functions": Contender(Paper(n_basis=32)),
    "right hand leads": Contender(LeaderFollower(leader="right"), random=False),
    "both follow": Contender(LeaderFollower(mutual=True), random=False),
}


def title_of(who: str) -> str:
    """Return the name of a contender on the page."""
    return "paper's method" if who == "paper" else who


@dataclass(frozen=True)
class Job:
    """Settings of a run.

    Attributes
    ----------
    purpose : figure or table for which it is run
    scene : name of an example; "open" is `wide` without its obstacles
    who : name of a contender
    movement : name of the movement from which it begins
    taught : this movement, or one for each end effector by its name; None for straight lines. A planar movement is
        laid into the plane `PLANE` of a spatial scene
    seed : seed of all random numbers
    budget : processor time after which the best motion so far is used [s]
    tolerance : tolerance of distances [m]; by default the scene's own
    acceleration : limit of the end effectors [m/s^2]; by default the contender's, or the scene's own
    velocity : c_vel of equation (4)
    gap : distance between the two walls of the scene [m]; by default the scene's own
    resemblance : weight of the movement's shape in the cost
    obstacles : hard constraints, or a term of the cost
    keep : whether the motion itself is kept too
    keep_failed : whether it is kept where it is not verified
    """

    purpose: str
    scene: str
    who: str
    movement: str
    taught: DMP | Mapping[str, DMP] | None = field(default=None, repr=False, compare=False)
    seed: int = 0
    budget: float = 60.0
    tolerance: float | None = None
    acceleration: float | None = None
    velocity: float = 0.01
    gap: float | None = None
    resemblance: float = 0.0
    obstacles: Literal["constraint", "cost"] = "constraint"
    keep: bool = False
    keep_failed: bool = False


@dataclass(frozen=True)
class Outcome:
    """Result of a job. The motion, its errors along the path and the method's log are kept only on request."""

    job: Job
    measures: Measures
    along: Along | None = None
    motion: CoordinatedMotion | None = None
    log: Mapping[str, Any] = field(default_factory=dict)


def run(job: Job) -> Outcome:
    """Solve a job and measure its motion."""
    contender = (CONTENDERS | OTHERS)[job.who]
    scene = scene_of(
        job.scene,
        tolerance=job.tolerance,
        acceleration=job.acceleration or contender.acceleration,
        gap=job.gap,
    )
    taught = job.taught
    if isinstance(taught, DMP) and taught.n_dims < scene.n_dims:
        taught = in_space(taught, PLANE)
    solution = solve(
        scene,
        demonstration=taught,
        seed=job.seed,
        method=contender.method,
        planner=contender.planner,
        budget=job.budget,
        objective=PaperCost(velocity=job.velocity, resemblance=job.resemblance),
        obstacles=job.obstacles,
    )
    if solution.interrupted:
        raise KeyboardInterrupt
    measures = measure(solution)
    if not job.keep:
        failed = job.keep_failed and not measures.verified
        return Outcome(job, measures, motion=solution.attempt if failed else None)
    return Outcome(job, measures, follow(solution.attempt, job.velocity), solution.attempt, solution.log)


def scene_of(
    name: str,
    *,
    tolerance: float | None = None,
    acceleration: float | None = None,
    gap: float | None = None,
) -> Scene:
    """Return an example with another tolerance, acceleration [m/s^2] or gap [m]."""
    scene = example("wide" if name == "open" else name)
    data = scene.file.model_dump(exclude_defaults=True)
    if name == "open":
        data["obstacles"] = []
    if tolerance is not None:
        first, second = data["manipulators"][:2]
        distance = {"type": "distance", "distance": data["load"]["length"], "tolerance": tolerance}
        data["constraints"] = [{**distance, "between": [first["name"], second["name"]]}]
    if acceleration is not None:
        data["limits"] = {**data.get("limits", {}), "acceleration": acceleration}
    if gap is not None:
        data["obstacles"] = _apart(data["obstacles"], gap)
    return Scene.from_dict(data, folder=scene.folder)


def _apart(walls: list[dict[str, Any]], gap: float) -> list[dict[str, Any]]:
    """Move two boxes to the distance `gap` [m] of their inner faces. The second one is above the first."""
    low, high = (np.array([wall["center"][1], wall["size"][1]]) for wall in walls)
    moved, middle = [], (low[0] + low[1] / 2 + high[0] - high[1] / 2) / 2
    for wall, (center, size), side in zip(walls, (low, high), (-1, 1), strict=True):
        inner, outer = middle + side * gap / 2, center + side * size / 2
        center, size = float((inner + outer) / 2), float(abs(outer - inner))
        moved.append(wall | {"center": [wall["center"][0], center], "size": [wall["size"][0], size]})
    return moved


def warm_up() -> None:
    """Load the compiled code, so that measured times exclude compilation."""
    load_kernels(SceneKind(2))
    for contender in (CONTENDERS | OTHERS).values():
        method, planner = contender.method, contender.planner
        solve(example("narrow"), method=method, planner=planner, budget=0.3)

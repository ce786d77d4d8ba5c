"""All runs of the reproduction, and how they are asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from comove.coordination.coordinates import arms_coordinates
from comove.coordination.motion import CoordinatedDMP, CoordinatedMotion
from comove.demonstrations import Demonstration
from comove.execution import Executor, compare
from comove.execution.comparison import Compared
from comove.experiments.examples import example
from comove.experiments.paper.jobs import CONTENDERS, Job, Outcome, run, warm_up
from comove.experiments.paper.measures import Measures, measure_motion
from comove.experiments.workers import run_all
from comove.planning import load_kernels
from comove.planning.seeds import minimum_jerk
from comove.primitives import DMP, motion_basis

SCENES = ("wide", "narrow", "complex")
STRAIGHT = "none"
BAND = 0.002  # m, within which the paper's method holds the distance in its figures: a hundredth of it
GAIT = {"velocity": 0.2, "acceleration": 1.0}
"""c_vel and the limit of accelerations [m/s^2] in Figures 3 to 6, with which movements take all of their time."""
RESEMBLANCE = 10.0
PRINTED_SEEDS, PRINTED_BUDGET = 5, 10.0  # of the method as printed, and of that without schedules
MOVEMENT_SEEDS, MOVEMENT_BUDGET = 2, 20.0  # in the table of movements
FEW = 0.1  # seeds in the small tables, for one of the large table; and budgets shrink in a quick look
ROLES = {
    "leader-follower [7]": "left leads",
    "right hand leads": "right leads",
    "both follow": "both follow",
}
"""Who leads, by contender."""
MOVEMENT_CONTENDERS = ("comove", "comove without planner", "paper")
MOVING_LIMIT = 3.0  # times the scene's duration, that an execution may last
RECORDED = {
    "line": None,
    "curve": None,
    "Angle": ("Angle", 0),
    "Sine": ("Sine", 0),
    "Sshape": ("Sshape", 0),
    "Multi_Models_3": ("Multi_Models_3", 6),
}
"""The movements: two synthetic ones, and recordings of handwriting (LASA shape and number)."""
TWO = ("Sine", "Angle")
"""What the left and the right hand are taught where they are to begin uncoordinated."""
STORY = {"wide": "Sine", "narrow": "Sine", "complex": "Multi_Models_3"}
"""The movement with which everybody begins in the large table, by scene."""


@dataclass(frozen=True)
class Encounter:
    """Figures of one execution among moving obstacles.

    Attributes
    ----------
    method : as in `comove.execution.comparison`
    distance_error, clearance : bounds over all instants [m]
    tolerance : of the distance [m]
    arrived : whether it came to its goal
    """

    method: str
    distance_error: float
    clearance: float
    tolerance: float
    arrived: bool


@dataclass(frozen=True, eq=False)
class Runs:
    """What all runs gave.

    Attributes
    ----------
    seeds : how many, in the large table
    outcomes : of all jobs; ("joint") of what is taught jointly in the wide passage; and ("given") of the initial
        movement of one hand as it is given to both there, before any optimisation
    encounters, compared : among moving obstacles: figures, and what is drawn
    recorded : the human movement of Figure 1, its primitive, and what it is when it is given to both hands
    """

    seeds: int
    outcomes: tuple[Outcome, ...]
    encounters: tuple[Encounter, ...]
    compared: tuple[Compared, ...] = ()
    recorded: tuple[Demonstration, DMP, CoordinatedMotion] | None = None

    def of(self, purpose: str, **asked: object) -> list[Outcome]:
        """Outcomes for a purpose whose jobs have these attributes."""
        return [
            outcome
            for outcome in self.outcomes
            if outcome.job.purpose == purpose
            and all(getattr(outcome.job, name) == value for name, value in asked.items())
        ]

    def one(self, purpose: str, **asked: object) -> Outcome:
        """The only such outcome."""
        (outcome,) = self.of(purpose, **asked)
        return outcome

    def measures(self, purpose: str, **asked: object) -> list[Measures]:
        """Figures of such outcomes."""
        return [outcome.measures for outcome in self.of(purpose, **asked)]

    def encounter(self, method: str) -> Encounter:
        """Figures of one method among moving obstacles."""
        (found,) = [e for e in self.encounters if e.method == method]
        return found


def run_everything(seeds: int, processes: int, tell: Callable[[str], None]) -> Runs:
    """Run everything.

    Parameters
    ----------
    seeds : how many, in the large table
    processes : how many runs at once
    tell : called with words on how far it is
    """
    tell("the initial movement of one hand")
    initial = run(Job("figure 3", "wide", "single [6]", STRAIGHT, keep=True, **GAIT))
    taught = movement_of(initial, 0)
    joint = run(Job("joint", "wide", "comove", "initial", taught, keep=True, tolerance=BAND, **GAIT))
    movements = movements_after(initial, joint)
    jobs = all_jobs(seeds, movements)
    step = max(1, len(jobs) // 20)

    def told(done: int) -> None:
        if done % step == 0 or done > len(jobs):
            tell(f"{done} of {len(jobs) + 1} runs")

    tell(f"{len(jobs) + 1} runs, {processes} at once; first the kernels are loaded")
    # Moving obstacles, with kernels of their own to load, go first.
    compared, *outcomes = run_all(_do, [None, *jobs], processes=processes, prepare=warm_up, tell=told)
    recording = example("narrow").demonstration
    given = given_to_both(movements["initial"], "wide")
    unchanged = Outcome(Job("given", "wide", "nobody", "initial"), measure_motion(given), None, given)
    return Runs(
        seeds=seeds,
        outcomes=(initial, joint, unchanged, *outcomes),
        encounters=tuple(_encounter(c) for c in compared),
        compared=tuple(compared),
        recorded=(recording, movements["Sine"], given_to_both(movements["Sine"], "narrow")),
    )


def movements_after(initial: Outcome, joint: Outcome) -> dict[str, DMP | dict[str, DMP] | None]:
    """All movements by name.

    None; the initial one of Figure 3; that of each hand as they were taught jointly in the wide passage; those
    recorded or made up; and two of these, another for each hand.
    """
    alone = {name: DMP.fit(recorded(name)) for name in RECORDED}
    hands = joint.motion.scene.manipulators
    return {
        STRAIGHT: None,
        "initial": movement_of(initial, 0),
        "joint": {name: movement_of(joint, i) for i, name in enumerate(hands)},
        "two": {name: alone[movement] for name, movement in zip(hands, TWO, strict=True)},
        **alone,
    }


def movement_of(outcome: Outcome, hand: int) -> DMP:
    """The movement of one hand, learned."""
    way = outcome.motion.trajectory()
    return DMP.fit(Demonstration(way.time, way.position[:, hand], f"{outcome.job.purpose}, hand {hand}"))


def recorded(name: str) -> Demonstration:
    """One of the `RECORDED` movements; the synthetic ones last a second and are a metre long."""
    if RECORDED[name] is not None:
        return Demonstration.from_lasa(*RECORDED[name])
    time = np.linspace(0.0, 1.0, 401)
    along = minimum_jerk(time)
    aside = 0.15 * np.sin(2 * np.pi * along) if name == "curve" else np.zeros_like(along)
    return Demonstration(time, np.stack([along, aside], axis=1), name)


def given_to_both(movement: DMP, scene: str) -> CoordinatedMotion:
    """One hand's movement as the coordinated primitive of both, before any optimisation (paper, III-B)."""
    loaded, basis = example(scene), motion_basis(30, "velocity")
    return CoordinatedDMP.from_demonstration(movement, loaded, arms_coordinates(loaded), basis).rollout()


def all_jobs(seeds: int, movements: dict[str, DMP | dict[str, DMP] | None]) -> list[Job]:
    """Everything but the initial movement, the longest first."""

    def job(purpose: str, scene: str, who: str, movement: str, **options: object) -> Job:
        return Job(purpose, scene, who, movement, movements[movement], **options)

    figure = {"tolerance": BAND, **GAIT}
    jobs = [job("three hands", "triangle", who, STRAIGHT) for who in ("comove", "paper")]
    jobs += [  # without a limit of accelerations, of which the paper knows nothing
        job(
            "printed",
            scene,
            who,
            "initial",
            seed=seed,
            **figure | {"acceleration": None},
            budget=PRINTED_BUDGET,
        )
        for who in ("printed", "paper without schedules")
        for scene in ("wide", "narrow")
        for seed in range(_few(seeds, PRINTED_SEEDS))
    ]
    jobs.append(job("figure 1", "narrow", "comove", "Sine", resemblance=RESEMBLANCE, keep=True))
    for who in ("paper", "comove"):
        for scene in ("wide", "narrow"):
            jobs.append(job("figure 4", scene, who, "initial", keep=True, **figure))
        jobs.append(job("figure 6", "complex", who, STORY["complex"], keep=True, **figure))
    jobs.append(job("figure 6", "narrow", "unconstrained [22]", "joint", keep=True, **figure))
    for who in (
        "comove",
        "unconstrained [22]",
        "leader-follower [7]",
        "speed-scaled [8]",
        "task-priority [5]",
    ):
        jobs.append(job("systems", "narrow", who, STRAIGHT, keep=True))
    jobs += [job("leaders", "open", who, "two", keep=True) for who in ROLES]
    jobs.append(job("obstacles in the cost", "narrow", "comove", STRAIGHT, obstacles="cost"))
    jobs += [
        job(
            *("movements", scene, who, movement),
            seed=seed,
            budget=MOVEMENT_BUDGET * min(1.0, FEW * seeds),
            resemblance=RESEMBLANCE if who == "comove" else 0.0,
        )
        for movement in RECORDED
        for scene in SCENES
        for who in MOVEMENT_CONTENDERS
        for seed in range(_few(seeds, MOVEMENT_SEEDS))
    ]
    jobs += [
        job("story", scene, who, STORY[scene], seed=seed)
        for scene in SCENES
        for who, contender in CONTENDERS.items()
        for seed in range(seeds if contender.random else 1)
    ]
    return jobs


def _few(seeds: int, most: int) -> int:
    return min(most, max(1, round(FEW * seeds)))


def _do(job: Job | None) -> Outcome | list[Compared]:
    """A job; or, for None, every way to deal with the moving obstacle of the example `turning`."""
    if job is not None:
        return run(job)
    load_kernels(2, True)
    scene = example("turning")
    budget = MOVING_LIMIT * scene.duration
    return compare(Executor(scene).run(budget), budget)[0]


def _encounter(one: Compared) -> Encounter:
    scene = one.record.scene
    return Encounter(
        method=one.method,
        distance_error=one.report.distance_error_max,
        clearance=one.report.clearance_min,
        tolerance=max(c.tolerance for c in scene.distances),
        arrived=one.arrived,
    )

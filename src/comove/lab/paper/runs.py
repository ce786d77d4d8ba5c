"""All runs of the reproduction, and queries on their results."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.control import Executor
from comove.dmp import DMP, motion_basis
from comove.dmp.demonstrations import Demonstration, lasa_names
from comove.errors import ResultError
from comove.lab.compared import single
from comove.lab.examples import example
from comove.lab.modulation.comparison import Compared, compare
from comove.lab.paper import baxter
from comove.lab.paper.jobs import CONTENDERS, Job, Outcome, run, scene_of, warm_up
from comove.lab.paper.measures import Along, Measures, measure_motion
from comove.model import recording_of
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import arms_coordinates, load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.planning import SceneKind, load_kernels
from comove.planning.seeds import minimum_jerk
from comove.processes import run_tasks
from comove.trajectory import interpolated

Movement = DMP | dict[str, DMP] | None
"""A movement, one for each hand by its name, or None for straight lines."""

SCENES = ("wide", "narrow", "complex")
STRAIGHT = "none"
INITIAL = {"wide": "initial", "complex": "winding"}
"""What a library's movements are combined to for one hand, by the environment in which it is (Figure 3)."""
GAIT: dict[str, Any] = {"velocity": 0.2, "acceleration": 1.0}
"""c_vel and the limit of accelerations [m/s^2] in Figures 3 to 6, with which movements take all of their time."""
RECORDING_SEEDS = dict.fromkeys(SCENES, 2) | {"triangle": 1}  # in the table of recordings, by scene
SENSITIVITY: dict[str, dict[str, dict[str, Any]]] = {
    "band of the distance [mm]": {
        "0.1": {"tolerance": 1e-4},
        "0.2": {},
        "0.5": {"tolerance": 5e-4},
        "2": {"tolerance": 2e-3},
    },
    "gap over length": {"0.35": {"gap": 0.07}, "0.5": {}, "0.65": {"gap": 0.13}, "0.8": {"gap": 0.16}},
    "basis functions": {
        "4": {"who": "paper, 4 basis functions"},
        "8": {},
        "16": {"who": "paper, 16 basis functions"},
        "32": {"who": "paper, 32 basis functions"},
    },
    "c_vel": {"0": {"velocity": 0.0}, "0.01": {}, "0.2": {"velocity": 0.2}, "1": {"velocity": 1.0}},
}
"""One thing changed at a time, for the paper's method in the narrow passage: how a job differs."""
ROLES = {
    "leader-follower [7]": "left leads",
    "right hand leads": "right leads",
    "both follow": "both follow",
}
"""Who leads, by contender."""
OTHER_SYSTEMS = ("unconstrained [22]", "leader-follower [7]", "speed-scaled [8]", "task-priority [5]")
MOVEMENT_CONTENDERS = ("comove", "comove without planner", "paper")
RECORDED: dict[str, tuple[str, int] | None] = {
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
AT_ONCE = ("Sine", "Sshape")
"""What the bar's middle and its direction follow where both hands were recorded at once, with the bar in them."""
SWING = np.pi / 6
"""How far the bar turns aside there [rad]."""
AT_ONCE_SCENES = ("open", "wide", "narrow")
STORY = {"wide": "Sine", "narrow": "Sine", "complex": "Multi_Models_3"}
"""The movement with which everybody begins in the large table, by scene."""


@dataclass(frozen=True)
class ReproductionPlan:
    """Numbers of a reproduction.

    Attributes
    ----------
    seeds : number of seeds in the large table
    small : seeds in the small tables, for one of the large table; budgets shrink alike in a quick look
    printed, movements, three_hands, sensitivity, baxter : most seeds of the method as printed and of that without
        schedules, in the table of movements, of three end effectors, for each changed setting, and of Baxter
    printed_budget, movements_budget : processor time of a run [s]
    at_once : number of simultaneous recordings of both end effectors, each the next one of both shapes
    fresh : first seed where others were used while the method was tuned
    band : error within which the paper's method holds the distance in its figures: a hundredth of it [m]
    resemblance : weight of a movement's shape in the cost, where it counts
    """

    seeds: int
    small: float = 0.1
    printed: int = 5
    movements: int = 2
    three_hands: int = 5
    sensitivity: int = 5
    baxter: int = 3
    printed_budget: float = 10.0
    movements_budget: float = 20.0
    at_once: int = 5
    fresh: int = 100
    band: float = 0.002
    resemblance: float = 10.0

    def few(self, most: int) -> range:
        """Return the seeds of a small table, `most` of them."""
        return range(min(most, max(1, round(self.small * self.seeds))))


@dataclass(frozen=True, eq=False)
class Runs:
    """Results of all runs.

    Attributes
    ----------
    plan : the numbers by which they were run
    outcomes : outcomes of all jobs. Those for "joint" are of the movements demonstrated jointly in the wide passage,
        for "given" of the initial movements of one end effector given to both, before any optimisation, for "as
        taught" of both end effectors recorded at once, for "straight" of the straight line of one end effector
    compared : executions among moving obstacles, by every method
    recorded : the human movement of Figure 1, its primitive, and the motion if it is given to both end effectors
    transports : Baxter's transports, by [5] as well; empty if `absent` names missing packages
    """

    plan: ReproductionPlan
    outcomes: tuple[Outcome, ...]
    compared: tuple[Compared, ...]
    recorded: tuple[Demonstration, DMP, CoordinatedMotion] | None = None
    transports: tuple[baxter.Transport, ...] = ()
    absent: str = ""

    def of(self, purpose: str, **asked: object) -> list[Outcome]:
        """Return the outcomes for a purpose with these job attributes."""
        return [
            outcome
            for outcome in self.outcomes
            if outcome.job.purpose == purpose
            and all(getattr(outcome.job, name) == value for name, value in asked.items())
        ]

    def one(self, purpose: str, **asked: object) -> Outcome:
        """Return the only outcome for a purpose with these job attributes."""
        (outcome,) = self.of(purpose, **asked)
        return outcome

    def motion(self, purpose: str, **asked: object) -> CoordinatedMotion:
        """Return the kept motion of the only such outcome."""
        motion = self.one(purpose, **asked).motion
        assert motion is not None, purpose
        return motion

    def along(self, purpose: str, **asked: object) -> Along:
        """Return the errors along that motion."""
        along = self.one(purpose, **asked).along
        assert along is not None, purpose
        return along

    def measures(self, purpose: str, **asked: object) -> list[Measures]:
        """Return the figures of such outcomes."""
        return [outcome.measures for outcome in self.of(purpose, **asked)]

    def carried(self, scene: str, who: str) -> list[baxter.Transport]:
        """Return Baxter's transports through a passage by a method. The first or drawn one is first."""
        return [t for t in self.transports if (t.passage.scene, t.passage.who) == (scene, who)]

    def encounter(self, method: str) -> Compared:
        """Return the execution of one method among moving obstacles."""
        (found,) = [one for one in self.compared if one.method == method]
        return found


def run_everything(plan: ReproductionPlan, processes: int, tell: Callable[[str], None]) -> Runs:
    """Run all jobs of the reproduction.

    Parameters
    ----------
    plan : numbers of seeds, budgets and bands
    processes : number of runs at the same time
    tell : function called with words on the progress
    """
    tell("the initial movements of one hand")
    initial = [run(Job("figure 3", scene, "single [6]", STRAIGHT, keep=True, **GAIT)) for scene in INITIAL]
    alone = {INITIAL[outcome.job.scene]: movement_of(outcome, 0) for outcome in initial}
    joint = run(
        Job("joint", "wide", "comove", "initial", alone["initial"], keep=True, tolerance=plan.band, **GAIT)
    )
    alone |= {name: DMP.fit(recorded(name)) for name in RECORDED}
    jobs, absent = all_jobs(plan, movements_after(alone, joint, plan)), baxter.missing()
    passages = [] if absent else baxter_passages(plan)
    step, n = max(1, len(jobs) // 20), 1 + len(passages) + len(jobs)

    def told(done: int) -> None:
        if done % step == 0 or done == n:
            tell(f"{done} of {n} runs")

    tell(f"{n} runs, {processes} at once; first the kernels are loaded")
    # Moving obstacles and arms, with kernels of their own to load, go first.
    done = _all_done([None, *passages, *jobs], processes, told)
    (compared,) = (found for found in done if isinstance(found, list))
    searched = (found for found in done if isinstance(found, Outcome))
    recording = recording_of(example("narrow"))
    assert recording is not None
    return Runs(
        plan=plan,
        outcomes=(*initial, joint, *unsearched(alone, plan), *searched),
        transports=tuple(found for found in done if isinstance(found, baxter.Transport)),
        absent=absent,
        compared=tuple(compared),
        recorded=(recording, alone["Sine"], given_to_both(alone["Sine"], "narrow")),
    )


def baxter_passages(plan: ReproductionPlan) -> list[baxter.Passage]:
    """Return Baxter's transports by the figures' methods and by [5]."""
    velocity = GAIT["velocity"]
    by_method = [
        baxter.Passage(scene, who, velocity, plan.fresh + i, drawn=i == 0)
        for scene in baxter.PASSAGES
        for who in baxter.METHODS
        for i in plan.few(plan.baxter)
    ]
    return by_method + [
        baxter.Passage(scene, baxter.WITH_JOINTS, velocity, plan.fresh, start=start)
        for scene in baxter.PASSAGES
        for start in baxter.STARTS
    ]


def unsearched(alone: Mapping[str, DMP], plan: ReproductionPlan) -> Iterator[Outcome]:
    """Yield the outcomes of motions without a search."""
    motions = [("given", s, name, given_to_both(alone[name], s)) for s, name in INITIAL.items()]
    motions += [("straight", scene, STRAIGHT, straight_of_one(scene)) for scene in INITIAL]
    motions += [
        ("as taught", "open", at_once(number), taught_at_once(number, plan.band))
        for number in plan.few(plan.at_once)
    ]
    for purpose, scene, movement, motion in motions:
        job = Job(purpose, scene, "nobody", movement)
        yield Outcome(job, measure_motion(motion), motion=motion)


def movements_after(alone: dict[str, DMP], joint: Outcome, plan: ReproductionPlan) -> dict[str, Movement]:
    """Return all movements by name.

    They are those of one end effector, `alone`: the initial movements of Figure 3, the recorded and synthetic ones;
    further recordings; None, for straight lines; the movement of each end effector as demonstrated jointly in the
    wide passage; and two of the recorded ones, a different one for each end effector.
    """
    hands = example(joint.job.scene).manipulators
    return {
        STRAIGHT: None,
        "joint": {name: movement_of(joint, i) for i, name in enumerate(hands)},
        "two": {name: alone[movement] for name, movement in zip(hands, TWO, strict=True)},
        **{at_once(number): recorded_at_once(number) for number in range(plan.at_once)},
        **{shape: DMP.fit(Demonstration.from_lasa(shape)) for shape in recordings()},
        **alone,
    }


def at_once(number: int) -> str:
    """Return the name of a simultaneous demonstration, by its number."""
    return f"at once {number}"


def recorded_at_once(number: int) -> dict[str, DMP]:
    """Return the simultaneously recorded movements of both end effectors. They are keyed by the end effectors'
    names. The middle of a bar follows one handwritten movement and its direction another, so that the end effectors
    keep their distance as the hands of a person who holds the bar."""
    scene = scene_of("open")
    way, aside = (_drawn(Demonstration.from_lasa(shape, number)) for shape in AT_ONCE)
    first, last = (complex(*end) for end in (scene.start.mean(axis=0), scene.goal.mean(axis=0)))
    bar = complex(*(scene.start[1] - scene.start[0]))
    swing = SWING * aside.imag / np.abs(aside.imag).max()
    middle, half = first + (last - first) * way, 0.5 * bar * np.exp(1j * swing)
    time = np.linspace(0.0, scene.duration, len(way))
    return {
        name: DMP.fit(
            Demonstration(time, np.stack([hand.real, hand.imag], axis=1), f"{name}, recording {number}")
        )
        for name, hand in zip(scene.manipulators, (middle - half, middle + half), strict=True)
    }


def taught_at_once(number: int, band: float) -> CoordinatedMotion:
    """Return the simultaneous demonstration with a distance tolerance [m]."""
    scene, movements = scene_of("open", tolerance=band), recorded_at_once(number)
    taught = tuple(movements[name] for name in scene.manipulators)
    return CoordinatedDMP.from_demonstration(
        taught, scene, arms_coordinates(scene), motion_basis(30, "velocity")
    ).rollout()


def _drawn(recording: Demonstration, n_steps: int = 1001) -> NDArray[np.complex128]:
    """Return a planar recording as complex numbers from 0 to 1. It is rotated, scaled, and at rest at both ends."""
    first, last = recording.time[[0, -1]]
    when = first + minimum_jerk(np.linspace(0.0, 1.0, n_steps)) * (last - first)
    x, y = interpolated(when, recording.time, recording.position).T
    point = x + 1j * y
    return (point - point[0]) / (point[-1] - point[0])


def movement_of(outcome: Outcome, hand: int) -> DMP:
    """Fit a primitive to the movement of one end effector."""
    assert outcome.motion is not None
    way = outcome.motion.trajectory()
    return DMP.fit(Demonstration(way.time, way.position[:, hand], f"{outcome.job.purpose}, hand {hand}"))


def recordings(count: int = 10) -> tuple[str, ...]:
    """Return the first shapes of the handwriting set. The first recording of each is used."""
    return lasa_names()[:count]


def recorded(name: str) -> Demonstration:
    """Return one of the `RECORDED` movements. The synthetic ones last a second and are a metre long."""
    known = RECORDED[name]
    if known is not None:
        return Demonstration.from_lasa(*known)
    time = np.linspace(0.0, 1.0, 401)
    along = minimum_jerk(time)
    aside = 0.15 * np.sin(2 * np.pi * along) if name == "curve" else np.zeros_like(along)
    return Demonstration(time, np.stack([along, aside], axis=1), name)


def straight_of_one(scene: str) -> CoordinatedMotion:
    """Return the straight line of the first end effector alone."""
    alone = single.alone(example(scene))
    return CoordinatedMotion.straight(alone, load_coordinates(alone))


def given_to_both(movement: DMP, scene: str) -> CoordinatedMotion:
    """Return a movement as coordinated primitive of both end effectors. It is not optimised yet (paper, III-B)."""
    loaded, basis = example(scene), motion_basis(30, "velocity")
    return CoordinatedDMP.from_demonstration(movement, loaded, arms_coordinates(loaded), basis).rollout()


def all_jobs(plan: ReproductionPlan, movements: Mapping[str, Movement]) -> list[Job]:
    """Return all jobs except the initial movements, the longest first."""
    return figure_jobs(plan, movements) + table_jobs(plan, movements)


def figure_jobs(plan: ReproductionPlan, movements: Mapping[str, Movement]) -> list[Job]:
    """Return the jobs for figures and single claims."""
    job = partial(_job, movements)
    figure = {"tolerance": plan.band, **GAIT}
    jobs = [
        job("three hands", "triangle", who, STRAIGHT, seed=plan.fresh + i)
        for who in ("comove", "paper")
        for i in plan.few(plan.three_hands)
    ]
    unlimited = figure | {
        "acceleration": None,
        "budget": plan.printed_budget,
    }  # the paper limits no accelerations
    jobs += [
        job("printed", scene, who, "initial", seed=seed, **unlimited)
        for who in ("printed", "paper without schedules")
        for scene in ("wide", "narrow")
        for seed in plan.few(plan.printed)
    ]
    jobs.append(job("figure 1", "narrow", "comove", "Sine", resemblance=plan.resemblance, keep=True))
    for who in ("paper", "comove"):
        for scene in ("wide", "narrow"):
            jobs.append(job("figure 4", scene, who, "initial", keep=True, **figure))
        jobs.append(job("figure 6", "complex", who, "winding", keep=True, **figure))
    jobs.append(job("figure 6", "narrow", "unconstrained [22]", "joint", keep=True, **figure))
    jobs += [job("systems", "narrow", who, STRAIGHT, keep=True) for who in ("comove", *OTHER_SYSTEMS)]
    jobs += [job("leaders", "open", who, "two", keep=True) for who in ROLES]
    jobs += [
        job("at once", scene, "unconstrained [22]", at_once(number), seed=plan.fresh + number, **figure)
        for scene in AT_ONCE_SCENES
        for number in plan.few(plan.at_once)
    ]
    jobs.append(job("obstacles in the cost", "narrow", "comove", STRAIGHT, obstacles="cost"))
    return jobs


def table_jobs(plan: ReproductionPlan, movements: Mapping[str, Movement]) -> list[Job]:
    """Return the jobs for tables of several seeds."""
    job, budget = partial(_job, movements), plan.movements_budget * min(1.0, plan.small * plan.seeds)
    jobs = [
        job(
            *("movements", scene, who, movement),
            seed=seed,
            budget=budget,
            resemblance=plan.resemblance if who == "comove" else 0.0,
        )
        for movement in RECORDED
        for scene in SCENES
        for who in MOVEMENT_CONTENDERS
        for seed in plan.few(plan.movements)
    ]
    jobs += [
        replace(job("sensitivity", "narrow", "paper", STORY["narrow"], seed=seed, budget=budget), **changes)
        for changes in differing(SENSITIVITY)
        for seed in plan.few(plan.sensitivity)
    ]
    jobs += [
        job("recordings", scene, "paper", shape, seed=seed, budget=budget, keep_failed=True)
        for shape in recordings()
        for scene, most in RECORDING_SEEDS.items()
        for seed in plan.few(most)
    ]
    jobs += [
        job("story", scene, who, STORY[scene], seed=seed)
        for scene in SCENES
        for who, contender in CONTENDERS.items()
        for seed in range(plan.seeds if contender.random else 1)
    ]
    return jobs


def _job(
    movements: Mapping[str, Movement], purpose: str, scene: str, who: str, movement: str, **options: Any
) -> Job:
    return Job(purpose, scene, who, movement, movements[movement], **options)


def differing(table: dict[str, dict[str, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Return every set of changes in a table once."""
    ways = [changes for values in table.values() for changes in values.values()]
    return [changes for i, changes in enumerate(ways) if changes not in ways[:i]]


Wanted = Job | baxter.Passage | None
Done = Outcome | baxter.Transport | list[Compared]


def _all_done(jobs: Sequence[Wanted], processes: int, tell: Callable[[int], None]) -> list[Done]:
    """Do all jobs on several processes; return results in order."""
    waiting, done = iter(enumerate(jobs)), dict[int, Done]()
    load_kernels(SceneKind(2, moving=None in jobs))  # by all cores, before processes that compile alone
    for ended in run_tasks(_do, lambda: next(waiting, None), workers=processes):
        number, job = ended.task
        if ended.made is None:
            why = ended.error or "its process was killed, perhaps as memory ran short"
            raise ResultError(f"a run of the reproduction failed: {job}: {why}", way_out="run fewer at once")
        done[number] = ended.made
        tell(len(done))
    return [done[number] for number in range(len(jobs))]


def _do(task: tuple[int, Wanted]) -> Done:
    """Do a job, given with its number; see `_done`."""
    _warm_up()
    return _done(task[1])


_warm_up = lru_cache(maxsize=1)(warm_up)


def _done(job: Wanted) -> Done:
    """Do a job; for None, run all methods on the example `turning`."""
    if isinstance(job, baxter.Passage):
        return baxter.transport(job)
    if job is not None:
        return run(job)
    load_kernels(SceneKind(2, moving=True))
    scene = example("turning")
    budget = 3.0 * scene.duration  # as `comove run`
    return compare(Executor(scene).run(budget), budget)[0]

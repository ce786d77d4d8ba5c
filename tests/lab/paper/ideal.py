"""Runs in which all goes as the paper says, made up without solving anything."""

from dataclasses import dataclass, replace
from functools import cache

from comove.lab.modulation.comparison import METHODS
from comove.lab.paper.baxter import METHODS as WAYS
from comove.lab.paper.baxter import PASSAGES, STARTS, WITH_JOINTS, Passage, Transport
from comove.lab.paper.jobs import Job, Outcome, scene_of
from comove.lab.paper.measures import Along, Measures
from comove.lab.paper.runs import (
    INITIAL,
    RECORDED,
    STRAIGHT,
    ReproductionPlan,
    Runs,
    all_jobs,
    at_once,
    recordings,
)
from comove.model import Scene
from comove.model.motion import CoordinatedMotion

GOOD = Measures(
    verified=True,
    distance_error=1e-16,
    clearance=0.01,
    end_error=0.0,
    cost=0.1,
    acceleration=1.0,
    jerk=10.0,
    turn=0.0,
    first=0.01,
    total=0.5,
)
STEADY = Along(
    at_start=1.0, at_end=0.0, rise=0.0, rise_near=False, error=1e-3, error_near=1e-3, error_far=1e-4
)


@dataclass(frozen=True)
class Encounter:
    """What is looked at of an execution among moving obstacles."""

    method: str
    distance_error: float
    clearance: float
    tolerance: float
    arrived: bool


LOG = {"epoch_error_rms_m": [0.1, 0.01, 0.001]}


@cache
def straight(height):
    """Both hands of the open scene on straight lines, moved sideways [m]."""
    scene = scene_of("open")
    data = scene.file.model_dump(exclude_defaults=True)
    for hand in data["manipulators"]:
        for end in ("start", "goal"):
            x, y = hand[end]
            hand[end] = [x, y + height]
    return CoordinatedMotion.straight(Scene.from_dict(data))


def motion_of(job):
    """What is looked at of a motion, where anything is."""
    return straight(0.1 if job.who == "right hand leads" else 0.0) if job.purpose == "leaders" else None


def measures_of(job):
    if job.who == "paper" and job.scene == "narrow":
        return replace(GOOD, jerk=100.0, turn=1.2)
    if job.purpose == "straight" and job.scene == "complex":
        return replace(GOOD, verified=False, clearance=-0.05)
    if job.who == "unconstrained [22]":
        return replace(GOOD, verified=False, distance_error=0.1)
    if job.purpose == "leaders" or job.who in ("leader-follower [7]", "speed-scaled [8]"):
        return replace(GOOD, verified=False, clearance=-0.05, first=None)
    return GOOD


NAMES = (STRAIGHT, "initial", "winding", "joint", "two", *map(at_once, range(ReproductionPlan(1).at_once)))
MOVEMENTS = dict.fromkeys((*NAMES, *recordings(), *RECORDED))


def ideal_runs(seeds=3):
    jobs = [
        *(Job("figure 3", scene, "single [6]", STRAIGHT) for scene in INITIAL),
        *(Job("given", scene, "nobody", movement) for scene, movement in INITIAL.items()),
        *(Job("straight", scene, "nobody", STRAIGHT) for scene in INITIAL),
        Job("joint", "wide", "comove", "initial"),
        Job("as taught", "open", "nobody", at_once(0)),
        *all_jobs(ReproductionPlan(seeds), MOVEMENTS),
    ]
    outcomes = tuple(
        Outcome(job, measures_of(job), STEADY if job.keep else None, motion_of(job), LOG) for job in jobs
    )
    transports = tuple(
        Transport(
            Passage(scene, who, 0.2, seed, drawn=seed == 0),
            verified=True,
            turn=1.0 if scene == "narrow" else 0.1,
            distance_error=1e-4,
            clearance=0.01,
            end_missed=0.0,
            seconds=10.0,
            delivered=True,
            lag=1e-3,
            end_error=1e-3,
            picture=b"picture" if seed == 0 else b"",
        )
        for scene in PASSAGES
        for who in WAYS
        for seed in range(2)
    )
    compared = tuple(Encounter(m, 0.0, 0.01, 1e-4, True) for m in METHODS)
    return Runs(ReproductionPlan(seeds), outcomes, compared, transports=transports + by_joints())


def by_joints():
    """Transports by [5], of which one stands before the posts."""
    log = {"relative_error_max_m": 1e-6, "turn_error_max_rad": 1e-6, "slack_max_m_per_s": 0.0}
    passages = [Passage(scene, WITH_JOINTS, 0.2, 100, start=start) for scene in PASSAGES for start in STARTS]
    through = Transport(passages[0], True, 0.1, 1e-4, 0.01, 0.0, 10.0, log=log, delivered=True)
    stuck = replace(through, verified=False, end_missed=0.5, reasons=("an end is missed",), delivered=False)
    return tuple(
        replace(stuck if passage.scene == "narrow" else through, passage=passage) for passage in passages
    )


def led(runs, who, height):
    """The runs with another motion of those who lead so."""
    outcomes = tuple(
        replace(o, motion=straight(height)) if o.job.purpose == "leaders" and o.job.who == who else o
        for o in runs.outcomes
    )
    return replace(runs, outcomes=outcomes)


def changed(runs, purpose, asked=None, along=None, **changes):
    """The runs with other figures in some outcomes."""
    asked, outcomes = asked or {}, []
    for outcome in runs.outcomes:
        if outcome.job.purpose == purpose and all(getattr(outcome.job, k) == v for k, v in asked.items()):
            outcome = replace(outcome, measures=replace(outcome.measures, **changes))
            if along:
                outcome = replace(outcome, along=replace(outcome.along, **along))
        outcomes.append(outcome)
    return replace(runs, outcomes=tuple(outcomes))


def carried(runs, asked, **changes):
    """The runs with other outcomes of some of Baxter's."""
    return replace(
        runs,
        transports=tuple(
            replace(t, **changes) if all(getattr(t.passage, k) == v for k, v in asked.items()) else t
            for t in runs.transports
        ),
    )


def met(runs, method, **changes):
    """The runs with another encounter."""
    return replace(
        runs, compared=tuple(replace(e, **changes) if e.method == method else e for e in runs.compared)
    )

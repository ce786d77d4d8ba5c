"""Methods: plan, fit, certify, polish; or, without a planner, grow the load."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import count
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import Coordinates, load_coordinates, projected_coordinates
from comove.coordination.motion import CoordinatedDMP
from comove.planning.clock import wind
from comove.planning.configurations import Space, configuration_space, span, way_length
from comove.planning.custom import improve_own
from comove.planning.method import Method
from comove.planning.objective import N_STEPS, Objective
from comove.planning.objectives import LeastTime, PaperCost
from comove.planning.planner import FEW_NODES, MANY_NODES, PLANE_MARGINS, SPACE_MARGINS, plan
from comove.planning.search import SMALLEST_LOAD, OutOfTime, Schedule, Search, improve, stricter
from comove.planning.seeds import bumps, fit, targets_along
from comove.planning.smooth import (
    FASTEST,
    cheaper,
    follows,
    hurry,
    least_worth,
    smooth_demonstration,
    smooth_way,
)
from comove.planning.spacetime import (
    MARGINS,
    SHARES,
    UNLIMITED,
    coast,
    plan_in_time,
    spacetime,
    targets_in_time,
)
from comove.primitives.basis import MotionBasis, motion_basis
from comove.scenes.scene import Scene
from comove.ties import first_least
from comove.verification.verify import Report

Array = NDArray[np.float64]

N_CERTIFIED = 7  # fits of one path judged, in order of their cost, before the next plan
MOST_DOUBTED = (
    2  # of these that the carrier doubts, whose picture of what moves the hands is a little too wide
)
RESTARTS = 25  # in which the load grows before planning is tried again
TURNS = (0, 0, 1, -1)  # ways round of the load, by restart
ROUNDS, DRAWS, SPREAD = 16, 64, 0.3  # rounds of bumps, bumps drawn in each, and their height [m]
WORTH_ANOTHER = 0.01  # of the value, that another way must gain
N_POLISHED = 3  # of the cheapest fits of different plans, by convex programmes
HASTY_IDLE = 2  # ways that may bring nothing where each is made as fast as it can be
SMOOTHING_SHARE = 0.4  # of the budget, before functions of the user are minimised
N_STARTS = 2  # smooth motions from which they are
HOPELESS = 0.03  # m inside something: another start is better than a stricter search

POLISHING = Schedule(sigma=0.02, generations=1000, patience=60, gain=0.002)
UNPOLISHED = replace(POLISHING, generations=0)
GROWING = Schedule(sigma=0.1, generations=600, patience=30, gain=0.01, growth=80)
THREADED = replace(GROWING, sigma=0.05)  # from a way that the smallest load has found
MENDING = Schedule(sigma=0.02, generations=300, patience=25, gain=0.005)
REPAIRING = Schedule(sigma=0.01, generations=80, patience=25, gain=0.01)


@dataclass(frozen=True)
class Comove(Method):
    """The default: planner, fit, certificate, polishing; growing the load where planning is off or fails.

    Attributes
    ----------
    smooths : whether it finds motions of least jerk
    coordinates : in which the search moves
    n_basis : shape weights a column when polishing
    n_basis_fine : where a plan needs more of them
    n_basis_growing : while the load grows
    n_plans : plans whose fits are compared before the best is polished
    n_failures : plans that may fail before the load is grown instead
    n_restarts : of these, how many before the next may have twice as many nodes
    n_unfit : plans that nothing could carry, before one is mended
    n_polishings : times that the search tries to improve a motion, more strictly each time it is rejected
    n_ways, n_idle : ways that are made smooth at most, and that may bring nothing before it is enough
    n_drawn : plans for every way that is made smooth
    n_met : ways with the best motion, after which it is enough
    polishing : how long and how widely a verified motion is improved
    """

    name: ClassVar[str] = "comove"
    smooths: ClassVar[bool] = True
    coordinates: Callable[[Scene], Coordinates] = load_coordinates
    n_basis: int = 30
    n_basis_fine: int = 100
    n_basis_growing: int = 20
    n_plans: int = 8
    n_failures: int = 12
    n_restarts: int = 2
    n_unfit: float = 3
    n_polishings: int = 5
    n_ways: int = 10
    n_idle: int = 4
    n_drawn: int = 3
    n_met: int = 3
    polishing: Schedule = POLISHING
    before: ClassVar[Array | None] = None

    def run(self, search: Search, *, planner: bool) -> None:
        """Search until nothing is to be gained or time is up (`OutOfTime`)."""
        if search.own is not None:
            self._customise(search, planner=planner)
            return
        if search.taught is not None and search.objective.weights.resemblance > 0:
            self._grow(search, range(1))  # from the demonstration, to stay near it
        if (planner and self._plan(search)) or search.best is not None:
            return
        if self._grow(search, range(RESTARTS) if planner else count()):
            return
        while not self._plan(search):  # only with the planner: without it the load grows until time is up
            search.check_time()

    def _customise(self, search: Search, *, planner: bool) -> None:
        """Smooth motions first, whatever the user's functions say of them; then from the best of them by these."""
        base = replace(
            search, own=None, checks=tuple(c for c in search.checks if c != search.own.reasons), kept=[]
        )
        base.deadline = min(base.deadline, base.started + SMOOTHING_SHARE * (base.deadline - base.started))
        with suppress(OutOfTime):
            self.run(base, planner=planner)
        search.evaluations, search.generations = base.evaluations, base.generations
        search.needed = base.needed
        search.attempt, search.attempt_verdict = base.attempt, base.attempt_verdict
        for motion in base.kept:
            search.judge(motion)
        search.stage = "minimising the objective given"
        for motion in reversed(base.kept[-N_STARTS:]):
            search.check_time()
            improve_own(search, search.own, motion)

    def _plan(self, search: Search) -> bool:
        """Plan, fit and certify; then polish the best. False where no plan could be certified."""
        scene = search.scene
        planning = load_coordinates(scene)
        space, ends = configuration_space(scene, planning), planning.boundary()
        in_time = scene.moving.any() or ends[1].any()
        plans_are_dear = search.carrier is None and not in_time  # beside mending
        targets_of = (
            _planner_in_time(search, space, ends, self.before) if in_time else _planner(search, space, ends)
        )
        if not isinstance(search.aim, PaperCost):
            if self._smooth(search, space, targets_of, ends):
                return True
            if search.carrier is None:
                return False
            search.settle_for(search.objective.weights)  # nothing as smooth can be carried out
        starts: list[tuple[float, CoordinatedDMP]] = []
        failures, unfit = 0, 0
        while len(starts) < self.n_plans and failures < self.n_failures:
            search.check_time()
            search.stage = "planning"
            found, start = targets_of(failures, self._nodes(failures)), None
            if found is not None:
                mend = search.best is None and (plans_are_dear or unfit >= self.n_unfit)
                start = self._certified_fit(search, *found, mend)
                unfit += start is None
            if start is None and self._will_do(search):
                return True
            if start is not None:
                starts.append(start)
            elif starts:
                break  # one way is known: others that are hard to find are not worth the time
            else:
                failures += 1
        starts.sort(key=lambda start: start[0])
        if starts and search.hard and search.carrier is None and starts[0][1].coordinates.kind == "load":
            search.stage = "polishing"
            for _, dmp in starts[:N_POLISHED]:
                before = search.best_cost
                cheaper(search, dmp)
                if search.best_cost > (1 - WORTH_ANOTHER) * before:
                    break
        elif starts:
            self._polish(search, starts[0][1])
        return bool(starts)

    def _smooth(self, search: Search, space: Space, targets_of: Targets, ends: Array) -> bool:
        """Smooth motions along several ways, and along the demonstration; False where none could be verified.

        Of a few plans the shortest is made smooth first: long ways seldom make good motions.
        """
        failures = idle = met = smooth = 0
        hasty, pool, tried = isinstance(search.aim, LeastTime), [], 0
        # Plans for arms and in time are dear, and near to a demonstration a short way is no better than another.
        dear = search.carrier is not None or search.scene.moving.any() or ends[1].any()
        n_drawn = 1 if dear or follows(search) else self.n_drawn
        while tried < self.n_ways and idle < self.n_idle and met < self.n_met:
            if idle >= HASTY_IDLE and (hasty or (search.best is None and search.needed < np.inf)):
                break  # seconds a way, and ways differ less in time than in jerk
            for _ in range(n_drawn):
                search.check_time()
                search.stage = "planning"
                found = targets_of(failures, self._nodes(failures if search.best is None else 0))
                if found is None:
                    failures += 1
                    break
                if search.best is None:  # something to hand out at once
                    self._certified_fit(search, *found, mend=False)
                pool.append(found)
            if failures >= self.n_failures:
                break
            if not pool:
                continue
            targets, goal = pool.pop(first_least([way_length(space, targets[0]) for targets, _ in pool]))
            before, needed, search.latest = search.best_cost, search.needed, np.inf
            if tried == 0 and follows(search):
                search.stage = "smoothing the demonstration"
                smooth_demonstration(search)
            search.stage = "smoothing"
            # The first target is run with least jerk, or as it was planned in time.
            done = smooth_way(search, targets[0], np.stack([ends[0], ends[1], goal, ends[3]]))
            tried, smooth, failures = tried + 1, smooth + done, failures + (not done)
            if search.best is None and self._will_do(search):
                return True
            gained = search.best_cost < (1 - WORTH_ANOTHER) * before
            gained |= search.needed < (1 - WORTH_ANOTHER) * needed
            idle = 0 if gained or needed == search.best_cost == np.inf else idle + 1
            met = 1 if gained else met + (search.latest < (1 + WORTH_ANOTHER) * search.best_cost)
            if search.best_cost < (1 + WORTH_ANOTHER) * least_worth(search):
                break
        if search.best is not None and hasty and search.carrier is None:  # of which arms know other limits
            hurry(search, search.best_motion, FASTEST)
        if search.carrier is not None:
            return smooth > 0
        return search.best is not None or search.needed < np.inf  # which no other way would shorten much

    def _will_do(self, search: Search) -> bool:
        """Whether what is not verified is good enough."""
        return False

    def _nodes(self, failures: int) -> int:
        """Nodes for the next plan: few at first, more after failures."""
        return min(MANY_NODES, FEW_NODES * 2 ** (failures // self.n_restarts))

    def _certified_fit(
        self, search: Search, targets: Array, goal: Array, mend: bool
    ) -> tuple[float, CoordinatedDMP] | None:
        """The cheapest fit of a plan that is verified, and its cost; None where none of the first is.

        A path with sharp bends needs more weights than others. Where `mend` says so, the best that touches nothing is
        mended instead.
        """
        hopeful, doubted = None, 0
        for n_basis in dict.fromkeys((self.n_basis, max(self.n_basis, self.n_basis_fine))):
            basis = motion_basis(n_basis, "velocity")
            dmp, weights = fit(targets, goal, search.objective.coordinates, basis, search.scene)
            value = search.evaluate(search.objective, dmp, weights)
            sound = search.objective.feasible(value._replace(possible=np.ones(len(weights), dtype=bool)))
            possible = np.broadcast_to(value.possible, sound.shape)
            missed = np.where(sound, 0.0, 100.0) + np.where(possible, 0.0, 10.0)
            rank = search.objective.search_value(value) + missed
            gentlest = np.argmin(np.maximum(*search.objective.limit_ratios(value)) + missed)
            for i in (*np.argsort(rank, kind="stable")[:N_CERTIFIED], gentlest):
                if search.attempt is not None:  # one is judged even if time is up
                    search.check_time()
                if sound[i] and not possible[i]:
                    doubted += 1
                    if doubted > MOST_DOUBTED or not search.checks:  # which know exactly
                        break
                if search.judge(dmp.rollout(weights[i])).verified:
                    return float(value.cost[i]), replace(dmp, weights=weights[i])
            # Only too fast or too sudden: that can be mended; likewise a plan in time that smoothing spoilt a little.
            spoilt = HOPELESS if search.scene.moving.any() else 0.0
            free = value.clearance > search.scene.clearance - spoilt
            if hopeful is None and free.any():
                hopeful = replace(dmp, weights=weights[np.where(free, rank, np.inf).argmin()])
        return self._mended(search, hopeful) if mend and hopeful is not None else None

    def _mended(self, search: Search, dmp: CoordinatedDMP) -> tuple[float, CoordinatedDMP] | None:
        """A motion near a rejected one that is verified, and its cost; None where none was found."""
        search.stage = "mending"
        objective, schedule = search.objective, replace(MENDING, enough=search.carrier is not None)
        for _ in range(self.n_polishings):
            dmp = improve(search, objective, dmp, schedule)
            verdict = search.judge(dmp.rollout())
            if verdict.verified:
                return search.objective.cost(dmp.rollout()).total, dmp
            objective = stricter(search, objective, verdict)
        return None

    def _polish(self, search: Search, dmp: CoordinatedDMP) -> None:
        """Improve a verified motion, more strictly until the result is verified as well."""
        search.stage = "polishing"
        objective, schedule = search.objective, self.polishing
        for _ in range(self.n_polishings):
            dmp = improve(search, objective, dmp, schedule)
            verdict = search.judge(dmp.rollout())
            if verdict.verified or not search.hard:
                return
            objective, schedule = stricter(search, objective, verdict), replace(self.polishing, sigma=0.01)

    def _grow(self, search: Search, restarts: Iterable[int]) -> bool:
        """Restarts in which the load grows; True once a motion is verified and polished."""
        basis = motion_basis(self.n_basis_growing, "acceleration")
        along_path = search.objective.with_penalty(along_path=True)
        for restart in restarts:
            search.stage = f"growing the load, restart {restart}"
            guess = first_guess(search, search.objective.coordinates, basis, restart)
            dmp = threaded(search, along_path, guess) if restart > 0 else guess
            if dmp is None:
                continue
            objective = along_path
            dmp = improve(search, objective, dmp, THREADED if restart > 0 else GROWING)
            for _ in range(self.n_polishings):
                search.check_time()
                motion = dmp.rollout()
                verdict = search.judge(motion)
                if verdict.verified or not search.hard:
                    self._polish(search, self._refined(dmp))
                    return True
                value = search.evaluate(objective, dmp, dmp.weights[None])
                if value.clearance[0] < -HOPELESS:
                    break
                objective = stricter(search, objective, verdict)
                dmp = improve(search, objective, dmp, REPAIRING)
        return False

    def _refined(self, dmp: CoordinatedDMP) -> CoordinatedDMP:
        """The same movement in the finer basis in which it is polished."""
        basis = motion_basis(self.n_basis, "velocity")
        phi, base = np.split(basis.sampled(N_STEPS).T, [basis.n_basis], axis=1)
        q = dmp.rollouts(dmp.weights[None], N_STEPS)[0].T
        weights = np.linalg.lstsq(phi, q - base @ dmp.boundary, rcond=None)[0].T
        return replace(dmp, basis=basis, weights=weights)


@dataclass(frozen=True)
class Quick(Comove):
    """Few ways, of which the best that is verified is taken: for those who cannot wait."""

    name: ClassVar[str] = "quick"
    n_plans: int = 2
    n_failures: int = 5
    n_ways: int = 2
    n_idle: int = 1
    polishing: Schedule = UNPOLISHED

    def run(self, search: Search, *, planner: bool) -> None:
        """Plan once."""
        self._plan(search)


@dataclass(frozen=True)
class Guide(Quick):
    """Plans for those who keep the limits themselves: what touches nothing may ask for more than there is.

    Attributes
    ----------
    before : array, shape (n_before, n_columns), a path in load coordinates that may still be of use
    excess : times the limits that it may ask for
    """

    name: ClassVar[str] = "guide"
    n_unfit: float = np.inf
    before: Array | None = field(default=None, compare=False)
    excess: float = 2.0

    def will_do(self, report: Report, scene: Scene) -> bool:
        """Whether a motion with this report is good enough."""
        excess = max(report.limit_ratios(scene))
        return report.clearance_min >= scene.clearance and excess <= self.excess

    def _will_do(self, search: Search) -> bool:
        rejected = search.attempt_verdict
        return rejected is not None and self.will_do(rejected.report, search.scene)


Targets = Callable[[int, int], tuple[Array, Array] | None]
"""What a number of failures and of nodes leads to: movements to fit, as `fit` takes them, and where they end."""


def _planner(search: Search, space: Space, ends: Array) -> Targets:
    """Plans in space, run under several time profiles; `ends` as `Coordinates.boundary`, at rest."""
    start, goal = ends[0], ends[2]
    margins = PLANE_MARGINS if search.scene.n_dims == 2 else SPACE_MARGINS
    grow = plan if search.carrier is None else search.carrier.plan

    def targets(failures: int, max_nodes: int) -> tuple[Array, Array] | None:
        margin, required = margins[failures % len(margins)], search.scene.clearance
        wind(space.clock, search.until)
        path = grow(space, start, goal, margin, search.rng, required=required, max_nodes=max_nodes)
        return None if path is None else (targets_along(space, path), path[-1])

    return targets


def _planner_in_time(search: Search, space: Space, ends: Array, before: Array | None) -> Targets:
    """Plans in space and time, smoothed over several widths; `ends` as `Coordinates.boundary`."""
    scene, (start, velocity, goal, _) = search.scene, ends
    coasting = coast(velocity, scene.acceleration_limit * scene.duration**2, N_STEPS)
    world = spacetime(scene, space)
    limit = min(scene.speed_limit * scene.duration, UNLIMITED * (span(space, start, goal) + space.cap))

    def targets(failures: int, max_nodes: int) -> tuple[Array, Array] | None:
        speed, margin = limit * SHARES[failures % len(SHARES)], MARGINS[failures % len(MARGINS)]
        wind(space.clock, search.until)
        found = plan_in_time(
            world, start, goal, speed, margin, search.rng, max_nodes=max_nodes, before=before
        )
        return None if found is None else (targets_in_time(space, *found, N_STEPS) + coasting, found[0][-1])

    return targets


@dataclass(frozen=True)
class Projection(Comove):
    """Free hands, every rollout projected onto the constraints; otherwise as the default."""

    name: ClassVar[str] = "projection"
    smooths: ClassVar[bool] = False
    coordinates: Callable[[Scene], Coordinates] = projected_coordinates


def first_guess(search: Search, coordinates: Coordinates, basis: MotionBasis, restart: int) -> CoordinatedDMP:
    """The demonstration where there is one (every third restart), else the straight way with some turn."""
    if search.taught is not None and restart % 3 == 0:
        return CoordinatedDMP.from_demonstration(search.taught, search.scene, coordinates, basis)
    boundary = coordinates.boundary(turn=TURNS[restart % len(TURNS)])
    weights = np.zeros((coordinates.n_columns, basis.n_basis))
    return CoordinatedDMP(search.scene, coordinates, basis, boundary, weights)


def threaded(search: Search, objective: Objective, dmp: CoordinatedDMP) -> CoordinatedDMP | None:
    """Add one bump a round, the best of many drawn, until the smallest load is free; None where it never is."""
    directions, weights, least = dmp.coordinates.search, dmp.weights[None], np.inf
    for _ in range(ROUNDS):
        search.check_time()
        value = search.evaluate(objective, dmp, weights, SMALLEST_LOAD)
        fitness = objective.search_value(value)
        i = int(np.argmin(fitness))
        if fitness[i] < least:
            dmp, least = replace(dmp, weights=weights[i]), fitness[i]
        if value.clearance[i] > search.scene.clearance:
            return replace(dmp, weights=weights[i])
        heights = SPREAD * search.rng.standard_normal((DRAWS, directions.shape[1], 1))
        weights = dmp.weights + directions @ (heights * bumps(dmp.basis, search.rng, DRAWS)[:, None])
    return None

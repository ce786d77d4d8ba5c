"""The default methods: plan, fit, verify and polish, or payload-size continuation."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, count, islice
from typing import ClassVar, NamedTuple

import numpy as np

from comove.arrays import Array, first_least
from comove.dmp.basis import MotionBasis
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import Coordinates, load_coordinates
from comove.model.scene import Scene
from comove.planning.ahead import Plan, PlansAhead, Targets
from comove.planning.clock import A_SECOND
from comove.planning.configurations import SETTINGS as SPACE
from comove.planning.configurations import (
    Space,
    SpaceSettings,
    clearance_of,
    configuration_space,
    deforms,
    lifted,
    span,
    way_length,
)
from comove.planning.custom import SETTINGS as CUSTOM
from comove.planning.custom import CustomSettings, improve_own
from comove.planning.method import Method
from comove.planning.objective import N_STEPS, Objective
from comove.planning.objectives import OwnFunctions
from comove.planning.orientations import can_turn, shortest_turned, turned_otherwise
from comove.planning.planner import SETTINGS as PLANNER
from comove.planning.planner import PlannerSettings, continuous, kept_margin
from comove.planning.search import OutOfTime, Schedule, Search, improve, stricter
from comove.planning.seeds import GENTLE, bumps, fit, targets_along
from comove.planning.smooth import SETTINGS as SMOOTHING
from comove.planning.smooth import (
    SmoothingSettings,
    cheaper,
    follows,
    hurry,
    least_worth,
    smooth_demonstration,
    smooth_way,
)
from comove.planning.spacetime import SETTINGS as IN_TIME
from comove.planning.spacetime import (
    SpaceTimeSettings,
    coast,
    spacetime,
    targets_in_time,
)
from comove.planning.trees import shortened
from comove.planning.world import World
from comove.verification.verify import Report

POLISHING = Schedule(sigma=0.02, generations=1000, patience=60, gain=0.002)
UNPOLISHED = replace(POLISHING, generations=0)
GROWING = Schedule(sigma=0.1, generations=600, patience=30, gain=0.01, growth=80)
MENDING = Schedule(sigma=0.02, generations=300, patience=25, gain=0.005)
REPAIRING = Schedule(sigma=0.01, generations=80, patience=25, gain=0.01)


@dataclass(frozen=True)
class MethodSettings:
    """Settings of the methods below. Settings that differ between methods are fields of theirs.

    Attributes
    ----------
    margins : margins of planned paths, tried in turn, in the plane and in space [m]
    most_nodes : largest number of nodes of a plan
    n_certified : fits of one path that are verified, in order of cost, before the next plan
    n_asked : fits that limited kinematics evaluate
    most_doubted : verified among those that they deem impossible, as their model of arms is a little too wide
    restarts : continuations of the payload size before planning is tried again
    turns : extra turns of the payload, by restart
    rounds, draws, spread : rounds of bumps, bumps drawn in each, and their height [m]
    worth_another : relative gain below which another path counts as no better
    compared : samples between those at which a path is compared with motions
    longer : length of a planar path, in terms of that of the best motion's, from which on it is not smoothed
    n_polished : cheapest fits of different plans that convex programmes improve
    hasty_idle : paths without gain that end the slower minimisation of the duration
    smoothing_share : share of the work of the budget before functions of the user are minimised
    n_starts : smooth motions from which these are minimised
    hopeless : penetration from which on a new start is better than a stricter search [m]
    mending, growing, repairing : schedules that slow a motion that is only too fast, grow the payload, and repair a
        rejected motion of the full payload
    threaded_sigma : first step size of continuation from a path of the smallest payload
    polishing_again : first step size of polishing after a rejection
    space : settings of distances and steps in the payload's configuration space
    planner, in_time : settings of the planners, in space and in space and time
    smoothing : settings of the smoothing of paths
    custom : settings of the minimisation of the user's functions
    """

    margins: tuple[tuple[float, ...], tuple[float, ...]] = (
        (0.002, 0.004, 0.0005, 0.008),
        (0.002, 0.004, 0.002, 0.008),
    )
    most_nodes: int = 10_000
    n_certified: int = 7
    n_asked: int = 10
    most_doubted: int = 2
    restarts: int = 25
    turns: tuple[int, ...] = (0, 0, 1, -1)
    rounds: int = 16
    draws: int = 64
    spread: float = 0.3
    worth_another: float = 0.01
    compared: int = 8
    longer: float = 1.15
    n_polished: int = 3
    hasty_idle: int = 2
    smoothing_share: float = 0.4
    n_starts: int = 2
    hopeless: float = 0.03
    mending: Schedule = MENDING
    growing: Schedule = GROWING
    threaded_sigma: float = 0.05
    repairing: Schedule = REPAIRING
    polishing_again: float = 0.01
    planner: PlannerSettings = PLANNER
    in_time: SpaceTimeSettings = IN_TIME
    smoothing: SmoothingSettings = SMOOTHING
    space: SpaceSettings = SPACE
    custom: CustomSettings = CUSTOM


SETTINGS = MethodSettings()


@dataclass(frozen=True)
class Comove(Method):
    """The default method, which plans, fits, verifies and polishes. Payload-size continuation follows if this fails.

    Attributes
    ----------
    smooths : whether the method finds motions of least jerk
    coordinates : function of a scene that returns the coordinates of the search
    n_basis : shape weights a column when polishing
    n_basis_fine : shape weights a column for plans that need more
    n_basis_growing : shape weights a column during the payload-size continuation
    n_plans : plans whose fits are compared before the best is polished
    n_failures : plans that may fail before the payload-size continuation
    n_nodes : number of nodes of the first plans; restarts beat long attempts
    n_restarts : failed plans after which the number of nodes of the next is doubled
    n_unfit : plans without a verified fit after which a rejected fit is repaired
    n_polishings : times that a motion is optimised, with a stricter objective after each rejection
    n_ways, n_idle : paths that are smoothed at most, and paths without gain after which smoothing ends
    n_drawn : plans from which each path to be smoothed is chosen, in the plane and in space
    n_met : paths that lead to a motion as good as the best after which smoothing ends
    polishing : schedule by which a verified motion is improved
    before : array, shape (n_before, n_columns), earlier path in payload coordinates, at even times, with which plans
        among moving obstacles begin; None for none
    settings : further settings
    """

    name: ClassVar[str] = "comove"
    smooths: ClassVar[bool] = True
    coordinates: Callable[[Scene], Coordinates] = load_coordinates
    n_basis: int = 30
    n_basis_fine: int = 100
    n_basis_growing: int = 20
    n_plans: int = 8
    n_failures: int = 12
    n_nodes: int = PLANNER.few_nodes
    n_restarts: int = 2
    n_unfit: float = 3
    n_polishings: int = 5
    n_ways: int = 16
    n_idle: int = 3
    n_drawn: tuple[int, int] = (4, 2)
    n_met: int = 3
    polishing: Schedule = POLISHING
    before: Array | None = field(default=None, compare=False)
    settings: MethodSettings = SETTINGS

    def run(self, search: Search, *, planner: bool) -> None:
        """Search until no improvement is expected; raises `OutOfTime` when time is up."""
        stages: Stages = self._stages(search, planner)
        done: bool | None = None
        with suppress(StopIteration):
            while True:
                stage = stages.send(done)
                done = stage()

    def _stages(self, search: Search, planner: bool) -> Stages:
        """Yield the stages of the search in order."""
        if search.own is not None:
            return bool((yield partial(self._customise, search, search.own, planner=planner)))
        if search.taught is not None and search.objective.weights.resemblance > 0:
            yield partial(self._grow, search, range(1))  # from the demonstration, to stay near it
        if (planner and (yield from self._planned(search))) or search.found.best is not None:
            return True
        if (yield partial(self._grow, search, range(self.settings.restarts) if planner else count())):
            return True
        while not (yield from self._planned(search)):  # without the planner the load grows until time is up
            search.check_time()
        return True

    def _customise(self, search: Search, own: OwnFunctions, *, planner: bool) -> bool:
        """Find smooth motions without the sampled functions, then optimise with them."""
        clock = search.clock
        base = replace(
            search,
            own=None,
            checks=tuple(check for check in search.checks if check != own.reasons),
            clock=replace(
                clock, budget=clock.budget.within(self.settings.smoothing_share * clock.budget.size)
            ),
            found=replace(search.found, kept=[]),
            journal=replace(search.journal),
            objective=replace(search.objective, scene=_unsampled(search.scene)),
            asked=None if search.asked is None else _unsampled(search.asked),
        )
        with suppress(OutOfTime):
            self.run(base, planner=planner)
        search.journal.evaluations, search.journal.generations = (
            base.journal.evaluations,
            base.journal.generations,
        )
        clock.add_work(A_SECOND * base.clock.work)
        search.found.needed = base.found.needed
        if base.found.attempt is not None:
            search.found.attempt, search.found.attempt_verdict = (
                replace(base.found.attempt, scene=search.scene),
                base.found.attempt_verdict,
            )
        kept = [replace(motion, scene=search.scene) for motion in base.found.kept]
        for motion in kept:
            search.judge(motion)
        search.journal.stage = "minimising the objective given"
        for motion in reversed(kept[-self.settings.n_starts :]):
            search.check_time()
            improve_own(search, own, motion, self.settings.custom)
        return search.found.best is not None

    def _planned(self, search: Search) -> Stages:
        """Plan paths; smooth them or fit motions, as the objective requires."""
        plans = Plans.of(search, self)
        if search.aim.is_smooth:
            if (yield partial(self._smooth, search, plans)):
                return True
            if not search.kinematics.has_limits:
                return False
            search.settle_for(search.objective.weights)  # nothing as smooth can be carried out
        return bool((yield partial(self._fitted, search, plans)))

    def _fitted(self, search: Search, plans: Plans) -> bool:
        """Plan, fit, verify, and polish the best; return whether a good motion was found."""
        plans_are_dear = not (search.kinematics.has_limits or plans.in_time)  # beside mending
        starts: list[tuple[float, CoordinatedDMP]] = []
        failures, unfit = 0, 0
        while len(starts) < self.n_plans and failures < self.n_failures:
            search.check_time()
            search.journal.stage = "planning"
            found, start = plans.targets(failures, self._nodes(failures), search.rng), None
            if found is not None:
                mend = search.found.best is None and (plans_are_dear or unfit >= self.n_unfit)
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
        if starts and _is_convex(search):
            search.journal.stage = "polishing"
            for _, dmp in starts[: self.settings.n_polished]:
                before = search.found.best_cost
                cheaper(search, dmp, self.settings.smoothing)
                if search.found.best_cost > (1 - self.settings.worth_another) * before:
                    break
        elif starts:
            self._polish(search, starts[0][1])
        return bool(starts)

    def _smooth(self, search: Search, plans: Plans) -> bool:
        """Smooth planned paths and the demonstration; return whether a good motion was found.

        The motion is verified, or would be in a longer duration that is known. Of a few plans the shortest is
        smoothed first: long paths seldom make good motions. In the plane, those that can be deformed into a known
        motion would become the same. Where one path is enough, that of the demonstration is.
        """
        # Plans for arms and in time are dear, and near to a demonstration a short way is no better than another.
        dear = search.kinematics.has_limits or plans.in_time
        n_drawn = 1 if dear or follows(search) else self.n_drawn[search.scene.n_dims - 2]
        failures = idle = met = smooth = 0
        known, near = list[TriedPath](), list[Plan]()
        space, ends = plans.space, plans.ends
        hasty, limited, pool, tried = search.aim.is_time, search.kinematics.has_limits, [], 0
        n_ways, n_idle, n_met = (search.level.patience * n for n in (self.n_ways, self.n_idle, self.n_met))
        n_ways = search.level.ways or n_ways
        taught = search.taught is not None and follows(search)
        if taught and n_ways == 1:
            taught = False
            if self._smooth_demonstration(search):
                return True
        with closing(PlansAhead(search, plans.planner, n_drawn)) as ahead:
            while tried < n_ways and idle < n_idle and met < n_met:
                if idle >= self.settings.hasty_idle and (
                    hasty or (search.found.best is None and search.found.needed < np.inf)
                ):
                    break  # seconds a way, and ways differ less in time than in jerk
                is_near = bool(near)
                if not near:
                    begun = ahead.taken()
                    for k in range(n_drawn):
                        search.check_time()
                        search.journal.stage = "planning"
                        nodes = self._nodes(failures if search.found.best is None else 0)
                        found = begun[k] if begun else plans.targets(failures, nodes, search.rng)
                        if found is None:
                            failures += 1
                            break
                        # Something to hand out at once; where the duration is open it would be a slow motion.
                        if search.found.best is None and not search.paced:
                            self._certified_fit(search, *found, mend=False)
                        pool.append(found)
                    if failures >= self.n_failures:
                        break
                    if not pool:
                        continue
                    longest = np.inf if follows(search) else self._longest(known)
                    pool, costs = _new_ways(space, pool, known, longest, self.settings.compared)
                    met += (
                        min(costs, default=np.inf)
                        < (1 + self.settings.worth_another) * search.found.best_cost
                    )
                    if not pool:  # what they would become is known
                        tried, idle = tried + 1, idle + 1
                        continue
                ways = near or pool
                targets, goal = ways.pop(first_least([way_length(space, targets[0]) for targets, _ in ways]))
                before, needed, search.found.latest = search.found.best_cost, search.found.needed, np.inf
                # One that gains nothing may be the last one.
                last = tried + 1 >= n_ways or idle + 1 >= n_idle or met + 1 >= n_met
                if not (limited or last or ahead.are_begun):
                    ahead.begin(failures, self._nodes(failures if search.found.best is None else 0))
                if tried == 0 and taught:
                    self._smooth_demonstration(search)
                search.journal.stage = "smoothing"
                # The first target is run with least jerk, or as it was planned in time.
                boundary = np.stack([ends[0], ends[1], goal, ends[3]])
                done = smooth_way(search, targets[0], boundary, self.settings.smoothing)
                tried, smooth, failures = tried + 1, smooth + done, failures + (not done)
                # In space ways around an obstacle can be deformed into each other, and yet differ.
                if done and space.blocks.n_dims == 2 and not dear and search.found.latest_motion is not None:
                    times = np.linspace(0.0, 1.0, N_STEPS)[:: self.settings.compared]
                    known.append(
                        TriedPath(
                            search.found.latest_motion.at(times)[0],
                            search.found.latest,
                            way_length(space, targets[0]),
                        )
                    )
                if search.found.best is None and self._will_do(search):
                    return True
                gained = search.found.best_cost < (1 - self.settings.worth_another) * before
                gained |= search.found.needed < (1 - self.settings.worth_another) * needed
                if gained:
                    idle, met = 0, 1
                    near = [] if dear or hasty or follows(search) else self._near(search, plans, known)
                elif not is_near:
                    idle += not needed == search.found.best_cost == np.inf
                    met += search.found.latest < (1 + self.settings.worth_another) * search.found.best_cost
                if search.found.best_cost < (1 + self.settings.worth_another) * least_worth(search):
                    break
        # Arms have other limits than the scene's.
        if search.found.best_motion is not None and hasty and not limited:
            hurry(search, search.found.best_motion, self.settings.smoothing.fastest, self.settings.smoothing)
        if limited:
            return smooth > 0
        return (
            search.found.best is not None or search.found.needed < np.inf
        )  # which no other way would shorten much

    def _near(self, search: Search, plans: Plans, known: Sequence[TriedPath]) -> list[Plan]:
        """Return paths that vary the best motion at one narrow place."""
        space, motion, settings = plans.space, search.found.best_motion, self.settings.planner
        if motion is None or not can_turn(space):
            return []
        margin, times = search.scene.clearance, np.linspace(0.0, 1.0, N_STEPS)
        paths = [
            continuous(
                space, shortened(World.of(space), path, margin, search.rng, settings.n_shortcuts, True)
            )
            for path in turned_otherwise(space, motion.at(times)[0], margin)
        ]
        ways = [(targets_along(space, path, gentle=True), path[-1]) for path in paths]
        return _new_ways(space, ways, known, self._longest(known), self.settings.compared)[0]

    def _longest(self, known: Sequence[TriedPath]) -> float:
        """Return the largest length of paths that are smoothed [m]."""
        best = min(known, key=lambda one: one.cost, default=None)
        return np.inf if best is None else self.settings.longer * best.length

    def _smooth_demonstration(self, search: Search) -> bool:
        """Adapt the demonstration to the scene and smooth it; return whether it is verified."""
        search.journal.stage = "smoothing the demonstration"
        return smooth_demonstration(search, search.taught or (), self.settings.smoothing)

    def _will_do(self, search: Search) -> bool:
        return False

    def _nodes(self, failures: int) -> int:
        return min(self.settings.most_nodes, self.n_nodes * 2 ** (failures // self.n_restarts))

    def _certified_fit(
        self, search: Search, targets: Array, goal: Array, mend: bool
    ) -> tuple[float, CoordinatedDMP] | None:
        """Return a plan's cheapest verified fit and its cost; None if there is none.

        A path with sharp bends is fitted again, with more weights. If `mend` is set and no fit is verified, the best
        one without contact is repaired instead.
        """
        hopeful, doubted = None, 0
        for n_basis in dict.fromkeys((self.n_basis, max(self.n_basis, self.n_basis_fine))):
            basis = search.basis(n_basis, "velocity")
            dmp, weights = fit(targets, goal, search.objective.coordinates, basis, search.scene)
            candidates = search.candidates(dmp, weights, self.settings.n_asked, limited=not mend)
            value, some = candidates.value, islice(candidates.best_first(), self.settings.n_certified)
            for i in chain(some, (candidates.gentlest for _ in range(1))):  # found only if it is its turn
                if search.found.attempt is not None:  # one is judged even if time is up
                    search.check_time()
                if candidates.sound[i] and not candidates.possible[i]:
                    doubted += 1
                    if doubted > self.settings.most_doubted:  # of its own check, which knows exactly
                        break
                if search.judge(dmp.rollout(weights[i])).verified:
                    return float(value.cost[i]), replace(dmp, weights=weights[i])
            # Only too fast or too sudden: that can be mended; likewise a plan in time that smoothing spoilt a little.
            spoilt = self.settings.hopeless if search.scene.moving.any() else 0.0
            free = value.clearance > search.scene.clearance - spoilt
            if mend and hopeful is None and free.any():
                candidates.ask_all()
                hopeful = replace(dmp, weights=weights[np.where(free, candidates.rank, np.inf).argmin()])
        if mend and _is_convex(search) and not (search.scene.moving.any() or dmp.boundary[1].any()):
            return self._smoothed(search, targets[GENTLE][0], dmp)
        return None if hopeful is None else self._mended(search, hopeful)

    def _smoothed(
        self, search: Search, way: Array, dmp: CoordinatedDMP
    ) -> tuple[float, CoordinatedDMP] | None:
        """Return the motion of least jerk along a path and its cost; None if it is not verified."""
        search.journal.stage = "mending"
        if not smooth_way(search, way, dmp.boundary, self.settings.smoothing):
            return None
        motion = search.found.best_motion
        assert motion is not None, "it was verified"
        return search.worth(motion), replace(dmp, basis=motion.basis, weights=motion.weights)

    def _mended(self, search: Search, dmp: CoordinatedDMP) -> tuple[float, CoordinatedDMP] | None:
        """Return a verified motion near a rejected one and its cost; None if none was found."""
        search.journal.stage = "mending"
        objective, schedule = (
            search.objective,
            replace(self.settings.mending, enough=search.kinematics.has_limits),
        )
        for _ in range(self.n_polishings):
            dmp = improve(search, objective, dmp, schedule)
            verdict = search.judge(dmp.rollout())
            if verdict.verified:
                return search.objective.cost(dmp.rollout()).total, dmp
            objective = stricter(search, objective, verdict)
        return None

    def _polish(self, search: Search, dmp: CoordinatedDMP) -> None:
        """Improve a verified motion, with stricter objectives until the result is verified."""
        search.journal.stage = "polishing"
        objective, schedule = search.objective, self.polishing
        for _ in range(self.n_polishings):
            dmp = improve(search, objective, dmp, schedule)
            verdict = search.judge(dmp.rollout())
            if verdict.verified or not search.hard:
                return
            objective, schedule = (
                stricter(search, objective, verdict),
                replace(self.polishing, sigma=self.settings.polishing_again),
            )

    def _grow(self, search: Search, restarts: Iterable[int]) -> bool:
        """Optimise motions by payload-size continuation; return whether one is verified and polished."""
        basis = search.basis(self.n_basis_growing, "acceleration")
        along_path = search.objective.with_penalty(along_path=True)
        for restart in restarts:
            search.journal.stage = f"growing the load, restart {restart}"
            guess = first_guess(search, search.objective.coordinates, basis, restart, self.settings)
            dmp = threaded(search, along_path, guess, self.settings) if restart > 0 else guess
            if dmp is None:
                continue
            objective = along_path
            schedule = self.settings.growing
            if restart > 0:
                schedule = replace(schedule, sigma=self.settings.threaded_sigma)
            dmp = improve(search, objective, dmp, schedule)
            for _ in range(self.n_polishings):
                search.check_time()
                motion = dmp.rollout()
                verdict = search.judge(motion)
                if verdict.verified or not search.hard:
                    self._polish(search, self._refined(search, dmp))
                    return True
                value = search.evaluate(objective, dmp, dmp.weights[None])
                if value.clearance[0] < -self.settings.hopeless:
                    break
                objective = stricter(search, objective, verdict)
                dmp = improve(search, objective, dmp, self.settings.repairing)
        return False

    def _refined(self, search: Search, dmp: CoordinatedDMP) -> CoordinatedDMP:
        q = dmp.rollouts(dmp.weights[None], N_STEPS)[0].T
        finer = replace(dmp, basis=search.basis(self.n_basis, "velocity"))
        return finer.fitted(np.linspace(0.0, 1.0, N_STEPS), q)


@dataclass(frozen=True)
class Quick(Comove):
    """A faster method with few plans and no polishing."""

    name: ClassVar[str] = "quick"
    n_plans: int = 2
    n_failures: int = 5
    n_ways: int = 2
    n_idle: int = 1
    polishing: Schedule = UNPOLISHED

    def _stages(self, search: Search, planner: bool) -> Stages:
        return (yield from self._planned(search))


@dataclass(frozen=True)
class Guide(Quick):
    """A method for callers that keep the limits. It accepts motions without contact that are too fast.

    Attributes
    ----------
    excess : largest accepted ratio of a rate to its limit
    """

    name: ClassVar[str] = "guide"
    n_unfit: float = np.inf
    excess: float = 2.0

    def will_do(self, report: Report, scene: Scene) -> bool:
        """Return whether a motion with this report is good enough."""
        excess = max(report.limit_ratios(scene))
        return report.clearance_min >= scene.clearance and excess <= self.excess

    def _will_do(self, search: Search) -> bool:
        rejected = search.found.attempt_verdict
        return rejected is not None and self.will_do(rejected.report, search.scene)


Stages = Generator[Callable[[], bool], bool | None, bool]
"""What yields functions that search, to be called one after the other, and receives what they return."""


class Plans(NamedTuple):
    """Planner of paths for a search.

    Attributes
    ----------
    space : configuration space of the payload
    ends : boundary of the motions, as in `CoordinatedMotion`
    planner : function of a clock that returns the planner
    targets : the planner with the search's clock
    in_time : whether plans are in time as well
    """

    space: Space
    ends: Array
    planner: Callable[[Array], Targets]
    targets: Targets
    in_time: bool

    @classmethod
    def of(cls, search: Search, method: Comove) -> Plans:
        """Return the planner for a search by a method."""
        planning = load_coordinates(search.scene)
        space = configuration_space(search.scene, planning, method.settings.space, search.clock.array)
        ends = planning.boundary()
        in_time = bool(search.scene.moving.any() or ends[1].any())
        kind = _planner_in_time if in_time else _planner

        def planner(clock: Array) -> Targets:
            # With scratch of its own, as another thread may plan; what was found so far counts for both.
            query = space.query._replace(normals=space.query.normals.copy())
            own = space._replace(clock=clock, parts=space.parts.copy(), query=query)
            return kind(search, own, ends, method)

        return cls(space, ends, planner, planner(space.clock), in_time)


def _is_convex(search: Search) -> bool:
    """Return whether convex programmes optimise motions by equation (4)."""
    return search.hard and not search.kinematics.has_limits and search.objective.coordinates.kind == "load"


class TriedPath(NamedTuple):
    """A motion that a path led to.

    Attributes
    ----------
    way : array, shape (n_times, n_columns), the motion
    cost : its value
    length : length of the path [m]
    """

    way: Array
    cost: float
    length: float


def _new_ways(
    space: Space, pool: list[Plan], known: Sequence[TriedPath], longest: float, compared: int
) -> tuple[list[Plan], list[float]]:
    """Return new paths shorter than `longest`, and the costs of known ones."""
    new, met = list[Plan](), list[float]()
    for targets, goal in pool:
        way = np.ascontiguousarray(targets[0][::compared])
        like = next((one.cost for one in known if deforms(space, way, one.way, 0.0)), None)
        if like is not None:
            met.append(like)
        elif way_length(space, targets[0]) < longest:
            new.append((targets, goal))
    return new, met


def _unsampled(scene: Scene) -> Scene:
    return replace(scene, constraints=tuple(c for c in scene.constraints if not c.sampled))


def _planner(search: Search, space: Space, ends: Array, method: Comove) -> Targets:
    """Return a planner in space; `ends` is a boundary at rest.

    Its paths are run with several time profiles. A payload is lifted off its supports and set down on them, and paths
    are planned in between.
    """
    scene, at_start, at_goal = search.scene, ends[0], ends[2]
    margins = method.settings.margins[scene.n_dims - 2]
    start = lifted(scene, space, at_start, "start", 2 * max(margins))
    goal = lifted(scene, space, at_goal, "goal", 2 * max(margins))
    settings = method.settings.planner
    grow = search.kinematics.planner(settings)
    turns = can_turn(space) and scene.n_dims == 3 and not search.kinematics.has_limits
    scratch = np.empty((space.blocks.node.shape[0], 3))
    at_ends = min(clearance_of(space, end, scratch, 0.0) for end in (start, goal)) if turns else 0.0

    def targets(failures: int, max_nodes: int, rng: np.random.Generator) -> Plan | None:
        margin, required = margins[failures % len(margins)], search.scene.clearance
        if space.clock is search.clock.array:
            search.clock.wind()
        path = grow(space, start, goal, margin, rng, required=required, max_nodes=max_nodes)
        if path is None:
            return None
        if turns:
            path = _turned(space, path, kept_margin(at_ends, margin, required), rng, settings)
        path, _ = _between_supports(
            space, path, np.zeros(len(path)), (at_start, start, goal, at_goal), np.inf
        )
        # To arrive early pays by equation (4) alone; arms may need it too.
        gentle = search.aim.is_smooth and not search.kinematics.has_limits
        return targets_along(space, path, gentle=gentle), path[-1]

    return targets


def _turned(
    space: Space, path: Array, margin: float, rng: np.random.Generator, settings: PlannerSettings
) -> Array:
    """Return the shortest path through the same places, shortened."""
    turned = shortest_turned(space, path, margin)
    if turned is path:
        return path
    return continuous(space, shortened(World.of(space), turned, margin, rng, settings.n_shortcuts, True))


def _between_supports(
    space: Space, path: Array, times: Array, ends: tuple[Array, Array, Array, Array], speed: float
) -> tuple[Array, Array]:
    """Extend a path between lifted ends to the start and goal; return its times too.

    Parameters
    ----------
    path, times : arrays, shapes (n_configurations, n_columns) and (n_configurations,)
    ends : start, lifted start, lifted goal and goal; arrays, shape (n_columns,)
    speed : speed; a payload is lifted and set down at half of it [m a duration]
    """
    start, high, low, goal = ends
    if high is start and low is goal:
        return path, times
    if high is not start:
        until = min(times[0] + 2 * span(space, start, high) / speed, 0.5 * (times[0] + times[1]))
        path, times = np.vstack([start, path]), np.concatenate([times[:1], [until], times[1:]])
    if low is not goal:
        since = max(times[-1] - 2 * span(space, low, goal) / speed, 0.5 * (times[-1] + times[-2]))
        path, times = np.vstack([path, goal]), np.concatenate([times[:-1], [since], times[-1:]])
    return continuous(space, path), times


def _planner_in_time(search: Search, space: Space, ends: Array, method: Comove) -> Targets:
    """Return a planner in space and time, with smoothed paths; `ends` is a boundary."""
    scene, (start, velocity, goal, _), settings = search.scene, ends, method.settings.in_time
    coasting = coast(velocity, scene.acceleration_limit * scene.duration**2, N_STEPS, settings)
    world = spacetime(scene, space, settings)
    lift = 2 * max(settings.margins)
    lifts = lifted(scene, space, start, "start", lift), lifted(scene, space, goal, "goal", lift)
    unlimited = settings.unlimited * (span(space, start, goal) + space.cap)
    limit = min(scene.speed_limit * scene.duration, unlimited)

    def targets(failures: int, max_nodes: int, rng: np.random.Generator) -> Plan | None:
        share = settings.shares[failures % len(settings.shares)]
        margin = settings.margins[failures % len(settings.margins)]
        if space.clock is search.clock.array:
            search.clock.wind()
        found = search.kinematics.plan_in_time(
            world,
            *lifts,
            share * limit,
            margin,
            rng,
            max_nodes=max_nodes,
            share=share,
            before=method.before,
            n_shortcuts=settings.n_shortcuts,
        )
        if found is None:
            return None
        found = _between_supports(space, *found, (start, *lifts, goal), share * limit)
        return targets_in_time(space, *found, N_STEPS, settings.smoothings) + coasting, found[0][-1]

    return targets


def first_guess(
    search: Search,
    coordinates: Coordinates,
    basis: MotionBasis,
    restart: int,
    settings: MethodSettings = SETTINGS,
) -> CoordinatedDMP:
    """Return the demonstration, or the straight line with some turn. Every third restart uses the demonstration."""
    if search.taught is not None and restart % 3 == 0:
        return CoordinatedDMP.from_demonstration(search.taught, search.scene, coordinates, basis)
    boundary = coordinates.boundary(turn=settings.turns[restart % len(settings.turns)])
    weights = np.zeros((coordinates.n_columns, basis.n_basis))
    return CoordinatedDMP(search.scene, coordinates, basis, boundary, weights)


def threaded(
    search: Search, objective: Objective, dmp: CoordinatedDMP, settings: MethodSettings = SETTINGS
) -> CoordinatedDMP | None:
    """Add the best random bump each round until the smallest payload fits. Return None on failure."""
    directions, weights, least = dmp.coordinates.search, dmp.weights[None], np.inf
    for _ in range(settings.rounds):
        search.check_time()
        value = search.evaluate(objective, dmp, weights, settings.growing.smallest_load)
        fitness = objective.search_value(value)
        i = int(np.argmin(fitness))
        if fitness[i] < least:
            dmp, least = replace(dmp, weights=weights[i]), fitness[i]
        if value.clearance[i] > search.scene.clearance:
            return replace(dmp, weights=weights[i])
        heights = settings.spread * search.rng.standard_normal((settings.draws, directions.shape[1], 1))
        weights = dmp.weights + directions @ (heights * bumps(dmp.basis, search.rng, settings.draws)[:, None])
    return None

"""The state of a search, and the optimisation of shape weights."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.dmp.basis import Metric, MotionBasis, motion_basis
from comove.dmp.dmp import DMP
from comove.dmp.system import LinearPhase, Phase
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.clock import A_SECOND, MOST, WORK, Budget, clock_until, now, wind
from comove.planning.compiling import Compiled
from comove.planning.configurations import MESH_WORK, SOLID_WORK
from comove.planning.convex.limits import Limits
from comove.planning.effort import NORMAL, EffortLevel
from comove.planning.kinematics import CERTIFIED, FREE, Kinematics
from comove.planning.objective import N_STEPS, Evaluation, Objective
from comove.planning.objectives import Criterion, OwnFunctions, PaperCost, Samples
from comove.planning.pace import in_least_time
from comove.planning.solution import Progress, ProgressCallback, SearchEffort
from comove.verification.verify import Check, Verdict, verify

# Work, as computed distances that take about as long.
ROLLOUT = 2e3  # of a rollout, besides its distances


class OutOfTime(Exception):
    """The error of a spent budget or the user's interruption."""


class Interruption:
    """A request to stop: by Ctrl-C, a `KeyboardInterrupt` of a callback, or the caller.

    Parameters
    ----------
    stop : function that returns whether the caller requests the end; never unless given
    """

    def __init__(self, stop: Callable[[], bool] | None = None) -> None:
        self._noticed, self._stop = False, stop

    @property
    def wished(self) -> bool:
        """Return whether the end was requested. A request stays."""
        if not self._noticed and self._stop is not None:
            self._noticed = self._stop()
        return self._noticed

    @contextmanager
    def noticed(self) -> Iterator[None]:
        """Hold Ctrl-C back until the next check of the time. Another handler than Python's own stays.

        A `KeyboardInterrupt` raised inside a compiled kernel would reach Python as a `SystemError`.
        """
        before = signal.getsignal(signal.SIGINT)
        held = before is signal.default_int_handler and threading.current_thread() is threading.main_thread()
        if held:
            signal.signal(signal.SIGINT, self._wish)
        try:
            yield
        except KeyboardInterrupt:
            self._noticed = True
        finally:
            if held:
                signal.signal(signal.SIGINT, before)

    def _wish(self, *_: object) -> None:
        """Note the first Ctrl-C; the next one raises `KeyboardInterrupt`."""
        self._noticed = True
        signal.signal(signal.SIGINT, signal.default_int_handler)


@dataclass
class SearchClock:
    """The bounds of a search, and the amounts spent.

    Attributes
    ----------
    budget : bounds of the search
    started : time of `clock.now` at which the search began [s]
    compiled : counters of the kernels compiled since the start
    interruption : flag of the user's request to end
    array : deadline and count of work, which all kernels share
    """

    budget: Budget = field(default_factory=Budget)
    started: float = field(default_factory=now)
    compiled: Compiled = field(default_factory=Compiled)
    interruption: Interruption = field(default_factory=Interruption)
    array: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self.array = clock_until(work=self.budget.work * A_SECOND)
        self.wind()

    def wind(self) -> None:
        """Postpone the deadline by the time that was spent on compilation."""
        wind(self.array, self.started + self.budget.seconds + self.compiled.seconds)

    def elapsed(self) -> float:
        """Return the time since the start without compilation [s]."""
        return now() - self.started - self.compiled.seconds

    @property
    def work(self) -> float:
        """Return the work counted so far, in units of about a second's."""
        return float(self.array[WORK]) / A_SECOND

    def add_work(self, work: float) -> None:
        """Count work, as computed distances that take about as long."""
        self.array[WORK] += work

    @property
    def is_worked_off(self) -> bool:
        """Return whether all work is done."""
        return bool(self.array[WORK] > self.array[MOST])


@dataclass
class Found:
    """Results of a search so far.

    Attributes
    ----------
    best, best_motion, best_cost : best motion so far with its verification result and its value of the objective
    latest, latest_motion : last verified motion (last evaluated one where obstacles are costs) and its value
    first_verified : time from the start to the first verified motion [s]
    kept : all motions that were the best at their time, in order
    attempt, attempt_verdict, attempt_violation : rejected motion that is nearest to being verified, its verification
        result, and its violation
    needed : shortest duration known to suffice if the given one is too short [s]; else inf
    smoothest : jerk of the smoothest motions along planned paths that were adapted to arms, as in `JerkCost`
    drawn : jerk of those of arms that were adapted to the demonstration
    """

    best: Verdict | None = None
    best_motion: CoordinatedMotion | None = None
    best_cost: float = np.inf
    latest: float = np.inf
    latest_motion: CoordinatedMotion | None = None
    first_verified: float | None = None
    kept: list[CoordinatedMotion] = field(default_factory=list)
    attempt: CoordinatedMotion | None = None
    attempt_verdict: Verdict | None = None
    attempt_violation: float = np.inf
    needed: float = np.inf
    smoothest: list[float] = field(default_factory=list)
    drawn: list[float] = field(default_factory=list)
    handed: list[tuple[CoordinatedMotion, CoordinatedMotion]] = field(
        default_factory=list, init=False, repr=False
    )


@dataclass
class Journal:
    """Progress that a search reports.

    Attributes
    ----------
    progress : function that is called once a generation, and for every motion that is the best so far
    stage : description of the current stage
    evaluations, generations : counters of evaluated samples and of generations
    log : figures that a method reports of its run, numbers or lists of numbers by name
    """

    progress: ProgressCallback | None = None
    stage: str = ""
    evaluations: int = 0
    generations: int = 0
    log: dict[str, float | list[float]] = field(default_factory=dict)


@dataclass(eq=False)
class Candidates:
    """A population of rollouts, best first.

    The kinematics of arms are slow: they evaluate one rollout after the other, and only while the result may change
    which one is next. All others count as impossible. The obstacles of rollouts beyond the limits are evaluated as
    late.

    Attributes
    ----------
    objective, value : objective, and the rollouts' evaluation by it, with the kinematics' penalties evaluated so far
    possible : array, shape (n_rollouts,), whether the kinematics may execute them
    unasked : what is left of the penalties of kinematics or obstacles and of the possibilities, by the number of the
        rollout; see `Kinematics.asking`
    """

    objective: Objective
    value: Evaluation
    possible: NDArray[np.bool_]
    unasked: dict[int, Iterator[tuple[float, bool, bool]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._alone = self.value.penalty.copy()  # without the kinematics' penalties

    @cached_property
    def sound(self) -> NDArray[np.bool_]:
        """Return which rollouts are feasible but for the kinematics; array, shape (n_rollouts,)."""
        return self.objective.feasible(self.value._replace(possible=np.ones(len(self.possible), dtype=bool)))

    @property
    def missed(self) -> Array:
        """Return the rank penalties of rollouts that objective or kinematics reject."""
        return np.where(self.sound, 0.0, 100.0) + np.where(self.possible, 0.0, 10.0)

    @property
    def rank(self) -> Array:
        """Return the values that rank rollouts; array, shape (n_rollouts,)."""
        return self.objective.search_value(self.value) + self.missed

    @property
    def gentlest(self) -> int:
        """Return the number of the rollout furthest within the limits."""
        self.ask_all(self.sound if self.sound.any() else ~self.sound)
        return int(np.argmin(np.maximum(*self.objective.limit_ratios(self.value)) + self.missed))

    def best_first(self) -> Iterator[int]:
        """Yield the numbers of the rollouts, best first. Penalties are never negative, so ranks hold."""
        left = np.ones(len(self.possible), dtype=bool)
        while left.any():
            order = np.argsort(self.rank, kind="stable")
            best = int(order[left[order]][0])
            if best in self.unasked:
                self._ask(best)
            else:
                left[best] = False
                yield best

    def ask_all(self, some: NDArray[np.bool_] | bool = True) -> None:
        """Evaluate what is left of some rollouts; array, shape (n_rollouts,)."""
        for number in np.flatnonzero(np.broadcast_to(some, len(self.possible))).tolist():
            while number in self.unasked:
                self._ask(number)

    def _ask(self, number: int) -> None:
        penalty, self.possible[number], is_all = next(self.unasked[number])
        self.value.penalty[number] = self._alone[number] + penalty
        if is_all:
            del self.unasked[number]


@dataclass
class Search:
    """The state of a search, with which a method works.

    Attributes
    ----------
    objective : equation (4) on the scene
    taught : demonstrated movement of every manipulator; None without any
    hard : whether obstacles are constraints, not only costs
    rng : source of all random numbers
    aim : objective that decides which motion is best
    limits : limits of the end effectors, for the duration of the scene that is searched
    own : objective and constraints of the user; None without any, if none of the scene's are sampled either
    asked : scene of the caller, on which motions are returned, as fast as possible if its duration is open; None if
        it is the scene that is searched
    checks : further checks that a motion must pass, on the scene of the caller
    kinematics : kinematics of the end effectors
    level : effort of improving a motion
    clock, found, journal : bounds and amounts spent, the best motions, and progress
    """

    objective: Objective
    taught: tuple[DMP, ...] | None
    hard: bool
    rng: np.random.Generator
    aim: Criterion = field(default_factory=PaperCost)
    limits: Limits | None = None
    own: OwnFunctions | None = None
    asked: Scene | None = None
    checks: Sequence[Check] = ()
    kinematics: Kinematics = FREE
    level: EffortLevel = NORMAL
    clock: SearchClock = field(default_factory=SearchClock)
    found: Found = field(default_factory=Found)
    journal: Journal = field(default_factory=Journal)

    def basis(self, n_basis: int, metric: Metric, phase: Phase | None = None) -> MotionBasis:
        """Return the basis of the motions that are searched.

        Where the scene limits the jerk it is that in the metric of jerk, whose accelerations do not jump at the ends,
        unless another phase than the linear one is requested.
        """
        limited = np.isfinite((self.asked or self.scene).jerk_limit)
        if limited and phase in (None, LinearPhase()):
            return motion_basis(n_basis, "jerk")
        return motion_basis(n_basis, metric, phase)

    @property
    def scene(self) -> Scene:
        """Return the scene that is searched."""
        return self.objective.scene

    @property
    def paced(self) -> bool:
        """Return whether the duration is open and the kinematics limit it."""
        return self.kinematics.has_limits and self.asked is not None and not self.asked.is_timed

    def count(self, n_rollouts: int, each: float = ROLLOUT) -> None:
        """Count evaluated rollouts, and the work of each."""
        self.journal.evaluations += n_rollouts
        self.clock.add_work(n_rollouts * each)

    @cached_property
    def _work_of_rollout(self) -> float:
        """Return the work of evaluating a rollout."""
        scene = self.objective.scene
        bodies = len(scene.body.edges) + SOLID_WORK * len(scene.body.solids)
        obstacles = int(scene.convex_rows.sum()) + MESH_WORK * len(scene.surfaces.root)
        return ROLLOUT + N_STEPS * bodies * (1.0 + obstacles)

    @property
    def effort(self) -> SearchEffort:
        """Return the effort so far."""
        journal, clock = self.journal, self.clock
        return SearchEffort(
            journal.evaluations, journal.generations, clock.elapsed(), clock.work, self.found.first_verified
        )

    @property
    def timed_out(self) -> bool:
        """Return whether time is up, or work is done without a motion."""
        return self.clock.elapsed() > self.clock.budget.seconds or (
            self.clock.is_worked_off and self.found.best is None
        )

    def over(self) -> bool:
        """Return whether the budget is spent, or the user requests the end."""
        return self.clock.interruption.wished or self.clock.is_worked_off or self.timed_out

    def check_time(self) -> None:
        """Raise `OutOfTime` once the search is over."""
        if self.over():
            raise OutOfTime

    def evaluate(
        self, objective: Objective, dmp: CoordinatedDMP, weights: Array, size: float = 1.0
    ) -> Evaluation:
        """Evaluate a population of weights, array of shape (n_rollouts, n_columns, n_basis)."""
        self.count(len(weights), self._work_of_rollout)
        q = dmp.rollouts(weights, N_STEPS)
        self.clock.add_work(self.kinematics.work_of_rollout * len(weights))
        return self.kinematics.followed(objective.evaluate(q, size), objective, q)

    def candidates(
        self, dmp: CoordinatedDMP, weights: Array, n_asked: int, limited: bool = True
    ) -> Candidates:
        """Evaluate a population; defer the kinematics of its best `n_asked` rollouts.

        Parameters
        ----------
        limited : whether to defer the obstacles of rollouts beyond the limits as well
        """
        kinematics, objective = self.kinematics, self.objective
        self.count(len(weights), self._work_of_rollout)
        q, unasked = dmp.rollouts(weights, N_STEPS), dict[int, Iterator[tuple[float, bool, bool]]]()
        value, possible = objective.evaluate(q, limited=limited), np.ones(len(weights), dtype=bool)
        if kinematics.has_limits:
            self.clock.add_work(kinematics.work_of_rollout * min(n_asked, len(weights)))
            every = _likely(objective, value, n_asked)
            if np.isnan(value.clearance[every]).any():  # too few keep the limits
                value = objective.evaluate(q)
                every = _likely(objective, value, n_asked)
            possible = np.isin(np.arange(len(weights)), every)
            ask = kinematics.asking(objective.coordinates.nodes(q[every]))
            unasked = {number: ask(k) for k, number in enumerate(every.tolist())}

        def obstructed(k: int) -> Iterator[tuple[float, bool, bool]]:
            found = objective.evaluate(q[k : k + 1])
            value.clearance[k], value.hits[k] = found.clearance[0], found.hits[0]
            yield float(found.penalty[0]), bool(possible[k]), True

        unasked |= {k: obstructed(k) for k in np.flatnonzero(np.isnan(value.clearance)).tolist()}
        return Candidates(objective, value._replace(penalty=value.penalty.copy()), possible, unasked)

    def judge(self, motion: CoordinatedMotion) -> Verdict:
        """Verify a motion, and keep it if it is the best. Further checks, which may be slow, come last."""
        self.clock.add_work(CERTIFIED)
        verdict = verify(motion)
        if verdict.verified is not None and (self.checks or self.asked is not None):
            self.clock.add_work(self.kinematics.work_of_check)
            handed = self.handed(motion)
            checked = verdict if handed is motion else verify(handed)
            checked = checked.checked(handed, self.checks)
            if checked.verified is None:
                verdict = replace(verdict, verified=None, reasons=checked.reasons)
        if verdict.verified is None:
            violation = self._violation(verdict)
            if self.found.attempt is None or violation < self.found.attempt_violation:
                self.found.attempt, self.found.attempt_verdict, self.found.attempt_violation = (
                    motion,
                    verdict,
                    violation,
                )
        elif self.found.first_verified is None:
            self.found.first_verified = self.clock.elapsed()
        if verdict.verified is not None or not self.hard:
            cost = self.found.latest = self.worth(motion)
            self.found.latest_motion = motion
            if cost < self.found.best_cost:
                self.found.best, self.found.best_motion, self.found.best_cost = verdict, motion, cost
                self.found.kept.append(motion)
                self._report(cost, 0.0)
        return verdict

    def worth(self, motion: CoordinatedMotion) -> float:
        """Return the value of the objective that decides, where less is better."""
        if self.own is not None and self.own.function is not None:
            return self.own.value(Samples.of(self.handed(motion)))
        return self.aim.value(motion, self.objective, lambda: self.handed(motion))

    def settle_for(self, aim: Criterion) -> None:
        """Replace the deciding objective, and evaluate the best motion by it."""
        self.aim = aim
        if self.found.best_motion is not None:
            self.found.best_cost = self.worth(self.found.best_motion)

    def handed(self, motion: CoordinatedMotion) -> CoordinatedMotion:
        """Return a motion on the caller's scene.

        Those of the last motion and of the best are kept: a second computation might choose other joints of the arms.
        """
        if self.asked is None:
            return motion
        for one, handed in self.found.handed:
            if one is motion:
                return handed
        kept = [pair for pair in self.found.handed if pair[0] is self.found.best_motion]
        self.found.handed = [*kept, (motion, self._on_time(motion, self.asked))]
        return self.found.handed[-1][1]

    def _on_time(self, motion: CoordinatedMotion, asked: Scene) -> CoordinatedMotion:
        if asked.is_timed:
            return motion.on(asked)
        least = self.kinematics.shortest(motion)
        return in_least_time(motion, asked, least if least < np.inf else 0.0)  # the checks tell the rest

    def _violation(self, verdict: Verdict) -> float:
        """Return a rejected motion's distance from being verified. Contact counts more than limits."""
        report, scene = verdict.report, self.scene
        missed = max(-(report.separation_spare_min or 0.0), report.constraint_excess_max or 0.0)
        depth = max(0.0, scene.clearance - report.clearance_min, missed)
        excess = max(report.limit_ratios(scene))
        centimetres = 100.0 * depth  # each of which counts as much as limits that are exceeded without end
        violation = (1.0 + centimetres if depth > 0 else 0.0) + 1.0 - 1.0 / (1.0 + excess)
        return np.inf if np.isnan(violation) else violation

    def tell(self, cost: float, violation: float) -> None:
        """Count a generation and report it."""
        self.journal.generations += 1
        self._report(cost, violation)

    def _report(self, cost: float, violation: float) -> None:
        if self.journal.progress is not None:
            best = None if self.found.best is None else self.found.best_cost
            motion = None if self.found.best_motion is None else self.handed(self.found.best_motion)
            self.journal.progress(
                Progress(self.journal.stage, self.journal.generations, cost, violation, best, motion)
            )


@dataclass(frozen=True)
class Schedule:
    """Settings of one optimisation of shape weights.

    Attributes
    ----------
    sigma : first step size
    generations : largest number of generations
    patience, gain : the optimisation ends after `patience` generations without a relative gain of `gain`
    growth : generations over which the payload grows to its full size, fewer while most samples are free; only those
        count whose best sample touches nothing (if it must not). 0 for the full payload at once. An optimisation with
        growth ends with the first feasible free sample of the full payload, or `patience` generations without growth.
    enough : whether to end with the first feasible sample
    population : samples a generation
    smallest_load : share of its size from which the payload grows
    easy : generations that one counts as while most samples are free
    smallest_step : least step size while the payload grows, as a share of the first: it must be able to follow
    """

    sigma: float
    generations: int
    patience: int
    gain: float
    growth: float = 0.0
    enough: bool = False
    population: int = 16
    smallest_load: float = 0.05
    easy: int = 3
    smallest_step: float = 0.1

    def size(self, progress: float) -> float:
        """Return the payload's size after some generations; 1 is the full size."""
        if progress >= self.growth:
            return 1.0
        return self.smallest_load + (1.0 - self.smallest_load) * progress / self.growth


def improve(search: Search, objective: Objective, dmp: CoordinatedDMP, schedule: Schedule) -> CoordinatedDMP:
    """Optimise shape weights by separable CMA-ES; return the best primitive."""
    directions = dmp.coordinates.search
    shape = (directions.shape[1], dmp.basis.n_basis)
    n = shape[0] * shape[1]
    from comove.optim import CMAES, DiagonalCovariance, Parameters  # slow to import

    optimiser = CMAES(
        np.zeros(n),
        schedule.sigma,
        search.rng,
        parameters=Parameters.default(n, schedule.population, separable=True),
        covariance=DiagonalCovariance(n),
    )
    best, best_value, reference, waited = dmp.weights, np.inf, np.inf, 0
    progress = 0
    for _ in range(schedule.generations):
        search.check_time()
        size = schedule.size(progress)
        samples = dmp.weights + directions @ optimiser.ask().reshape(-1, *shape)
        value = search.evaluate(objective, dmp, samples, size)
        fitness = objective.search_value(value)
        optimiser.tell(fitness)
        if size < 1.0:
            spread = np.sqrt((optimiser.standard_deviations() ** 2).mean())
            optimiser.sigma *= max(1.0, schedule.smallest_step * schedule.sigma / spread)
        i = int(np.argmin(fitness))
        search.tell(float(value.cost[i]), float(fitness[i] - value.cost[i]))
        free = value.penalty == 0.0
        if size < 1.0:
            passing = value.clearance[i] > search.scene.clearance or not search.hard
            grown = schedule.easy if free.mean() > 0.5 else int(passing)
            progress, waited = progress + grown, 0 if grown else waited + 1
        else:
            if fitness[i] < best_value:
                best, best_value = samples[i], float(fitness[i])
            looks_good = (free[i] and schedule.growth) or schedule.enough
            if looks_good and objective.feasible(value)[i]:
                break
            waited += 1
            if best_value < reference * (1 - schedule.gain):
                reference, waited = best_value, 0
        if waited >= schedule.patience:
            break
    return replace(dmp, weights=best)


def stricter(search: Search, objective: Objective, verdict: Verdict, *, widening: float = 0.004) -> Objective:
    """Return an objective with wider margin or lower limits after a rejection.

    If the motion satisfies the scene, the kinematics must have rejected it: more careful ones replace them.

    Parameters
    ----------
    verdict : verification result of the rejected motion
    widening : length by which the margin widens [m]
    """
    scene, penalty, report = objective.scene, objective.penalty, verdict.report
    changes: dict[str, float] = {}
    if not (report.clearance_min >= scene.clearance and (report.separation_spare_min or 0.0) >= 0):
        changes["margin"] = penalty.margin + widening
    ratio = max(report.limit_ratios(scene))
    if ratio > 1:
        changes["limits"] = penalty.limits * max(0.8, 0.998 / ratio)
    if not changes:
        search.kinematics = search.kinematics.stricter()
    return objective.with_penalty(**changes)


def _likely(objective: Objective, value: Evaluation, n_asked: int) -> Integers:
    """Return the numbers of the `n_asked` best rollouts. The gentlest is among them."""
    if len(value.cost) <= n_asked:
        return np.arange(len(value.cost))
    missed = np.where(objective.feasible(value), 0.0, 100.0)
    gentlest = np.argmin(np.maximum(*objective.limit_ratios(value)) + missed)
    ranked = np.argsort(objective.search_value(value) + missed, kind="stable")
    return np.unique(np.append(ranked[: n_asked - 1], gentlest))

"""Obstacle-avoiding combination of several movements (the paper's reference [6]).

All movements are transferred to common ends. There the weights of the combination are, in every dimension d,

    w_d = sum_k c_kd w_kd,

so that any coefficients c meet the ends, and CMA-ES searches for those that minimise the objective (4) with
obstacles as constraints. The combination is transferred to every end effector as a demonstration is; its rollout is
verified like any other motion.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, first_largest
from comove.dmp import DMP, LinearPhase, Variant, motion_basis
from comove.dmp.operations import refitted
from comove.dmp.variants import adaptation
from comove.model.adaptation import modulate
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import Coordinates, load_coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.optim import CMAES, Parameters
from comove.planning.arguments import check_options
from comove.planning.choice import N_BASIS, Movements, best_movement, suitable
from comove.planning.clock import Budget
from comove.planning.compiling import compiling
from comove.planning.displays import displayed
from comove.planning.kernels import SceneKind, load_kernels
from comove.planning.objective import N_STEPS, ContactPenalty, Objective
from comove.planning.objectives.criteria import PaperCost
from comove.planning.search import Journal, OutOfTime, Schedule, Search, SearchClock, stricter
from comove.planning.solution import ProgressCallback, SearchEffort
from comove.processes import one_blas_thread
from comove.verification.verify import Check, VerifiedMotion, verify

IMPROVING = Schedule(sigma=0.5, generations=400, patience=40, gain=0.003, population=32)


@dataclass(frozen=True)
class CombinationSettings:
    """Settings of the search for coefficients.

    Attributes
    ----------
    schedule : schedule of the first runs; the population is doubled with every second restart
    largest : largest population
    restarts : runs at most
    compared : verified runs after which the best is returned
    agreeing, alike : verified runs that are enough if their costs agree, up to this share
    stricter : times that a rejected combination is improved with a wider margin
    again : first step size after a rejection
    """

    schedule: Schedule = IMPROVING
    largest: int = 128
    restarts: int = 12
    compared: int = 5
    agreeing: int = 3
    alike: float = 0.01
    stricter: int = 4
    again: float = 0.05


SETTINGS = CombinationSettings()


@dataclass(frozen=True, eq=False)
class Combination:
    """Result of `combine`.

    Attributes
    ----------
    dmp : the combination, at the ends of the end effector with the longest path; can be a demonstration for `solve`
    names : names of the movements
    coefficients : array, shape (n_movements, n_dims)
    attempt : motion of the combination, transferred to every end effector
    motion : `attempt` as a verified motion; None if it is not verified
    reasons : reasons why `attempt` is not verified
    cost : J of `attempt`
    effort : samples, time and work of the search
    restarts : number of runs of the optimiser
    seed : seed of all random numbers
    interrupted : whether the user stopped the search
    timed_out : whether the budget ran out before the search ended by itself
    """

    dmp: DMP
    names: tuple[str, ...]
    coefficients: Array
    attempt: CoordinatedMotion
    motion: VerifiedMotion | None
    reasons: tuple[str, ...]
    cost: float
    effort: SearchEffort
    restarts: int
    seed: int
    interrupted: bool = False
    timed_out: bool = False

    @property
    def verified(self) -> bool:
        """Return whether `motion` holds a verified motion."""
        return self.motion is not None


def combine(
    movements: Movements,
    scene: Scene,
    *,
    seed: int = 0,
    budget: float | Budget = 30.0,
    objective: PaperCost | None = None,
    plane: str | None = None,
    checks: Sequence[Check] = (),
    progress: ProgressCallback | bool | None = None,
    settings: CombinationSettings = SETTINGS,
) -> Combination:
    """Combine movements into one that avoids a scene's obstacles.

    Parameters
    ----------
    movements, plane : as for `best_movement`
    scene : scene of one end effector or several; several ones all make the same movement, each between its own ends
    seed : seed of all random numbers; the same inputs, seed and version give the same combination,
        unless the budget runs out (`Combination.timed_out`)
    budget : processor time after which the best attempt is returned [s], or a `Budget`, as of `solve`
    objective : weights of equation (4)
    checks : further checks that the motion must pass
    progress : as of `solve`
    settings : settings of the search

    Raises
    ------
    OptionError
        If no movement can be transferred, or an argument is out of range.
    """
    check_options(scene, None, seed, None, budget, objective, "constraint", checks)
    suited = suitable(movements, scene, plane)
    bounds = Budget.of(budget)
    coordinates = load_coordinates(scene)
    with displayed(progress, bounds) as tell, one_blas_thread():
        load_kernels(SceneKind.of(scene))
        search = Search(
            objective=Objective(
                scene, coordinates, objective or PaperCost(), ContactPenalty(along_path=True)
            ),
            taught=None,
            hard=True,
            rng=np.random.default_rng(seed),
            checks=checks,
            clock=SearchClock(bounds),
            journal=Journal(tell or None),
        )
        attempts = Attempts(search, suited, settings)
        with (
            suppress(OutOfTime),
            search.clock.interruption.noticed(),
            compiling(compiled=search.clock.compiled),
        ):
            attempts.run()
        timed_out = search.timed_out
        found = attempts.found()
    verdict = verify(found.motion, checks)
    reasons = verdict.reasons
    if verdict.verified is None and timed_out and not search.clock.interruption.wished:
        reasons = (bounds.ran_out, *reasons)
    return Combination(
        dmp=found.dmp,
        names=tuple(suited),
        coefficients=found.coefficients,
        attempt=found.motion,
        motion=verdict.verified,
        reasons=reasons,
        cost=search.objective.cost(found.motion).total,
        effort=search.effort,
        restarts=attempts.restarts,
        seed=int(seed),
        interrupted=search.clock.interruption.wished,
        timed_out=timed_out,
    )


@dataclass(frozen=True, eq=False)
class _Span:
    """Linear span of some movements, transferred to a scene's end effectors.

    Attributes
    ----------
    common : movement with zero shape weights between the common ends
    weights : array, shape (n_movements, n_dims, n_basis), shape weights of the movements between the common ends
    turns : array, shape (n_manipulators, n_dims, n_dims), matrices that transfer the weights to each end effector
    hands : movement of every end effector with zero shape weights
    ways : array, shape (N_STEPS, n_manipulators, n_dims), positions of the end effectors with zero shape weights [m]
    """

    scene: Scene
    coordinates: Coordinates
    common: DMP
    weights: Array
    turns: Array
    hands: tuple[DMP, ...]
    ways: Array

    @classmethod
    def of(cls, movements: dict[str, DMP], scene: Scene, coordinates: Coordinates) -> _Span:
        far = first_largest(np.linalg.norm(scene.goal - scene.start, axis=1))
        ends = scene.start[far], scene.goal[far]
        carried = [
            refitted(modulate(dmp, *ends), n_basis=N_BASIS, phase=LinearPhase(), variant=Variant.CLOSED_FORM)
            for dmp in movements.values()
        ]
        common = replace(carried[0], weights=np.zeros_like(carried[0].weights), duration=scene.duration)
        # One size for all combinations, so that what transfers them does not depend on the coefficients.
        extent = float(np.mean([dmp.extent for dmp in carried]))
        way = common.goal - common.start
        hands = tuple(modulate(common, *ends) for ends in zip(scene.start, scene.goal, strict=True))
        s = np.linspace(0.0, 1.0, N_STEPS)
        return cls(
            scene,
            coordinates,
            common,
            np.stack([dmp.weights for dmp in carried]),
            np.stack([adaptation(way, hand.goal - hand.start, extent) for hand in hands]),
            hands,
            np.stack([hand.at(s * hand.duration).position for hand in hands], axis=1),
        )

    def configurations(self, coefficients: Array) -> Array:
        """Return the configurations of many combinations.

        Parameters
        ----------
        coefficients : array, shape (n, n_movements, n_dims)

        Returns
        -------
        array, shape (n, n_columns, N_STEPS)
        """
        weights = np.einsum("nkd,kdj->ndj", coefficients, self.weights)
        shape = weights @ self.common.basis.sampled(N_STEPS)[:N_BASIS]
        hands = self.ways + np.einsum("mde,net->ntmd", self.turns, shape)
        n, n_steps = hands.shape[:2]
        # One long row of samples: whole turns between rollouts do not matter to what is evaluated.
        q = self.coordinates.from_hands(hands.reshape(n * n_steps, *hands.shape[2:]))
        return np.ascontiguousarray(q.reshape(n, n_steps, -1).transpose(0, 2, 1))

    def combined(self, coefficients: Array) -> DMP:
        """Return the combined primitive. `coefficients` has the shape (n_movements, n_dims)."""
        return replace(self.common, weights=np.einsum("kd,kdj->dj", coefficients, self.weights))

    def motion(self, dmp: DMP) -> CoordinatedMotion:
        """Return the motion of a primitive transferred to every end effector."""
        basis = motion_basis(N_BASIS, "velocity")
        each = [
            replace(hand, weights=turn @ dmp.weights)
            for hand, turn in zip(self.hands, self.turns, strict=True)
        ]
        return CoordinatedDMP.from_demonstration(each, self.scene, self.coordinates, basis).rollout()

    def begin(self, restart: int, best: int, rng: np.random.Generator) -> Array:
        """Return initial coefficients: the best movement, the straight line, or random."""
        coefficients = np.zeros(self.weights.shape[:2])
        if restart == 1:
            coefficients[best] = 1.0
        elif restart > 2:
            coefficients = rng.standard_normal(coefficients.shape)
        return coefficients


class Combined(NamedTuple):
    """Combination of movements and its motion on a scene.

    Attributes
    ----------
    coefficients : array, shape (n_movements, n_dims)
    dmp : the combination, at the ends of the end effector with the longest path
    motion : motion of the combination, transferred to every end effector
    """

    coefficients: Array
    dmp: DMP
    motion: CoordinatedMotion


class Attempts:
    """Runs of CMA-ES over the coefficients. They keep the best verified combination, or else the best attempt.

    Parameters
    ----------
    search : search whose objective is in load coordinates
    movements : movements by name, all of the scene's dimension
    settings : settings of the runs
    """

    def __init__(self, search: Search, movements: dict[str, DMP], settings: CombinationSettings = SETTINGS):
        self.settings = settings
        self.search, self.span = search, _Span.of(movements, search.scene, search.objective.coordinates)
        best = best_movement(movements, search.scene, objective=search.objective.weights).best.name
        self.first = list(movements).index(best)
        self.best: Array | None = None
        self.least = np.inf
        self.costs: list[float] = []
        self.restarts = 0

    def run(self) -> None:
        """Run the optimiser until further runs promise no improvement. Raise `OutOfTime` when time is up."""
        settings = self.settings
        while self.restarts < settings.restarts and not self.enough:
            grown = settings.schedule.population * 2 ** (self.restarts // 2)
            self.restarts += 1
            begin = self.span.begin(self.restarts, self.first, self.search.rng)
            self._run_once(begin, replace(settings.schedule, population=min(settings.largest, grown)))

    def found(self) -> Combined:
        """Return the best combination so far, at first the best movement."""
        coefficients = self.span.begin(1, self.first, self.search.rng) if self.best is None else self.best
        dmp = self.span.combined(coefficients)
        return Combined(coefficients, dmp, self.span.motion(dmp))

    @property
    def enough(self) -> bool:
        """Return whether more runs promise no improvement."""
        alike = sum(cost <= (1 + self.settings.alike) * min(self.costs) for cost in self.costs)
        return len(self.costs) >= self.settings.compared or alike >= self.settings.agreeing

    def _run_once(self, begin: Array, schedule: Schedule) -> None:
        """Optimise coefficients until their motion is verified. The objective is stricter after each rejection."""
        objective, coefficients = self.search.objective, begin
        for _ in range(1 + self.settings.stricter):
            coefficients, feasible = self._improve(objective, coefficients, schedule)
            if not feasible:
                return
            motion = self.span.motion(self.span.combined(coefficients))
            verdict = self.search.judge(motion)
            if verdict.verified is not None:
                self.costs.append(objective.cost(motion).total)
                if self.search.found.best is verdict:  # the cheapest so far
                    self.best = coefficients
                return
            objective = stricter(self.search, objective, verdict)
            schedule = replace(schedule, sigma=self.settings.again)

    def _improve(self, objective: Objective, begin: Array, schedule: Schedule) -> tuple[Array, bool]:
        """Run CMA-ES once; return the best coefficients and their feasibility. Feasibility is that at the samples."""
        search = self.search
        search.journal.stage = f"combining {len(begin)} movements"
        parameters = Parameters.default(begin.size, schedule.population)
        optimiser = CMAES(begin.ravel(), schedule.sigma, search.rng, parameters=parameters)
        best, best_value, feasible, reference, waited = begin, np.inf, False, np.inf, 0
        for _ in range(schedule.generations):
            search.check_time()
            samples = optimiser.ask()
            value = objective.evaluate(self.span.configurations(samples.reshape(-1, *begin.shape)))
            search.count(len(samples))
            fitness = objective.search_value(value)
            optimiser.tell(fitness)
            i = int(np.argmin(fitness))
            search.tell(float(value.cost[i]), float(fitness[i] - value.cost[i]))
            if fitness[i] < best_value:
                best, best_value = samples[i].reshape(begin.shape), float(fitness[i])
                feasible = bool(objective.feasible(value)[i])
                if self.search.found.best is None and best_value < self.least:
                    self.best, self.least = best, best_value
            waited += 1
            if best_value < reference * (1 - schedule.gain):
                reference, waited = best_value, 0
            if waited >= schedule.patience:
                break
        return best, feasible

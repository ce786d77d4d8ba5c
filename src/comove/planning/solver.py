"""The solver: plan, fit, certify, polish; or, without a planner, grow the load."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import Coordinates, load_coordinates, projected_coordinates
from comove.coordination.motion import CoordinatedDMP, CoordinatedMotion, modulate, rollouts
from comove.optimisers.separable import SeparableCMAES
from comove.planning.configurations import configuration_space
from comove.planning.kernels import load_kernels
from comove.planning.objective import N_STEPS, CostWeights, Objective, Penalty
from comove.planning.planner import FEW_NODES, MANY_NODES, PLANE_MARGINS, SPACE_MARGINS, plan
from comove.planning.seeds import fit_path
from comove.planning.solution import Progress, ProgressCallback, Solution
from comove.primitives.basis import MotionBasis, motion_basis
from comove.primitives.dmp import DMP
from comove.scenes.scene import Scene
from comove.verification.verify import Check, Verdict, verify

Array = NDArray[np.float64]

POPULATION = 16
N_CERTIFIED = 7  # seeds judged, in order of their cost, before the next plan
PATIENCE = 10  # further plans tried where a scene has several ways through
MARGIN_STEP = 0.004  # m


class OutOfTime(Exception):
    """The budget is spent."""


@dataclass
class Search:
    """One run of a method on a scene: its clock, its counters, and the best found so far.

    Attributes
    ----------
    objective : equation (4) on the scene
    taught : the demonstrated movement, None without one
    hard : obstacles are constraints, not only costs
    """

    objective: Objective
    taught: DMP | None
    hard: bool
    rng: np.random.Generator
    started: float
    deadline: float
    checks: Sequence[Check]
    progress: ProgressCallback | None
    evaluations: int = 0
    generations: int = 0
    first_verified: float | None = None
    best: Verdict | None = None
    best_motion: CoordinatedMotion | None = None
    best_cost: float = np.inf
    attempt: CoordinatedMotion | None = None
    attempt_value: float = np.inf
    stage: str = field(default="")

    @property
    def scene(self) -> Scene:
        """What is solved."""
        return self.objective.scene

    def check_time(self) -> None:
        """Raise `OutOfTime` once the budget is spent."""
        if time.perf_counter() > self.deadline:
            raise OutOfTime

    def evaluate(self, objective: Objective, basis: MotionBasis, boundary: Array, weights: Array, size=1.0):
        """Evaluate weights, array of shape (n_rollouts, n_columns, n_basis)."""
        self.evaluations += len(weights)
        return objective.evaluate(rollouts(basis, boundary, weights, N_STEPS), size)

    def judge(self, motion: CoordinatedMotion) -> Verdict:
        """Verify a motion; keep it if it is the best."""
        verdict = verify(motion, self.checks)
        if verdict.verified is not None and self.first_verified is None:
            self.first_verified = time.perf_counter() - self.started
        if verdict.verified is not None or not self.hard:
            cost = self.objective.cost(motion).total
            if cost < self.best_cost:
                self.best, self.best_motion, self.best_cost = verdict, motion, cost
        return verdict

    def remember(self, motion: CoordinatedMotion, value: float) -> None:
        """Keep the best attempt, for the case that nothing is verified."""
        if self.attempt is None or value < self.attempt_value:
            self.attempt, self.attempt_value = motion, value

    def tell(self, cost: float, violation: float) -> None:
        """Count a generation and report it."""
        self.generations += 1
        if self.progress is not None:
            best = None if self.best is None else self.best_cost
            self.progress(Progress(self.stage, self.generations, cost, violation, best))


@dataclass(frozen=True)
class Comove:
    """The default: planner, fit, certificate, polishing; growing the load where planning is off or fails.

    Attributes
    ----------
    coordinates : in which the search moves
    n_basis : shape weights a column when polishing
    n_plans : plans whose fits are compared before the best is polished
    n_failures : plans that may fail before the load is grown instead
    n_polishings : times that the search tries to improve a motion, more strictly each time it is rejected
    """

    name: ClassVar[str] = "comove"
    coordinates: Callable[[Scene], Coordinates] = load_coordinates
    n_basis: int = 30
    n_plans: int = 8
    n_failures: int = 12
    n_polishings: int = 5

    def run(self, search: Search, *, planner: bool) -> None:
        """Search until nothing is to be gained or time is up (`OutOfTime`)."""
        coordinates = search.objective.coordinates
        if search.taught is not None and search.objective.weights.resemblance > 0:
            self._grown(search, coordinates, restarts=1)  # from the demonstration, to stay near it
        if planner and self._planned(search, coordinates):
            return
        if search.best is not None or self._grown(search, coordinates, restarts=25):
            return
        while search.best is None:  # last resort, and the only one where growing does not help
            self._planned(search, coordinates)
            search.check_time()

    def _planned(self, search: Search, coordinates: Coordinates) -> bool:
        """Plan, fit and certify; then polish the best. False where no plan could be certified."""
        scene = search.scene
        planning = load_coordinates(scene)
        space = configuration_space(scene, planning)
        ends = planning.boundary()
        basis = motion_basis(self.n_basis, "velocity")
        margins = PLANE_MARGINS if scene.n_dims == 2 else SPACE_MARGINS
        starts, failures = [], 0
        while len(starts) < self.n_plans and failures < self.n_failures:
            search.check_time()
            search.stage = "planning"
            margin = margins[failures % len(margins)]
            nodes = min(MANY_NODES, FEW_NODES * 2 ** (failures // 2))
            path = plan(
                space, ends[0], ends[2], margin, search.rng, required=scene.clearance, max_nodes=nodes
            )
            start = None if path is None else self._seed(search, space, path, coordinates, basis)
            if start is not None:
                starts.append(start)
            elif starts:
                break  # one way is known: others that are hard to find are not worth the time
            else:
                failures += 1
        if not starts:
            return False
        _, boundary, weights = min(starts, key=lambda start: start[0])
        self._polish(search, coordinates, basis, boundary, weights)
        return True

    def _seed(self, search, space, path, coordinates, basis):
        """Certify the fits of one path in order of their cost: the first, or None."""
        seeds = fit_path(space, path, coordinates, basis)
        value = search.evaluate(search.objective, basis, seeds.boundary, seeds.weights)
        rank = search.objective.search_value(value) + np.where(search.objective.feasible(value), 0.0, 100.0)
        for i in np.argsort(rank, kind="stable")[:N_CERTIFIED]:
            motion = CoordinatedMotion(search.scene, coordinates, basis, seeds.boundary, seeds.weights[i])
            search.remember(motion, float(rank[i]))
            if search.judge(motion).verified:
                return float(value.cost[i]), seeds.boundary, seeds.weights[i]
        return None

    def _polish(self, search, coordinates, basis, boundary, weights) -> None:
        """Improve a verified motion; the margin widens until the result verifies as well."""
        search.stage = "polishing"
        objective, sigma = search.objective, 0.02
        for _ in range(self.n_polishings):
            weights = minimise_weights(
                search,
                objective,
                basis,
                boundary,
                weights,
                sigma=sigma,
                generations=1000,
                patience=60,
                gain=0.002,
            )
            verdict = search.judge(CoordinatedMotion(search.scene, coordinates, basis, boundary, weights))
            if verdict.verified or not search.hard:
                return
            objective, sigma = stricter(objective, verdict), 0.01

    def _grown(self, search, coordinates, restarts: int) -> bool:
        """Restarts in which the load grows; True once a motion is verified."""
        basis = motion_basis(20, "acceleration")
        for restart in range(restarts):
            search.stage = f"growing the load, restart {restart}"
            boundary, weights = self._first_guess(search, coordinates, basis, restart)
            objective = search.objective.with_penalty(along_path=True)
            if restart > 0:
                draws = 0.2 * search.rng.standard_normal((63, coordinates.search.shape[1], basis.n_basis))
                draws = weights + coordinates.search @ draws
                value = search.evaluate(objective, basis, boundary, draws, 0.05)
                weights = draws[np.argmin(objective.search_value(value))]
            weights = minimise_weights(
                search,
                objective,
                basis,
                boundary,
                weights,
                sigma=0.1,
                generations=200,
                patience=25,
                gain=0.01,
                growth=120,
            )
            for _ in range(self.n_polishings):
                motion = CoordinatedMotion(search.scene, coordinates, basis, boundary, weights)
                search.check_time()
                verdict = search.judge(motion)
                if verdict.verified or not search.hard:
                    self._polish_grown(search, coordinates, basis, boundary, weights)
                    return True
                value = search.evaluate(objective, basis, boundary, weights[None])
                search.remember(motion, float(search.objective.search_value(value)[0]))
                if value.clearance[0] < -0.03:
                    break  # deep inside something: another start, not a stricter search
                objective = stricter(objective, verdict)
                weights = minimise_weights(
                    search,
                    objective,
                    basis,
                    boundary,
                    weights,
                    sigma=0.01,
                    generations=80,
                    patience=25,
                    gain=0.01,
                )
        return False

    def _first_guess(self, search, coordinates, basis, restart):
        """The demonstration where there is one (first), else the straight way with different turns."""
        if search.taught is not None and restart % 3 == 0:
            taught = CoordinatedDMP.from_demonstration(search.taught, search.scene, coordinates, basis)
            return taught.boundary, taught.weights
        boundary = coordinates.boundary(turn=(0, 0, 1, -1)[restart % 4])
        return boundary, np.zeros((coordinates.n_columns, basis.n_basis))

    def _polish_grown(self, search, coordinates, basis, boundary, weights) -> None:
        """Refit the verified motion in the finer basis and polish it there."""
        fine = motion_basis(self.n_basis, "velocity")
        phi, base = np.split(fine.sampled(N_STEPS).T, [fine.n_basis], axis=1)
        q = rollouts(basis, boundary, weights[None], N_STEPS)[0].T
        refit = np.linalg.lstsq(phi, q - base @ boundary, rcond=None)[0].T
        self._polish(search, coordinates, fine, boundary, refit)


@dataclass(frozen=True)
class Projection(Comove):
    """Free hands, every rollout projected onto the distance constraints; otherwise as the default."""

    name: ClassVar[str] = "projection"
    coordinates: Callable[[Scene], Coordinates] = projected_coordinates


def stricter(objective: Objective, verdict: Verdict) -> Objective:
    """The objective with a wider margin, or lower limits, after a motion was rejected for want of them."""
    scene, penalty, report = objective.scene, objective.penalty, verdict.report
    changes: dict[str, float] = {}
    if not report.clearance_min >= scene.clearance:
        changes["margin"] = penalty.margin + MARGIN_STEP
    ratio = max(report.speed_max / scene.speed_limit, report.acceleration_max / scene.acceleration_limit)
    if ratio > 1:
        changes["limits"] = penalty.limits * max(0.8, 0.998 / ratio)
    return objective.with_penalty(**changes)


def minimise_weights(
    search: Search,
    objective: Objective,
    basis: MotionBasis,
    boundary: Array,
    weights: Array,
    *,
    sigma: float,
    generations: int,
    patience: int,
    gain: float,
    growth: int = 0,
) -> Array:
    """Improve shape weights by separable CMA-ES; array, shape (n_columns, n_basis).

    Parameters
    ----------
    patience, gain
        Stop after `patience` generations without a relative gain of `gain`.
    growth
        Generations over which the load grows from 5 % to its full size.
    """
    directions = objective.coordinates.search
    shape = (directions.shape[1], basis.n_basis)
    offset = weights
    optimiser = SeparableCMAES(
        np.zeros(shape[0] * shape[1]),
        sigma,
        search.rng,
        population=POPULATION,
        sigma_floor=0.01 if growth else 0.0,
    )
    best, best_value, reference, waited = weights, np.inf, np.inf, 0
    for generation in range(generations):
        search.check_time()
        size = 1.0 if growth == 0 else 0.05 + 0.95 * min(1.0, generation / growth)
        if size == 1.0:
            optimiser.sigma_floor = 0.0
        samples = offset + directions @ optimiser.ask().reshape(-1, *shape)
        value = search.evaluate(objective, basis, boundary, samples, size)
        fitness = objective.search_value(value)
        optimiser.tell(fitness)
        i = int(np.argmin(fitness))
        search.tell(float(value.cost[i]), float(fitness[i] - value.cost[i]))
        if size < 1.0:
            continue
        if fitness[i] < best_value:
            best, best_value = samples[i], float(fitness[i])
        if best_value < reference * (1 - gain):
            reference, waited = best_value, 0
        else:
            waited += 1
            if waited >= patience:
                break
    return best


def solve(
    scene: Scene,
    *,
    demonstration: DMP | None = None,
    seed: int = 0,
    method: Comove | None = None,
    planner: bool = True,
    budget: float = 30.0,
    cost: CostWeights | None = None,
    obstacles: Literal["constraint", "cost"] = "constraint",
    checks: Sequence[Check] = (),
    progress: ProgressCallback | None = None,
) -> Solution:
    """Find a verified coordinated motion for a scene.

    Parameters
    ----------
    scene
        What to solve.
    demonstration
        A movement of a single manipulator, of the scene's dimension: a start for the search, and what
        the result shall resemble where `cost.resemblance` is positive.
    seed
        Of all random numbers: the same inputs, seed and version give the same motion as long as the
        budget is not what ends the search.
    method
        `Comove()` unless given.
    planner
        Start from a path planned in the load's own configuration space.
    budget
        Seconds after which the best so far is returned.
    cost
        Weights of the objective.
    obstacles
        Hard constraints, or only the term c_obst of the objective (paper, III-B): then the motion of the least
        cost is handed out, verified or not.
    checks
        Further checks that a motion must pass to be verified.
    progress
        Called once a generation.
    """
    load_kernels(scene.n_dims)
    started = time.perf_counter()
    method = method or Comove()
    weights = cost or CostWeights()
    coordinates = method.coordinates(scene)
    taught = None if demonstration is None else carried_demonstration(demonstration, scene)
    penalty = Penalty() if obstacles == "constraint" else Penalty(margin=0.0, step=weights.obstacle)
    search = Search(
        Objective(scene, coordinates, weights, penalty, taught),
        demonstration,
        obstacles == "constraint",
        np.random.default_rng(seed),
        started,
        started + budget,
        checks,
        progress,
    )
    interrupted = False
    try:
        method.run(search, planner=planner)
    except OutOfTime:
        pass
    except KeyboardInterrupt:
        interrupted = True
    if search.best is not None:
        motion, verdict = search.best_motion, search.best
    else:
        motion = search.attempt or _straight(scene, coordinates)
        verdict = verify(motion, checks)
    return Solution(
        scene=scene,
        motion=verdict.verified,
        attempt=motion,
        report=verdict.report,
        reasons=verdict.reasons,
        cost=search.objective.cost(motion),
        method=method.name,
        seed=seed,
        evaluations=search.evaluations,
        generations=search.generations,
        time_to_first_verified_s=search.first_verified,
        solve_time_s=time.perf_counter() - started,
        interrupted=interrupted,
    )


def carried_demonstration(dmp: DMP, scene: Scene) -> Array:
    """The demonstration carried to every manipulator's ends; array, shape (N_STEPS, n_manipulators, 3), [m]."""
    s = np.linspace(0.0, 1.0, N_STEPS)
    hands = np.zeros((N_STEPS, len(scene.manipulators), 3))
    for i, (start, goal) in enumerate(zip(scene.start, scene.goal, strict=True)):
        hands[:, i, : scene.n_dims] = modulate(dmp, start, goal).at(s * dmp.duration).position
    return hands


def _straight(scene: Scene, coordinates: Coordinates) -> CoordinatedMotion:
    basis = motion_basis(20, "velocity")
    weights = np.zeros((coordinates.n_columns, basis.n_basis))
    return CoordinatedMotion(scene, coordinates, basis, coordinates.boundary(), weights)

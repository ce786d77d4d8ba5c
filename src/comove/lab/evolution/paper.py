"""The paper's method, repaired: constrained CMA-ES with a distance band.

It optimises the weights of all arms. Equation (7) requires ``|y1(t) - y2(t)| = D`` at every instant. Two
inequalities in place of the equality have no interior, so that resampling until nothing is violated, as the paper
describes, would never end; the paper must have used a band. As printed (`Printed`), the method does not progress.
The following is added here, each as a field that can be switched off, so that its effect can be measured
(docs/ablation.md):

- the form of the reduction (6), which stays positive definite (`optim.ccmaes`);
- a limited number of resampling passes: samples that are still infeasible then rank last;
- a band that narrows geometrically (`narrowing`), and a payload that grows (`growing`), while enough of the samples
  meet the constraints;
- one constraint for each window of time and side of the band (`windows`), so that the record of a constraint says
  when and to which side a sample was off;
- a cost of errors within the band (`centring`), which draws the best samples away from its edge;
- a movement whose mean navigates the environment first (`threading`; the paper, Fig. 3), given to every arm;
- a linear phase.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from comove.arrays import Array
from comove.dmp.system import Phase
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import Coordinates, arms_coordinates, load_coordinates, projected_coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.optim.ccmaes import CCMAES, CCMAESRun, Reduction
from comove.optim.method import Start
from comove.planning.method import Method, require_distances
from comove.planning.methods import GROWING, Comove, first_guess, threaded
from comove.planning.objective import N_STEPS, Objective
from comove.planning.search import Search, stricter

OPTIMISER = CCMAES(passes=8, patience=1e6, reduction=Reduction(size=0.2))


@dataclass(frozen=True)
class BandSettings:
    """Settings of the narrowing band and growing payload.

    Attributes
    ----------
    first : half width of the first band, as a share of the distance
    inside : share of the tolerance to which the band narrows: end effectors also move between the samples
    least, instead : tolerance, as a share of the distance, below which another is used instead, and that one
    enough : share of feasible samples above which the schedules advance; with fewer they go back
    pace : progress in generations, per share of feasible samples beyond that
    wait : generations without progress, after which another attempt is made
    narrowed, grown : progress at which the band has its final width, and the payload its size
    """

    first: float = 0.2
    inside: float = 0.9
    least: float = 1e-6
    instead: float = 1e-3
    enough: float = 0.3
    pace: float = 2.0
    wait: int = 100
    narrowed: float = 0.95
    grown: float = 0.4


BANDS = BandSettings()


@dataclass(frozen=True)
class Paper(Method):
    """Repaired CCMA-ES (paper, III), from the demonstration or straight lines.

    Attributes
    ----------
    coordinates : function of a scene that returns the coordinates of free end effectors
    n_basis : shape weights a column
    optimiser : constrained CMA-ES
    population : samples a generation
    sigma : first step size
    windows : number of windows of time; in each, the largest error of a distance is a constraint, for either sign
    generations : generations of progress until band and payload are final
    finishing : generations with a feasible sample after that, before the best motion is verified
    narrowing, growing : whether to begin with a wide band, and with a small payload
    centring : cost of errors as large as their bands
    threading : whether the movement's mean navigates the environment first
    phase : phase of the forcing term; linear unless given
    bands : settings of the schedules
    """

    name: ClassVar[str] = "paper"
    coordinates: Callable[[Scene], Coordinates] = arms_coordinates
    n_basis: int = 8
    optimiser: CCMAES = OPTIMISER
    population: int = 16
    sigma: float = 0.05
    windows: int = 20
    generations: int = 300
    finishing: int = 30
    narrowing: bool = True
    growing: bool = True
    centring: float = 0.5
    threading: bool = True
    phase: Phase | None = None
    bands: BandSettings = BANDS

    def check(self, scene: Scene) -> None:
        """Refuse a scene without distance constraints."""
        super().check(scene)
        require_distances(scene)

    def run(self, search: Search, *, planner: bool) -> None:
        """Search until a motion is verified, without path planning. Raise `OutOfTime` when time is up."""
        attempt, objective = 0, search.objective.with_penalty(along_path=True)
        while True:
            search.journal.stage = f"initial movement, attempt {attempt}"
            initial = self._initial(search, attempt)
            if initial is not None:
                search.journal.stage = f"narrowing the band, attempt {attempt}"
                motion = self._improved(search, objective, initial)
                if motion is not None:
                    verdict = search.judge(motion)
                    if verdict.verified or not search.hard:
                        return
                    objective = stricter(search, objective, verdict)
            attempt += 1

    def _initial(self, search: Search, attempt: int) -> CoordinatedDMP | None:
        """Return a movement whose mean navigates the environment, or None."""
        basis = search.basis(self.n_basis, "acceleration", self.phase)
        coordinates = load_coordinates(search.scene)
        objective = replace(search.objective.with_penalty(along_path=True), coordinates=coordinates)
        restart = attempt if search.taught is None else 0  # always from the demonstration
        guess: CoordinatedDMP | None = first_guess(search, coordinates, basis, restart)
        if self.threading and guess is not None:
            guess = threaded(search, objective, guess)
        if guess is None:
            return None
        s = np.linspace(0.0, 1.0, N_STEPS)
        hands, free = guess.rollout().hands(s)[0], search.objective.coordinates
        dmp = CoordinatedDMP(search.scene, free, basis, free.boundary(), np.zeros(0))
        return dmp.fitted(s, free.from_hands(hands))

    def _improved(
        self, search: Search, objective: Objective, dmp: CoordinatedDMP
    ) -> CoordinatedMotion | None:
        """Run the optimiser once; return the best in-band motion, or None."""
        scene, shape = search.scene, dmp.weights.shape
        first = self._errors(dmp, dmp.weights[None])
        widest = max(1.5 * first.max(), self._reach(search, dmp))
        run = self._started(search.rng, dmp.weights.size, n_limits=first.size)
        progress = furthest = 0.0 if self.narrowing or self.growing else 1.0
        finished, waited = 0, 0
        best, best_value, latest = None, np.inf, dmp.weights
        while run.reason is None and finished < self.finishing and waited < self.bands.wait:
            if search.over():  # what there is, judged and labelled
                search.judge(dmp.rollout(latest))
            search.check_time()
            request, bands = run.ask(), self._bands(scene, progress, widest)
            weights = dmp.weights + request.x.reshape(-1, *shape)
            if request.constraints:
                missed = self._errors(dmp, weights) - bands
                search.count(len(weights))
                if len(weights) == self.population:
                    share = (missed <= 0).all(axis=1).mean()
                run.tell(None, missed)
                continue
            size = replace(GROWING, growth=self.bands.grown).size(progress) if self.growing else 1.0
            value = search.evaluate(objective, dmp, weights, size)
            fitness = objective.search_value(value)
            i = int(np.argmin(fitness))
            search.tell(float(value.cost[i]), float(fitness[i] - value.cost[i]))
            waited, latest = waited + 1, weights[i]
            if progress >= 1.0:
                found = np.where(objective.feasible(value) | (not search.hard), fitness, np.inf)
                i = int(np.argmin(found))
                if found[i] < np.inf:
                    finished, waited = finished + 1, 0
                if found[i] < best_value:
                    best, best_value = dmp.rollout(weights[i]), float(found[i])
            stuck = search.hard and not (value.clearance > scene.clearance).any()
            step = min(self.bands.pace * (share - self.bands.enough), 0.0 if stuck else np.inf)
            if self.narrowing or self.growing:
                progress = min(1.0, max(0.0, progress + step / self.generations))
            if progress > furthest:
                furthest, waited = progress, 0
            errors = np.maximum(0.0, 1.0 + np.asarray(request.known) / bands)
            run.tell(fitness + self.centring * (errors**2).mean(axis=1), None)
        return best

    def _started(self, rng: np.random.Generator, n: int, n_limits: int) -> CCMAESRun:
        """Return an optimiser run from the initial movement."""
        start = Start(
            x=np.zeros(n),
            sigma=self.sigma,
            rng=rng,
            equality=np.zeros(n_limits, dtype=bool),
            tolerance=0.0,
            lower=np.full(n, -np.inf),
            upper=np.full(n, np.inf),
            population=self.population,
        )
        return self.optimiser.start(start)

    def _reach(self, search: Search, dmp: CoordinatedDMP) -> float:
        """Return a band width that enough first samples meet [m]. It grows with the number of end effectors."""
        draws = self.sigma * search.rng.standard_normal((self.population, *dmp.weights.shape))
        return float(np.quantile(self._errors(dmp, dmp.weights + draws).max(axis=1), self.bands.enough))

    def _errors(self, dmp: CoordinatedDMP, weights: Array) -> Array:
        """Return the `window_errors` of rollouts. Weights have the shape (n_rollouts, n_columns, n_basis)."""
        hands = dmp.coordinates.centers(dmp.rollouts(weights, N_STEPS))
        return window_errors(dmp.scene, hands, self.windows)

    def _bands(self, scene: Scene, progress: float, least: float) -> Array:
        """Return the half widths of the bands [m]. Array, shape (n_distances * 2 * n_windows,).

        Parameters
        ----------
        progress : progress of the narrowing, from 0 to 1
        least : least half width at the beginning [m]
        """
        bands, widths = self.bands, []
        for c in scene.distances:
            held = c.tolerance if c.tolerance > bands.least * c.distance else bands.instead * c.distance
            final = bands.inside * held
            share = min(1.0, progress / bands.narrowed) if self.narrowing else 1.0
            first = max(bands.first * c.distance, least)
            widths.append(first * (final / first) ** share)
        return np.repeat(widths, 2 * self.windows)


def window_errors(scene: Scene, q: Array, n_windows: int) -> Array:
    """Compute each distance's largest error in every window of time. End effectors are free.

    Parameters
    ----------
    q : array, shape (n_rollouts, n_manipulators * n_dims, n_steps)

    Returns
    -------
    array, shape (n_rollouts, n_distances * 2 * n_windows), [m]; for every distance too large, then too small
    """
    hands = q.reshape(len(q), -1, scene.n_dims, q.shape[2])
    edges = np.linspace(0, q.shape[2], n_windows, endpoint=False, dtype=int)
    errors = []
    for c in scene.distances:
        apart = np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1)
        for error in (apart - c.distance, c.distance - apart):
            errors.append(np.maximum.reduceat(error, edges, axis=1))
    return np.concatenate(errors, axis=1)


@dataclass(frozen=True)
class Projection(Comove):
    """Variant of the default method that projects rollouts onto the constraints. End effectors are free."""

    name: ClassVar[str] = "projection"
    smooths: ClassVar[bool] = False
    coordinates: Callable[[Scene], Coordinates] = projected_coordinates

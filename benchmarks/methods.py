"""Every method on the example scenes `wide` (from a straight line), `narrow` and `complex` (from a demonstration).

- ``comove``, ``comove, no planner``, ``projection``, ``paper``: the methods of `comove.solve`.
- ``AugmentedLagrangian``, ``CCMAES``, ``EpsilonLevel``, ``Penalty`` of `comove.optimisers`, and pycma's
  ``ConstrainedFitnessAL``: what the paper's method minimises, but all at once: the cost (4) with the solver's penalty
  for contact over the weights of both arms, every error of the distance within 1e-3 of it in each of 20 windows
  of time, the whole load from the beginning. They begin with the demonstration (or the line), step size 0.05.
- ``SLSQP`` of scipy: the same problem, derivatives by forward differences (one batch of rollouts each).
- ``IPOPT`` through CasADi: direct transcription, 50 knots of both hands (distance as an equality, 11 points of the
  bar outside of every box by 10 mm, cost (4)), begun with the demonstration plus noise of 1 cm by the seed.

Motions are verified in continuous time by comove's judge. Only IPOPT's, cubic curves through its knots, are looked at
4001 times instead: error at most 1e-3 of the distance, nothing touched.
Columns: motions that hold; rollouts evaluated (IPOPT: its iterations) and seconds until the method ended, medians;
largest error of the distance over its length, median of what was handed out; median cost J of the motions that hold.

To repeat: ``pip install 'comove[bench]'``, ``python benchmarks/methods.py [--seeds 20] [--budget 5]``.
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from statistics import median

import numpy as np
from timing import number, on_one_thread, peer, print_table

import comove
from comove import optimisers
from comove.coordination.coordinates import arms_coordinates
from comove.coordination.motion import CoordinatedDMP
from comove.experiments.examples import example
from comove.planning import Comove, Paper, Projection
from comove.planning.objective import N_STEPS, Objective, Penalty
from comove.planning.paper import window_errors
from comove.primitives.basis import motion_basis
from comove.scenes.distances import segment_distance
from comove.verification import verify

Array = np.ndarray

SCENES = ("wide", "narrow", "complex")
WINDOWS, BAND, SIGMA = 20, 1e-3, 0.05
N_BASIS = Paper().n_basis
KNOTS, POINTS, MARGIN, NOISE = 50, 11, 0.01, 0.01


@dataclass(frozen=True)
class Outcome:
    """Of one method with one seed on one scene.

    Attributes
    ----------
    holds : whether the motion handed out holds
    rollouts : evaluated; iterations of IPOPT
    seconds : until the method ended
    error : largest error of the distance, over the distance
    cost : J
    """

    holds: bool
    rollouts: int
    seconds: float
    error: float
    cost: float


def taught(scene: comove.Scene) -> comove.DMP | None:
    """The scene's demonstration, if it has one."""
    return None if scene.demonstration is None else comove.DMP.fit(scene.demonstration)


class Late(Exception):
    """Time is up."""


class Bands:
    """The weights of both arms around those that the search begins with: cost and constraints, counted.

    Parameters
    ----------
    scene : of two hands
    seconds : after which an evaluation raises `Late`
    """

    def __init__(self, scene: comove.Scene, seconds: float) -> None:
        coordinates = arms_coordinates(scene)
        basis = motion_basis(N_BASIS, "acceleration")
        straight = np.zeros((coordinates.n_columns, basis.n_basis))
        self.dmp = CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), straight)
        if (dmp := taught(scene)) is not None:
            self.dmp = CoordinatedDMP.from_demonstration(dmp, scene, coordinates, basis)
        self.objective = Objective(scene, coordinates, penalty=Penalty(along_path=True))
        self.n, self.rollouts, self.deadline = self.dmp.weights.size, 0, time.perf_counter() + seconds
        self.best, self.best_rank = np.zeros(self.n), (np.inf, np.inf)

    def weights(self, x: Array) -> Array:
        """Shape weights of points; arrays, shapes (n_points, n), (n_points, n_columns, n_basis)."""
        return self.dmp.weights + np.atleast_2d(x).reshape(-1, *self.dmp.weights.shape)

    def both(self, x: Array) -> tuple[Array, Array]:
        """Cost (n_points,) and constraints (n_points, 2 WINDOWS), at most 0 within the bands, over the distance."""
        if time.perf_counter() > self.deadline:
            raise Late
        q = self.dmp.rollouts(self.weights(x), N_STEPS)
        self.rollouts += len(q)
        value = self.objective.search_value(self.objective.evaluate(q))
        (c,) = self.dmp.scene.constraints
        error = window_errors(self.dmp.scene, q, WINDOWS) / c.distance
        missed = error - 0.9 * BAND  # fitted into the band between the samples, too
        violation = np.maximum(missed, 0.0).max(axis=1)
        k = np.lexsort((value, violation))[0]  # the best seen is what is judged
        if (violation[k], value[k]) < self.best_rank:
            self.best_rank, self.best = (violation[k], value[k]), np.array(np.atleast_2d(x)[k])
        return value, missed

    def outcome(self, seconds: float) -> Outcome:
        """Judge the best point."""
        motion = self.dmp.rollout(self.weights(self.best)[0])
        verdict = verify(motion)
        (c,) = self.dmp.scene.constraints
        return Outcome(
            verdict.verified is not None,
            self.rollouts,
            seconds,
            verdict.report.distance_error_max / c.distance,
            self.objective.cost(motion).total,
        )


def timed(bands: Bands, search: Callable[[], object]) -> Outcome:
    """Let a search run until it ends, or is late."""
    begun = time.perf_counter()
    with suppress(Late):
        search()
    return bands.outcome(time.perf_counter() - begun)


def solved(method: Comove | Paper, planner: bool, scene: comove.Scene, seed: int, budget: float) -> Outcome:
    """One of the solver's own methods."""
    solution = comove.solve(
        scene,
        demonstration=taught(scene),
        seed=seed,
        method=method,
        planner=planner,
        budget=budget,
    )
    error = solution.report.distance_error_max / scene.constraints[0].distance
    return Outcome(solution.verified, solution.evaluations, solution.solve_time_s, error, solution.cost.total)


def optimised(method: str, scene: comove.Scene, seed: int, budget: float) -> Outcome:
    """One of comove's optimisers, by its name."""
    bands = Bands(scene, budget)
    return timed(
        bands,
        lambda: optimisers.minimise(
            lambda x: bands.both(x)[0],
            np.zeros(bands.n),
            SIGMA,
            constraints=lambda x: bands.both(x)[1],
            method=getattr(optimisers, method)(),
            seed=seed,
        ),
    )


def pycma(scene: comove.Scene, seed: int, budget: float) -> Outcome:
    """Pycma's augmented Lagrangian."""
    cma = peer("cma")
    from cma.constraints_handler import ConstrainedFitnessAL

    os.chdir(tempfile.gettempdir())  # where pycma makes a folder for its logs
    bands = Bands(scene, budget)

    def search() -> None:
        fitness = ConstrainedFitnessAL(
            lambda x: bands.both(x)[0][0], lambda x: bands.both(x)[1][0], logging=0
        )
        run = cma.CMAEvolutionStrategy(np.zeros(bands.n), SIGMA, {"verbose": -9, "seed": seed + 1})
        while not run.stop():
            points = run.ask()
            run.tell(points, [fitness(x) for x in points])
            fitness.update(run)

    return timed(bands, search)


def slsqp(scene: comove.Scene, seed: int, budget: float) -> Outcome:
    """Scipy's sequential quadratic programme, from the demonstration moved by the seed."""
    optimize = peer("scipy.optimize")
    bands, step = Bands(scene, budget), 1e-6

    def slopes(x: Array) -> tuple[Array, Array]:
        value, missed = bands.both(np.vstack([x, x + step * np.eye(bands.n)]))
        return (value[1:] - value[0]) / step, (missed[1:] - missed[0]).T / step

    return timed(
        bands,
        lambda: optimize.minimize(
            lambda x: bands.both(x)[0][0],
            np.random.default_rng(seed).normal(0.0, 0.1 * SIGMA, bands.n),
            jac=lambda x: slopes(x)[0],
            method="SLSQP",
            constraints={
                "type": "ineq",
                "fun": lambda x: -bands.both(x)[1][0],
                "jac": lambda x: -slopes(x)[1],
            },
            options={"maxiter": 1000},
        ),
    )


def ipopt(scene: comove.Scene, seed: int, budget: float) -> Outcome:
    """Direct transcription."""
    casadi = peer("casadi")
    begun = time.perf_counter()
    (c,) = scene.constraints
    bands, problem = Bands(scene, budget), casadi.Opti()
    s = np.linspace(0.0, 1.0, KNOTS)
    first = bands.dmp.rollout().hands(s)[0].reshape(KNOTS, 4)
    first[1:-1] += np.random.default_rng(seed).normal(0.0, NOISE, (KNOTS - 2, 4))
    y = problem.variable(KNOTS, 4)
    ends = np.stack([scene.start.ravel(), scene.goal.ravel()])
    for row, end in zip((0, KNOTS - 1), ends, strict=True):
        problem.subject_to(y[row, :] == end[None])
    problem.subject_to(y[1, :] == y[0, :])  # at rest
    problem.subject_to(y[KNOTS - 2, :] == y[KNOTS - 1, :])
    problem.subject_to(casadi.sum2((y[:, :2] - y[:, 2:]) ** 2)[1:-1] == c.distance**2)
    lower, upper = (np.array(w)[:2] for w in scene.workspace)
    for column in range(4):
        problem.subject_to(problem.bounded(lower[column % 2], y[:, column], upper[column % 2]))
    for share in np.linspace(0.0, 1.0, POINTS):
        point = (1 - share) * y[:, :2] + share * y[:, 2:]
        for box in scene.obstacles:  # axis-aligned in these scenes
            away = [casadi.fabs(point[:, axis] - box[1 + axis]) - box[13 + axis] for axis in range(2)]
            problem.subject_to(casadi.fmax(*away)[2:-2] >= MARGIN)
    goal = casadi.sumsqr(y - np.tile(ends[1], (KNOTS, 1))) / KNOTS
    moved = casadi.sumsqr(y[1:, :] - y[:-1, :]) * (KNOTS - 1) ** 2 / KNOTS
    weights = bands.objective.weights
    problem.minimize(weights.goal * goal + weights.velocity * moved)
    problem.set_initial(y, first)
    problem.solver("ipopt", {"print_time": False}, {"print_level": 0, "sb": "yes", "max_cpu_time": budget})
    with suppress(RuntimeError):  # not converged: its last iterate is judged all the same
        problem.solve()
    seconds = time.perf_counter() - begun
    knots = np.asarray(problem.debug.value(y))
    spline = peer("scipy.interpolate").CubicSpline(s, knots, bc_type="clamped")
    return looked_at(bands, spline(np.linspace(0.0, 1.0, 4001)), seconds, problem.stats()["iter_count"])


def looked_at(bands: Bands, hands: Array, seconds: float, iterations: int) -> Outcome:
    """Judge samples of both hands; array, shape (n_steps, 4)."""
    scene, n = bands.dmp.scene, len(hands)
    (c,) = scene.constraints
    error = np.abs(np.linalg.norm(hands[:, :2] - hands[:, 2:], axis=1) / c.distance - 1.0).max()
    free = all(
        segment_distance(scene.obstacles, j, a, b, 0.0, d, e, 0.0, 1.0, 1e-9) >= 0
        for a, b, d, e in hands
        for j in range(len(scene.obstacles))
    )
    weights = bands.objective.weights
    cost = weights.goal * ((hands - hands[-1]) ** 2).sum() / n
    cost += weights.velocity * (np.diff(hands, axis=0) ** 2).sum() * (n - 1) ** 2 / n
    return Outcome(bool(free and error <= BAND), iterations, seconds, float(error), float(cost))


METHODS: dict[str, Callable[[comove.Scene, int, float], Outcome]] = {
    "comove": partial(solved, Comove(), True),
    "comove, no planner": partial(solved, Comove(), False),
    "projection": partial(solved, Projection(), True),
    "projection, no planner": partial(solved, Projection(), False),
    "paper": partial(solved, Paper(), False),
    **{
        name: partial(optimised, name)
        for name in ("AugmentedLagrangian", "CCMAES", "EpsilonLevel", "Penalty")
    },
    "pycma": pycma,
    "SLSQP": slsqp,
    "IPOPT": ipopt,
}


def run(job: tuple[str, str, int, float]) -> Outcome:
    """One method on one scene with one seed."""
    scene, method, seed, budget = job
    warnings.simplefilter("ignore")
    return METHODS[method](example(scene), seed, budget)


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    parser.add_argument("--scenes", nargs="+", default=list(SCENES), choices=SCENES)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--budget", type=float, default=5.0, help="seconds for each")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    on_one_thread()
    rows, found = [], {}
    with ProcessPoolExecutor(options.workers) as pool:
        for scene in options.scenes:
            for method in options.methods:
                jobs = [(scene, method, seed, options.budget) for seed in range(options.seeds)]
                found[f"{scene} {method}"] = outcomes = list(pool.map(run, jobs))
                rows.append(row(scene, method, outcomes))
                print(*rows[-1], sep="  ", flush=True)
    if options.json:
        options.json.write_text(
            json.dumps({name: [asdict(o) for o in each] for name, each in found.items()}, indent=1)
        )
    print()
    print_table(["scene", "method", "hold", "rollouts", "time [s]", "distance error / D", "J"], rows)


def row(scene: str, method: str, outcomes: list[Outcome]) -> list[str]:
    """Cells of one row."""
    good = [o for o in outcomes if o.holds]
    return [
        scene,
        method,
        f"{len(good)}/{len(outcomes)}",
        f"{median(o.rollouts for o in outcomes):.0f}",
        number(median(o.seconds for o in outcomes)),
        f"{median(o.error for o in outcomes):.1e}",
        number(median(o.cost for o in good)) if good else "-",
    ]


if __name__ == "__main__":
    main()

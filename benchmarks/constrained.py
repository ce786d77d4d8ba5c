"""Constrained test problems of COCO and CEC 2006, one row a solver.

``bbob`` (54 functions, `--dimension`, `--instances`): share of 51 targets 1e2 .. 1e-8 above the optimum that are
reached by feasible points within 10^4 n evaluations of the constraints, and of the objective. ``cec2006`` (g03 g05
g11 g13 g14 g15 g17 g21 g23, equalities within 1e-4, `--seeds`): feasible points within 1e-4 of the best known value,
500,000 evaluations (`--evaluations`); those without equalities are `--functions 1 2 4 6 7 8 9 10 12 16 18 19 24`.
``unconstrained``: bbob, one instance, targets 1e2 .. 1e-8 within 10^4 n evaluations.

All solvers begin at COCO's initial solution with step size 1 (with 2 where there are no constraints), or at a random
point of the box with 0.3 of its width, and restarts until the evaluations are used.

To repeat: ``pip install 'comove[bench]'``, ``python benchmarks/constrained.py bbob [--solvers comove cma] ...``.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

TARGETS = 10.0 ** np.linspace(2, -8, 51)
EQUALITIES = 3, 5, 11, 13, 14, 15, 17, 21, 23


class Spent(Exception):
    """Signal that the evaluations are used up."""


@dataclass
class Problem:
    """Problem of one point, with counted evaluations and its best value.

    Attributes
    ----------
    f, h : (n,) -> float, (n,) -> (m,); None without constraints
    equality : number of equalities, which come first
    x0, sigma0, lower, upper : initial point, step size and search range, arrays of shape (n,) or numbers
    optimum : best value known
    limit : evaluations
    goal : distance from the optimum at which the search may end
    """

    f: Callable
    h: Callable | None
    equality: int
    x0: np.ndarray
    sigma0: float
    lower: np.ndarray | None
    upper: np.ndarray | None
    optimum: float
    limit: int
    goal: float
    best: float = np.inf
    n_f: int = 0
    n_h: int = 0
    last: tuple = (None, None)

    def constraints(self, x: np.ndarray) -> np.ndarray:
        self.n_h += 1
        if self.n_h > self.limit:
            raise Spent
        values = np.array(self.h(x))
        self.last = x.copy(), values
        self._see(x)
        return values

    def objective(self, x: np.ndarray) -> float:
        self.n_f += 1
        if self.n_f > self.limit:
            raise Spent
        self.value = x.copy(), float(self.f(x))
        self._see(x)
        return self.value[1]

    def _see(self, x: np.ndarray) -> None:
        """Count a point whose objective and constraints are known."""
        if self.h is not None and not np.array_equal(self.last[0], x):
            values = np.array(self.h(x))  # judged, not counted
        else:
            values = self.last[1] if self.h is not None else np.zeros(0)
        missed = np.concatenate([np.abs(values[: self.equality]) - 1e-4, values[self.equality :]])
        value = getattr(self, "value", (None, np.inf))
        if (missed <= 0).all() and np.array_equal(value[0], x) and value[1] < self.best:
            self.best = value[1]
        if self.best <= self.optimum + self.goal:
            raise Spent


def coco(suite: str, function: int, dimension: int, instance: int) -> Problem:
    import cocoex

    def fresh():
        chosen = f"dimensions: {dimension} function_indices: {function}"
        with suppress(cocoex.exceptions.NoSuchSuiteException):  # no such dimension
            problem = cocoex.Suite(suite, f"instances: {instance}", chosen)[0]
            if problem.id == f"{suite}_f{function:03d}_i{instance:02d}_d{dimension:02d}":
                return problem
        sys.exit(f"COCO's {suite} has no function {function}, instance {instance} in {dimension} dimensions")

    os.chdir(tempfile.mkdtemp())  # where COCO leaves the optimum
    known = fresh()
    known._best_parameter("print")
    optimum = known(np.loadtxt("._bbob_problem_best_parameter.txt"))
    problem = fresh()
    constrained = suite == "bbob-constrained"
    return Problem(
        f=problem,
        h=problem.constraint if constrained else None,
        equality=0,
        x0=np.array(problem.initial_solution),
        sigma0=1.0 if constrained else 2.0,
        lower=None,
        upper=None,
        optimum=optimum,
        limit=10_000 * dimension,
        goal=1e-8,
    )


def cec2006(number: int, seed: int, limit: int) -> Problem:
    import pygmo

    problem = pygmo.problem(pygmo.cec2006(prob_id=number))
    lower, upper = map(np.array, problem.get_bounds())
    width, equality = upper - lower, problem.get_nec()

    def at(u):
        return problem.fitness(np.clip(lower + u * width, lower, upper))

    return Problem(
        f=lambda u: at(u)[0],
        h=lambda u: at(u)[1:],
        equality=equality,
        x0=np.random.default_rng(seed).random(len(lower)),
        sigma0=0.3,
        lower=np.zeros(len(lower)),
        upper=np.ones(len(lower)),
        optimum=problem.fitness(problem.extract(pygmo.cec2006).best_known())[0],
        limit=limit,
        goal=1e-4,
    )


def comove(problem: Problem, seed: int, method: str = "") -> None:
    from comove import optim

    mask = None
    if problem.h is not None:
        mask = np.arange(len(problem.h(problem.x0))) < problem.equality
    optim.minimise(
        problem.objective,
        problem.x0,
        problem.sigma0,
        constraints=problem.constraints if problem.h is not None else None,
        equality=mask,
        bounds=None if problem.lower is None else (problem.lower, problem.upper),
        method=getattr(optim, method)() if method else None,
        max_evaluations=problem.limit + 1,
        seed=seed,
        vectorized=False,
    )


def cma(problem: Problem, seed: int) -> None:
    import cma as pycma

    options = {"verbose": -9, "seed": seed + 1, "maxfevals": problem.limit}
    if problem.lower is not None:
        options["bounds"] = [list(problem.lower), list(problem.upper)]
    rng, x0, run = np.random.default_rng(seed), problem.x0, 0
    if problem.h is None:
        pycma.fmin2(
            problem.objective,
            lambda: rng.uniform(-4, 4, len(x0)),
            problem.sigma0,
            options,
            restarts=9,
            bipop=True,
        )
        return
    from cma.constraints_handler import ConstrainedFitnessAL

    os.chdir(tempfile.gettempdir())  # where pycma makes a folder for its logs
    while True:
        fitness = ConstrainedFitnessAL(
            problem.objective,
            lambda x: (
                np.concatenate(
                    [
                        values[problem.equality :],
                        values[: problem.equality] - 1e-4,
                        -values[: problem.equality] - 1e-4,
                    ]
                )
                if len(values := problem.constraints(x))
                else values
            ),
            logging=0,
        )
        search = pycma.CMAEvolutionStrategy(
            x0, problem.sigma0, options | {"popsize": (4 + int(3 * np.log(len(x0)))) * 2**run}
        )
        while not search.stop():
            points = search.ask()
            search.tell(points, [fitness(x) for x in points])
            fitness.update(search)
        run += 1
        x0 = (
            rng.uniform(problem.lower, problem.upper)
            if problem.lower is not None
            else problem.x0 + 2 * problem.sigma0 * rng.standard_normal(len(x0))
        )


SOLVERS = {"comove": comove, "cma": cma}
for _name in ("CCMAES", "EpsilonLevel", "Penalty"):
    SOLVERS[f"comove-{_name}"] = partial(comove, method=_name)


def solved(job: tuple) -> dict:
    """Run one solver on one problem."""
    solver, make, arguments, seed = job
    warnings.simplefilter("ignore")
    problem = make(*arguments)
    begun = time.perf_counter()
    with suppress(Spent):
        SOLVERS[solver](problem, seed)
    gap = problem.best - problem.optimum
    return {
        "solver": solver,
        "problem": list(arguments),
        "seed": seed,
        "gap": gap,
        "share": float((gap <= TARGETS).mean()),
        "solved": bool(gap <= problem.goal),
        "n_f": problem.n_f,
        "n_h": problem.n_h,
        "seconds": time.perf_counter() - begun,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("suite", choices=("bbob", "cec2006", "unconstrained"))
    parser.add_argument("--solvers", nargs="+", default=["comove", "cma"], choices=sorted(SOLVERS))
    parser.add_argument("--dimension", type=int, default=10)
    parser.add_argument("--instances", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--functions", type=int, nargs="+")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--evaluations", type=int, default=500_000, help="of a CEC 2006 problem")
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--json", type=Path)
    parser.add_argument("--verbose", action="store_true")
    options = parser.parse_args()
    if options.suite == "cec2006":
        numbers = options.functions or EQUALITIES
        limit = options.evaluations
        jobs = [(cec2006, (number, seed, limit), seed) for number in numbers for seed in range(options.seeds)]
    else:
        suite, count = ("bbob-constrained", 54) if options.suite == "bbob" else ("bbob", 24)
        numbers = options.functions or range(1, count + 1)
        instances = options.instances if options.suite == "bbob" else options.instances[:1]
        jobs = [(coco, (suite, f, options.dimension, i), 0) for f in numbers for i in instances]
    rows = []
    with ProcessPoolExecutor(options.workers) as pool:
        for row in pool.map(solved, [(s, *job) for s in options.solvers for job in jobs]):
            rows.append(row)
            if options.verbose:
                print(row, flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))
    print_table(options, rows)


def print_table(options: argparse.Namespace, rows: list[dict]) -> None:
    """Print means by solver, then the solved problems."""
    position = 0 if options.suite == "cec2006" else 1
    print(f"{'solver':22} {'share':>6} {'solved':>8} {'seconds':>8}")
    for solver in options.solvers:
        own = [row for row in rows if row["solver"] == solver]
        share = np.mean([row["share"] for row in own])
        count = sum(row["solved"] for row in own)
        print(f"{solver:22} {share:6.3f} {count:4d}/{len(own)} {sum(r['seconds'] for r in own):8.0f}")
    for solver in options.solvers:
        print(f"\n{solver}: problem share solved median-gap")
        for number in sorted({row["problem"][position] for row in rows}):
            own = [r for r in rows if r["solver"] == solver and r["problem"][position] == number]
            share, gap = np.mean([r["share"] for r in own]), np.median([r["gap"] for r in own])
            print(f"  {number:3d} {share:6.3f} {sum(r['solved'] for r in own)}/{len(own)} {gap:9.2e}")


if __name__ == "__main__":
    main()

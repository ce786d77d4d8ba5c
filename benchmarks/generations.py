"""Mean time of a CMA-ES generation without the objective, by dimension.

It is the mean of 300 generations and not the median: decompositions are lazy, which a median hides. All have the
default population (4 + 3 ln n) and minimise an ellipsoid whose own time is not counted. `ratio` is the full
covariance's over pycma's, `separable` likewise.

To repeat: ``pip install 'comove[bench]'``, ``OMP_NUM_THREADS=1 python benchmarks/generations.py``.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable

import numpy as np

from comove.optim import CMAES, DiagonalCovariance, Parameters, TransformationMatrix

GENERATIONS = 300
DIMENSIONS = 40, 100, 200, 400


def ours(n: int, covariance: Callable | None = None, separable: bool = False) -> tuple[Callable, Callable]:
    search = CMAES(
        np.ones(n),
        1.0,
        np.random.default_rng(0),
        parameters=Parameters.default(n, separable=separable),
        covariance=None if covariance is None else covariance(n),
    )
    return search.ask, lambda x, f: search.tell(f)


def pycma(n: int) -> tuple[Callable, Callable]:
    import cma

    search = cma.CMAEvolutionStrategy(np.ones(n), 1.0, {"verbose": -9, "seed": 1})
    return search.ask, lambda x, f: search.tell(x, list(f))


def cmaes(n: int) -> tuple[Callable, Callable]:
    import cmaes

    search = cmaes.CMA(mean=np.ones(n), sigma=1.0, seed=1)
    return (
        lambda: [search.ask() for _ in range(search.population_size)],
        lambda x, f: search.tell(list(zip(x, f, strict=True))),
    )


SOLVERS = {
    "full": ours,
    "matrix adaptation": lambda n: ours(n, TransformationMatrix),
    "separable": lambda n: ours(n, DiagonalCovariance, separable=True),
    "pycma": pycma,
    "cmaes": cmaes,
}


def mean_time(make: Callable, n: int) -> float:
    """Return the seconds of a generation."""
    scale = 10.0 ** (6 * np.arange(n) / (n - 1))
    ask, tell = make(n)
    spent = 0.0
    for _ in range(GENERATIONS):
        begun = time.perf_counter()
        x = ask()
        spent += time.perf_counter() - begun
        values = (np.asarray(x) ** 2) @ scale
        begun = time.perf_counter()
        tell(x, values)
        spent += time.perf_counter() - begun
    return spent / GENERATIONS


def main() -> None:
    """Measure and print the table."""
    argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    ).parse_args()
    warnings.simplefilter("ignore")
    print(
        f"{'n':>4} "
        + " ".join(f"{name + ' [ms]':>22}" for name in SOLVERS)
        + f" {'ratio':>7} {'separable':>10}"
    )
    for n in DIMENSIONS:
        times = {name: mean_time(make, n) for name, make in SOLVERS.items()}
        shown = " ".join(f"{1e3 * value:22.3f}" for value in times.values())
        print(
            f"{n:4d} {shown} {times['full'] / times['pycma']:7.2f} "
            f"{times['separable'] / times['pycma']:10.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()

"""Pycma's augmented Lagrangian on the shape weights of all hands."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

from comove.experiments.peers.common import PeerOutOfTime, load_clearances, refusal
from comove.experiments.peers.needed import needed
from comove.experiments.peers.shapes import Shapes
from comove.experiments.systems import Offers, System, SystemProblem
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_BASIS, SIGMA = 16, 0.05


@dataclass(frozen=True)
class PycmaAL(System):
    """Pycma's `ConstrainedFitnessAL`, with the largest violation of each demand in 20 windows of time as constraints.

    A run that ends is followed by another from the same guess, until the budget is used up.
    """

    name: str

    def refuses(self, scene: Scene) -> str:
        """Return why peers cannot represent the scene, empty if they can."""
        return refusal(scene)

    def warm_up(self, problem: SystemProblem) -> None:
        """Import pycma, which takes a second, and compile the kernels of distances."""
        needed("cma.constraints_handler")
        load_clearances(problem.scene)

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Minimise J on the shape weights."""
        cma, handler = needed("cma"), needed("cma.constraints_handler")
        shapes, rng = Shapes(problem, offers, N_BASIS), np.random.default_rng(problem.seed)
        known: dict[bytes, tuple[float, Array]] = {}

        def evaluate(points: Array) -> None:
            hands = shapes.hands(points)
            costs, asked = shapes.costs(hands), shapes.demands(hands)
            missed = shapes.windows(asked)
            known.clear()
            for k, x in enumerate(points):
                known[x.tobytes()] = float(costs[k]), missed[k]
                shapes.note(x, float(costs[k]), asked, k)

        def value(x: Array) -> tuple[float, Array]:
            x = np.asarray(x)
            if x.tobytes() not in known:
                evaluate(x[None])
            return known[x.tobytes()]

        options = {
            "verbose": -9,
            "verb_log": 0,
            "seed": np.nan,
            "randn": lambda *size: rng.standard_normal(size),
        }
        with suppress(PeerOutOfTime), _silence(handler, needed("cma.logger").LoggerDummy):
            while True:
                fitness = handler.ConstrainedFitnessAL(
                    lambda x: value(x)[0], lambda x: value(x)[1], logging=0, archives=False
                )
                run = cma.CMAEvolutionStrategy(np.zeros(shapes.n), SIGMA, options)
                while not run.stop():
                    points = run.ask()
                    evaluate(np.array(points))
                    run.tell(points, [fitness(x) for x in points])
                    fitness.update(run)
        shapes.close()


@contextmanager
def _silence(handler: ModuleType, dummy: type) -> Iterator[None]:
    """Suppress warnings (about demands that never change), and the folder that pycma makes even without a log."""
    logger = handler._Logger
    handler._Logger = dummy  # as pycma's source advises
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        handler._Logger = logger

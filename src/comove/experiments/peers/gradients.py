"""Scipy's optimisers for constrained problems on the shape weights of all hands.

Derivatives are exact, except those of clearances, which are central differences at each sample. J is quadratic.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.experiments.peers.common import PeerOutOfTime, load_clearances, refusal
from comove.experiments.peers.needed import needed
from comove.experiments.peers.shapes import Shapes
from comove.experiments.systems import Offers, System, SystemProblem
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_BASIS = 24
NOISE = 0.02  # of the weights a first attempt begins with, and a further one with more
GROWTH = 2.0
MOST = 0.5  # at most so much


@dataclass(frozen=True)
class Scipy(System):
    """`scipy.optimize.minimize`, restarted from random points around the guess until a movement looks feasible.

    Attributes
    ----------
    method : "SLSQP" or "trust-constr"
    """

    name: str
    method: str

    def refuses(self, scene: Scene) -> str:
        """Return why peers cannot represent the scene, empty if they can."""
        return refusal(scene)

    def warm_up(self, problem: SystemProblem) -> None:
        """Import scipy's optimisers and compile the kernels of distances."""
        needed("scipy.optimize")
        load_clearances(problem.scene)

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Minimise J subject to the constraints at the samples."""
        shapes, rng = Shapes(problem, offers, N_BASIS), np.random.default_rng(problem.seed)
        noise = NOISE
        with suppress(PeerOutOfTime):
            while True:
                self._attempt(shapes, rng.normal(0.0, noise, shapes.n))
                if shapes.promise[0] <= 0.0:
                    break
                noise = min(GROWTH * noise, MOST)
        shapes.close()

    def _attempt(self, shapes: Shapes, x: Array) -> None:
        optimize = needed("scipy.optimize")

        def hands(x: Array) -> Array:
            return shapes.hands(x[None])

        def constraints(x: Array) -> Array:
            asked = shapes.demands(samples := hands(x))
            shapes.note(x, float(shapes.costs(samples)[0]), asked)
            return shapes.constraints(asked)

        options: dict[str, Any] = {"maxiter": 1000, "ftol": 1e-6}
        limits: Any = {
            "type": "ineq",
            "fun": constraints,
            "jac": lambda x: shapes.constraint_slopes(hands(x)[0]),
        }
        extra: dict[str, Any] = {}
        if self.method == "trust-constr":
            options = {"maxiter": 1000, "xtol": 1e-6, "gtol": 1e-5, "initial_tr_radius": 0.5}
            limits = optimize.NonlinearConstraint(
                limits["fun"], 0.0, np.inf, jac=limits["jac"], hess=optimize.BFGS()
            )
            extra["hess"] = lambda x: shapes.curvature
        optimize.minimize(
            lambda x: float(shapes.costs(hands(x))[0]),
            x,
            jac=lambda x: shapes.cost_slope(hands(x)[0]),
            method=self.method,
            constraints=[limits],
            options=options,
            **extra,
        )

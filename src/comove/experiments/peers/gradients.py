"""Scipy's optimisers for constrained problems on the shape weights of all hands.

Slopes are exact, those of clearances by central differences of the distances of each sample. J is quadratic.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.experiments.peers.common import OutOfTime, load_clearances, refusal
from comove.experiments.peers.needed import needed
from comove.experiments.peers.shapes import Shapes
from comove.experiments.systems import Offers, Problem, System
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_BASIS = 20
NOISE = 0.02  # of the weights a first attempt begins with, and a further one with more
GROWTH = 2.0
MOST = 0.5  # at most so much


@dataclass(frozen=True)
class Scipy(System):
    """`scipy.optimize.minimize`, again from elsewhere around the guess until a movement looks feasible.

    Attributes
    ----------
    method : "SLSQP" or "trust-constr"
    """

    name: str
    method: str

    def refuses(self, scene: Scene) -> str:
        """What no peer can be told."""
        return refusal(scene)

    def warm_up(self, problem: Problem) -> None:
        """Import scipy's optimisers and compile the distances."""
        needed("scipy.optimize")
        load_clearances(problem.scene)

    def run(self, problem: Problem, offers: Offers) -> None:
        """Minimise J subject to the constraints at the samples."""
        shapes, rng = Shapes(problem, offers, N_BASIS), np.random.default_rng(problem.seed)
        noise = NOISE
        with suppress(OutOfTime):
            while shapes.promise[0] > 0.0:
                self._attempt(shapes, rng.normal(0.0, noise, shapes.n))
                noise = min(GROWTH * noise, MOST)
        shapes.close()

    def _attempt(self, shapes: Shapes, x: Array) -> None:
        optimize = needed("scipy.optimize")

        def cost(x: Array) -> float:
            hands = shapes.hands(x[None])
            value, left = float(shapes.costs(hands)[0]), shapes.spare(hands)
            shapes.note(x, value, -min(float(each.min()) for each in left))
            return value

        def one(x: Array) -> Array:
            return shapes.hands(x[None])[0]

        options: dict[str, Any] = {"maxiter": 1000, "ftol": 1e-6}
        limits: Any = {
            "type": "ineq",
            "fun": lambda x: shapes.limits(one(x)),
            "jac": lambda x: shapes.limit_slopes(one(x)),
        }
        extra: dict[str, Any] = {}
        if self.method == "trust-constr":
            options = {"maxiter": 1000, "xtol": 1e-6, "gtol": 1e-5, "initial_tr_radius": 0.5}
            limits = optimize.NonlinearConstraint(
                limits["fun"], 0.0, np.inf, jac=limits["jac"], hess=optimize.BFGS()
            )
            extra["hess"] = lambda x: shapes.curvature
        optimize.minimize(
            cost,
            x,
            jac=lambda x: shapes.cost_slope(one(x)),
            method=self.method,
            constraints=[limits],
            options=options,
            **extra,
        )

"""Method of reference [22]: optimised primitives without constraint (7b).

The jointly demonstrated primitives are optimised on the cost (4),

    minimise over all w   J(y_1(0..T), .., y_M(0..T))

Each end effector has its own weights, and all share one phase. Obstacles count where an end effector touches them,
as (4) is printed: neither the payload between the end effectors nor any constraint on their distance enters. The
search is that of the other methods, separable CMA-ES on orthonormalised weights.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from comove.lab.compared.common import taught_primitives
from comove.model.coordinates import arms_coordinates
from comove.model.scene import MovingBody, Scene
from comove.planning.method import Method
from comove.planning.methods import threaded
from comove.planning.objective import Objective
from comove.planning.search import OutOfTime, Schedule, Search, improve

OPTIMISING = Schedule(sigma=0.05, generations=1000, patience=60, gain=0.002)


@dataclass(frozen=True)
class Unconstrained(Method):
    """Method that optimises jointly demonstrated primitives without coordination.

    Attributes
    ----------
    n_basis : shape weights a dimension
    schedule : schedule of one run of the optimiser
    restarts : largest number of runs: the first from the demonstrated primitives, the others from these with random
        bumps that avoid the obstacles; no run follows one without contact
    """

    name: ClassVar[str] = "unconstrained"
    coordinates = staticmethod(arms_coordinates)
    n_basis: int = 30
    schedule: Schedule = OPTIMISING
    restarts: int = 20

    def run(self, search: Search, *, planner: bool) -> None:
        """Optimise until no end effector touches anything; verify the best motion. No path is planned."""
        best = start = taught = taught_primitives(search, self.n_basis)
        objective, least = hands_alone(search.objective), np.inf
        with suppress(OutOfTime):
            for restart in range(self.restarts):
                search.journal.stage = f"optimising without coordination, run {restart + 1}"
                found = improve(search, objective, start, self.schedule)
                value = search.evaluate(objective, found, found.weights[None])
                if objective.search_value(value)[0] < least:
                    best, least = found, float(objective.search_value(value)[0])
                if objective.feasible(value)[0] or not search.hard:
                    break
                start = threaded(search, objective, taught) or start
        search.judge(best.rollout())


def hands_alone(objective: Objective) -> Objective:
    """Return the objective for end effectors without payload and constraints."""
    alone = replace(objective.coordinates, together=())
    return replace(objective, scene=without_load(objective.scene), coordinates=alone)


def without_load(scene: Scene) -> Scene:
    """Return the scene without payload and constraints."""
    n = len(scene.manipulators)
    points = np.repeat(np.arange(n), 2).reshape(n, 2)
    return replace(scene, body=MovingBody(points, np.zeros(n), n), constraints=())

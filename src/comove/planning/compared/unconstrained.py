"""Jointly taught primitives, optimised on the paper's cost (4) without its constraint (7b); reference [22].

    minimise over all w   J(y_1(0..T), .., y_M(0..T))

Each hand has its own weights, all have one phase. Obstacles are what the hands touch, as (4) is printed: neither the
load between them nor any demand on their distance enters. The search is that of the other methods, separable CMA-ES
on orthonormalised weights.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from comove.coordination.coordinates import arms_coordinates
from comove.planning.compared.taught import N_BASIS, taught_primitives
from comove.planning.method import Method
from comove.planning.methods import threaded
from comove.planning.objective import Objective
from comove.planning.search import OutOfTime, Schedule, Search, improve
from comove.primitives.basis import motion_basis
from comove.scenes.scene import Body, Scene

OPTIMISING = Schedule(sigma=0.05, generations=1000, patience=60, gain=0.002)


@dataclass(frozen=True)
class Unconstrained(Method):
    """Jointly taught primitives without coordination.

    Attributes
    ----------
    n_basis : shape weights a dimension
    schedule : of one run of the optimiser
    restarts : runs at most, from what was taught and then from that with random bumps that make room, until no hand
        touches anything
    """

    name: ClassVar[str] = "unconstrained"
    coordinates = staticmethod(arms_coordinates)
    n_basis: int = N_BASIS
    schedule: Schedule = OPTIMISING
    restarts: int = 20

    def run(self, search: Search, *, planner: bool) -> None:
        """Optimise until no hand touches anything, and have the best of J judged; nothing is ever planned."""
        basis = motion_basis(self.n_basis, "velocity")
        best = start = taught = taught_primitives(search, basis)
        objective, least = hands_alone(search.objective), np.inf
        with suppress(OutOfTime):
            for restart in range(self.restarts):
                search.stage = f"optimising without coordination, run {restart + 1}"
                found = improve(search, objective, start, self.schedule)
                value = search.evaluate(objective, found, found.weights[None])
                if objective.search_value(value)[0] < least:
                    best, least = found, float(objective.search_value(value)[0])
                if objective.feasible(value)[0] or not search.hard:
                    break
                start = threaded(search, objective, taught) or start
        search.judge(best.rollout())


def hands_alone(objective: Objective) -> Objective:
    """The objective as the hands alone feel it: as points, without a load and without demands on each other."""
    alone = replace(objective.coordinates, together=())
    return replace(objective, scene=without_load(objective.scene), coordinates=alone)


def without_load(scene: Scene) -> Scene:
    """The same hands among the same obstacles; nothing ties them."""
    n = len(scene.manipulators)
    points = np.repeat(np.arange(n), 2).reshape(n, 2)
    return replace(scene, body=Body(points, np.zeros(n), n), constraints=())

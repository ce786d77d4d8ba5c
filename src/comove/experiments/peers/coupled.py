"""The dual-arm coupling of movement_primitives: a spring between two hands on one phase, after Gams et al. (2014).

It keeps a distance and ignores obstacles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.experiments.peers.common import first_hands, refusal, spatial
from comove.experiments.peers.needed import needed
from comove.experiments.systems import N_SAMPLES, Offers, System, SystemProblem
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_WEIGHTS = 30
SPRING = 100.0  # k; holds distances to 1e-8 m in the scenes tried, ten times better than 10 and 1


@dataclass(frozen=True)
class Coupled(System):
    """A `DualCartesianDMP` with `CouplingTermDualCartesianDistance` that imitates the first guess."""

    name: str

    def refuses(self, scene: Scene) -> str:
        """Return why the coupling of two hands does not suit the scene, empty if it does."""
        if len(scene.manipulators) != 2 or len(scene.distances) != 1:
            return "It couples two hands by one distance."
        return refusal(scene)

    def warm_up(self, problem: SystemProblem) -> None:
        """Import movement_primitives."""
        needed("movement_primitives.dmp")

    def run(self, problem: SystemProblem, offers: Offers) -> None:
        """Imitate the first guess, roll out with the coupling, and offer the result."""
        dmp = needed("movement_primitives.dmp")
        scene, (c,) = problem.scene, problem.scene.distances
        time = problem.instants * scene.duration
        states = np.zeros((N_SAMPLES, 14))
        hands = spatial(first_hands(problem, problem.instants))
        states[:, 0:3], states[:, 7:10] = hands[:, 0], hands[:, 1]
        states[:, [3, 10]] = 1.0  # quaternions w x y z of hands that do not turn
        model = dmp.DualCartesianDMP(
            execution_time=scene.duration, dt=time[1], n_weights_per_dim=N_WEIGHTS, int_dt=time[1]
        )
        model.imitate(time, states)
        model.configure(start_y=states[0], goal_y=states[-1])
        coupling = dmp.CouplingTermDualCartesianDistance(c.distance, lf=(1.0, 1.0), k=SPRING)
        _, states = model.open_loop(coupling_term=coupling)
        hands = np.stack([states[:, 0:3], states[:, 7:10]], axis=1)
        at = np.linspace(0, len(hands) - 1, N_SAMPLES).round().astype(int)
        offers.take(hands[at, :, : scene.n_dims])

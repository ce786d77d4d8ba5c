"""The paper's method as printed: Algorithm 1 without improvements.

It uses (3), (5) and (6). The paper leaves some choices open: the equality (7b) is a band, as two inequalities
without one have no interior; its width is the scene's tolerance; each side of it at each sample is a constraint h_j.
The objective (4) covers the end effectors alone, as printed. The movement is a coordinated primitive of comove,
whose ends are exact, with the exponential phase of (1b).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.dmp.basis import motion_basis
from comove.dmp.system import ExponentialPhase, Phase
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import Coordinates, arms_coordinates
from comove.model.scene import Scene
from comove.optim.ccmaes import PrintedCCMAES as Algorithm
from comove.planning.method import Method, require_distances
from comove.planning.objective import N_STEPS, ContactPenalty, Objective
from comove.planning.search import Search


@dataclass(frozen=True)
class Printed(Method):
    """CCMA-ES as printed, from the demonstration or straight lines. The demonstration is given to every end
    effector.

    Attributes
    ----------
    n_basis : number of weights w_n a column
    population : K, samples a generation
    sigma : sigma_0, first step size
    phase : phase of (1b)
    converged : share of the first step size at which the search has converged
    """

    name: ClassVar[str] = "printed"
    coordinates: Callable[[Scene], Coordinates] = arms_coordinates
    n_basis: int = 8
    population: int = 16
    sigma: float = 0.05
    phase: Phase = ExponentialPhase()
    converged: float = 1e-9

    def check(self, scene: Scene) -> None:
        """Refuse a scene without distance constraints."""
        super().check(scene)
        require_distances(scene)

    def run(self, search: Search, *, planner: bool) -> None:
        """Run Algorithm 1 until convergence or breakdown, without path planning. Raise `OutOfTime` if time is up."""
        scene = search.scene
        free, basis = search.objective.coordinates, motion_basis(self.n_basis, "acceleration", self.phase)
        dmp = CoordinatedDMP(scene, free, basis, free.boundary(), np.zeros((free.n_columns, self.n_basis)))
        if search.taught is not None:
            dmp = CoordinatedDMP.from_demonstration(search.taught, scene, free, basis)
        objective, shape = of_hands_alone(search.objective), dmp.weights.shape
        run = Algorithm(np.zeros(dmp.weights.size), self.sigma, search.rng, self.population)

        def weights(x: Array) -> Array:
            return dmp.weights + x.reshape(-1, *shape)

        def handed_out() -> None:
            search.judge(dmp.rollout(weights(run.mean[None])[0]))

        while run.sigma > self.converged * self.sigma:
            try:
                points, open_points = run.sample(), np.ones(self.population, dtype=bool)
                while open_points.any():
                    violated = violations(scene, dmp.rollouts(weights(points), N_STEPS))
                    search.count(len(points))
                    run.constrain(points, violated)
                    open_points[open_points] = violated.any(axis=1)
                    if search.over():
                        handed_out()
                    search.check_time()
                    if open_points.any():
                        search.journal.stage = f"drawing again, generation {search.journal.generations}"
                        points = run.sample(open_points)
            except np.linalg.LinAlgError:
                search.journal.log["broke_down_after_generations"] = float(search.journal.generations)
                break
            value = objective.evaluate(dmp.rollouts(weights(run.samples), N_STEPS))
            cost = value.cost + objective.weights.obstacle * value.hits
            search.tell(float(cost.min()), 0.0)
            run.adapt(cost)
        handed_out()


def violations(scene: Scene, q: Array) -> NDArray[np.bool_]:
    """Return which distances violate their tolerance at every sample.

    Parameters
    ----------
    q : array, shape (n_rollouts, n_manipulators * n_dims, n_steps)

    Returns
    -------
    array of bool, shape (n_rollouts, n_distances * 2 * n_steps); for every distance too far apart, then too near
    """
    hands, found = q.reshape(len(q), -1, scene.n_dims, q.shape[2]), []
    for c in scene.distances:
        apart = np.linalg.norm(hands[:, c.first] - hands[:, c.second], axis=1)
        found += [apart - c.distance > c.tolerance, c.distance - apart > c.tolerance]
    return np.concatenate(found, axis=1)


def of_hands_alone(objective: Objective) -> Objective:
    """Return equation (4) as printed. An obstacle counts only at samples at which an end effector is in it."""
    scene = objective.scene
    data = scene.file.model_dump(exclude_defaults=True)
    data.pop("load", None)
    data["constraints"] = []
    hands = Scene.from_dict(data, folder=scene.folder)
    return Objective(
        hands, arms_coordinates(hands), objective.weights, ContactPenalty(margin=0.0, slope=0.0, step=0.0)
    )

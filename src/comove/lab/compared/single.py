"""Method of reference [6] (paper, Fig. 3) for one manipulator.

CMA-ES optimises in two stages, on the scene of the first manipulator alone:

1. the coefficients of a combination of library movements that avoids the obstacles, w_d = sum_k c_kd w_kd (see
   `combination`);
2. the weights of the resulting movement, on the cost (4).

The source builds its movement for an environment, without a payload and without a second end effector; it is
verified likewise.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from comove.dmp import DMP, Library, motion_basis
from comove.dmp.arguments import require_count
from comove.dmp.demonstrations import Demonstration
from comove.errors import OptionError
from comove.lab.evolution.combination import Attempts
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import load_coordinates
from comove.model.scene import Scene
from comove.planning.choice import Movements, best_movement, suitable
from comove.planning.method import Method
from comove.planning.methods import POLISHING
from comove.planning.search import OutOfTime, Schedule, Search, improve, stricter

SHAPES = (
    *("Angle", "CShape", "GShape", "JShape", "LShape", "NShape"),
    *("PShape", "RShape", "Sine", "Spoon", "Sshape", "WShape"),
)
PLANES = ("xy", "xz")  # in which planar movements are laid into space
TAUGHT = "demonstration"


@dataclass(frozen=True)
class Single(Method):
    """Method that combines library movements for the first manipulator alone.

    Attributes
    ----------
    movements : a library, primitives, or DMPs (by name, or numbered); unless given, a dozen handwritten
        shapes. The demonstration is added, if there is one
    n_movements : number of movements that are combined, those most suitable for the scene
    n_basis : shape weights a dimension in the second stage
    schedule : schedule of the second stage
    tries : largest number of runs of it, with a stricter objective after each rejection
    """

    name: ClassVar[str] = "single"
    coordinates = staticmethod(load_coordinates)
    movements: Movements | None = field(default=None, repr=False)
    n_movements: int = 6
    n_basis: int = 30
    schedule: Schedule = POLISHING
    tries: int = 5

    def __post_init__(self) -> None:
        require_count("n_movements", self.n_movements)

    def scene_of(self, scene: Scene) -> Scene:
        """Return the scene of the first manipulator alone."""
        return alone(scene)

    def run(self, search: Search, *, planner: bool) -> None:
        """Combine movements, then optimise the weights, without path planning."""
        search.objective = search.objective.with_penalty(along_path=True)
        attempts = Attempts(search, self._suited(search))
        with suppress(OutOfTime):
            attempts.run()
        found = attempts.found()
        if search.found.best is None:
            search.judge(found.motion)
        basis, coordinates = motion_basis(self.n_basis, "velocity"), search.objective.coordinates
        self._optimised(
            search, CoordinatedDMP.from_demonstration(found.dmp, search.scene, coordinates, basis)
        )

    def _suited(self, search: Search) -> dict[str, DMP]:
        """Return the most suitable movements and any demonstration, by name."""
        scene = search.scene
        given = _handwriting() if self.movements is None else self.movements
        if not isinstance(given, (Library, Mapping)):
            given = list(given)
        suited = suitable(given, scene, PLANES[0])
        if scene.n_dims == 3:  # planar movements once more, in another plane
            across = suitable(given, scene, PLANES[1])
            planar = [
                name for name in suited if not np.array_equal(suited[name].weights, across[name].weights)
            ]
            suited = suited | {f"{name} in {PLANES[1]}": across[name] for name in planar}
        ranking = best_movement(suited, scene, objective=search.objective.weights).ranking
        chosen = {candidate.name: candidate.dmp for candidate in ranking[: self.n_movements]}
        if search.taught is None:
            return chosen
        return {TAUGHT: search.taught[0], **chosen}

    def _optimised(self, search: Search, dmp: CoordinatedDMP) -> None:
        """Optimise the weights, with a stricter objective after each rejection."""
        objective = search.objective
        for _ in range(self.tries):
            search.journal.stage = "optimising the weights"
            dmp = improve(search, objective, dmp, self.schedule)
            verdict = search.judge(dmp.rollout())
            if verdict.verified is not None or not search.hard:
                return
            objective = stricter(search, objective, verdict)


def alone(scene: Scene) -> Scene:
    """Return the scene of the first manipulator alone. Obstacles, limits and clearance are the same; there is no
    payload and no other end effector.

    Raises
    ------
    OptionError
        If the scene continues another movement: library movements begin at rest.
    """
    if scene.begins or any(group.start_twist.any() for group in scene.groups):
        raise OptionError(
            "the scene goes on from another movement, and movements of a library begin at rest",
            key="method",
            way_out="use the method 'comove'",
        )
    hand = scene.file.manipulators[0]
    ends = {"start": scene.start[0].tolist(), "goal": scene.goal[0].tolist()}
    data = scene.file.model_dump() | {
        "manipulators": [hand.model_dump() | ends],
        "load": None,
        "constraints": [],
        "demonstration": None,
        "robot": None,
        "grasp": None,
    }
    return Scene.from_dict(data, folder=scene.folder, check_ends=False)  # those of the scene are free


def _handwriting() -> dict[str, DMP]:
    return {name: DMP.fit(Demonstration.from_lasa(name)) for name in SHAPES}

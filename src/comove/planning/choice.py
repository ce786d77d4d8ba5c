"""The choice of a library movement for a scene."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from comove.dmp import DMP, Library, Primitive, Variant, motion_basis
from comove.dmp.operations import in_space
from comove.dmp.poses import PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.errors import OptionError
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import load_coordinates
from comove.model.scene import Scene
from comove.planning.objective import N_STEPS, Evaluation, Objective
from comove.planning.objectives.criteria import PaperCost

N_BASIS = 30  # shape weights a dimension of a transferred movement

Movements = Library | Mapping[str, DMP] | Iterable[Primitive | DMP]


@dataclass(frozen=True, eq=False)
class Candidate:
    """A library movement transferred to every end effector, and its evaluation.

    Attributes
    ----------
    name : name of the movement
    dmp : the movement as it was given, or laid into space if it is planar and a plane was given
    passes : whether nothing is touched and no limit exceeded at the samples
    cost : J without its obstacle term
    penalty : penalty of obstacles (`ContactPenalty`)
    clearance : least clearance at the samples [m], capped as in `Evaluation`
    """

    name: str
    dmp: DMP
    passes: bool
    cost: float
    penalty: float
    clearance: float


@dataclass(frozen=True, eq=False)
class Choice:
    """A ranking of movements by how well they suit a scene.

    Attributes
    ----------
    ranking : candidates, best first: those that pass, then the others, each part in order of cost plus penalties
    """

    ranking: tuple[Candidate, ...]

    @property
    def best(self) -> Candidate:
        """Return the first candidate of the ranking."""
        return self.ranking[0]


def best_movement(
    movements: Movements,
    scene: Scene,
    *,
    objective: PaperCost | None = None,
    plane: str | None = None,
) -> Choice:
    """Find the movement of a library that suits a scene best.

    Parameters
    ----------
    movements : a library, primitives, or DMPs (by name, or numbered); those of another dimension than the scene's,
        of joints, and rhythmic ones, are left out
    scene : scene to whose end effectors each movement is transferred, as `solve` does
    objective : weights of equation (4)
    plane : "xy", "xz" or "yz", plane into which planar movements are laid in a spatial scene

    Raises
    ------
    OptionError
        If no movement can be transferred.
    """
    suited = suitable(movements, scene, plane)
    coordinates, basis = load_coordinates(scene), motion_basis(N_BASIS, "velocity")
    cost = Objective(scene, coordinates, objective or PaperCost())
    names, values = list(suited), []
    for dmp in suited.values():
        carried = CoordinatedDMP.from_demonstration(dmp, scene, coordinates, basis)
        values.append(cost.evaluate(carried.rollouts(carried.weights[None], N_STEPS)))
    value = Evaluation(*(np.concatenate(arrays) for arrays in zip(*(v[:-1] for v in values), strict=True)))
    passes, total = cost.feasible(value), cost.search_value(value)
    order = np.lexsort((total, ~passes))
    return Choice(
        tuple(
            Candidate(
                names[i],
                suited[names[i]],
                bool(passes[i]),
                float(value.cost[i]),
                float(value.penalty[i]),
                float(value.clearance[i]),
            )
            for i in order
        )
    )


def suitable(movements: Movements, scene: Scene, plane: str | None = None) -> dict[str, DMP]:
    """Return the movements that can be transferred to a scene, by name.

    Raises
    ------
    OptionError
        If there is no such movement.
    """
    suited: dict[str, DMP] = {}
    n_given = n_joints = 0
    for name, dmp, is_joints in _named(movements):
        n_given += 1
        n_joints += is_joints
        if is_joints:
            continue
        if plane is not None and dmp.n_dims == 2 and scene.n_dims == 3:
            dmp = in_space(dmp, plane)
        if dmp.n_dims == scene.n_dims and dmp.variant is not Variant.RHYTHMIC:
            suited[name] = dmp
    if not suited:
        raise OptionError(
            f"none of the {n_given} movements has the scene's {scene.n_dims} dimensions and an end"
            + (f"; {n_joints} are of joints, which are no path of an end effector" if n_joints else ""),
            key="library",
            way_out="learn one: comove library add DEMO",
        )
    return suited


def _named(movements: Movements) -> Iterator[tuple[str, DMP, bool]]:
    """Yield the movements with their names, and whether they are of joints."""
    if isinstance(movements, Mapping):
        movements = [Primitive(name, dmp) for name, dmp in movements.items()]
    for i, movement in enumerate(movements):
        name = movement.name if isinstance(movement, Primitive) else str(i)
        dmp = movement.followed if isinstance(movement, Primitive) else movement
        dmp = dmp.mean if isinstance(dmp, ProMP) else dmp
        is_joints = isinstance(movement, Primitive) and movement.is_joints
        yield name, dmp.translation if isinstance(dmp, PoseDMP) else dmp, is_joints

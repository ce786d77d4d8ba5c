"""Demonstrated movements of a hand or of the load, adapted to the hands of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.demonstration import Demonstration
from comove.errors import OptionError
from comove.geometry.rotations import (
    conjugate,
    matrices,
    quaternion_of_rotation,
    quaternion_product,
    similarity,
)
from comove.primitives.dmp import DMP
from comove.primitives.poses import Pose, PoseDMP
from comove.primitives.probabilistic import ProMP
from comove.primitives.variants import Variant
from comove.scenes.groups import RigidGroup
from comove.scenes.scene import Scene

Array = NDArray[np.float64]


def carried_to_hands(dmp: DMP | Sequence[DMP], scene: Scene, s: Array) -> Array:
    """Return a movement, or one for each manipulator, modulated to the hands' ends.

    Parameters
    ----------
    s : array, shape (n_steps,), shares of the duration

    Returns
    -------
    array, shape (n_steps, n_manipulators, n_dims) [m]
    """
    each = [dmp] * len(scene.start) if isinstance(dmp, DMP) else dmp
    return np.stack(
        [
            modulate(own, start, goal).at(s * own.duration).position
            for own, start, goal in zip(each, scene.start, scene.goal, strict=True)
        ],
        axis=1,
    )


def covariance_of_hands(promp: ProMP, scene: Scene, s: Array) -> Array:
    """Return the covariance of the hands' positions, of the movements that lead from the scene's start to its goal.

    Covariances turn and scale with the movements, by the similarities of `modulate`. Hands that share one movement
    vary each for itself; hands that were recorded together, together.

    Parameters
    ----------
    s : array, shape (n_steps,), shares of the duration

    Returns
    -------
    array, shape (n_steps, n_hands * n_dims, n_hands * n_dims) [m^2]
    """
    n_hands, n_dims = scene.start.shape
    mean = promp.mean
    between = promp.towards(start=mean.start, goal=mean.goal).covariance_at(s * promp.duration)
    turns = [
        _similarity(own, start, goal)
        for own, start, goal in zip(movements_of_hands(promp, scene), scene.start, scene.goal, strict=True)
    ]
    covariance = np.zeros((len(s), n_hands * n_dims, n_hands * n_dims))
    order = [promp.manipulators.index(name) for name in scene.manipulators] if promp.manipulators else None
    for i, turn in enumerate(turns):
        for j, other in enumerate(turns):
            if order is None and i != j:
                continue
            k, m = (0, 0) if order is None else (order[i], order[j])
            block = between[:, k * n_dims : (k + 1) * n_dims, m * n_dims : (m + 1) * n_dims]
            covariance[:, i * n_dims : (i + 1) * n_dims, j * n_dims : (j + 1) * n_dims] = (
                turn @ block @ other.T
            )
    return covariance


def movements_of_hands(promp: ProMP, scene: Scene) -> tuple[DMP, ...]:
    """Return the mean movement of every hand of a scene, in their order.

    Raises
    ------
    OptionError
        If the distribution is of other manipulators, or has another dimension.
    """
    if promp.n_dims != scene.n_dims:
        raise OptionError(
            f"the distribution has {promp.n_dims} dimensions, the scene {scene.n_dims}",
            key="demonstration",
            way_out="give one of the scene's dimension",
        )
    if not promp.manipulators:
        return promp.movements * len(scene.manipulators)
    if sorted(promp.manipulators) != sorted(scene.manipulators):
        raise OptionError(
            f"the distribution is of {', '.join(promp.manipulators)}",
            key="demonstration",
            way_out=f"record {', '.join(scene.manipulators)}, or one hand for all",
        )
    by_name = dict(zip(promp.manipulators, promp.movements, strict=True))
    return tuple(by_name[name] for name in scene.manipulators)


def modulate(dmp: DMP, start: Array, goal: Array) -> DMP:
    """Carry a movement to another start and goal, by the similarity that maps its own ends to these.

    The similarity is a rotation and a scale.

    Where its own start and goal coincide there is no such map: then it is only shifted. The result starts at rest.

    Parameters
    ----------
    start, goal : arrays, shape (n_dims,), [m]

    Raises
    ------
    OptionError
        If the movement is rhythmic.
    """
    if dmp.variant is Variant.RHYTHMIC:
        raise OptionError(
            "a rhythmic movement leads from no start to no goal",
            key="demonstration",
            way_out="give one that ends",
        )
    wanted, turn = goal - start, _similarity(dmp, start, goal)
    still = np.zeros_like(start)
    # The classic form scales along the axes and cannot be turned; for these ends the closed form is the same.
    classic = dmp.variant is Variant.CLASSIC
    return replace(
        dmp,
        variant=Variant.CLOSED_FORM if classic else dmp.variant,
        weights=turn @ dmp.shape_weights,
        learned=wanted,
        start=start,
        goal=goal,
        start_velocity=still,
        goal_velocity=still,
    )


def _similarity(dmp: DMP, start: Array, goal: Array) -> Array:
    """Return the rotation and scale that carry a movement's ends to others; array, shape (n_dims, n_dims)."""
    own, wanted = dmp.goal - dmp.start, goal - start
    closed = np.linalg.norm(own) <= 1e-9 * np.abs(dmp.shape_weights).max(initial=1e-300)
    return np.eye(len(start)) if closed else similarity(own, wanted)


def hands_of_poses(dmp: PoseDMP, scene: Scene, *, n_steps: int = 401, n_basis: int = 50) -> tuple[DMP, ...]:
    """Return the movements of all hands that carry the load as demonstrated, from the scene's start to its goal.

    The path is carried to the load's start and goal by a similarity, as that of a single hand is (paper, III-B), and
    the axes of rotation turn with it; then the rotation is adapted to the load's own start and goal. Rotations that
    the load cannot perform, such as tilting where it stays upright, are left out.

    Parameters
    ----------
    dmp : poses of the load; of the orientations, only the rotation since the start matters
    n_steps, n_basis : samples between, and basis functions of the hands' movements

    Raises
    ------
    OptionError
        If a single body is not all that moves, or the movement has another dimension.
    """
    if not scene.turns_as_one:
        raise OptionError(
            "a movement of poses is for one load that turns, held by all hands",
            key="demonstration",
            way_out="give a movement of positions",
        )
    if dmp.n_dims != scene.n_dims:
        raise OptionError(
            f"the demonstration has {dmp.n_dims} dimensions, the scene {scene.n_dims}",
            key="demonstration",
            way_out="give one of the scene's dimension",
        )
    group, n_dims = scene.groups[0], scene.n_dims
    start, goal = group.start.center[:n_dims], group.goal.center[:n_dims]
    s = np.linspace(0.0, 1.0, n_steps)
    middle = modulate(dmp.translation, start, goal).at(s * dmp.duration).position
    along, frame = dmp.goal.position - dmp.start.position, np.eye(3)
    if n_dims == 3 and np.linalg.norm(along) > 0 and np.linalg.norm(goal - start) > 0:
        frame = similarity(along, goal - start) * (np.linalg.norm(along) / np.linalg.norm(goal - start))
    wanted = quaternion_of_rotation(frame.T @ _turned(group) @ frame)
    begin, end = dmp.start, dmp.goal
    led = dmp.towards(start=begin, goal=Pose(end.position, quaternion_product(wanted, begin.orientation)))
    turns = quaternion_product(led.at(s * dmp.duration).orientation, conjugate(begin.orientation))
    turns[:, 1:] = turns[:, 1:] @ frame.T
    if group.orientation == "vertical":
        angle = np.unwrap(2 * np.arctan2(turns[:, 3], turns[:, 0]))
        turns = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=1)
    away = scene.nodes_at("start")[: len(scene.manipulators)] - group.start.center
    hands = middle[:, None] + np.einsum("tab,ib->tia", matrices(turns), away)[..., :n_dims]
    time = s * dmp.duration
    return tuple(DMP.fit(Demonstration(time, hands[:, i]), n_basis=n_basis) for i in range(len(away)))


def _turned(group: RigidGroup) -> Array:
    """Return the rotation of a group from start to goal, as small as its hands allow; array, shape (3, 3)."""
    if group.orientation == "axis":
        return similarity(group.start.rotation[:, 0], group.goal.rotation[:, 0])
    return group.goal.rotation @ group.start.rotation.T

"""Demonstrated movements, adapted to a scene's end effectors."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from comove.arrays import Array
from comove.dmp.basis import MAX_BASIS
from comove.dmp.demonstrations.demonstration import Demonstration
from comove.dmp.dmp import DMP
from comove.dmp.operations import settled
from comove.dmp.poses import Pose, PoseDMP
from comove.dmp.probabilistic import ProMP
from comove.dmp.variants import LARGE, Variant, adaptation, scaled_share
from comove.errors import ComoveWarning, OptionError
from comove.geometry.rotations import (
    conjugate,
    matrices,
    quaternion_of_rotation,
    quaternion_product,
    similarity,
)
from comove.model.groups import RigidGroup
from comove.model.scene import Scene

N_STEPS = 201
"""Samples of a demonstration that end effectors follow."""


def carried_to_hands(dmp: DMP | Sequence[DMP], scene: Scene) -> Array:
    """Return movements adapted to the start and goal of end effectors.

    Returns
    -------
    array, shape (N_STEPS, n_manipulators, n_dims), read-only, at even times from start to goal [m]
    """
    return _carried(scene, *([dmp] * len(scene.start) if isinstance(dmp, DMP) else dmp))


@lru_cache(maxsize=4)  # search, warnings and measures ask for the same
def _carried(scene: Scene, *movements: DMP) -> Array:
    s = np.linspace(0.0, 1.0, N_STEPS)
    hands = np.stack(
        [
            modulate(own, start, goal).at(s * own.duration).position
            for own, start, goal in zip(movements, scene.start, scene.goal, strict=True)
        ],
        axis=1,
    )
    hands.setflags(write=False)
    return hands


def covariance_of_hands(promp: ProMP, scene: Scene, s: Array) -> Array:
    """Return the covariance of the end effectors' positions.

    The movements lead from the scene's start to its goal. Covariances turn and scale with them, by the matrices of
    `modulate`. End effectors that share one movement vary independently; those recorded together vary together.

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
        adapting(own, goal - start)
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
    """Return the mean movement of every end effector, in order.

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
    """Adapt a movement to another start and goal by a similarity.

    The similarity is a rotation and a scale. The nearer a movement's own ends are, as a share of its extent, the less
    it is scaled and turned (`comove.dmp.variants`); where they nearly coincide, it is only shifted. The result
    starts at rest, and meets both ends exactly.

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
    wanted = goal - start
    turn = adapting(dmp, wanted)
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


def adapting(dmp: DMP, displacement: Array) -> Array:
    """Return the matrix of `modulate`; array, shape (n_dims, n_dims).

    Parameters
    ----------
    displacement : array, shape (n_dims,), from the new start to the new goal [m]
    """
    return adaptation(dmp.goal - dmp.start, displacement, dmp.extent)


def magnification(dmp: DMP, start: Array, goal: Array, of: str) -> tuple[float, str]:
    """Return a movement's magnification, and a sentence if above `LARGE`.

    Parameters
    ----------
    start, goal : arrays, shape (n_dims,), ends to which it is adapted [m]
    of : name of the movement
    """
    factor = float(np.linalg.norm(adapting(dmp, goal - start), 2))
    if factor <= LARGE:
        return factor, ""
    gap, way = np.linalg.norm(dmp.goal - dmp.start), np.linalg.norm(goal - start)
    closed = ", or one that ends where it starts" if gap < 0.5 * dmp.extent else ""
    return factor, (
        f"the demonstration is magnified {factor:.3g} times for {of}, from {dmp.extent:.2g} m to "
        f"{modulate(dmp, start, goal).extent:.2g} m, since its ends are {gap:.2g} m apart and those of the scene "
        f"{way:.2g} m: give one with ends at least {rounded_up(float(way) / LARGE):g} m apart{closed}"
    )


def rounded_up(value: Array | float) -> Array:
    """Return numbers rounded up to three digits of the greatest."""
    unit = 10.0 ** (np.floor(np.log10(max(np.abs(value).max(), 1e-12))) - 2)
    return np.asarray(np.round(np.ceil(np.asarray(value) / unit) * unit, 12), dtype=np.float64)


def hands_of_poses(dmp: PoseDMP, scene: Scene, *, n_steps: int = 401, n_basis: int = 50) -> tuple[DMP, ...]:
    """Return the end effectors' movements with the payload moving as demonstrated.

    The path is adapted to the payload's start and goal as that of a single end effector is (`modulate`; paper,
    III-B), and the axes of rotation turn with it; then the rotation is adapted to the payload's own start and goal.
    Rotations that the payload cannot perform, such as tilting where it stays upright, are left out.

    Parameters
    ----------
    dmp : poses of the payload; of the orientations, only the rotation since the start matters
    n_steps, n_basis : samples between, and least basis functions of the end effectors' movements

    Raises
    ------
    OptionError
        If more than a single body moves, or the movement has another dimension.

    Warns
    -----
    ComoveWarning
        If the path is magnified by more than 3.
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
    _, magnified = magnification(dmp.translation, start, goal, "the load")
    if magnified:
        warnings.warn(magnified, ComoveWarning, stacklevel=3)
    s = np.linspace(0.0, 1.0, n_steps)
    middle = modulate(dmp.translation, start, goal).at(s * dmp.duration).position
    away = scene.nodes_at("start")[: len(scene.manipulators)] - group.start.center
    frame = np.eye(3)
    if n_dims == 3:
        frame = _turned_with_path(dmp.translation, goal - start, float(np.linalg.norm(away, axis=1).max()))
    wanted = quaternion_of_rotation(frame.T @ _turned(group) @ frame)
    begin, end = dmp.start, dmp.goal
    if dmp.turning.variant is Variant.CLASSIC:  # it scales every component, without bound, and does not turn
        dmp = replace(dmp, turning=settled(dmp.turning))
    led = dmp.towards(start=begin, goal=Pose(end.position, quaternion_product(wanted, begin.orientation)))
    turns = quaternion_product(led.at(s * dmp.duration).orientation, conjugate(begin.orientation))
    turns[:, 1:] = turns[:, 1:] @ frame.T
    if group.orientation == "vertical":
        angle = np.unwrap(2 * np.arctan2(turns[:, 3], turns[:, 0]))
        turns = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], axis=1)
    hands = middle[:, None] + np.einsum("tab,ib->tia", matrices(turns), away)[..., :n_dims]
    time = s * dmp.duration
    n_basis = max(n_basis, min(MAX_BASIS, 2 * dmp.weights.shape[1]))
    return tuple(DMP.fit(Demonstration(time, hands[:, i]), n_basis=n_basis) for i in range(len(away)))


def _turned_with_path(dmp: DMP, displacement: Array, reach: float) -> Array:
    """Return the rotation of a path's rotation axes; array, shape (3, 3).

    It leads from the path's own direction to that of the adapted path, less so where the displacement is small
    relative to the payload, as its direction is then noise.

    Parameters
    ----------
    displacement : array, shape (3,), from the new start to the new goal [m]
    reach : greatest distance of an end effector from the centre of the payload [m]
    """
    own, target = dmp.goal - dmp.start, displacement
    if scaled_share(own, dmp.extent) < 1.0:
        target = adapting(dmp, displacement) @ own
    length, wanted = np.linalg.norm(own), np.linalg.norm(target)
    share = scaled_share(displacement, reach)
    if share < 1.0 and length > 0.0 and wanted > 0.0:
        target = (1.0 - share) * own / length + share * target / wanted
        wanted = np.linalg.norm(target)
    if not (length > 0.0 and wanted > 0.0):
        return np.eye(3)
    return similarity(own, target) * (length / wanted)


def _turned(group: RigidGroup) -> Array:
    """Return a group's smallest rotation from start to goal, shape (3, 3)."""
    if group.orientation == "axis":
        return similarity(group.start.rotation[:, 0], group.goal.rotation[:, 0])
    return group.goal.rotation @ group.start.rotation.T

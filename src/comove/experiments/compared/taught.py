"""Jointly taught primitives, one for every hand on a common phase, with which all compared methods begin."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedDMP
from comove.errors import OptionError
from comove.planning.objective import N_STEPS
from comove.planning.search import Search
from comove.planning.seeds import minimum_jerk
from comove.primitives.basis import MotionBasis, motion_basis
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_BASIS = 30  # shape weights a dimension


def taught_primitives(search: Search, basis: MotionBasis | None = None) -> CoordinatedDMP:
    """Return the demonstration transferred to every hand (paper, III-B), or straight lines of minimum jerk.

    Parameters
    ----------
    search : search whose objective is in coordinates of free hands
    basis : basis of the primitives; one with `N_BASIS` shape weights unless given

    Raises
    ------
    OptionError
        If the scene goes on from another movement: taught movements begin at rest.
    """
    scene, coordinates = search.scene, search.objective.coordinates
    if any(group.start_twist.any() for group in scene.groups):
        raise OptionError(
            "what is taught begins at rest, and the scene goes on from another movement",
            key="method",
            way_out="use the method 'comove'",
        )
    basis = basis or motion_basis(N_BASIS, "velocity")
    if search.taught is not None:
        return CoordinatedDMP.from_demonstration(search.taught, scene, coordinates, basis)
    s = np.linspace(0.0, 1.0, N_STEPS)
    hands = scene.start + minimum_jerk(s)[:, None, None] * (scene.goal - scene.start)
    dmp = CoordinatedDMP(scene, coordinates, basis, coordinates.boundary(), np.zeros(0))
    return dmp.fitted(s, coordinates.from_hands(hands))


def group_means(scene: Scene) -> Array:
    """Return the matrix that averages over the hands of every rigid group, shape (n_groups, n_manipulators)."""
    means = np.zeros((len(scene.groups), len(scene.manipulators)))
    for g, group in enumerate(scene.groups):
        means[g, list(group.members)] = 1.0 / len(group.members)
    return means

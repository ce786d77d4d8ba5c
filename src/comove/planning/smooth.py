"""Smooth motions: planned ways and demonstrations, made least in jerk by convex programmes and verified."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import load_coordinates
from comove.coordination.motion import CoordinatedDMP
from comove.planning.convex.jerk import squares
from comove.planning.convex.programme import Programme, Settings, optimise
from comove.planning.objective import N_STEPS
from comove.planning.search import Search
from comove.primitives.basis import motion_basis

Array = NDArray[np.float64]

N_BASIS = (24, 40)  # shape weights a column: few, and where these cannot follow a way
RIDGES = (1e-8, 1e-9, 1e-10, 1e-11)  # of the fit that a search begins with, from smooth to near
NEAR = 0.05  # m, within which a fit follows the way about which clearances are linearised
SETTINGS = Settings()
AGAIN = 0.03  # m, trust region after a rejection
ATTEMPTS = 4  # until a motion is verified, each with more margin
MORE, MORE_BORDER = 1e-3, 2e-4  # m


def smooth_way(search: Search, way: Array, boundary: Array) -> bool:
    """Make the best of a way that touches nothing, and have it judged; whether it is verified.

    Parameters
    ----------
    way : array, shape (N_STEPS, n_columns), in load coordinates, at even times
    boundary : array, shape (4, n_columns), as `CoordinatedMotion` has it
    """
    programme = z = None
    for n_basis in N_BASIS:
        programme = _programme(search, boundary, n_basis)
        n_fine, n_columns = programme.fine.base.shape
        fine = np.linspace(0.0, N_STEPS - 1, n_fine)
        reference = np.stack(
            [np.interp(fine, np.arange(N_STEPS), way[:, c]) for c in range(n_columns)], axis=1
        )
        for ridge in RIDGES:
            z = programme.fit(reference, ridge)
            off = np.abs((programme.fine.q(z) - reference) / programme.scale[:n_columns]).max()
            if off < NEAR:
                return _verified(search, programme, z, reference)
    return _verified(search, programme, z, reference)


def smooth_demonstration(search: Search) -> bool:
    """Make the demonstration itself fit for the scene, and have it judged; whether that is verified."""
    scene = search.scene
    basis, coordinates = motion_basis(N_BASIS[1], "jerk"), load_coordinates(scene)
    dmp = CoordinatedDMP.from_demonstration(search.taught, scene, coordinates, basis)
    return _verified(search, _programme(search, dmp.boundary, N_BASIS[1]), dmp.weights.ravel(), None)


def _programme(search: Search, boundary: Array, n_basis: int) -> Programme:
    return Programme(search.scene, load_coordinates(search.scene), motion_basis(n_basis, "jerk"), boundary)


def _verified(search: Search, programme: Programme, z: Array, reference: Array | None) -> bool:
    """Optimise, judge, and again with more margin where that is rejected."""
    scene, settings = search.scene, replace(SETTINGS, wish=search.smoothness.room)
    cost = squares(scene, search.smoothness, search.objective.demonstration)
    for attempt in range(ATTEMPTS):
        search.check_time()
        outcome = optimise(programme, cost, z, settings, reference, search.over)
        z, reference = outcome.z, None
        search.evaluations += outcome.iterations
        search.tell(outcome.value, outcome.missed)
        if search.judge(programme.motion(z)).verified is not None:
            return True
        more = attempt + 1
        settings = replace(
            settings,
            radius=AGAIN,
            margin=SETTINGS.margin + more * MORE,
            border_margin=SETTINGS.border_margin + more * MORE_BORDER,
        )
    return False

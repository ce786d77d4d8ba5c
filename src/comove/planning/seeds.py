"""Initial shape weights: path fits with many time profiles, and random bumps."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from comove.arrays import Array
from comove.dmp.basis import MotionBasis
from comove.model.coordinated_dmp import CoordinatedDMP
from comove.model.coordinates import Coordinates, load_coordinates
from comove.model.scene import Scene
from comove.planning.configurations import Space
from comove.planning.objective import N_STEPS
from comove.planning.planner import along

# (p, f): the share of the path at time t is min_jerk(1 - (1 - min(t/f, 1))^p); early arrival costs least, a steady
# pace needs the least acceleration, so several are fitted and the best that is verified is kept.
PROFILES = ((1.0, 1.0), (1.0, 0.7), (2.0, 1.0), (3.0, 1.0), (4.5, 1.0), (3.0, 0.7), (6.0, 1.0))
RAMPS = (0.06, 0.15)  # shares of the time at both ends in which the speed of `steady` changes
GENTLE = [0, len(PROFILES), len(PROFILES) + 1]  # minimum jerk, and a steady pace
RIDGES = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)


def minimum_jerk(t: Array) -> Array:
    """Return minimum-jerk shares of a path at normalised times. See Flash and Hogan (1985)."""
    t = np.clip(t, 0.0, 1.0)
    return t**3 * (10.0 + t * (-15.0 + 6.0 * t))


def steady(t: Array, ramp: float) -> Array:
    """Return shares of a path at normalised times, at mostly constant speed. It rises and falls in a time `ramp`."""
    x = np.minimum(np.minimum(t, 1.0 - t) / ramp, 1.0)
    half = ramp * x**3 * (1.0 - 0.5 * x) + np.maximum(np.minimum(t, 1.0 - t) - ramp, 0.0)
    return np.where(t <= 0.5, half / (1.0 - ramp), 1.0 - half / (1.0 - ramp))


@lru_cache(maxsize=4)
def profiles(n_steps: int) -> Array:
    """Return shares of the path at even times, by every profile; array, shape (n_profiles, n_steps)."""
    t = np.linspace(0.0, 1.0, n_steps)
    early = [minimum_jerk(1.0 - (1.0 - np.minimum(t / f, 1.0)) ** p) for p, f in PROFILES]
    return np.stack([*early, *(steady(t, ramp) for ramp in RAMPS)])


def targets_along(space: Space, path: Array, *, gentle: bool) -> Array:
    """Return a path, run with every time profile.

    Parameters
    ----------
    path : array, shape (n_configurations, n_columns), in payload coordinates, continuous
    gentle : whether to leave out the profiles that arrive early

    Returns
    -------
    array, shape (n_profiles, N_STEPS, n_columns)
    """
    shares = profiles(N_STEPS)
    return along(space, path, shares[GENTLE] if gentle else shares)


def fit(
    target: Array, goal: Array, coordinates: Coordinates, basis: MotionBasis, scene: Scene
) -> tuple[CoordinatedDMP, Array]:
    """Fit a primitive to every movement with every ridge.

    Parameters
    ----------
    target : array, shape (n_targets, N_STEPS, n_columns), in payload coordinates, continuous
    goal : array, shape (n_columns,), common end of the movements
    coordinates : coordinates of the primitive

    Returns
    -------
    dmp : primitive with the ends of the movements and the first of the weights
    weights : array, shape (n_targets * n_ridges, n_columns, n_basis)
    """
    boundary = coordinates.boundary()
    if coordinates.kind == "load":
        boundary[2] = goal  # the same pose, but with the movements' number of turns
    else:
        target = coordinates.from_load(target, load_coordinates(scene))
    misses = target - basis.sampled(N_STEPS)[basis.n_basis :].T @ boundary
    weights = _ridge_solvers(basis)[None] @ misses[:, None]  # (n_targets, n_ridges, n_basis, n_columns)
    weights = np.ascontiguousarray(weights.reshape(-1, *weights.shape[2:]).transpose(0, 2, 1))
    return CoordinatedDMP(scene, coordinates, basis, boundary, weights[0]), weights


def bumps(
    basis: MotionBasis, rng: np.random.Generator, count: int, widths: tuple[float, float] = (0.025, 0.15)
) -> Array:
    """Return weights of flat-topped unit bumps of random times and widths.

    Parameters
    ----------
    widths : least and largest width [durations]

    Returns
    -------
    array, shape (count, n_basis)
    """
    narrowest, widest = widths
    width = narrowest * (widest / narrowest) ** rng.uniform(size=(count, 1))
    away = (np.linspace(0.0, 1.0, N_STEPS) - rng.uniform(size=(count, 1))) / width
    return np.exp(-0.5 * away**4) @ _ridge_solvers(basis)[0].T


@lru_cache(maxsize=8)
def _ridge_solvers(basis: MotionBasis) -> Array:
    """Return (Phi^T Phi + ridge |Phi|^2 I)^-1 Phi^T for every ridge; array, shape (n_ridges, n_basis, n_steps)."""
    left, singular, right = np.linalg.svd(basis.sampled(N_STEPS)[: basis.n_basis].T, full_matrices=False)
    size = singular[0] ** 2
    return np.stack([(right.T * (singular / (singular**2 + ridge * size))) @ left.T for ridge in RIDGES])

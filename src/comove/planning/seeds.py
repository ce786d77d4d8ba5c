"""Weights to begin with: fits of a path in configuration space under many time profiles, and random bumps."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import Coordinates, load_coordinates
from comove.coordination.motion import CoordinatedDMP
from comove.planning.configurations import Space
from comove.planning.objective import N_STEPS
from comove.planning.planner import along
from comove.primitives.basis import MotionBasis
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

# (p, f): the path is run as min_jerk(1 - (1 - min(t/f, 1))^p); early arrival costs least, steady pace
# brakes least, so several are fitted and the best that verifies is kept.
PROFILES = ((1.0, 1.0), (1.0, 0.7), (2.0, 1.0), (3.0, 1.0), (4.5, 1.0), (3.0, 0.7), (6.0, 1.0))
RAMPS = (0.06, 0.15)  # of the steadiest, whose speed is even but for these shares of the time at both ends
RIDGES = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3)
NARROWEST, WIDEST = 0.025, 0.15  # of a bump, in durations


def minimum_jerk(t: Array) -> Array:
    """Share of the way at normalised times (Flash and Hogan, 1985), any shape."""
    t = np.clip(t, 0.0, 1.0)
    return t**3 * (10.0 + t * (-15.0 + 6.0 * t))


def steady(t: Array, ramp: float) -> Array:
    """Share of the way at normalised times, (n_steps,), where the speed rises and falls smoothly in a time `ramp`."""
    x = np.minimum(np.minimum(t, 1.0 - t) / ramp, 1.0)
    half = ramp * x**3 * (1.0 - 0.5 * x) + np.maximum(np.minimum(t, 1.0 - t) - ramp, 0.0)
    return np.where(t <= 0.5, half / (1.0 - ramp), 1.0 - half / (1.0 - ramp))


@lru_cache(maxsize=4)
def profiles(n_steps: int) -> Array:
    """Shares of the path at even times; array, shape (n_profiles, n_steps)."""
    t = np.linspace(0.0, 1.0, n_steps)
    early = [minimum_jerk(1.0 - (1.0 - np.minimum(t / f, 1.0)) ** p) for p, f in PROFILES]
    return np.stack([*early, *(steady(t, ramp) for ramp in RAMPS)])


def targets_along(space: Space, path: Array) -> Array:
    """A path under every time profile.

    Parameters
    ----------
    path : array, shape (n_configurations, n_columns), in load coordinates, continuous

    Returns
    -------
    array, shape (n_profiles, N_STEPS, n_columns)
    """
    return along(space, path, profiles(N_STEPS))


def fit(
    target: Array, goal: Array, coordinates: Coordinates, basis: MotionBasis, scene: Scene
) -> tuple[CoordinatedDMP, Array]:
    """Fit the primitive to movements with every ridge.

    Parameters
    ----------
    target : array, shape (n_targets, N_STEPS, n_columns), in load coordinates, continuous
    goal : array, shape (n_columns,), where all end
    coordinates : those of the primitive

    Returns
    -------
    dmp : with the ends of the movements
    weights : array, shape (n_targets * n_ridges, n_columns, n_basis)
    """
    boundary = coordinates.boundary()
    if coordinates.kind == "load":
        boundary[2] = goal  # the same, but by the movements' number of turns
    else:
        target = coordinates.from_load(target, load_coordinates(scene))
    misses = target - basis.sampled(N_STEPS)[basis.n_basis :].T @ boundary
    weights = _ridge_solvers(basis)[None] @ misses[:, None]  # (n_targets, n_ridges, n_basis, n_columns)
    weights = np.ascontiguousarray(weights.reshape(-1, *weights.shape[2:]).transpose(0, 2, 1))
    return CoordinatedDMP(scene, coordinates, basis, boundary, weights[0]), weights


def bumps(basis: MotionBasis, rng: np.random.Generator, count: int) -> Array:
    """Weights of bumps of unit height, flat on top, at random times and of random widths.

    Returns
    -------
    array, shape (count, n_basis)
    """
    width = NARROWEST * (WIDEST / NARROWEST) ** rng.uniform(size=(count, 1))
    away = (np.linspace(0.0, 1.0, N_STEPS) - rng.uniform(size=(count, 1))) / width
    return np.exp(-0.5 * away**4) @ _ridge_solvers(basis)[0].T


@lru_cache(maxsize=8)
def _ridge_solvers(basis: MotionBasis) -> Array:
    """(Phi^T Phi + ridge I)^-1 Phi^T for every ridge; array, shape (n_ridges, n_basis, n_steps)."""
    left, singular, right = np.linalg.svd(basis.sampled(N_STEPS)[: basis.n_basis].T, full_matrices=False)
    size = singular[0] ** 2
    return np.stack([(right.T * (singular / (singular**2 + ridge * size))) @ left.T for ridge in RIDGES])

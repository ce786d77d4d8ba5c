"""Forcing functions: the psi of equation (2), evaluated at the knots."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from comove.primitives.phase import Phase

Array = NDArray[np.float64]

N_INTERVALS = 800
INTERVAL = 1.0 / N_INTERVALS
WIDTH = 0.55  # of a bell, in distances between centres: narrow enough to stay well conditioned

Kernels = Callable[[int, Phase], Array]


def gaussians(n_functions: int, phase: Phase) -> Array:
    """Compute normalised Gaussians of the phase times the phase (Ijspeert et al., 2013); the paper's equation (2).

    Centres lie evenly in time, from a little before the start to a little after the end.

    Returns
    -------
    array, shape (n_knots, n_functions)
    """
    x, away, spacing = _from_centres(n_functions, phase)
    log_psi = -0.5 * (away / (WIDTH * spacing)) ** 2
    psi = np.exp(log_psi - log_psi.max(axis=1, keepdims=True))
    return psi / psi.sum(axis=1, keepdims=True) * x[:, None]


def mollifiers(n_functions: int, phase: Phase) -> Array:
    """Compute normalised mollifiers ``exp(-1 / (1 - r^2))`` of the phase times the phase (Ginesi et al., 2021).

    They are smooth, and zero farther than 1.5 distances between centres from their own, so two or three of them share
    every instant, and a weight changes only its own part of the movement.

    Returns
    -------
    array, shape (n_knots, n_functions)
    """
    x, away, spacing = _from_centres(n_functions, phase)
    inside = np.maximum(1.0 - (away / (1.5 * spacing)) ** 2, 1e-9)
    log_psi = -1.0 / inside
    psi = np.exp(log_psi - log_psi.max(axis=1, keepdims=True))
    return psi / psi.sum(axis=1, keepdims=True) * x[:, None]


def von_mises(n_functions: int) -> Array:
    """Compute normalised periodic bell functions ``exp(h (cos(2 pi s - c) - 1))`` (Ijspeert et al., 2013).

    Returns
    -------
    array, shape (n_knots, n_functions); the last knot is the first one, a period later
    """
    angle = 2 * np.pi * np.linspace(0.0, 1.0, N_INTERVALS + 1)[:, None]
    centres = 2 * np.pi * np.arange(n_functions) / n_functions
    width = 2 * np.pi * WIDTH / n_functions
    psi = np.exp((np.cos(angle - centres) - 1.0) / width**2)
    return psi / psi.sum(axis=1, keepdims=True)


def _from_centres(n_functions: int, phase: Phase) -> tuple[Array, Array, Array]:
    """Return the phase at the knots, its distances from the centres, and the distances between centres.

    The centres reach a twenty-fifth of the duration beyond both ends, a spacing at most: recorded shapes fit best so.
    """
    x = phase(np.linspace(0.0, 1.0, N_INTERVALS + 1))
    overhang = min(0.04, 1.0 / n_functions)
    centres = phase(np.linspace(-overhang, 1.0 + overhang, n_functions))
    return x, x[:, None] - centres, np.gradient(centres)

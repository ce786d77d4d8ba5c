"""The terms of the paper's objective, equation (4), that follow from a verified motion alone, each with weight 1.

In unit duration and with T samples,

    goal = 1/T sum_t sum_i |y_i - g_i|^2,    velocity = (T-1)^2/T sum_t sum_i |y_i(t+1) - y_i(t)|^2.

The obstacle term counts the obstacles that the payload or a hand is in: none, where the clearance is certified.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion

WEIGHTS = {"goal": 1.0, "velocity": 0.01, "obstacle": 10.0, "resemblance": 0.0}
"""Usual weights of the terms."""
N_STEPS = 201


def unit_terms(motion: CoordinatedMotion) -> dict[str, float]:
    """Compute the terms of goal, velocity and obstacles of a verified motion."""
    return unit_terms_of(motion.hands(np.linspace(0.0, 1.0, N_STEPS))[0])


def unit_terms_of(position: NDArray[np.float64]) -> dict[str, float]:
    """Compute the terms of a movement without contact from its samples.

    Parameters
    ----------
    position : array, shape (n_steps, n_manipulators, n_dims), hands at even times [m]
    """
    n_steps, away, moved = len(position), position - position[-1], np.diff(position, axis=0)
    return {
        "goal": float((away**2).sum() / n_steps),
        "velocity": float((moved**2).sum() * (n_steps - 1) ** 2 / n_steps),
        "obstacle": 0.0,
    }

"""The precision of a distribution of movements at every instant, by which a motion is drawn to its mean.

Where people agree, a deviation costs much; where they vary, little; and hands that moved together may deviate
together. In unit duration the pull of `LeastJerk` becomes

    pull / L^2  integral (y - d)' W(s) (y - d) ds,    W(s) = v (C(s) + e v 1)^-1,

with C(s) the covariance of all hands at the instant s, transferred to the scene, v its mean variance over instants
and coordinates, and e the square of `LEAST_SPREAD`. A deviation in a direction in which people vary as much as on
average costs what it costs without a distribution.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.coordination.adaptation import covariance_of_hands
from comove.planning.objective import N_STEPS
from comove.primitives.probabilistic import ProMP
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

LEAST_SPREAD = (
    0.1  # of the mean standard deviation, added to all: so much is allowed where people agree entirely
)


def precision_root(promp: ProMP, scene: Scene) -> Array:
    """Return R with ``R' R = W`` at even instants; array, shape (N_STEPS, n_hands * n_dims, n_hands * n_dims)."""
    covariance = covariance_of_hands(promp, scene, np.linspace(0.0, 1.0, N_STEPS))
    width = covariance.shape[1]
    variance = float(np.trace(covariance, axis1=1, axis2=2).mean()) / width
    if not variance > 0:
        return np.repeat(np.eye(width)[None], N_STEPS, axis=0)
    covariance = covariance / variance + LEAST_SPREAD**2 * np.eye(width)
    values, vectors = np.linalg.eigh(covariance)
    return np.swapaxes(vectors / np.sqrt(values)[:, None, :], 1, 2)

"""Distance of a motion from a demonstration, weighted by its precision.

Where demonstrations agree, a deviation costs much; where they vary, little; and end effectors that moved together may
deviate together. In unit duration the weighted deviation of `LeastJerk` becomes

    pull / L^2  integral (y - d)' W(s) (y - d) ds,    W(s) = v (C(s) + e v 1)^-1,

with C(s) the covariance of all end effectors at the instant s, transferred to the scene, v its mean variance over
instants and coordinates, and e the square of `least_spread`. A deviation in a direction in which demonstrations vary
as much as on average costs what it costs without a distribution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.dmp.probabilistic import ProMP
from comove.model.adaptation import covariance_of_hands
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene
from comove.planning.objective import N_STEPS


def precision_root(promp: ProMP, scene: Scene, least_spread: float = 0.1) -> Array:
    """Return R with ``R' R = W`` at even instants; array, shape (N_STEPS, n_hands * n_dims, n_hands * n_dims).

    Parameters
    ----------
    least_spread : share of the mean standard deviation that is added to all: so much is allowed where people agree
        entirely
    """
    covariance = covariance_of_hands(promp, scene, np.linspace(0.0, 1.0, N_STEPS))
    width = covariance.shape[1]
    variance = float(np.trace(covariance, axis1=1, axis2=2).mean()) / width
    if not variance > 0:
        return np.repeat(np.eye(width)[None], N_STEPS, axis=0)
    covariance = covariance / variance + least_spread**2 * np.eye(width)
    values, vectors = np.linalg.eigh(covariance)
    return np.swapaxes(vectors / np.sqrt(values)[:, None, :], 1, 2)


@dataclass(frozen=True)
class Followed:
    """Mean distances of the end effectors from the demonstration, over samples.

    Attributes
    ----------
    distance : distance from the demonstration at the same instant [m]
    direction : angle between the directions of travel, at instants at which both move [rad]
    share : `distance` as a share of the straight path from start to goal
    weighted : root mean square distance, weighted by the precision of a demonstrated distribution: more where people
        agree, less where they vary [m]; None without a distribution
    """

    distance: float
    direction: float
    share: float
    weighted: float | None = None


def followed(
    motion: CoordinatedMotion, demonstration: Array, precision: Array | None = None, still: float = 0.05
) -> Followed:
    """Measure the distance of a motion from a demonstration.

    Parameters
    ----------
    demonstration : array, shape (n_steps, n_manipulators, 3), transferred to every end effector, at even times [m]
    precision : array, shape (n_steps, n_hands * n_dims, n_hands * n_dims), of `precision_root`; None for none
    still : share of the largest speed below which the direction of travel is ignored
    """
    scene, s = motion.scene, np.linspace(0.0, 1.0, len(demonstration))
    hands, velocity, _ = motion.hands(s)
    taught = demonstration[..., : hands.shape[2]]
    heading = np.gradient(taught, s, axis=0)
    speed, pace = np.linalg.norm(velocity, axis=2), np.linalg.norm(heading, axis=2)
    both = (speed > still * speed.max()) & (pace > still * pace.max())
    cosine = (velocity * heading).sum(axis=2)[both] / (speed * pace)[both]
    distance = float(np.linalg.norm(hands - taught, axis=2).mean())
    weighted = None
    if precision is not None:
        away = precision @ (hands - taught).reshape(len(s), -1, 1)
        weighted = float(np.sqrt((away**2).sum(axis=1).mean() / hands.shape[1]))
    way = float(np.linalg.norm(scene.goal - scene.start, axis=1).mean())
    return Followed(
        distance,
        float(np.arccos(np.clip(cosine, -1.0, 1.0)).mean()) if both.any() else 0.0,
        distance / way if way > 0 else 0.0,
        weighted,
    )

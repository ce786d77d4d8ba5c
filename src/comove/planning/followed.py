"""Measures of the distance between a motion and its demonstration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion

Array = NDArray[np.float64]

STILL = 0.05  # share of the largest speed below which the direction of travel is ignored


@dataclass(frozen=True)
class Followed:
    """Mean distances of the hands from the demonstration, over samples and hands.

    Attributes
    ----------
    distance : distance from the demonstration at the same instant [m]
    direction : angle between the directions of travel, at instants at which both move [rad]
    share : `distance` as a share of the straight way from start to goal
    weighted : root mean square distance, weighted by the precision of a demonstrated distribution: more where people
        agree, less where they vary [m]; None without a distribution
    """

    distance: float
    direction: float
    share: float
    weighted: float | None = None


def followed(motion: CoordinatedMotion, demonstration: Array, precision: Array | None = None) -> Followed:
    """Measure the distance of a motion from a demonstration.

    Parameters
    ----------
    demonstration : array, shape (n_steps, n_manipulators, 3), transferred to every hand, at even times [m]
    precision : array, shape (n_steps, n_hands * n_dims, n_hands * n_dims), of `planning.precision`; None for none
    """
    scene, s = motion.scene, np.linspace(0.0, 1.0, len(demonstration))
    hands, velocity, _ = motion.hands(s)
    taught = demonstration[..., : hands.shape[2]]
    heading = np.gradient(taught, s, axis=0)
    speed, pace = np.linalg.norm(velocity, axis=2), np.linalg.norm(heading, axis=2)
    both = (speed > STILL * speed.max()) & (pace > STILL * pace.max())
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

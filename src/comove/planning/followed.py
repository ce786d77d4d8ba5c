"""How near a motion is to what was taught."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion

Array = NDArray[np.float64]

STILL = 0.05  # of the largest speed, below which a direction of travel says nothing


@dataclass(frozen=True)
class Followed:
    """How near the hands are to the demonstration, sampled and in the mean over time and hands.

    Attributes
    ----------
    distance : from where the demonstration is at the same instant [m]
    direction : angle between the directions of travel, at instants at which both move [rad]
    share : the distance, as a share of the straight way from start to goal
    """

    distance: float
    direction: float
    share: float


def followed(motion: CoordinatedMotion, demonstration: Array) -> Followed:
    """Measure how near a motion is to a demonstration.

    Parameters
    ----------
    demonstration : array, shape (n_steps, n_manipulators, 3), carried to every hand, at even times [m]
    """
    scene, s = motion.scene, np.linspace(0.0, 1.0, len(demonstration))
    hands, velocity, _ = motion.hands(s)
    taught = demonstration[..., : hands.shape[2]]
    heading = np.gradient(taught, s, axis=0)
    speed, pace = np.linalg.norm(velocity, axis=2), np.linalg.norm(heading, axis=2)
    both = (speed > STILL * speed.max()) & (pace > STILL * pace.max())
    cosine = (velocity * heading).sum(axis=2)[both] / (speed * pace)[both]
    distance = float(np.linalg.norm(hands - taught, axis=2).mean())
    way = float(np.linalg.norm(scene.goal - scene.start, axis=1).mean())
    return Followed(
        distance,
        float(np.arccos(np.clip(cosine, -1.0, 1.0)).mean()) if both.any() else 0.0,
        distance / way if way > 0 else 0.0,
    )

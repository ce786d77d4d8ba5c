"""Poses possibly within arms' reach, by distances of wrists from shoulders.

The *shoulder* is the last of an arm's joints that no joint moves; the *wrist* the first one that is fixed in the end
effector's frame. So an end effector's pose alone determines their distance. Between the least and the largest
distance not every pose is reached; outside none is. Both distances are found by random joints, ever closer to the
best, and taken a little wider.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.compiled import kernel
from comove.robots.search.chains import Chains, place_arm

STILL = 1e-9  # m, that a point which stays where it is may move by


class WristRanges(NamedTuple):
    """The possible distances of wrists from shoulders, for each arm.

    Attributes
    ----------
    shoulder : array, shape (n_arms, 3), in the scene [m]
    wrist : array, shape (n_arms, 3), in the frame of the end effector [m]
    least, most : arrays, shape (n_arms,), distances [m]
    """

    shoulder: Array
    wrist: Array
    least: Array
    most: Array


def ranges_of(chains: Chains, *, n_samples: int = 200, n_rounds: int = 8, edge: float = 0.01) -> WristRanges:
    """Return the ranges of arms, from random joints within their limits.

    Parameters
    ----------
    n_samples : random joints a round
    n_rounds : rounds about the best joints so far, each half as far from them as the one before
    edge : by which ranges are wider than those found [m]
    """
    rng, span = np.random.default_rng(0), chains.upper - chains.lower
    samples = rng.uniform(chains.lower, chains.upper, (n_samples, len(span)))
    steps = span * rng.standard_normal((n_rounds, n_samples, len(span)))
    steps *= 0.5 ** np.arange(2, n_rounds + 2)[:, None, None]
    found = []
    for arm in range(len(chains.first) - 1):
        points, hands = _placed(chains, arm, samples)
        seen = np.einsum("sba,skb->ska", hands, points - points[:, -1:])
        shoulder, wrist = np.flatnonzero(_still(points))[-1], np.flatnonzero(_still(seen))[0]
        least, most = (_extreme(chains, arm, shoulder, wrist, sign, samples, steps) for sign in (1.0, -1.0))
        found.append((points[0, shoulder], seen[0, wrist], least - edge, most + edge))
    return WristRanges(*(np.array(part) for part in zip(*found, strict=True)))


def _still(points: Array) -> NDArray[np.bool_]:
    """Return which points are fixed; arrays, shapes (n_samples, n_points, 3) and (n_points,)."""
    return np.ptp(points, axis=0).max(axis=-1) < STILL


def _extreme(
    chains: Chains, arm: int, shoulder: int, wrist: int, sign: float, samples: Array, steps: Array
) -> float:
    """Return the least (sign 1) or largest (-1) distance found. Every round samples near the best."""
    best, least = samples[0], np.inf
    for step in (None, *steps):
        if step is not None:
            samples = np.clip(best + step, chains.lower, chains.upper)
        points, _ = _placed(chains, arm, samples)
        values = sign * np.linalg.norm(points[:, wrist] - points[:, shoulder], axis=1)
        if values.min() < least:
            best, least = samples[values.argmin()], float(values.min())
    return sign * least


@kernel
def _placed(chains: Chains, arm: int, samples: Array) -> tuple[Array, Array]:
    """Compute an arm's base, joint origins, end effector, and its orientation.

    Arrays, shapes (n_samples, n_joints + 2, 3) and (n_samples, 3, 3).
    """
    first, n = chains.first[arm], chains.first[arm + 1] - chains.first[arm]
    points, hands = np.empty((samples.shape[0], n + 2, 3)), np.empty((samples.shape[0], 3, 3))
    rotations = np.empty((n + 1, 3, 3))
    for s in range(samples.shape[0]):
        place_arm(chains, arm, samples[s], rotations, points[s, 1:])
        for a in range(3):
            points[s, 0, a] = chains.offset[first, a]  # a first joint that slides moves its frame
            for b in range(3):
                hands[s, a, b] = rotations[n, a, b]
    return points, hands


@kernel
def may_reach(ranges: WristRanges, arm: int, rotation: Array, point: Array) -> bool:
    """Return whether an end effector's pose is within its arm's range. Its arrays have the shapes (3, 3) and (3,)."""
    square = 0.0
    for a in range(3):
        away = point[a] - ranges.shoulder[arm, a]
        for b in range(3):
            away += rotation[a, b] * ranges.wrist[arm, b]
        square += away * away
    least = max(ranges.least[arm], 0.0)
    return least * least <= square <= ranges.most[arm] * ranges.most[arm]

"""The way back of a robot that was driven off: its hands turn the load, as they hold it, until plans know the pose.

What drives arms off tilts the load and the hands with it, and plans know only poses in which hands turn as the grasp
says. The nearest of these is gone to: load and hands turn as one body about their middle.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from comove.geometry.rotations import exponential, logarithm, matrices, quaternion_of_rotation
from comove.planning.seeds import minimum_jerk
from comove.robots.search.chains import Iteration, reach_pose
from comove.robots.search.following import Arms

Array = NDArray[np.float64]

PACE = 0.3  # of the joints' speeds and accelerations
TURN, SHIFT = 0.02, 0.01  # rad and m, of a step at most
REACHING = Iteration(gain=0.0, keep=0.0, tolerance=1e-8, steady=np.inf, most=30)


def way_back(arms: Arms, joints: Array, held: Array, wanted: Array) -> Array | None:
    """Return joints by which hands turn a load to a pose; array, shape (n_steps, n_joints), None where arms cannot.

    Parameters
    ----------
    joints : array, shape (n_joints,), where the arms stand
    held, wanted : arrays, shape (n_arms, 4, 4), poses of the hands there, and those they are to have
    """
    turns = np.array(
        [
            logarithm(quaternion_of_rotation(b[:3, :3] @ a[:3, :3].T))
            for a, b in zip(held, wanted, strict=True)
        ]
    )
    place, target = held[:, :3, 3], wanted[:, :3, 3]
    middle, shift = place.mean(axis=0), target.mean(axis=0) - place.mean(axis=0)
    apart = (
        target - middle - shift - _turned(turns, place - middle)
    )  # how hands come to lie otherwise on the load
    count = max(
        np.linalg.norm(turns, axis=1).max() / TURN, np.linalg.norm(target - place, axis=1).max() / SHIFT
    )
    way = [joints]
    for share in np.linspace(0.0, 1.0, 2 + int(count))[1:]:
        q = way[-1].copy()
        places = middle + share * (shift + apart) + _turned(share * turns, place - middle)
        rotations = matrices(exponential(share * turns)) @ held[:, :3, :3]
        for i in range(len(held)):
            if reach_pose(arms.chains, i, rotations[i], places[i], q, REACHING, q) > REACHING.tolerance:
                return None
        way.append(q)
    return np.array(way)


def at_ease(arms: Arms, way: Array, period: float) -> Array:
    """Return a way from rest to rest at a gentle pace, one sample a period [s]; arrays, shape (n_steps, n_joints)."""
    chains = arms.chains
    seconds = np.append(0.0, np.cumsum((np.abs(np.diff(way, axis=0)) / (PACE * chains.velocity)).max(axis=1)))
    # 1.875 and 5.774 are the greatest speed and acceleration of a minimum-jerk motion by 1 in a time of 1.
    least = 1.875 * seconds[-1], np.sqrt(5.774 * seconds[-1] * (chains.velocity / chains.acceleration).max())
    count = 1 + int(np.ceil(max(least) / period))
    at = seconds[-1] * minimum_jerk(np.linspace(0.0, 1.0, count + 1))[1:]
    return np.stack([np.interp(at, seconds, q) for q in way.T], axis=1)


def _turned(turns: Array, points: Array) -> Array:
    """Return points turned about the origin, each by a rotation vector; arrays, shape (n, 3)."""
    return (matrices(exponential(turns)) @ points[:, :, None])[:, :, 0]

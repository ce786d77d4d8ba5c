"""Recovery of a displaced robot: compliant until it rests, then back.

External forces tilt the payload and the end effectors as well, and plans contain only poses in which end effectors
turn as the grasp determines. The nearest of these is the goal: both turn as one body about their middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array
from comove.dmp.arguments import require_positive
from comove.geometry.rotations import exponential, logarithm, matrices, quaternion_of_rotation
from comove.planning.seeds import minimum_jerk
from comove.robots.motion import approach_shares
from comove.robots.search.chains import Iteration, reach_pose
from comove.robots.search.following import Arms
from comove.trajectory import interpolated

SLOWEST = (
    100.0  # times as long, at most, as joints far from their soft limits: arms may have been driven onto them
)

REACHING = Iteration(gain=0.0, keep=0.0, tolerance=1e-8, steady=np.inf, most=30)


@dataclass(frozen=True)
class RecoverySettings:
    """Settings of the recovery of a displaced robot.

    Attributes
    ----------
    gives : difference of measured and commanded joints up to which arms resist external forces [rad]
    still, rests : they rest once no joint has moved by more than this for this time [rad, s]
    longest : time after which a robot that does not come to rest raises an error [s]
    turn, shift : of the payload, from one step of the way back to the next at most [rad, m]
    pace : share of the joints' speeds and accelerations on that way
    """

    gives: float = 0.03
    still: float = 0.01
    rests: float = 0.3
    longest: float = 20.0
    turn: float = 0.02
    shift: float = 0.01
    pace: float = 0.3

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require_positive(name, value)


class Recovery:
    """A displaced robot, step by step.

    Parameters
    ----------
    began : time of its displacement [s]
    measured : array, shape (n_joints,), its arms' joints then [rad]

    Attributes
    ----------
    way : remaining commands of the way back, array, shape (n_steps, n_joints) [rad]
    ended : whether it has returned
    """

    def __init__(self, began: float, measured: Array, settings: RecoverySettings):
        self.settings, self.began = settings, began
        self._place, self._since = measured, began
        self.way, self.ended = measured[None][:0], False

    def stands(self, measured: Array, time: float) -> bool:
        """Return whether the arms have rested for long enough. It must be called at every step."""
        if np.abs(measured - self._place).max() > self.settings.still:
            self._place, self._since = measured.copy(), time
        return time - self._since >= self.settings.rests

    def command(self, before: Array, measured: Array, lost: float) -> Array:
        """Return the next command: of the way back, or a compliant one. The way back requires arms that follow.

        Parameters
        ----------
        before, measured : arrays, shape (n_joints,), the last command, and the arms' joints [rad]
        lost : difference of both at which arms do not follow [rad]
        """
        if len(self.way) and np.abs(measured - before).max() <= lost:
            command, self.way = self.way[0], self.way[1:]
            self.ended = not len(self.way)
            return command
        self.way = self.way[:0]
        return measured + np.clip(before - measured, -self.settings.gives, self.settings.gives)


def way_back(
    arms: Arms, joints: Array, held: Array, wanted: Array, settings: RecoverySettings = RecoverySettings()
) -> Array | None:
    """Return joints that turn a payload to a pose; array, shape (n_steps, n_joints), or None.

    Parameters
    ----------
    joints : array, shape (n_joints,), the arms' present joints
    held, wanted : arrays, shape (n_arms, 4, 4), present and desired poses of the end effectors
    """
    turns = np.array([_turn(*ends) for ends in zip(held, wanted, strict=True)])
    place, target = held[:, :3, 3], wanted[:, :3, 3]
    middle, shift = place.mean(axis=0), target.mean(axis=0) - place.mean(axis=0)
    slid = target - middle - shift - _turned(turns, place - middle)  # of hands on the load
    turned, shifted = (np.linalg.norm(vectors, axis=1).max() for vectors in (turns, target - place))
    count = 2 + int(max(turned / settings.turn, shifted / settings.shift))
    way = [joints]
    for share in np.linspace(0.0, 1.0, count)[1:]:
        q = way[-1].copy()
        places = middle + share * (shift + slid) + _turned(share * turns, place - middle)
        rotations = matrices(exponential(share * turns)) @ held[:, :3, :3]
        for i in range(len(held)):
            if reach_pose(arms.chains, i, rotations[i], places[i], q, REACHING, q) > REACHING.tolerance:
                return None
        way.append(q)
    return np.array(way)


def at_ease(arms: Arms, way: Array, period: float, settings: RecoverySettings = RecoverySettings()) -> Array:
    """Return a path timed from rest to rest, sampled by `period` [s]; arrays, shape (n_steps, n_joints)."""
    chains = arms.chains
    steps = np.diff(way, axis=0)
    shares = approach_shares(way[1:], steps, chains.approach, chains.lower, chains.upper)
    rates = np.abs(steps) / chains.velocity
    spent = np.maximum(rates, np.minimum(shares, SLOWEST * rates)) / settings.pace
    seconds = np.append(0.0, np.cumsum(spent.max(axis=1)))
    # 1.875 and 5.774 are the greatest speed and acceleration of a minimum-jerk motion by 1 in a time of 1.
    least = 1.875 * seconds[-1], np.sqrt(5.774 * seconds[-1] * (chains.velocity / chains.acceleration).max())
    count = 1 + int(np.ceil(max(least) / period))
    at = seconds[-1] * minimum_jerk(np.linspace(0.0, 1.0, count + 1))[1:]
    return interpolated(at, seconds, way)


def _turn(here: Array, there: Array) -> Array:
    return logarithm(quaternion_of_rotation(there[:3, :3] @ here[:3, :3].T))


def _turned(turns: Array, points: Array) -> Array:
    """Return points turned by rotation vectors; arrays, shape (n, 3)."""
    return (matrices(exponential(turns)) @ points[:, :, None])[:, :, 0]

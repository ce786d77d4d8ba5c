"""Motion of hands and load for the judge of joints: positions, rotations, and bounds of their derivatives.

All of it comes from the verified curve and from the bounds by which it was verified.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion
from comove.primitives.forcing import N_INTERVALS
from comove.robots.extremes import Ranges
from comove.verification.bounds import NodeBounds, node_bounds

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Carried:
    """A verified motion of hands and load in space, by time [s].

    Attributes
    ----------
    motion : CoordinatedMotion on a spatial scene
    """

    motion: CoordinatedMotion

    @cached_property
    def time(self) -> Array:
        """Return the times of the knots, between which the bounds hold; array, shape (n_knots,) [s]."""
        return np.linspace(0.0, self.motion.scene.duration, N_INTERVALS + 1)

    def nodes(self, time: Array) -> Array:
        """Compute the positions of the hands and of the load's corners; array, shape (n_steps, n_nodes, 3) [m]."""
        return self.motion.coordinates.motion(self.motion.at(time / self.motion.scene.duration))[0]

    def hands(self, time: Array) -> tuple[Array, Array]:
        """Compute positions [m] and velocities [m/s] of the hands; arrays, shape (n_steps, n_manipulators, 3)."""
        duration = self.motion.scene.duration
        position, velocity, _ = self.motion.hands(time / duration)
        return position, velocity / duration

    def rotations(self, time: Array) -> tuple[Array, Array] | None:
        """Compute orientations and angular velocities of the hands' grasp frames; None where the scene has no grasp.

        Returns
        -------
        rotations : array, shape (n_steps, n_manipulators, 3, 3)
        velocities : array, shape (n_steps, n_manipulators, 3) [rad/s]
        """
        grasp = self.motion.scene.grasp
        if grasp is None:
            return None
        position, velocity = self.hands(time)
        spin = np.zeros_like(position)
        if len(grasp.holders) > 1:
            along, change = (
                x[:, grasp.holders[0], :2] - x[:, grasp.holders[1], :2] for x in (position, velocity)
            )
            turn = (along[:, 0] * change[:, 1] - along[:, 1] * change[:, 0]) / (along**2).sum(axis=1)
            spin[:, grasp.turning, 2] = turn[:, None]
        return grasp.hand_rotations(position), spin

    @cached_property
    def speed(self) -> Ranges:
        """Return upper bounds of the speed of every node [m/s]."""
        speed = self._speeds / self.motion.scene.duration
        return Ranges(self.time, speed)

    @cached_property
    def jerk(self) -> Ranges:
        """Return upper bounds of the third derivative of every hand's position [m/s^3]."""
        n_hands = len(self.motion.scene.manipulators)
        return Ranges(self.time, self._bounds.jerk[:, :n_hands] / self.motion.scene.duration**3)

    @cached_property
    def swing(self) -> Ranges:
        """Return upper bounds of the third derivative of the heading [rad/s^3]; array of width 1.

        The unit vector u along a planar vector r has ``|u'''| <= a3 + 2 sqrt(3) a1 a2 + 3 a1^3``, a_i the bounds of
        the derivatives of r over the least |r| (see `comove.verification.bounds`), and its angle has
        ``|psi'''| <= |u'''| + |u'|^3``.
        """
        scene, time = self.motion.scene, self.time
        if scene.grasp is None or len(scene.grasp.holders) < 2:
            return Ranges(time, np.zeros((N_INTERVALS, 1)))
        pair = list(scene.grasp.holders[:2])
        hands = self.nodes(time)[:, pair, :2]
        apart = np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1)
        change = self._speeds[:, pair].sum(axis=1)
        least = np.minimum(apart[1:], apart[:-1]) - 0.5 / N_INTERVALS * change
        sums = change, *(bound[:, pair].sum(axis=1) for bound in self._bounds)
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second, third = (np.where(least > 0, x / least, np.inf) for x in sums)
        bound = third + 2 * np.sqrt(3.0) * first * second + 4 * first**3
        return Ranges(time, bound[:, None] / scene.duration**3)

    @cached_property
    def _bounds(self) -> NodeBounds:
        return node_bounds(self.motion)

    @cached_property
    def _speeds(self) -> Array:
        """Return upper bounds of the speed of every node between two knots, in unit duration; (n_intervals,
        n_nodes).
        """
        speed = np.linalg.norm(self.motion.coordinates.motion(self.motion.knots)[1], axis=2)
        return np.maximum(speed[1:], speed[:-1]) + 0.5 / N_INTERVALS * self._bounds.acceleration

"""Upright bodies, as distances and derivatives for the quadratic programmes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.model.blocks import Blocks, lean
from comove.model.coordinates import Coordinates
from comove.planning.convex.contacts import spins

ROUGH = 1e-5
"""Distance by which an end may be nearer to its limit than the motion between [m]."""
SOON = 0.05
"""Distance from the limit up to which it counts how a body leans [m]."""


@dataclass(frozen=True, eq=False)
class Leaning:
    """The bodies whose directions `up` must stay near the vertical.

    Their distance from leaning too far is the angle that is left, times the body's reach.

    Attributes
    ----------
    all : blocks of the coordinates
    blocks : numbers of those that must not lean
    reach : array, shape (n,), their reach [m]
    at_ends : array, shape (n,), least distances at start and goal [m]
    """

    all: Blocks
    blocks: Integers
    reach: Array
    at_ends: Array

    @classmethod
    def of(cls, coordinates: Coordinates, boundary: Array) -> Leaning:
        """Return those of a scene, for motions with given ends."""
        blocks = np.flatnonzero(coordinates.blocks.tilt < np.pi)
        reach = np.array([coordinates.groups[b].reach for b in blocks])
        found = cls(coordinates.blocks, blocks, reach, np.zeros(len(blocks)))
        return cls(coordinates.blocks, blocks, reach, found.spare(boundary[[0, 2]]).min(axis=0))

    def required(self, margin: float) -> Array:
        """Return the required distances, less where the ends have less; array, shape (n,) [m]."""
        return np.minimum(margin, self.at_ends - ROUGH)

    def spare(self, q: Array) -> Array:
        """Return the distances in configurations (n_samples, n_columns); array, shape (n_samples, n) [m]."""
        return self.linear(q)[0] if len(self.blocks) else np.zeros((len(q), 0))

    def linear(self, q: Array) -> tuple[Array, Array]:
        """Return these distances and their derivatives by q. Derivatives are 0 where nothing is near.

        Arrays, shapes (n_samples, n) [m] and (n_samples, n, n_columns).
        """
        return _leaned(self.all, self.blocks, self.reach, np.ascontiguousarray(q))


@kernel
def _leaned(blocks: Blocks, which: Integers, reach: Array, q: Array) -> tuple[Array, Array]:
    n_samples, n_columns = q.shape
    spare, slopes = np.empty((n_samples, len(which))), np.zeros((n_samples, len(which), n_columns))
    up, turns = np.empty(3), np.empty((4, 3))
    for s in range(n_samples):
        for i in range(len(which)):
            b = which[i]
            spare[s, i] = reach[i] * (blocks.tilt[b] - lean(blocks, b, q[s], up))
            sine = np.hypot(up[0], up[1])
            if spare[s, i] > SOON or sine < 1e-6:
                continue
            width = spins(blocks, b, q[s], turns)
            for k in range(width):  # d angle = -d cos / sin
                rise = turns[k, 0] * up[1] - turns[k, 1] * up[0]
                slopes[s, i, blocks.turn[b] + k] = reach[i] * rise / sine
    return spare, slopes

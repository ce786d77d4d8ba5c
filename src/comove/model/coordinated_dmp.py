"""The primitive of several manipulators, which generates coordinated movements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from comove.arrays import Array
from comove.brief import brief
from comove.dmp.basis import MotionBasis, rollouts
from comove.dmp.dmp import DMP
from comove.model.adaptation import carried_to_hands
from comove.model.coordinates import ANGLE, QUATERNION, Coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene


@dataclass(frozen=True, eq=False)
class CoordinatedDMP:
    """A primitive of several manipulators on one canonical system. The paper calls it a joint DMP.

    Attributes
    ----------
    scene, coordinates, basis, boundary : as in `CoordinatedMotion`
    weights : array, shape (n_columns, n_basis), shape weights of the demonstration
    """

    __repr__ = brief

    scene: Scene
    coordinates: Coordinates
    basis: MotionBasis
    boundary: Array
    weights: Array

    @classmethod
    def from_demonstration(
        cls, dmp: DMP | Sequence[DMP], scene: Scene, coordinates: Coordinates, basis: MotionBasis
    ) -> CoordinatedDMP:
        """Build the primitive from a movement, adapted to every manipulator.

        The adaptation is that of the paper, III-B.

        Parameters
        ----------
        dmp
            The demonstrated movement, of the scene's dimension; or one for each manipulator.
        """
        hands = carried_to_hands(dmp, scene)
        s = np.linspace(0.0, 1.0, len(hands))
        return cls(scene, coordinates, basis, coordinates.boundary(), np.zeros(0)).fitted(
            s, coordinates.from_hands(hands)
        )

    def fitted(self, s: Array, q: Array) -> CoordinatedDMP:
        """Return the primitive whose rollout is nearest to given configurations.

        Parameters
        ----------
        s : array, shape (n_steps,), normalised times
        q : array, shape (n_steps, n_columns); whole turns by which it differs at the goal are kept
        """
        boundary = self.boundary.copy()
        for kind, columns, *_ in self.coordinates.parts:
            turn = np.arange(len(boundary[0]))[columns][self.coordinates.n_dims :]
            if kind == ANGLE:
                way, own = q[-1, turn] - q[0, turn], boundary[2, turn] - boundary[0, turn]
                boundary[2, turn] += 2 * np.pi * np.round((way - own) / (2 * np.pi))
                q = q.copy()
                q[:, turn] += boundary[0, turn] - q[0, turn]
            elif kind == QUATERNION:
                q = q.copy()
                q[:, turn] *= np.sign(q[0, turn] @ boundary[0, turn]) or 1.0
                boundary[2, turn] *= np.sign(q[-1, turn] @ boundary[2, turn]) or 1.0
        of_boundary, of_shape = self.basis.at(s)
        weights = np.linalg.lstsq(of_shape[0], q - of_boundary[0] @ boundary, rcond=None)[0].T
        return replace(self, boundary=boundary, weights=weights)

    def rollout(self, weights: Array | None = None) -> CoordinatedMotion:
        """Return the movement with given shape weights, or its own. `weights` has shape (n_columns, n_basis)."""
        weights = self.weights if weights is None else np.asarray(weights, dtype=float)
        return CoordinatedMotion(self.scene, self.coordinates, self.basis, self.boundary, weights)

    def rollouts(self, weights: Array, n_steps: int = 201) -> Array:
        """Return the configurations of a population by one matrix product.

        Parameters
        ----------
        weights : array, shape (n_rollouts, n_columns, n_basis)

        Returns
        -------
        array, shape (n_rollouts, n_columns, n_steps)
        """
        return rollouts(self.basis, self.boundary, weights, n_steps)

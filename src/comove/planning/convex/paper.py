"""Equation (4) of the paper as a sum of squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.planning.objectives.paper import PaperCost

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class PaperSquares:
    """J of the hands, without its term of obstacles, which are constraints here.

    Attributes
    ----------
    weights : weights of the terms
    goal : array, shape (n_hands * n_dims,), goal of the hands [m]
    demonstration : array, shape (n_samples, n_hands * n_dims) [m], if resemblance to it counts; else None
    haste : 0, as J does not depend on the duration (see `programme.QuadraticCost`)
    """

    weights: PaperCost
    goal: Array
    demonstration: Array | None = None
    haste: float = 0.0

    def residuals(self, hands: Array) -> Array:
        """Return the residuals of hands at even samples, array of shape (n_samples, n_hands * n_dims)."""
        goal, velocity, resemblance = self._roots(len(hands))
        parts = [goal * (hands - self.goal), velocity * np.diff(hands, axis=0)]
        if self.demonstration is not None:
            parts.append(resemblance * (hands - self.demonstration))
        return np.concatenate([part.ravel() for part in parts])

    def slopes(self, moves: Array) -> Array:
        """Return the derivatives of the residuals by n variables.

        Parameters
        ----------
        moves : array, shape (n_samples, n_hands * n_dims, n), derivatives of the hands by the variables
        """
        goal, velocity, resemblance = self._roots(len(moves))
        parts = [goal * moves, velocity * np.diff(moves, axis=0)]
        if self.demonstration is not None:
            parts.append(resemblance * moves)
        return np.concatenate([part.reshape(-1, moves.shape[2]) for part in parts])

    def _roots(self, n: int) -> tuple[float, float, float]:
        w = self.weights
        return np.sqrt(w.goal / n), np.sqrt(w.velocity / n) * (n - 1), np.sqrt(w.resemblance / n)

"""The cost of least jerk, with and without a demonstration, as a sum of squares."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.coordination.motion import CoordinatedMotion
from comove.planning.objectives.least_jerk import LeastJerk
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_SAMPLES = 101


@dataclass(frozen=True, eq=False)
class JerkCost:
    """Squared jerk of all hands, integrated over unit duration, over that of the straight motions of least jerk.

    With a demonstration, of the departure from it; and `pull` times the mean square of the departure, over the
    square of the way from start to goal.

    Attributes
    ----------
    way : root of the summed squared ways of all hands from start to goal [m]
    demonstration : array, shape (n_samples, n_hands * n_dims) [m], None without one
    pull : how strongly hands are drawn to it
    weight : of all of that
    haste : what each duration costs that the limits ask for (see `programme.Cost`)
    """

    way: float
    demonstration: Array | None = None
    pull: float = 0.0
    weight: float = 1.0
    haste: float = 0.0

    def residuals(self, hands: Array) -> Array:
        """What is squared and summed, of hands at even samples, array of shape (n_samples, n_hands * n_dims)."""
        scale, jerk = self._scale(len(hands)), third_differences(hands)
        if self.demonstration is None:
            return scale * jerk.ravel()
        taught = third_differences(self.demonstration)
        taught[:2] = taught[-2:] = 0.0  # it need not rest at its ends
        away = self._pull(len(hands)) * (hands - self.demonstration)
        return np.concatenate([scale * (jerk - taught).ravel(), away.ravel()])

    def slopes(self, moves: Array) -> Array:
        """How the residuals change, of how hands change with n variables, array (n_samples, n_hands * n_dims, n)."""
        n_samples, _, n = moves.shape
        rows = self._scale(n_samples) * third_differences(moves).reshape(-1, n)
        if self.demonstration is None:
            return rows
        return np.concatenate([rows, self._pull(n_samples) * moves.reshape(-1, n)])

    def _scale(self, n_samples: int) -> float:
        return np.sqrt(self.weight / (720.0 * self.way**2 * (n_samples - 1)))

    def _pull(self, n_samples: int) -> float:
        return np.sqrt(self.weight * self.pull / (n_samples * self.way**2))


@dataclass(frozen=True, eq=False)
class Anchored:
    """A cost, and a pull of all hands to where they were planned to be.

    Attributes
    ----------
    cost : the cost
    anchor : array, shape (n_samples, n_hands * n_dims), where hands are drawn to [m]
    pull : how strongly, as of `JerkCost`
    """

    cost: JerkCost
    anchor: Array
    pull: float

    @property
    def haste(self) -> float:
        """That of the cost."""
        return self.cost.haste

    def residuals(self, hands: Array) -> Array:
        """As of `JerkCost`."""
        return np.concatenate([self.cost.residuals(hands), self._weight() * (hands - self.anchor).ravel()])

    def slopes(self, moves: Array) -> Array:
        """As of `JerkCost`."""
        return np.concatenate([self.cost.slopes(moves), self._weight() * moves.reshape(-1, moves.shape[2])])

    def _weight(self) -> float:
        return np.sqrt(self.pull / (len(self.anchor) * self.cost.way**2))


def squares(
    scene: Scene, objective: LeastJerk, demonstration: Array | None, n_samples: int = N_SAMPLES
) -> JerkCost:
    """The objective as a sum of squares at even samples.

    Parameters
    ----------
    demonstration : array, shape (n_steps, n_manipulators, 3), what was taught transferred to every hand [m], where
        n_steps - 1 is a multiple of n_samples - 1; None without one
    """
    way, pull = float(np.linalg.norm(scene.goal - scene.start)), objective.pull(demonstration is not None)
    if pull == 0:
        return JerkCost(max(way, 1e-6))
    step = (len(demonstration) - 1) // (n_samples - 1)
    return JerkCost(max(way, 1e-6), demonstration[::step, :, : scene.n_dims].reshape(n_samples, -1), pull)


def jerk_cost(motion: CoordinatedMotion, objective: LeastJerk, demonstration: Array | None) -> float:
    """The value of the objective for a motion; `demonstration` as in `squares`."""
    hands = motion.hands(np.linspace(0.0, 1.0, N_SAMPLES))[0].reshape(N_SAMPLES, -1)
    residuals = squares(motion.scene, objective, demonstration).residuals(hands)
    return float(residuals @ residuals)


def third_differences(y: Array) -> Array:
    """Third derivatives between even samples of what has no acceleration at either end, in unit duration.

    Parameters
    ----------
    y : array, shape (n_samples, ...)

    Returns
    -------
    array, shape (n_samples - 1, ...)
    """
    rate = len(y) - 1
    second = np.zeros_like(y)
    second[1:-1] = y[2:] - 2 * y[1:-1] + y[:-2]
    return np.diff(second, axis=0) * rate**3

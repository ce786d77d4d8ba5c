"""The costs of motions as sums of squares: least jerk, near to a demonstration or without, and equation (4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from comove.arrays import Array
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene

N_SAMPLES = 101


class Pulling(Protocol):
    """An objective that says how much a deviation from a demonstration counts (`LeastJerk`)."""

    def pull(self, taught: bool) -> float: ...


@dataclass(frozen=True, eq=False)
class JerkCost:
    """The integral of the squared jerk of all hands, relative to that of straight motions of least jerk.

    With a demonstration, the jerk is that of the deviation from it, and `pull` times the mean squared deviation,
    divided by `way` squared, is added; with a distribution, deviations are weighted by its precision at each instant.

    Attributes
    ----------
    way : root of the summed squared distances of all hands from start to goal [m]
    demonstration : array, shape (n_samples, n_hands * n_dims) [m], None without one
    pull : weight of the deviation from the demonstration
    precision : array, shape (n_samples, n_hands * n_dims, n_hands * n_dims), root of the relative precision (see
        `planning.resemblance`); None for equal weights
    weight : factor of the whole cost
    haste : cost of a pace of 1 (see `programme.QuadraticCost`)
    """

    way: float
    demonstration: Array | None = None
    pull: float = 0.0
    precision: Array | None = None
    weight: float = 1.0
    haste: float = 0.0

    def residuals(self, hands: Array) -> Array:
        """Return the residuals of hands at even samples, array of shape (n_samples, n_hands * n_dims)."""
        scale, jerk = self._scale(len(hands)), third_differences(hands)
        if self.demonstration is None:
            return scale * jerk.ravel()
        taught = third_differences(self.demonstration)
        taught[:2] = taught[-2:] = 0.0  # it need not rest at its ends
        away = self._pull(len(hands)) * self._weighted((hands - self.demonstration)[:, :, None])
        return np.concatenate([scale * (jerk - taught).ravel(), away.ravel()])

    def slopes(self, moves: Array) -> Array:
        """Return the derivatives of the residuals by n variables.

        Parameters
        ----------
        moves : array, shape (n_samples, n_hands * n_dims, n), derivatives of the hands by the variables
        """
        n_samples, _, n = moves.shape
        rows = self._scale(n_samples) * third_differences(moves).reshape(-1, n)
        if self.demonstration is None:
            return rows
        return np.concatenate([rows, self._pull(n_samples) * self._weighted(moves).reshape(-1, n)])

    def _weighted(self, moves: Array) -> Array:
        return moves if self.precision is None else self.precision @ moves

    def _scale(self, n_samples: int) -> float:
        return np.sqrt(self.weight / (720.0 * self.way**2 * (n_samples - 1)))

    def _pull(self, n_samples: int) -> float:
        return np.sqrt(self.weight * self.pull / (n_samples * self.way**2))


@dataclass(frozen=True, eq=False)
class Anchored:
    """A cost to which the deviation of the hands from their planned positions is added.

    Attributes
    ----------
    cost : cost without the addition
    anchor : array, shape (n_samples, n_hands * n_dims), planned positions of the hands [m]
    pull : weight of the deviation, as in `JerkCost`
    """

    cost: JerkCost
    anchor: Array
    pull: float

    @property
    def haste(self) -> float:
        """Return the `haste` of the cost."""
        return self.cost.haste

    def residuals(self, hands: Array) -> Array:
        """Return the residuals, as `JerkCost.residuals`."""
        return np.concatenate([self.cost.residuals(hands), self._weight() * (hands - self.anchor).ravel()])

    def slopes(self, moves: Array) -> Array:
        """Return the derivatives of the residuals, as `JerkCost.slopes`."""
        return np.concatenate([self.cost.slopes(moves), self._weight() * moves.reshape(-1, moves.shape[2])])

    def _weight(self) -> float:
        return np.sqrt(self.pull / (len(self.anchor) * self.cost.way**2))


@dataclass(frozen=True, eq=False)
class PaperSquares:
    """J of the hands, without its term of obstacles, which are constraints here.

    Attributes
    ----------
    weights : c_goal, c_vel and c_res
    goal : array, shape (n_hands * n_dims,), goal of the hands [m]
    demonstration : array, shape (n_samples, n_hands * n_dims) [m], if resemblance to it counts; else None
    haste : 0, as J does not depend on the duration (see `programme.QuadraticCost`)
    """

    weights: tuple[float, float, float]
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
        goal, velocity, resemblance = np.sqrt(np.array(self.weights) / n)
        return goal, velocity * (n - 1), resemblance


def squares(
    scene: Scene,
    objective: Pulling,
    demonstration: Array | None,
    n_samples: int = N_SAMPLES,
    precision: Array | None = None,
) -> JerkCost:
    """Return the objective as a sum of squares at even samples.

    Parameters
    ----------
    demonstration : array, shape (n_steps, n_manipulators, 3), demonstration transferred to every hand [m], where
        n_steps - 1 is a multiple of n_samples - 1; None without one
    precision : array, shape (n_steps, n_hands * n_dims, n_hands * n_dims), of `planning.resemblance`; None for none
    """
    way, pull = float(np.linalg.norm(scene.goal - scene.start)), objective.pull(demonstration is not None)
    if pull == 0 or demonstration is None:
        return JerkCost(max(way, 1e-6))
    step = (len(demonstration) - 1) // (n_samples - 1)
    taught = demonstration[::step, :, : scene.n_dims].reshape(n_samples, -1)
    return JerkCost(max(way, 1e-6), taught, pull, None if precision is None else precision[::step])


def jerk_cost(
    motion: CoordinatedMotion,
    objective: Pulling,
    demonstration: Array | None,
    precision: Array | None = None,
) -> float:
    """Return the value of the objective for a motion; `demonstration` and `precision` as in `squares`."""
    hands = motion.hands(np.linspace(0.0, 1.0, N_SAMPLES))[0].reshape(N_SAMPLES, -1)
    residuals = squares(motion.scene, objective, demonstration, precision=precision).residuals(hands)
    return float(residuals @ residuals)


def third_differences(y: Array) -> Array:
    """Return third derivatives between even samples of a motion in unit duration with no acceleration at its ends.

    Parameters
    ----------
    y : array, shape (n_samples, ...)

    Returns
    -------
    array, shape (n_samples - 1, ...)
    """
    first = y[1:] - y[:-1]
    second, third = first[1:] - first[:-1], np.empty_like(first)
    third[0], third[-1] = second[0], -second[-1]
    np.subtract(second[1:], second[:-1], out=third[1:-1])
    third *= (len(y) - 1) ** 3
    return third

"""The cost of least jerk, with and without a demonstration, as a sum of squares."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import DIRECTION, QUATERNION, Coordinates
from comove.coordination.motion import CoordinatedMotion
from comove.planning.convex.contacts import hand_slopes
from comove.planning.objectives.least_jerk import LeastJerk
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

N_SAMPLES = 101
GAUGE, GAUGE_EVERY = (
    3.0,
    4,
)  # what holds directions and quaternions near unit length, and at every so many samples


@dataclass(frozen=True, eq=False)
class JerkCost:
    """Squared jerk of all hands, integrated over unit duration, over that of the straight motions of least jerk.

    With a demonstration, of the departure from it; and ``pull`` times the mean square of the departure, over the
    mean square of the way from start to goal.

    Attributes
    ----------
    scene, coordinates : what moves
    demonstration : array, shape (n_samples, n_hands, n_dims) [m], None without one
    pull : how strongly hands are drawn to it
    gauge : weight of what holds directions and quaternions near unit length, which no motion shows
    """

    scene: Scene
    coordinates: Coordinates
    demonstration: Array | None = None
    pull: float = 0.0
    gauge: float = GAUGE

    @property
    def _way(self) -> float:
        """Sum of the squared ways of all hands [m^2]."""
        return max(float(((self.scene.goal - self.scene.start) ** 2).sum()), 1e-12)

    def _hands(self, q: Array) -> tuple[Array, Array]:
        """All nodes, and the hands' coordinates one after the other, (n_samples, n_hands * n_dims)."""
        nodes = self.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
        hands = nodes[:, : len(self.scene.manipulators), : self.scene.n_dims]
        return nodes, hands.reshape(len(q), -1)

    def _residuals(self, hands: Array, q: Array) -> Array:
        n_samples = len(q)
        scale = np.sqrt(1.0 / (720.0 * self._way * (n_samples - 1)))
        jerk = third_differences(hands)
        parts = [jerk]
        if self.demonstration is not None:
            taught = self.demonstration.reshape(n_samples, -1)
            own = third_differences(taught)
            own[:2] = own[-2:] = 0.0  # it need not rest at its ends
            parts = [jerk - own, self._pull_scale(n_samples) / scale * (hands - taught)]
        return np.concatenate([*(scale * part.ravel() for part in parts), self._gauge(q)])

    def _pull_scale(self, n_samples: int) -> float:
        return np.sqrt(self.pull / (n_samples * self._way))

    def _gauge(self, q: Array) -> Array:
        return np.concatenate(
            [np.zeros(0)]
            + [
                self.gauge * reach * (np.linalg.norm(q[::GAUGE_EVERY, turn], axis=1) - 1.0)
                for turn, reach in self._normed()
            ]
        )

    def _normed(self) -> list[tuple[Array, float]]:
        """Columns of every direction and quaternion, and the reach of what they turn [m]."""
        return [
            (
                np.arange(self.coordinates.n_columns)[part.columns][self.coordinates.n_dims :],
                float(np.linalg.norm(part.points, axis=1).max()),
            )
            for part in self.coordinates.parts
            if part.kind in (DIRECTION, QUATERNION)
        ]

    def value(self, q: Array) -> float:
        """The cost of configurations at even samples, array of shape (n_samples, n_columns)."""
        residuals = self._residuals(self._hands(q)[1], q)
        return float(residuals @ residuals)

    def model(self, q: Array, shape: Array) -> tuple[float, Array, Array]:
        """The cost, half its gradient and half its Gauss-Newton matrix by the shape weights."""
        nodes, hands = self._hands(q)
        n_samples, n_basis = shape.shape
        block = np.zeros(nodes.shape[1], dtype=np.int64)
        for b, part in enumerate(self.coordinates.parts):
            block[part.nodes] = b
        slopes = hand_slopes(self.coordinates.blocks, block, nodes, q, len(self.scene.manipulators))
        slopes = slopes.reshape(n_samples, -1, q.shape[1])
        moves = (slopes[:, :, :, None] * shape[:, None, None, :]).reshape(n_samples, hands.shape[1], -1)
        scale = np.sqrt(1.0 / (720.0 * self._way * (n_samples - 1)))
        rows = [scale * third_differences(moves).reshape(-1, moves.shape[2])]
        if self.demonstration is not None:
            rows.append(self._pull_scale(n_samples) * moves.reshape(-1, moves.shape[2]))
        for turn, reach in self._normed():
            p = q[::GAUGE_EVERY, turn]
            row = np.zeros((len(p), q.shape[1], n_basis))
            unit = p / np.linalg.norm(p, axis=1, keepdims=True)
            row[:, turn] = self.gauge * reach * unit[:, :, None] * shape[::GAUGE_EVERY, None, :]
            rows.append(row.reshape(len(p), -1))
        jacobian = np.concatenate(rows)
        residuals = self._residuals(hands, q)
        return float(residuals @ residuals), jacobian.T @ residuals, jacobian.T @ jacobian


def squares(
    scene: Scene, coordinates: Coordinates, objective: LeastJerk, demonstration: Array | None
) -> JerkCost:
    """The objective as a sum of squares at `N_SAMPLES` even samples.

    Parameters
    ----------
    demonstration : array, shape (n_steps, n_manipulators, 3), what was taught transferred to every hand [m], where
        n_steps - 1 is a multiple of `N_SAMPLES` - 1; None without one
    """
    pull = objective.pull(demonstration is not None)
    if pull == 0:
        return JerkCost(scene, coordinates)
    step = (len(demonstration) - 1) // (N_SAMPLES - 1)
    return JerkCost(scene, coordinates, demonstration[::step, :, : scene.n_dims], pull)


def jerk_cost(motion: CoordinatedMotion, objective: LeastJerk, demonstration: Array | None) -> float:
    """The value of the objective for a motion; `demonstration` as in `squares`."""
    cost = replace(squares(motion.scene, motion.coordinates, objective, demonstration), gauge=0.0)
    return cost.value(motion.at(np.linspace(0.0, 1.0, N_SAMPLES))[0])


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

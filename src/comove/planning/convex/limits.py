"""Limits of the end effectors' speed, acceleration and jerk, and their linearisation."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.model.scene import Scene
from comove.planning.convex.costs import STENCILS, Moves, differences, n_differences, stencil


@dataclass(frozen=True)
class Limits:
    """The limits of end effectors for a movement in unit duration.

    Attributes
    ----------
    n_dims : number of dimensions of an end effector
    values : limits of speed, acceleration and jerk, inf where there is none
    shares : shares of these that are kept to: samples miss the peaks
    """

    n_dims: int
    values: tuple[float, float, float]
    shares: tuple[float, float, float] = (0.99, 0.97, 0.97)

    @classmethod
    def of(cls, scene: Scene, duration: float) -> Limits:
        """Return a scene's limits for a duration [s], scaled to unit duration."""
        return cls(
            scene.n_dims,
            (
                scene.speed_limit * duration,
                scene.acceleration_limit * duration**2,
                scene.jerk_limit * duration**3,
            ),
        )

    def stricter(self, exceeded: tuple[float, float, float], more: float = 1.003) -> Limits:
        """Return limits divided by the exceeded ratios, and by a little `more`."""
        speed, acceleration, jerk = (
            value / max(1.0, more * ratio) for value, ratio in zip(self.values, exceeded, strict=True)
        )
        return replace(self, values=(speed, acceleration, jerk))

    def pace(self, hands: Array) -> float:
        """Return the number of durations in which a movement keeps the limits. It is 0 without limits.

        Parameters
        ----------
        hands : array, shape (n_samples, n_hands * n_dims), evenly spaced [m]
        """
        paces = (float(ratio.max()) ** (1.0 / order) for order, ratio in self._ratios(hands))
        return max(paces, default=0.0)

    def excess(self, hands: Array) -> float:
        """Return the relative excess over each limit, summed over the limits."""
        return float(sum(max(ratio.max() - 1.0, 0.0) for _, ratio in self._ratios(hands)))

    def linear(self, hands: Array, moves: Moves, pace: float = 1.0) -> LinearLimits:
        """Return the limits, linearised in a change of the variables.

        Parameters
        ----------
        moves : derivatives of the end effectors by n variables
        pace : number of durations that the movement takes
        """
        finite = [(order, share * value) for order, share, value in self._finite()]
        orders, values = np.array([o for o, _ in finite], dtype=np.int64), np.array([v for _, v in finite])
        return LinearLimits(self.n_dims, np.ascontiguousarray(hands), moves, orders, values, pace)

    def _ratios(self, hands: Array) -> Iterator[tuple[int, Array]]:
        """Yield the order of each limited rate and its ratios; arrays, shape (n, n_hands)."""
        for order, share, value in self._finite():
            yield order, _sizes(differences(hands, order), self.n_dims) / (share * value)

    def _finite(self) -> Iterator[tuple[int, float, float]]:
        for order, (share, value) in enumerate(zip(self.shares, self.values, strict=True), start=1):
            if value < np.inf:
                yield order, share, value


@kernel
def _sizes(rates, n_dims):
    """Return the norms of rates (n, n_hands * n_dims); array, shape (n, n_hands)."""
    sizes = np.zeros((rates.shape[0], rates.shape[1] // n_dims))
    for row in range(sizes.shape[0]):
        for hand in range(sizes.shape[1]):
            for d in range(hand * n_dims, (hand + 1) * n_dims):
                sizes[row, hand] += rates[row, d] ** 2
            sizes[row, hand] = sqrt(sizes[row, hand])
    return sizes


class LinearLimits(NamedTuple):
    """Linearised rates, whose limits depend on the pace.

    If the pace grows by dp, the limits are ``(pace + dp)^order`` times as large.

    Attributes
    ----------
    n_dims : number of dimensions of an end effector
    hands : array, shape (n_samples, n_hands * n_dims) [m]
    moves : derivatives of the end effectors by the variables
    orders, values : arrays, shape (n_limits,), orders of the limited rates, and their limits
    pace : number of durations that the movement takes
    """

    n_dims: int
    hands: Array
    moves: Moves
    orders: Integers
    values: Array
    pace: float

    def cuts(self, dz: Array, dp: float, share: float) -> tuple[Array, Array]:
        """Return half-spaces for rates above a share of their limits. They contain all admissible changes.

        Returns
        -------
        rows, bounds : arrays, shapes (n, n_variables) and (n,), of ``rows dz + dp >= bounds``
        """
        if not len(self.orders):
            return np.zeros((0, len(dz))), np.zeros(0)
        slopes, shape, _ = self.moves
        return _cuts(
            self.n_dims, self.hands, slopes, shape, self.orders, self.values, self.pace, dz, dp, share
        )


@kernel
def _cuts(n_dims, hands, slopes, shape, orders, values, pace, dz, dp, share):
    """Return rows and bounds of `LinearLimits.cuts`."""
    (n_samples, width), n_columns, n_basis = hands.shape, slopes.shape[2], shape.shape[1]
    there, rates = hands.copy(), np.empty((orders.shape[0], n_samples - 1, width))
    for s in range(n_samples):
        for c in range(n_columns):
            change = 0.0
            for k in range(n_basis):
                change += shape[s, k] * dz[c * n_basis + k]
            for h in range(width):
                there[s, h] += slopes[s, h, c] * change
    active, n = np.empty((rates.size // n_dims, 3), dtype=np.int64), 0
    for o in range(orders.shape[0]):
        scale, bound = (n_samples - 1.0) ** orders[o] / values[o], pace ** orders[o]
        bound = max(share * (bound + orders[o] * pace ** (orders[o] - 1) * dp), 0.0)
        for row in range(n_differences(orders[o], n_samples)):
            first, count, sign = stencil(orders[o], row, n_samples)
            for h in range(width):
                rates[o, row, h] = 0.0
                for j in range(count):
                    rates[o, row, h] += sign * scale * STENCILS[count - 1, j] * there[first + j, h]
            for h in range(0, width, n_dims):
                square = 0.0
                for d in range(h, h + n_dims):
                    square += rates[o, row, d] ** 2
                if square > bound**2:
                    active[n, 0], active[n, 1], active[n, 2] = o, row, h
                    n += 1
    rows, bounds = np.zeros((n, n_columns * n_basis)), np.empty(n)
    for r in range(n):
        o, row, h = active[r]
        first, count, sign = stencil(orders[o], row, n_samples)
        scale, slower = sign * (n_samples - 1.0) ** orders[o] / values[o], orders[o] * pace ** (orders[o] - 1)
        square = 0.0
        for d in range(h, h + n_dims):
            square += rates[o, row, d] ** 2
        size = sqrt(square)
        for j in range(count):
            for c in range(n_columns):
                along = 0.0
                for d in range(h, h + n_dims):
                    along += rates[o, row, d] / size * slopes[first + j, d, c]
                along *= scale * STENCILS[count - 1, j] / slower
                for k in range(n_basis):
                    rows[r, c * n_basis + k] -= along * shape[first + j, k]
        bounds[r] = (size - pace ** orders[o]) / slower
        for k in range(rows.shape[1]):
            bounds[r] += rows[r, k] * dz[k]
    return rows, bounds

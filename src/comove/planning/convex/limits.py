"""Limits of the hands' speed, acceleration and jerk, their linearisation, and the pace that they allow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.model.scene import Scene
from comove.planning.convex.costs import third_differences


@dataclass(frozen=True)
class Limits:
    """The limits of the hands for a movement in unit duration.

    Attributes
    ----------
    n_dims : number of dimensions of a hand
    values : limits of speed, acceleration and jerk, inf where there is none
    shares : shares of these that are kept to: samples miss the peaks
    """

    n_dims: int
    values: tuple[float, float, float]
    shares: tuple[float, float, float] = (0.99, 0.97, 0.97)

    @classmethod
    def of(cls, scene: Scene, duration: float) -> Limits:
        """Return the limits of a scene for a movement of a duration [s], scaled to unit duration."""
        return cls(
            scene.n_dims,
            (
                scene.speed_limit * duration,
                scene.acceleration_limit * duration**2,
                scene.jerk_limit * duration**3,
            ),
        )

    def stricter(self, exceeded: tuple[float, float, float], more: float = 1.003) -> Limits:
        """Return lower limits, divided by the ratios by which a motion exceeded them, and by a little `more`."""
        speed, acceleration, jerk = (
            value / max(1.0, more * ratio) for value, ratio in zip(self.values, exceeded, strict=True)
        )
        return replace(self, values=(speed, acceleration, jerk))

    def pace(self, hands: Array) -> float:
        """Return the least number of durations that a movement needs to keep the limits; 0 without limits.

        Parameters
        ----------
        hands : array, shape (n_samples, n_hands * n_dims), evenly spaced [m]
        """
        paces = (float(ratio.max()) ** (1.0 / order) for order, ratio in self._ratios(hands))
        return max(paces, default=0.0)

    def excess(self, hands: Array) -> float:
        """Return the relative excess over each limit, summed over the limits."""
        return float(sum(max(ratio.max() - 1.0, 0.0) for _, ratio in self._ratios(hands)))

    def linear(self, hands: Array, moves: Array, pace: float = 1.0) -> LinearLimits:
        """Return the limits, linearised in a change of the variables.

        Parameters
        ----------
        moves : array, shape (n_samples, n_hands * n_dims, n), derivatives of the hands by n variables
        pace : number of durations that the movement takes
        """
        rates, slopes, slower, limits = [], [], [], []
        for order, share, value in self._finite():
            rates.append(_rate(hands, order).reshape(-1, self.n_dims) / (share * value))
            slopes.append(_rate(moves, order).reshape(-1, self.n_dims, moves.shape[2]) / (share * value))
            slower.append(np.full(len(rates[-1]), order * pace ** (order - 1)))
            limits.append(np.full(len(rates[-1]), pace**order))
        if not rates:
            none = np.zeros((0, self.n_dims))
            return LinearLimits(none, np.zeros((*none.shape, moves.shape[2])), none[:, 0], none[:, 0])
        return LinearLimits(*map(np.concatenate, (rates, slopes, slower, limits)))

    def _ratios(self, hands: Array) -> Iterator[tuple[int, Array]]:
        """Yield the order of each limited rate and its ratio to the limit, array of shape (n, n_hands)."""
        for order, share, value in self._finite():
            rate = _rate(hands, order)
            size = np.linalg.norm(rate.reshape(len(rate), -1, self.n_dims), axis=2)
            yield order, size / (share * value)

    def _finite(self) -> Iterator[tuple[int, float, float]]:
        """Yield order, share that is kept to, and value of every finite limit."""
        for order, (share, value) in enumerate(zip(self.shares, self.values, strict=True), start=1):
            if value < np.inf:
                yield order, share, value


class LinearLimits(NamedTuple):
    """Linearised rates ``rates + slopes dz``, whose norms may reach ``limits + slower dp`` if the pace grows by dp.

    Attributes
    ----------
    rates : array, shape (n, n_dims), rates divided by their limits
    slopes : array, shape (n, n_dims, n_variables), derivatives of `rates` by the variables
    limits, slower : arrays, shape (n,), largest norms of the rates at the present pace, and their derivatives by it
    """

    rates: Array
    slopes: Array
    slower: Array
    limits: Array

    def cuts(self, dz: Array, dp: float, share: float) -> tuple[Array, Array]:
        """Return half-spaces that contain all changes within the limits, for rates above a share of them at a trial.

        Returns
        -------
        rows, bounds : arrays, shapes (n, n_variables) and (n,), of ``rows dz + dp >= bounds``
        """
        rates = self.rates + (self.slopes.reshape(-1, len(dz)) @ dz).reshape(self.rates.shape)
        square = np.einsum("kd,kd->k", rates, rates)
        bound = np.maximum(share * (self.limits + self.slower * dp), 0.0)
        at = np.flatnonzero(square > bound**2)
        size = np.sqrt(square[at])
        unit = rates[at] / size[:, None]
        rows = -np.einsum("kd,kdn->kn", unit, self.slopes[at]) / self.slower[at][:, None]
        return rows, (size - self.limits[at]) / self.slower[at] + rows @ dz


def _rate(y: Array, order: int) -> Array:
    """Return derivatives of order 1, 2 or 3 in unit duration, by differences; order 3 as `third_differences`."""
    if order == 3:
        return third_differences(y)
    return np.diff(y, n=order, axis=0) * (len(y) - 1) ** order

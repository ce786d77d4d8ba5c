"""Limits of the hands' speed, acceleration and jerk, linearised; and the pace that they allow."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.planning.convex.jerk import third_differences
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

ACTIVE = 0.7  # of a limit, from which on it is part of a programme
LITTLE = 1.003  # more than a limit was exceeded by, that it is lowered by
# Of the limits of speed, acceleration and jerk, kept to: samples miss their peaks.
SHARES = (0.99, 0.97, 0.97)


@dataclass(frozen=True)
class Limits:
    """Limits in unit duration.

    Attributes
    ----------
    n_dims : of every hand
    values : of speed, acceleration and jerk, inf where there is none
    """

    n_dims: int
    values: tuple[float, float, float]

    @classmethod
    def of(cls, scene: Scene, duration: float) -> Limits:
        """Those of a scene for a movement of a duration [s]."""
        limits = scene.speed_limit, scene.acceleration_limit, scene.jerk_limit
        return cls(scene.n_dims, tuple(value * duration ** (i + 1) for i, value in enumerate(limits)))

    def stricter(self, exceeded: tuple[float, float, float]) -> Limits:
        """The same, each divided by a ratio that a motion that seemed to keep it has reached, and a little more."""
        values = (
            value / max(1.0, LITTLE * ratio) for value, ratio in zip(self.values, exceeded, strict=True)
        )
        return replace(self, values=tuple(values))

    def pace(self, hands: Array) -> float:
        """Return the least number of durations that a movement needs to keep the limits; 0 without limits.

        Parameters
        ----------
        hands : array, shape (n_samples, n_hands * n_dims), evenly spaced [m]
        """
        paces = (float(ratio.max()) ** (1.0 / order) for order, ratio in self._ratios(hands))
        return max(paces, default=0.0)

    def excess(self, hands: Array) -> float:
        """By how much of themselves the limits are exceeded, all summed."""
        return float(sum(max(ratio.max() - 1.0, 0.0) for _, ratio in self._ratios(hands)))

    def linear(self, hands: Array, moves: Array, pace: float = 1.0) -> LinearLimits:
        """Return the limits as functions of a change of the variables, to first order.

        Parameters
        ----------
        moves : array, shape (n_samples, n_hands * n_dims, n), how hands change with n variables
        pace : in how many durations the movement is made
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
        """Orders of the limited rates, and their sizes over the limits, arrays of shape (n, n_hands)."""
        for order, share, value in self._finite():
            rate = _rate(hands, order)
            size = np.linalg.norm(rate.reshape(len(rate), -1, self.n_dims), axis=2)
            yield order, size / (share * value)

    def _finite(self) -> Iterator[tuple[int, float, float]]:
        """Order, share that is kept to, and value of every limit that there is."""
        for order, (share, value) in enumerate(zip(SHARES, self.values, strict=True), start=1):
            if value < np.inf:
                yield order, share, value


class LinearLimits(NamedTuple):
    """Limited rates ``rates + slopes dz``, which may reach ``limits + slower dp`` where the pace grows by dp.

    Attributes
    ----------
    rates : array, shape (n, n_dims), in shares of the limits
    slopes : array, shape (n, n_dims, n_variables)
    slower, limits : arrays, shape (n,)
    """

    rates: Array
    slopes: Array
    slower: Array
    limits: Array

    def cuts(self, dz: Array, dp: float, share: float) -> tuple[Array, Array]:
        """Half-spaces that hold what keeps the limits, for rates that exceed a share of them at a trial.

        Returns
        -------
        rows, bounds : ``rows dz + dp >= bounds``
        """
        rates = self.rates + self.slopes @ dz
        size = np.linalg.norm(rates, axis=1)
        at = np.flatnonzero(size > share * (self.limits + self.slower * dp))
        unit = rates[at] / size[at][:, None]
        rows = -np.einsum("kd,kdn->kn", unit, self.slopes[at]) / self.slower[at][:, None]
        return rows, (size[at] - self.limits[at]) / self.slower[at] + rows @ dz


def _rate(y: Array, order: int) -> Array:
    """First, second or third differences as rates in unit duration; the last without acceleration at either end."""
    if order == 3:
        return third_differences(y)
    return np.diff(y, n=order, axis=0) * (len(y) - 1) ** order

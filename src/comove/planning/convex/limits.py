"""Limits of the hands' speed and acceleration, linearised."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ACTIVE = 0.7  # of a limit, from which on it is part of a programme
SHARES = (0.99, 0.97)  # of the limits of speed and acceleration, kept to: samples miss their peaks


@dataclass(frozen=True)
class Limits:
    """Limits in unit duration.

    Attributes
    ----------
    n_dims : of every hand
    values : of speed and of acceleration, inf where there is none
    """

    n_dims: int
    values: tuple[float, float]

    def ratios(self, hands: Array) -> tuple[Array, Array]:
        """Speeds and accelerations over their limits, arrays of shape (n, n_hands); see `JerkCost.residuals`."""
        return tuple(
            np.linalg.norm(rate.reshape(len(rate), -1, self.n_dims), axis=2) / value
            for rate, value in zip(_rates(hands), self._kept(), strict=True)
        )

    def excess(self, hands: Array) -> float:
        """By how much of themselves the limits are exceeded, both summed."""
        return float(sum(max(ratio.max() - 1.0, 0.0) for ratio in self.ratios(hands)))

    def linear(self, hands: Array, moves: Array) -> tuple[Array, Array]:
        """Rows A and bounds b of the linearised limits, ``A dz >= b``, in shares of the limits."""
        n, rows, bounds = moves.shape[2], [np.zeros((0, moves.shape[2]))], [np.zeros(0)]
        for rate, slope, value in zip(_rates(hands), _rates(moves), self._kept(), strict=True):
            rate = rate.reshape(len(rate), -1, self.n_dims) / value
            size = np.linalg.norm(rate, axis=2)
            at = np.nonzero(size > ACTIVE)
            if len(at[0]):
                unit = rate[at] / size[at][:, None]
                slope = slope.reshape(*rate.shape, n)[at] / value
                rows.append(-np.einsum("kd,kdn->kn", unit, slope))
                bounds.append(size[at] - 1.0)
        return np.concatenate(rows), np.concatenate(bounds)

    def _kept(self) -> tuple[float, float]:
        return tuple(share * value for share, value in zip(SHARES, self.values, strict=True))


def _rates(y: Array) -> tuple[Array, Array]:
    """First differences and second ones, as rates in unit duration."""
    rate = len(y) - 1
    first = np.diff(y, axis=0) * rate
    return first, np.diff(first, axis=0) * rate

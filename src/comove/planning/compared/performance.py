"""Prescribed performance: an error that stays within a bound that shrinks (Bechlioulis and Rovithakis, 2008).

With the bound rho(t) = (rho_0 - rho_end) exp(-a t) + rho_end and xi = e/rho, the error is mapped to eps = artanh(xi),
which is finite only inside. Under

    e' = rho'/rho e - k rho eps / (1 - xi^2)        eps' = -k eps / (1 - xi^2)^2

eps dies out at least as fast as exp(-k t), so that an error which begins inside stays inside; near its end it shrinks
as exp(-k t). In discrete time the pull is at most what removes half of the error in a step, and an error that was
forced outside is drawn back by that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import OptionError
from comove.primitives.arguments import require_positive

Array = NDArray[np.float64]

MOST = 0.5  # of the error, removed in a step
OUTSIDE = 1.0 - 1e-6  # from which xi counts as lost


@dataclass(frozen=True)
class Performance:
    """A bound of an error, and how strongly the error is drawn to nothing.

    Attributes
    ----------
    first, last : rho_0 and rho_end [m]
    decay : a [1/s]
    gain : k [1/s]
    """

    first: float
    last: float
    decay: float
    gain: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            require_positive(name, value)
        if not self.last <= self.first:
            raise OptionError(f"last = {self.last!r}", key="last", way_out=f"give at most {self.first:g}")

    def bound(self, time: ArrayLike) -> Array:
        """rho at times [s], of any shape [m]."""
        return (self.first - self.last) * np.exp(-self.decay * np.asarray(time, dtype=float)) + self.last

    def wanted(self, error: Array, time: float, period: float) -> Array:
        """e' that keeps errors within the bound; arrays of one shape, [m] and [m/s].

        Parameters
        ----------
        period : of the control step [s]
        """
        rho = float(self.bound(time))
        shrinking = -self.decay * (rho - self.last) / rho
        xi = np.clip(np.abs(error) / rho, 1e-9, OUTSIDE)
        pull = self.gain * np.arctanh(xi) / (xi * (1.0 - xi**2))
        return (shrinking - np.minimum(pull, MOST / period)) * error

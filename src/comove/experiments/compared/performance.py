"""Prescribed performance: control that keeps an error within a shrinking bound (Bechlioulis and Rovithakis, 2008).

With the bound rho(t) = (rho_0 - rho_end) exp(-a t) + rho_end and xi = e/rho, the error is mapped to eps = artanh(xi),
which is finite only inside the bound. With the control law

    e' = rho'/rho e - k rho eps / (1 - xi^2)        eps' = -k eps / (1 - xi^2)^2

eps decays at least as fast as exp(-k t), so that an error that begins inside the bound stays inside; a small error
decays like exp(-k t). In discrete time the pull removes at most half of the error in a step, which also draws an
error back that was forced outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import OptionError
from comove.primitives.arguments import require_positive

Array = NDArray[np.float64]

MOST = 0.5  # largest share of the error that is removed in a step
OUTSIDE = 1.0 - 1e-6  # xi from which on an error counts as outside the bound


@dataclass(frozen=True)
class Performance:
    """The bound of an error, and the gain that draws the error to zero.

    Attributes
    ----------
    first, last : rho_0 and rho_end, the bound at first and in the limit [m]
    decay : a, decay rate of the bound [1/s]
    gain : k, decay rate of the error [1/s]
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
        """Return the bound rho [m] at times [s]; arrays of any one shape."""
        return (self.first - self.last) * np.exp(-self.decay * np.asarray(time, dtype=float)) + self.last

    def wanted(self, error: Array, time: float, period: float) -> Array:
        """Return the rate e' [m/s] that keeps errors [m] within the bound; arrays of the same shape.

        Parameters
        ----------
        period : control period [s]
        """
        rho = float(self.bound(time))
        shrinking = -self.decay * (rho - self.last) / rho
        xi = np.clip(np.abs(error) / rho, 1e-9, OUTSIDE)
        pull = self.gain * np.arctanh(xi) / (xi * (1.0 - xi**2))
        return (shrinking - np.minimum(pull, MOST / period)) * error

"""Canonical systems: the phase variable that replaces time and gates the forcing term, equation (1b).

``s = t / duration`` is the normalised time. (The paper's (1b) lost a sign: the phase must decay.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.errors import OptionError

FASTEST = 20.0  # decay rate: the phase falls to 2e-9


@dataclass(frozen=True)
class LinearPhase:
    """``duration * dx/dt = -1``: the phase reaches 0 exactly when the movement ends.

    The forcing term fades out with the phase, so the acceleration vanishes at the end too: robots stop smoothly.
    """

    def __call__(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the phase x at the normalised times `s` (any shape)."""
        return 1.0 - np.asarray(s, dtype=float)


@dataclass(frozen=True)
class ExponentialPhase:
    """``duration * dx/dt = -alpha * x``, the classic canonical system (Ijspeert et al., 2013).

    The forcing term is cut off at the end, where people's recorded movements still brake.

    Attributes
    ----------
    alpha : decay rate per duration

    Raises
    ------
    OptionError
        If alpha is not positive, or exceeds `FASTEST`, so that the phase vanishes before the end.
    """

    alpha: float = 1.0

    def __post_init__(self) -> None:
        if not isinstance(self.alpha, (int, float)) or not 0 < self.alpha <= FASTEST:
            raise OptionError(
                f"alpha = {self.alpha!r}", way_out=f"give a number above 0, at most {FASTEST:g}"
            )

    def __call__(self, s: ArrayLike) -> NDArray[np.float64]:
        """Return the phase x at the normalised times `s` (any shape)."""
        return np.exp(-self.alpha * np.asarray(s, dtype=float))


Phase = LinearPhase | ExponentialPhase

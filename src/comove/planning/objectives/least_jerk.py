"""The objective of smoothness: least jerk, and near to what was taught."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.errors import OptionError

DEFAULT = 0.7
LOOSEST, CLOSEST = 2.0, 7.7  # powers of ten of the pull, just above a resemblance of 0 and at 1


@dataclass(frozen=True)
class LeastJerk:
    """Least squared jerk of all hands; with a demonstration, of the departure from it, and a pull to it.

    In unit duration, with L the root of the summed squared ways from start to goal and d_i the demonstration
    transferred to hand i,

        1/(720 L^2) integral sum_i |y_i''' - d_i'''|^2 ds + pull/L^2 integral sum_i |y_i - d_i|^2 ds,

    which is 1 for straight motions of least jerk (Flash and Hogan, 1985) without a demonstration.

    Attributes
    ----------
    resemblance : between 0 and 1: how near to the demonstration; 0 leaves it unused, 1 is as near as what is in the
        way allows. 0.7 where there is a demonstration, unless given
    room : clearance that is wished for where it costs little, beyond what the scene asks for [m]. While a way is
        optimised, an obstacle that is touched makes the motion dearer by 15 %, and by less the nearer to the wish;
        of several ways, the one whose motion has the least of the above is taken
    """

    resemblance: float | None = None
    room: float = 0.01

    def __post_init__(self) -> None:
        value = self.resemblance
        number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
        if value is not None and not (number and 0 <= value <= 1):
            raise OptionError(
                f"the resemblance {value!r} is not between 0 and 1",
                key="resemblance",
                way_out="give 0 for a motion that needs no demonstration, 1 for one as near to it as possible",
            )
        number = isinstance(self.room, (int, float, np.number)) and not isinstance(self.room, bool)
        if not (number and 0 <= self.room < np.inf):
            raise OptionError(
                f"the wish for room {self.room!r}", key="room", way_out="give a number of metres, 0 for none"
            )

    def pull(self, taught: bool) -> float:
        """How strongly hands are drawn to the demonstration; 0 where there is none, or it is not used."""
        strength = DEFAULT if self.resemblance is None else float(self.resemblance)
        return 10.0 ** (LOOSEST + (CLOSEST - LOOSEST) * strength) if taught and strength > 0 else 0.0

"""The objective of the paper, equation (4)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from comove.errors import OptionError
from comove.planning.objectives.criterion import Criterion
from comove.verification.measures import WEIGHTS

if TYPE_CHECKING:
    from comove.model.motion import CoordinatedMotion
    from comove.planning.objective import Objective


@dataclass(frozen=True)
class PaperCost(Criterion):
    """The weights of the terms of equation (4), and of the resemblance to a demonstration.

    Attributes
    ----------
    goal, velocity, obstacle : c_goal, c_vel, c_obst
    resemblance : c_res, weight of the distance from the demonstration; 0 if this is only the start of the search
    """

    is_smooth: ClassVar[bool] = False
    goal: float = WEIGHTS["goal"]
    velocity: float = WEIGHTS["velocity"]
    obstacle: float = WEIGHTS["obstacle"]
    resemblance: float = WEIGHTS["resemblance"]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise OptionError(f"the cost weight {name} = {value!r}", way_out="give a number, 0 or more")

    def value(
        self, motion: CoordinatedMotion, evaluated: Objective, returned: Callable[[], CoordinatedMotion]
    ) -> float:
        """Return J of the motion, by the weights of `evaluated`."""
        return evaluated.cost(motion).total

    def pull(self, taught: bool) -> float:
        """Return the weight of the distance from the demonstration; 0 without one."""
        return self.resemblance if taught else 0.0

    @property
    def begins_taught(self) -> bool:
        """Return True: a demonstration is the start of the search, whatever its weight."""
        return True

    @property
    def weights(self) -> PaperCost:
        """Return the objective itself."""
        return self

"""The objective of the paper, equation (4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from comove.errors import OptionError
from comove.verification.measures import WEIGHTS


@dataclass(frozen=True)
class PaperCost:
    """The weights of the terms of equation (4), and of the resemblance to a demonstration.

    Attributes
    ----------
    goal, velocity, obstacle : c_goal, c_vel, c_obst
    resemblance : c_res, weight of the distance from the demonstration; 0 if this is only the start of the search
    """

    goal: float = WEIGHTS["goal"]
    velocity: float = WEIGHTS["velocity"]
    obstacle: float = WEIGHTS["obstacle"]
    resemblance: float = WEIGHTS["resemblance"]

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not 0 <= value < np.inf:
                raise OptionError(f"the cost weight {name} = {value!r}", way_out="give a number, 0 or more")

"""Levels of effort: how many paths a search makes smooth, and which gains it still works for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from comove.errors import OptionError, near_name

EffortName = Literal["quick", "normal", "thorough"]


@dataclass(frozen=True)
class EffortLevel:
    """A level of effort: how hard a search tries to better a motion that is verified.

    Attributes
    ----------
    ways : paths that are made smooth at most; None for as many as the method says
    gain : least relative decrease of the cost that counts as a gain of a step of the optimisation; None for what the
        method says
    patience : factor on the paths that a method makes smooth, at most and without gain
    """

    ways: int | None = None
    gain: float | None = None
    patience: int = 1

    def __post_init__(self) -> None:
        for name, number in (("ways", self.ways), ("patience", self.patience)):
            if number is not None and (not isinstance(number, int | np.integer) or number < 1):
                raise OptionError(
                    f"{name} = {number!r}", key="effort", way_out="give a whole number, 1 or more"
                )
        if self.gain is not None and not (isinstance(self.gain, float | int) and 0 < self.gain < 1):
            raise OptionError(f"gain = {self.gain!r}", key="effort", way_out="give a number between 0 and 1")

    @classmethod
    def of(cls, effort: object) -> EffortLevel:
        """Return an effort, given as such or by its name.

        Raises
        ------
        OptionError
            If no effort has this name.
        """
        if isinstance(effort, EffortLevel):
            return effort
        if not isinstance(effort, str) or effort not in EFFORTS:
            raise OptionError(
                f"effort = {effort!r}", key="effort", way_out=near_name(str(effort), tuple(EFFORTS))
            )
        return EFFORTS[effort]


NORMAL = EffortLevel()
EFFORTS: dict[str, EffortLevel] = {
    "quick": EffortLevel(ways=1, gain=0.01),
    "normal": NORMAL,
    "thorough": EffortLevel(patience=3),
}
"""Levels by name."""

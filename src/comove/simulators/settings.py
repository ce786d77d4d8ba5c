"""What a simulation keeps to and how it is judged."""

from __future__ import annotations

from dataclasses import dataclass

from comove.errors import OptionError


@dataclass(frozen=True)
class Settings:
    """Of a simulation.

    Attributes
    ----------
    log_rate : samples a second in an execution [Hz]
    settle, hold : how long the robot stands still before and after the motion [s]
    slip_limit : how far a hand may slide on the load [m]
    end_error_limit : how far from its goal the load may end [m]
    internal_force_limit : with which hands may work against each other [N]
    """

    log_rate: float = 100.0
    settle: float = 0.5
    hold: float = 0.5
    slip_limit: float = 0.002
    end_error_limit: float = 0.003
    internal_force_limit: float = 40.0

    def __post_init__(self) -> None:
        for name in ("log_rate", "settle", "hold", "slip_limit", "end_error_limit", "internal_force_limit"):
            value = getattr(self, name)
            if not (value > 0 or (value == 0 and name in ("settle", "hold"))) or value == float("inf"):
                raise OptionError(f"{value} is not possible", key=name, way_out="give a positive number")

"""Settings of a simulation, and the limits by which it is judged."""

from __future__ import annotations

from dataclasses import dataclass

from comove.errors import OptionError

LOG_RATES = (10.0, 500.0)  # Hz, the least and the largest


@dataclass(frozen=True)
class Settings:
    """Settings of a simulation.

    Attributes
    ----------
    log_rate : samples per second in an execution [Hz], from 10 to 500; the nearest that whole steps of 2 ms allow
    settle, hold : time for which the robot stands still before and after the motion [s]
    slip_limit : largest distance that a hand may slide on the load [m]
    end_error_limit : largest distance of the load from its goal at the end [m]
    internal_force_limit : largest force with which hands may work against each other [N]
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
        if not LOG_RATES[0] <= self.log_rate <= LOG_RATES[1]:
            raise OptionError(
                f"{self.log_rate} Hz are not possible",
                key="log_rate",
                way_out=f"give a number from {LOG_RATES[0]:g} to {LOG_RATES[1]:g}",
            )

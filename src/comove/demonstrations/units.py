"""Units of length and time of recordings."""

from __future__ import annotations

from comove.errors import OptionError, near_name

LENGTHS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "km": 1e3, "in": 0.0254, "ft": 0.3048}
"""Metres of each."""
TIMES = {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
"""Seconds of each."""


def length(unit: str, file: object = None) -> float:
    """Return the length of a unit in metres.

    Raises
    ------
    OptionError
        If the unit is unknown.
    """
    if unit not in LENGTHS:
        raise OptionError(
            f"the unit {unit!r} is not known", file=file, key="unit", way_out=near_name(unit, LENGTHS)
        )
    return LENGTHS[unit]

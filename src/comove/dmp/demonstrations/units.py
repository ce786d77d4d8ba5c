"""Units of lengths, times and angles, as recordings spell them."""

from __future__ import annotations

import math

from comove.errors import OptionError, near_name

LENGTHS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "km": 1e3, "in": 0.0254, "ft": 0.3048}
"""Metres of each unit."""
TIMES = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0}
"""Seconds of each unit."""
ANGLES = {"rad": 1.0, "deg": math.pi / 180.0}
"""Radians of each unit."""
UNSTATED = "LeRobot unit"
"""Unit of LeRobot's small arms: degrees, or percent of each joint's range, which a dataset does not say."""
_SPELLINGS = {
    "m": "meter meters metre metres",
    "dm": "decimeter decimeters decimetre decimetres",
    "cm": "centimeter centimeters centimetre centimetres",
    "mm": "millimeter millimeters millimetre millimetres",
    "um": "µm μm micrometer micrometers micrometre micrometres micron microns",
    "km": "kilometer kilometers kilometre kilometres",
    "in": "inch inches",
    "ft": "foot feet",
    "s": "sec secs second seconds sekunde sekunden",
    "ms": "msec msecs millisec millisecs millis millisecond milliseconds",
    "us": "µs μs usec usecs µsec μsec microsec micros microsecond microseconds",
    "ns": "nsec nsecs nanosec nanosecs nanos nanosecond nanoseconds",
    "min": "mins minute minutes",
    "rad": "rads radian radians",
    "deg": "degs degree degrees °",
}
UNITS = {unit: unit for unit in (*LENGTHS, *TIMES, *ANGLES)} | {
    spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings.split()
}
"""The unit that each spelling, in lower case, stands for."""


def unit_named(text: str) -> str | None:
    """Return the unit that a text spells in any case, else None.

    >>> [unit_named(text) for text in ("Seconds", "msec", "Meters", "m/s")]
    ['s', 'ms', 'm', None]
    """
    return UNITS.get(text.strip().lower())


def is_length(unit: str | None) -> bool:
    """Return whether a unit is one of lengths."""
    return unit in LENGTHS


def is_angle(unit: str | None) -> bool:
    """Return whether a unit is one of angles."""
    return unit in ANGLES


def is_of_joints(unit: str) -> bool:
    """Return whether a unit is of joints: an angle or LeRobot's.

    >>> [is_of_joints(unit) for unit in ("rad", "rad/m", "LeRobot unit", "mm", "LASA unit")]
    [True, True, True, False, False]
    """
    return unit == UNSTATED or any(is_angle(part) for part in unit.split("/"))


def base_unit(unit: str) -> str:
    """Return the unit in which comove keeps a quantity. They are metres, seconds and radians; other units stay.

    >>> [base_unit(unit) for unit in ("mm", "deg", "ns", "LASA unit")]
    ['m', 'rad', 's', 'LASA unit']
    """
    bases = (("m", LENGTHS), ("rad", ANGLES), ("s", TIMES))
    return next((base for base, units in bases if unit in units), unit)


def in_base_unit(unit: str) -> float:
    """Return a unit's size in base units; 1 for unknown ones."""
    return (LENGTHS | ANGLES | TIMES).get(unit, 1.0)


def require_unit(text: str, file: object = None) -> str:
    """Return the unit of positions or joints that a user names."""
    unit = unit_named(text)
    if unit is None or not (is_length(unit) or is_angle(unit)):
        known = (*LENGTHS, *ANGLES)
        raise OptionError(
            f"the unit {text!r} is not known", file=file, key="unit", way_out=near_name(text, known)
        )
    return unit

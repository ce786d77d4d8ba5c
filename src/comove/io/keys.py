"""Building blocks of the YAML files' models: strict base class, numbers, vectors, quaternions and names.

Lengths are in metres, quaternions in the order w, x, y, z.
"""

from __future__ import annotations

import math
import re
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from comove.io.messages import counted, show

MAX_NAME = 100
SMALLEST, LARGEST = 1e-9, 1e9
"""What numbers must lie between, in SI units: beyond, rounding or overflow make the results wrong."""
QUATERNION_TOLERANCE = 1e-3
UNTURNED = (1.0, 0.0, 0.0, 0.0)


class Wrong(ValueError):
    """Raised when a value has the right type but breaks the rules of the file.

    `args` are the message and what to write instead.
    """


def no_minus_zero(number: float) -> float:
    """Return the number with -0.0 turned into 0.0, so that equal files have equal checksums."""
    return number + 0.0


def not_huge(number: float) -> float:
    """Return a number, or raise `Wrong` where it is too large for computing with lengths; -0.0 becomes 0.0."""
    if abs(number) > LARGEST:
        raise Wrong(f"{show(number)} is out of range", f"write a number of at most {LARGEST:g}, in SI units")
    return no_minus_zero(number)


def measurable(number: float) -> float:
    """Return a number, or raise `Wrong` where it is too small for a length, a time or a mass."""
    if number < SMALLEST:
        raise Wrong(
            f"{show(number)} is out of range", f"write a number of at least {SMALLEST:g}, in SI units"
        )
    return not_huge(number)


def as_tuple(value: Any) -> Any:
    """Return a list or an array as a tuple, any other value as it is."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(value) if isinstance(value, list) else value


def safe_name(name: str) -> str:
    """Return a name, or raise `Wrong` where it cannot name a folder, a file and a column of a table."""
    if not re.fullmatch(r"\w[\w +-]*(\.[\w +-]+)*", name) or name.endswith(" "):
        way_out = "begin with a letter or digit; letters, digits, blanks and . _ + - may follow"
        raise Wrong(f"{show(name)} cannot name a file", way_out)
    if len(name) > MAX_NAME or len(name.encode()) > 2 * MAX_NAME:
        raise Wrong(f"the name has {len(name)} characters", f"use at most {MAX_NAME} ({2 * MAX_NAME} bytes)")
    return name


def _manipulator_name(name: str) -> str:
    if "." in name or " " in name:
        raise Wrong(f"{show(name)} contains a point or a blank", "use letters, digits, '_', '-'")
    return safe_name(name)


def _unit_quaternion(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    if len(quaternion) != 4:
        raise Wrong(
            f"{show(quaternion)} has {counted(quaternion, 'number')}", "write 4, in the order w, x, y, z"
        )
    norm = math.hypot(*quaternion)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        raise Wrong(f"{show(quaternion)} has the norm {norm:.6g}", "write a unit quaternion, w first")
    rounding = 1e-15  # an already normalised quaternion stays as it is
    return quaternion if abs(norm - 1.0) <= rounding else tuple(part / norm for part in quaternion)


def at_least(count: int, what: str) -> AfterValidator:
    """Return a validator that refuses lists of fewer than `count` entries."""

    def check(items: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(items) < count:
            raise Wrong(
                f"the list has {counted(items, 'entry', 'entries')}", f"write at least {count} {what}"
            )
        return items

    return AfterValidator(check)


def at_most(count: int, what: str) -> AfterValidator:
    """Return a validator that refuses lists of more than `count` entries, which would take too long to solve."""

    def check(items: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(items) > count:
            raise Wrong(f"the list has {len(items)} entries", f"write at most {count} {what}")
        return items

    return AfterValidator(check)


Number = Annotated[float, AfterValidator(not_huge)]
Positive = Annotated[float, Field(gt=0), AfterValidator(measurable)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(not_huge)]
Vector = Annotated[tuple[Number, ...], BeforeValidator(as_tuple)]
Sizes = Annotated[tuple[Positive, ...], BeforeValidator(as_tuple)]
Quaternion = Annotated[tuple[Number, ...], BeforeValidator(as_tuple), AfterValidator(_unit_quaternion)]
Name = Annotated[str, AfterValidator(_manipulator_name)]


class Part(BaseModel):
    """Base class of all models, which are frozen and strict.

    Unknown keys, NaN and infinity are refused, and so are a bool or a text in the place of a number.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

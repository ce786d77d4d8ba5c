"""What files in YAML are made of: strict models, numbers, vectors, quaternions and names, told in plain words.

Lengths are in metres, quaternions in the order w, x, y, z.
"""

from __future__ import annotations

import math
import re
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field

from comove.scenes.messages import counted, show

MAX_NAME = 100
SMALLEST, LARGEST = 1e-9, 1e9
"""What numbers must lie between, in SI units: beyond, rounding or overflow make the results wrong."""
QUATERNION_TOLERANCE = 1e-3
UNTURNED = (1.0, 0.0, 0.0, 0.0)


class Wrong(ValueError):
    """A value that its type accepts and the contract does not; `args` are message and way out."""


def no_minus_zero(number: float) -> float:
    """Turn -0.0 into 0.0, so that equal files have equal checksums."""
    return number + 0.0


def not_huge(number: float) -> float:
    """Accept numbers with which lengths can be computed; -0.0 becomes 0.0."""
    if abs(number) > LARGEST:
        raise Wrong(f"{show(number)} is out of range", f"write a number of at most {LARGEST:g}, in SI units")
    return no_minus_zero(number)


def measurable(number: float) -> float:
    """Accept positive numbers that are a length, a time, a mass... of things."""
    if number < SMALLEST:
        raise Wrong(
            f"{show(number)} is out of range", f"write a number of at least {SMALLEST:g}, in SI units"
        )
    return not_huge(number)


def as_tuple(value: Any) -> Any:
    """Turn a list or an array into a tuple."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(value) if isinstance(value, list) else value


def safe_name(name: str) -> str:
    """Accept names that can name a folder, a file, a column of a table."""
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
    """Make a validator of lists."""

    def check(items: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(items) < count:
            raise Wrong(
                f"the list has {counted(items, 'entry', 'entries')}", f"write at least {count} {what}"
            )
        return items

    return AfterValidator(check)


def at_most(count: int, what: str) -> AfterValidator:
    """Make a validator of lists that nobody can wait for when they are longer."""

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
    """Frozen and strict: no unknown keys, no NaN or infinity, a bool or a text is no number."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

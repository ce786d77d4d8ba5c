"""Building blocks of the YAML files' models: strict base class, numbers, vectors, quaternions and names.

Lengths are in metres, quaternions in the order w, x, y, z. Types are marked by what their values are, so that
`marked` finds every vector of a file, and every name of a hand, and `scaled` every number that grows with lengths.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, get_args

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
)

from comove.io.messages import KeyPath, counted, show

MAX_NAME = 100
SMALLEST, LARGEST = 1e-9, 1e9
"""What numbers must lie between, in SI units: beyond, rounding or overflow make the results wrong."""
LARGE = 50.0  # m, wider than this is probably written in millimetres
QUATERNION_TOLERANCE = 1e-3
UNTURNED = (1.0, 0.0, 0.0, 0.0)
SCALES, VECTOR, HAND = "grows with lengths", "has the scene's dimension", "names a hand"
"""Marks of types."""


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


def distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names, or raise `Wrong` where there are none or one is repeated."""
    if not names:
        raise Wrong("no manipulator is named", "name at least one")
    if len(set(names)) < len(names):
        raise Wrong(f"{show(names)} names a manipulator twice", "name different manipulators")
    return names


def _pair(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(names) != 2:
        raise Wrong(f"{show(names)} has {counted(names, 'name')}", "name two manipulators")
    return distinct(names)


Number = Annotated[float, AfterValidator(not_huge)]
Positive = Annotated[float, Field(gt=0), AfterValidator(measurable)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(not_huge)]
PositiveLength = Annotated[Positive, SCALES]
Length = Annotated[NotNegative, SCALES]
Vector = Annotated[tuple[Number, ...], BeforeValidator(as_tuple), SCALES, VECTOR]
Sizes = Annotated[tuple[Positive, ...], BeforeValidator(as_tuple), SCALES, VECTOR]
Quaternion = Annotated[tuple[Number, ...], BeforeValidator(as_tuple), AfterValidator(_unit_quaternion)]
Name = Annotated[str, AfterValidator(_manipulator_name)]
Hand = Annotated[str, HAND]
Hands = Annotated[tuple[Hand, ...], BeforeValidator(as_tuple), AfterValidator(distinct)]
Pair = Annotated[tuple[Hand, ...], BeforeValidator(as_tuple), AfterValidator(_pair)]


class Part(BaseModel):
    """Base class of all models, which are frozen and strict.

    Unknown keys, NaN and infinity are refused, and so are a bool or a text in the place of a number.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Sparse(Part):
    """A part that leaves out of its plain data those of its keys in `LATER` that are not set.

    Files that do not use a key that came later keep their checksum.
    """

    LATER: ClassVar[tuple[str, ...]] = ()

    @model_serializer(mode="wrap")
    def _sparse(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {
            key: value for key, value in write(self).items() if value is not None or key not in self.LATER
        }


def marked(part: Part, mark: str) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the values of a part whose type has a mark, with their key paths: names, and vectors as a whole."""
    for key, field in type(part).model_fields.items():
        yield from _leaves(
            (key,), getattr(part, key), mark, mark in _marks(field.annotation, *field.metadata)
        )


def _leaves(path: KeyPath, value: Any, mark: str, has: bool) -> Iterator[tuple[KeyPath, Any]]:
    if isinstance(value, Part):
        yield from (((*path, *inner), leaf) for inner, leaf in marked(value, mark))
    elif isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves((*path, key), item, mark, has)
    elif isinstance(value, tuple) and value and not isinstance(value[0], float):
        for i, item in enumerate(value):
            yield from _leaves((*path, i), item, mark, has)
    elif has and value is not None:
        yield path, value


def scaled(part: Part, factor: float) -> dict[str, Any]:
    """Return a part as plain data, with every number that grows with lengths multiplied by a factor."""

    def times(value: Any, grows: bool) -> Any:
        if isinstance(value, Part):
            return scaled(value, factor)
        if isinstance(value, dict):
            return {key: times(item, grows) for key, item in value.items()}
        if isinstance(value, tuple):
            return [times(item, grows) for item in value]
        return value * factor if grows and isinstance(value, float) else value

    return {
        key: times(getattr(part, key), SCALES in _marks(field.annotation, *field.metadata))
        for key, field in type(part).model_fields.items()
    }


def _marks(*annotations: Any) -> set[str]:
    """Return the marks of types, inside unions, tuples and mappings too, but not inside models."""
    marks = {mark for mark in annotations if mark in (SCALES, VECTOR, HAND)}
    return marks.union(*(_marks(*get_args(one)) for one in annotations if get_args(one)))

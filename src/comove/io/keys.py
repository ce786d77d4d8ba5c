"""Building blocks of models of YAML files.

They are a strict base class, numbers, vectors, quaternions and names. Lengths are in metres, quaternions in the
order w, x, y, z. Types carry marks of their meaning, so that `marked` finds every vector of a file and every name of
a manipulator, and `scaled` every number that grows with lengths.

Errors of pydantic are translated into plain words: key, line, value and correction. A `Contract`, which the models
fill in, describes the keys that a file may hold.
"""

from __future__ import annotations

import difflib
import math
import re
import reprlib
from collections.abc import Iterable, Iterator, Mapping, Sized
from functools import cache, reduce
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, NamedTuple, Union, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    ValidationError,
    model_serializer,
)
from pydantic_core import ErrorDetails

from comove.errors import SceneError, near_name
from comove.io.yaml_reader import Lines

MAX_TOLD = 3
"""How many errors one message tells."""

KeyPath = tuple[str | int, ...]
_Keys = dict[KeyPath, list[str]]


class Flaw(NamedTuple):
    """Error in a file: key path, message and correction."""

    path: KeyPath
    message: str
    way_out: str


class Family(NamedTuple):
    """Place in a file whose model depends on a tag. It holds the tag's key, the models, and the place's depth."""

    tag: str
    models: Mapping[str, type[BaseModel]]
    depth: int


class Contract(NamedTuple):
    """Models of a file. One is of the whole file, the others of places whose model depends on a tag."""

    root: type[BaseModel]
    families: Mapping[str | int, Family]


_PLAIN_NUMBER = "write a plain number such as 0.5: no quotes, no unit, a point for decimals"
_KINDS = {
    "float_type": ("a number", _PLAIN_NUMBER),
    "finite_number": ("a finite number", _PLAIN_NUMBER),
    "int_type": ("a whole number", "write a whole number such as 1"),
    "string_type": ("text", "write a name or text, in quotes where it looks like a number"),
    "tuple_type": ("a list", "write it in brackets, such as [0.5, 0.5]"),
    "dict_type": ("a mapping", "write 'key: value' lines"),
    "model_type": ("a mapping", "write 'key: value' lines"),
    "model_attributes_type": ("a mapping", "write 'key: value' lines"),
    "invalid_key": ("a key", "write keys as text"),
}
_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "not less than"),
    "less_than_equal": ("le", "not greater than"),
}


def show(value: Any) -> str:
    """Return a value as a scene file would hold it, shortened. Characters that a terminal may act on are escaped."""
    if value is None or isinstance(value, bool):
        return {None: "nothing", True: "true", False: "false"}[value]
    try:
        return reprlib.repr(list(value) if isinstance(value, tuple) else value)
    except ValueError:  # a whole number too long to be written
        return f"a very long {type(value).__name__}"


def counted(items: Sized, one: str, several: str | None = None) -> str:
    """Return a count with its noun, such as ``1 entry``."""
    return f"{len(items)} {one if len(items) == 1 else several or one + 's'}"


def _dotted(path: Iterable[str | int]) -> str:
    """Return a key path as text, such as ``obstacles[0].size``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{_plain_key(part)}" for part in path)
    return "".join(parts).removeprefix(".")


def _plain_key(key: str) -> str:
    return key if re.fullmatch(r"[\w-]{1,40}", key) else show(key)


def scene_error(flaws: list[Flaw], file: str | Path | None, lines: Lines) -> SceneError:
    """Return one error that reports the first flaws of the file."""
    flaws = sorted(flaws, key=lambda flaw: lines.get(flaw.path, 0))
    keys = [place(flaw.path, lines) for flaw in flaws]
    if len(flaws) == 1:
        return SceneError(flaws[0].message, file=file, key=keys[0], way_out=flaws[0].way_out)
    told = [
        f"{key}: {flaw.message}; {flaw.way_out}" if key else f"{flaw.message}; {flaw.way_out}"
        for key, flaw in zip(keys[:MAX_TOLD], flaws, strict=False)
    ]
    more = [f"and {len(flaws) - MAX_TOLD} more"] if len(flaws) > MAX_TOLD else []
    return SceneError("\n  ".join([f"{len(flaws)} errors", *told, *more]), file=file)


def place(path: KeyPath, lines: Mapping[KeyPath, int]) -> str | None:
    """Return a key path and the nearest known line as text."""
    known = next((path[:n] for n in range(len(path), 0, -1) if path[:n] in lines), None)
    line = "" if known is None else f" (line {lines[known]})"
    return f"{_dotted(path)}{line}" or None


def explained(error: ValidationError, data: Any, contract: Contract) -> list[Flaw]:
    """Return pydantic's errors as flaws in plain words. Missing and misspelt keys of one place are reported once."""
    details = [
        (_existing(detail["loc"], data, contract), detail) for detail in error.errors(include_url=False)
    ]
    unknown: _Keys = {}
    missing: _Keys = {}
    flaws: dict[KeyPath, Flaw] = {}
    for path, detail in details:
        if detail["type"] == "missing":
            missing.setdefault(path, []).append(str(detail["loc"][-1]))
        elif detail["type"] == "extra_forbidden":
            unknown.setdefault(path[:-1], []).append(str(path[-1]))
        else:
            flaws.setdefault(path, Flaw(path, *_translated(detail, path, contract)))
    return [
        *_unknown_keys(unknown, data, contract),
        *_missing_keys(missing, unknown, data, contract),
        *flaws.values(),
    ]


def _existing(location: KeyPath, data: Any, contract: Contract) -> KeyPath:
    """Return an error's location as a key path in the data."""
    family = contract.families.get(location[0]) if location else None
    if family:
        location = location[: family.depth] + location[family.depth + 1 :]
    path = []
    for part in location:
        try:
            data = data[part]
        except (TypeError, KeyError, IndexError):
            continue
        path.append(part)
    return tuple(path)


def _keys(path: KeyPath, data: Any, contract: Contract) -> dict[str, bool]:
    """Return the keys allowed at `path`, and whether each is required."""
    if path and (family := _family_at(path, contract)):
        part = reduce(lambda whole, key: whole[key], path[: family.depth], data)
        model = _model_at(family.models[part[family.tag]], path[family.depth :])
    else:
        model = _model_at(contract.root, path)
    return {name: field.is_required() for name, field in model.model_fields.items()}


def _family_at(path: KeyPath, contract: Contract) -> Family | None:
    """Return the family that a path leads into. Lists within a part are found by the two keys that lead to them."""
    inner = ".".join(map(str, path[:2])) if len(path) > 2 else ""
    return contract.families.get(inner) or contract.families.get(path[0])


def _model_at(root: type[BaseModel], path: KeyPath) -> type[BaseModel]:
    """Return the model of the mapping at `path`."""
    found: Any = root
    for part in path:
        if isinstance(found, type) and issubclass(found, BaseModel):
            if isinstance(part, int):  # one of several, where one alone may be written as well
                continue
            found = found.model_fields[part].annotation
        else:
            found = get_args(found)[-1 if get_origin(found) is dict else 0]
        while get_origin(found) in (UnionType, Union, Annotated):
            found = get_args(found)[0]
    return found


def _unknown_keys(unknown: _Keys, data: Any, contract: Contract) -> Iterator[Flaw]:
    for path, keys in unknown.items():
        for key in keys:
            digits = "write decimals with a point, and lists in brackets" if key.isdigit() else None
            way_out = digits or near_name(key, _keys(path, data, contract))
            yield Flaw((*path, key), f"unknown key {show(key)}", way_out)


def _missing_keys(missing: _Keys, unknown: _Keys, data: Any, contract: Contract) -> Iterator[Flaw]:
    for path, keys in missing.items():
        keys = [key for key in keys if not difflib.get_close_matches(key, unknown.get(path, []))]
        if keys:
            verb = "is" if len(keys) == 1 else "are"
            required = ", ".join(key for key, needed in _keys(path, data, contract).items() if needed)
            yield Flaw(path, f"{', '.join(map(repr, keys))} {verb} missing", f"required here: {required}")


def _translated(detail: ErrorDetails, path: KeyPath, contract: Contract) -> tuple[str, str]:
    """Return a value's error in plain words, and the correction."""
    kind, value, context = detail["type"], detail["input"], detail.get("ctx", {})
    if kind == "value_error":  # raised by a validator of the models, with message and way out
        return context["error"].args
    if kind in _KINDS:
        wanted, way_out = _KINDS[kind]
        return f"{show(value)} is not {wanted}", way_out
    if kind in _BOUNDS:
        bound, words = _BOUNDS[kind]
        return f"{show(value)} is out of range", f"write a number {words} {context[bound]:g}"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _tag_error(value, path, contract)
    if kind == "literal_error":
        return f"{show(value)} is not known", f"write {context['expected']}"
    return f"{show(value)} is not allowed here", "correct it, or leave it out"


def _tag_error(part: Any, path: KeyPath, contract: Contract) -> tuple[str, str]:
    family = _family_at(path, contract)
    assert family is not None, "only parts with a tag have errors of it"
    if family.tag not in part:
        return f"the key '{family.tag}' is missing", f"write one of: {', '.join(family.models)}"
    tag = part[family.tag]
    return f"the {family.tag} {show(tag)} is not known", near_name(tag, family.models)


MAX_NAME = 100
SMALLEST, LARGEST = 1e-9, 1e9
"""What numbers must lie between, in SI units: beyond, rounding or overflow make the results wrong."""
LARGE = 50.0  # m, wider than this is probably written in millimetres
QUATERNION_TOLERANCE = 1e-3
UNTURNED = (1.0, 0.0, 0.0, 0.0)
SCALES, VECTOR, HAND = "grows with lengths", "has the scene's dimension", "names a hand"
"""Marks of types."""


class Wrong(ValueError):
    """Error of a value with the right type that breaks a rule. `args` are the message and the correction."""


def no_minus_zero(number: float) -> float:
    """Turn -0.0 into 0.0, so that equal files have equal checksums."""
    return number + 0.0


def not_huge(number: float) -> float:
    """Return a number with -0.0 as 0.0. Raise `Wrong` where it is too large for computing with lengths."""
    if abs(number) > LARGEST:
        raise Wrong(f"{show(number)} is out of range", f"write a number of at most {LARGEST:g}, in SI units")
    return no_minus_zero(number)


def measurable(number: float) -> float:
    """Return a number of valid size for a length, time or mass. Raise `Wrong` where it is too small or too large."""
    if number < SMALLEST:
        raise Wrong(
            f"{show(number)} is out of range", f"write a number of at least {SMALLEST:g}, in SI units"
        )
    return not_huge(number)


def as_tuple(value: Any) -> Any:
    """Return lists and arrays as tuples, other values unchanged."""
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(value) if isinstance(value, list) else value


def safe_name(name: str) -> str:
    """Return a name that is valid for files, folders and columns. Raise `Wrong` where it is not."""
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
        if norm < 1e-6:
            raise Wrong(f"{show(quaternion)} is no orientation", f"write {list(UNTURNED)} for none")
        unit = [round(part / norm, 6) + 0.0 for part in quaternion]
        raise Wrong(
            f"{show(quaternion)} has the norm {norm:.6g}",
            f"write a unit quaternion, w first: {unit}, if its order is w, x, y, z",
        )
    rounding = 1e-15  # an already normalised quaternion stays as it is
    return quaternion if abs(norm - 1.0) <= rounding else tuple(part / norm for part in quaternion)


def _direction(vector: tuple[float, ...]) -> tuple[float, ...]:
    if len(vector) != 3:
        raise Wrong(f"{show(vector)} has {counted(vector, 'number')}", "write 3 (x, y, z), such as [0, 0, 1]")
    if not math.hypot(*vector) > SMALLEST:
        raise Wrong(f"{show(vector)} has no direction", "write a vector such as [0, 0, 1]")
    return vector


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
    """Return a validator that refuses lists of more than `count` entries."""

    def check(items: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(items) > count:
            raise Wrong(f"the list has {len(items)} entries", f"write at most {count} {what}")
        return items

    return AfterValidator(check)


def distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return names; raise `Wrong` if empty or one is repeated."""
    if not names:
        raise Wrong("no manipulator is named", "name at least one")
    if len(set(names)) < len(names):
        raise Wrong(f"{show(names)} names a manipulator twice", "name different manipulators")
    return names


def _pair(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(names) != 2:
        raise Wrong(f"{show(names)} has {counted(names, 'name')}", "name two manipulators")
    return distinct(names)


class Entries(NamedTuple):
    """Least and most entries of a list, for the JSON schema."""

    least: int
    most: int

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> dict[str, Any]:
        return {**handler(core), "minItems": self.least, "maxItems": self.most}


Number = Annotated[float, AfterValidator(not_huge)]
Positive = Annotated[float, Field(gt=0), AfterValidator(measurable)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(not_huge)]
PositiveLength = Annotated[Positive, SCALES]
Length = Annotated[NotNegative, SCALES]
Vector = Annotated[tuple[Number, ...], BeforeValidator(as_tuple), SCALES, VECTOR, Entries(2, 3)]
Sizes = Annotated[tuple[Positive, ...], BeforeValidator(as_tuple), SCALES, VECTOR, Entries(2, 3)]
Quaternion = Annotated[
    tuple[Number, ...], BeforeValidator(as_tuple), AfterValidator(_unit_quaternion), Entries(4, 4)
]
Direction = Annotated[
    tuple[Number, ...], BeforeValidator(as_tuple), AfterValidator(_direction), Entries(3, 3)
]
Name = Annotated[str, AfterValidator(_manipulator_name)]
Hand = Annotated[str, HAND]
Hands = Annotated[tuple[Hand, ...], BeforeValidator(as_tuple), AfterValidator(distinct)]
Pair = Annotated[tuple[Hand, ...], BeforeValidator(as_tuple), AfterValidator(_pair), Entries(2, 2)]


class Part(BaseModel):
    """Base class of all models, which are frozen and strict. Unknown keys, NaN and infinity are refused, and so is a
    bool or a text instead of a number."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Sparse(Part):
    """Part whose plain data omit unset keys of `LATER`. So files that do not use a later key keep their checksum."""

    LATER: ClassVar[tuple[str, ...]] = ()

    @model_serializer(mode="wrap")
    def _sparse(self, write: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return {
            key: value for key, value in write(self).items() if value is not None or key not in self.LATER
        }


def marked(part: Part, mark: str) -> Iterator[tuple[KeyPath, Any]]:
    """Yield the values whose type has a mark, with key paths. Names are yielded one by one, vectors as a whole."""
    for key, marks in _marks_of(type(part)).items():
        yield from _leaves((key,), getattr(part, key), mark, mark in marks)


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
    """Return a part as plain data with lengths scaled by `factor`."""

    def times(value: Any, grows: bool) -> Any:
        if isinstance(value, Part):
            return scaled(value, factor)
        if isinstance(value, dict):
            return {key: times(item, grows) for key, item in value.items()}
        if isinstance(value, tuple):
            return [times(item, grows) for item in value]
        return value * factor if grows and isinstance(value, float) else value

    return {key: times(getattr(part, key), SCALES in marks) for key, marks in _marks_of(type(part)).items()}


@cache
def _marks_of(kind: type[Part]) -> dict[str, set[str]]:
    return {key: _marks(field.annotation, *field.metadata) for key, field in kind.model_fields.items()}


def _marks(*annotations: Any) -> set[str]:
    """Return the marks of types and their arguments, without models."""
    marks = {mark for mark in annotations if mark in (SCALES, VECTOR, HAND)}
    return marks.union(*(_marks(*get_args(one)) for one in annotations if get_args(one)))

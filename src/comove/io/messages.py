"""Messages on errors in a scene file, in plain words: key, line, value and what to write instead.

Errors of pydantic are translated; its own text never reaches the user. The keys that a file may hold are described
by a `Contract`, which the models fill in.
"""

from __future__ import annotations

import difflib
import re
import reprlib
from collections.abc import Iterable, Iterator, Mapping, Sized
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from comove.errors import SceneError, near_name
from comove.io.yaml_reader import Lines

MAX_TOLD = 3
"""How many errors one message tells."""

KeyPath = tuple[str | int, ...]
_Keys = dict[KeyPath, list[str]]


class Flaw(NamedTuple):
    """An error in a file, which holds its place, what is wrong, and what to write instead."""

    path: KeyPath
    message: str
    way_out: str


class Family(NamedTuple):
    """A place in a file whose model depends on a tag; it holds the tag's key, the models, and the place's depth."""

    tag: str
    models: Mapping[str, type[BaseModel]]
    depth: int


class Contract(NamedTuple):
    """The models of a file: one of the whole, and those of the places whose model depends on a tag."""

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
    """Return a value as a scene file would hold it, shortened.

    Characters that a terminal may act on are escaped.
    """
    if value is None or isinstance(value, bool):
        return {None: "nothing", True: "true", False: "false"}[value]
    try:
        return reprlib.repr(list(value) if isinstance(value, tuple) else value)
    except ValueError:  # a whole number too long to be written
        return f"a very long {type(value).__name__}"


def counted(items: Sized, one: str, several: str | None = None) -> str:
    """Return the number of items with its noun, such as ``1 entry`` or ``2 entries``."""
    return f"{len(items)} {one if len(items) == 1 else several or one + 's'}"


def _dotted(path: Iterable[str | int]) -> str:
    """Return a key path as text, such as ``obstacles[0].size``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{_plain_key(part)}" for part in path)
    return "".join(parts).removeprefix(".")


def _plain_key(key: str) -> str:
    return key if re.fullmatch(r"[\w-]{1,40}", key) else show(key)


def scene_error(flaws: list[Flaw], file: str | Path | None, lines: Lines) -> SceneError:
    """Return one error that tells the first flaws of the file."""
    flaws = sorted(flaws, key=lambda flaw: lines.get(flaw.path, 0))
    keys = [_place(flaw.path, lines) for flaw in flaws]
    if len(flaws) == 1:
        return SceneError(flaws[0].message, file=file, key=keys[0], way_out=flaws[0].way_out)
    told = [
        f"{key}: {flaw.message}; {flaw.way_out}" if key else f"{flaw.message}; {flaw.way_out}"
        for key, flaw in zip(keys[:MAX_TOLD], flaws, strict=False)
    ]
    more = [f"and {len(flaws) - MAX_TOLD} more"] if len(flaws) > MAX_TOLD else []
    return SceneError("\n  ".join([f"{len(flaws)} errors", *told, *more]), file=file)


def _place(path: KeyPath, lines: Lines) -> str | None:
    """Return the key and its line as text, as far as both are known."""
    line = f" (line {lines[path]})" if path in lines else ""
    return f"{_dotted(path)}{line}" or None


def explained(error: ValidationError, data: Any, contract: Contract) -> list[Flaw]:
    """Return pydantic's errors as flaws in plain words; a place's missing keys, and misspelt ones, are told once."""
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
    """Return an error's location without pydantic's union tags and without keys that the data lack."""
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
    """Return the keys that the contract knows for the mapping at `path`, and whether each is required."""
    if path and (family := contract.families.get(path[0])):
        part = data[path[0]] if family.depth == 1 else data[path[0]][path[1]]
        model = _model_at(family.models[part[family.tag]], path[family.depth :])
    else:
        model = _model_at(contract.root, path)
    return {name: field.is_required() for name, field in model.model_fields.items()}


def _model_at(root: type[BaseModel], path: KeyPath) -> type[BaseModel]:
    """Return the model of the mapping at `path`, through lists, mappings by name and optional parts."""
    found: Any = root
    for part in path:
        if isinstance(found, type) and issubclass(found, BaseModel):
            found = found.model_fields[str(part)].annotation
        else:
            found = get_args(found)[-1 if get_origin(found) is dict else 0]
        if get_origin(found) in (UnionType, Union):
            found = get_args(found)[0]
        if get_origin(found) is Annotated:
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
    """Return what is wrong with a value, in plain words, and what to write instead."""
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
    family = contract.families[path[0]]
    if family.tag not in part:
        return f"the key '{family.tag}' is missing", f"write one of: {', '.join(family.models)}"
    tag = part[family.tag]
    return f"the {family.tag} {show(tag)} is not known", near_name(tag, family.models)

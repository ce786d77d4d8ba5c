"""Checks of the entries of JSON files that may have been edited: their types and values."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from comove.errors import ResultError, shortened


def number(value: object) -> float | None:
    """Return a finite number out of a JSON file; None where it is none."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


def agrees(stated: object, right: float, within: float) -> bool:
    """Return whether a number stated in a file agrees with the right one to within `within`."""
    found = number(stated)
    return found is not None and abs(found - right) <= within


@dataclass(frozen=True)
class Type:
    """A type of an entry of a JSON file: its name, and the test for it."""

    name: str
    fits: Callable[[object], bool]

    @property
    def or_nothing(self) -> Type:
        """Return the type that also accepts null or a missing entry."""
        return Type(f"{self.name} or null", lambda value: value is None or self.fits(value))


NUMBER = Type("a number", lambda value: number(value) is not None)
TEXT = Type("a text that can be printed", lambda value: isinstance(value, str) and value.isprintable())
TEXTS = Type(
    "a list of texts that can be printed",
    lambda value: isinstance(value, list) and all(map(TEXT.fits, value)),
)
TRUTH = Type("true or false", lambda value: isinstance(value, bool))
COUNT = Type("a whole number", lambda value: type(value) is int and 0 <= value < 2**63)
MAPPING = Type("a mapping", lambda value: isinstance(value, dict))


def require_types(
    entries: Mapping[str, Any],
    types: Mapping[str, Type],
    file: Path,
    within: str = "",
    others: Type | None = None,
) -> None:
    """Refuse entries of a JSON file that are not of their types.

    Parameters
    ----------
    within : prefix of the keys in messages
    others : type of further entries; any unless given
    """
    further = {} if others is None else {key: others for key in entries if key not in types}
    for key, wanted in {**types, **further}.items():
        if not wanted.fits(entries.get(key)):
            raise ResultError(
                f"{shortened(repr(entries.get(key)))} is not {wanted.name}",
                file=file,
                key=f"{within}{key}",
                way_out="put the file back, or solve the scene again",
            )

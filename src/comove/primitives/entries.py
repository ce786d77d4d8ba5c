"""Entries of the files of primitives: mappings that check what is in them, and errors that name file and key."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import LibraryError, near_name

Array = NDArray[np.float64]

LEARN_AGAIN = "learn it again: comove learn DEMO --out PRIMITIVE"
COPY_ANEW = f"copy it anew, or {LEARN_AGAIN}"


@dataclass(frozen=True)
class FileEntry:
    """A mapping in the file, with methods that check and return its values; errors name file and key."""

    content: Any
    key: str
    file: object

    def __post_init__(self) -> None:
        if not isinstance(self.content, dict):
            raise LibraryError(
                f"{shown(self.content)} is no mapping",
                file=self.file,
                key=self.key,
                way_out=COPY_ANEW,
            )

    def with_keys(self, known: Sequence[str]) -> FileEntry:
        """Raise unless the mapping has exactly these keys; return the part itself."""
        for key in self.content:
            if key not in known:
                raise self.wrong(key, "the key is not known", near_name(key, known))
        for key in known:
            self.value(key)
        return self

    def value(self, key: str) -> Any:
        """Return the value of a key, whatever it is."""
        if key not in self.content:
            raise self.wrong(key, "the key is missing", COPY_ANEW)
        return self.content[key]

    def part(self, key: str) -> FileEntry:
        """Return the mapping of a key."""
        return FileEntry(self.value(key), self._path(key), self.file)

    def parts(self, key: str) -> list[FileEntry]:
        """Return the mappings in the list of a key."""
        value = self.value(key)
        if not isinstance(value, list):
            raise self.wrong(key, f"{shown(value)} is no list", "a list of mappings belongs there")
        return [FileEntry(entry, f"{self._path(key)}[{i}]", self.file) for i, entry in enumerate(value)]

    def named(self, key: str) -> dict[str, FileEntry]:
        """Return the mappings of a key by their names."""
        inner = self.part(key)
        return {name: inner.part(name) for name in inner.content}

    def text(self, key: str) -> str:
        """Return a text."""
        value = self.value(key)
        if not isinstance(value, str) or len(value) > 10_000:
            raise self.wrong(key, f"{shown(value)} is no text", "a text in quotes belongs there")
        return value

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of texts."""
        value = self.value(key)
        if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
            raise self.wrong(key, f"{shown(value)} is no list of texts", "texts in quotes belong there")
        return tuple(value)

    def count(self, key: str) -> int:
        """Return a whole number from 1 on."""
        value = self.value(key)
        if isinstance(value, bool) or not isinstance(value, int) or value < 1:
            raise self.wrong(
                key, f"{shown(value)} is no number of things", "a whole number from 1 on belongs there"
            )
        return value

    def number(self, key: str) -> float:
        """Return a finite number."""
        return float(self.array(key, ()))

    def array(self, key: str, shape: tuple[int | None, ...]) -> Array:
        """Return finite numbers from nested lists as an array; None in `shape` stands for any length from 1 on."""
        value = self.value(key)
        found: tuple[int, ...] = ()
        level = [value]
        for wanted in shape:
            lengths = {len(entry) if isinstance(entry, list) else -1 for entry in level}
            if len(lengths) != 1 or min(lengths) < 1 or (wanted is not None and lengths != {wanted}):
                raise self._misshaped(key, value, shape)
            found += (lengths.pop(),)
            level = [entry for row in level for entry in row]
        for entry in level:
            if isinstance(entry, bool) or not isinstance(entry, (int, float)):
                raise self._misshaped(key, entry, shape)
            if not abs(entry) <= 1e300:
                raise self.wrong(key, f"{shown(entry)} is not finite", "finite numbers belong there")
        return np.array(level, dtype=float).reshape(found)

    def wrong(self, key: str, message: str, way_out: str) -> LibraryError:
        """Return the error of a key, to be raised."""
        return LibraryError(message, file=self.file, key=self._path(key), way_out=way_out)

    def _path(self, key: str) -> str:
        return f"{self.key}.{key}" if self.key else key

    def _misshaped(self, key: str, value: object, shape: tuple[int | None, ...]) -> LibraryError:
        sizes = " lists of ".join("some" if size is None else str(size) for size in shape)
        wanted = f"{sizes} numbers belong" if shape else "a number belongs"
        return self.wrong(key, f"{shown(value)} has another shape", f"{wanted} there")


def shown(value: object) -> str:
    """Return a value as messages show it."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."

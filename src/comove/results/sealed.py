"""Sealed result files: a JSON summary and an archive of arrays.

The summary holds the checksums of both. Every kind of result declares its files and entries once, and is written,
read and checked in one way. Entries may have been edited: their types and values are checked.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.brief import brief
from comove.errors import DemonstrationError, ResultError, shortened
from comove.io.arrays import read_arrays
from comove.io.drafts import steadily
from comove.io.files import telling, whole_file
from comove.io.folders import require_folder


def number(value: object) -> float | None:
    """Return a value of a JSON file if finite, else None."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        return float(value) if math.isfinite(value) else None
    except OverflowError:
        return None


def agrees(stated: object, right: float, within: float) -> bool:
    """Return whether a stated value is a number close to another."""
    found = number(stated)
    return found is not None and abs(found - right) <= within


@dataclass(frozen=True)
class Type:
    """The type of an entry of a JSON file: name and test."""

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
    """Raise ResultError if entries of a JSON file have other types.

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


Arrays = dict[str, NDArray[Any]]
Summary = dict[str, Any]


@dataclass(frozen=True, eq=False)
class Stored:
    """Contents of a part of a result folder.

    Attributes
    ----------
    folder : path of the folder
    summary : contents of the part's JSON file
    arrays : contents of its archive
    """

    __repr__ = brief

    folder: Path
    summary: Summary
    arrays: Arrays


SEAL = "summary_sha256"
AGAIN = "solve the scene again"
FITS = 1e-9  # m, s and of a quaternion's length, to which what a result says twice agrees
SAME = 1e-6  # relative, by which measures may differ from those of the summary


def near(name: str, value: float) -> float:
    """Return the tolerance of a measure in the summary."""
    return SAME * max(1e-3, abs(value))


def checksum(arrays: Mapping[str, Any]) -> str:
    """Compute the SHA-256 of arrays: their names, types, shapes and bytes."""
    digest = hashlib.sha256()
    for name in sorted(arrays):
        array = np.ascontiguousarray(arrays[name])
        digest.update(f"{name} {array.dtype.str} {array.shape}\n".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()


def finite(value: float | None) -> float | None:
    """Return a number for JSON, None if it is infinite or nan."""
    return value if value is not None and math.isfinite(value) else None


def read_json(path: Path, hint: str, max_bytes: int = 2**20) -> dict[str, Any]:
    """Read an object from a JSON file of at most `max_bytes`.

    Raises
    ------
    ResultError
        If it cannot be read or holds something else; `hint` is the advice.
    """
    if not path.is_file():
        raise ResultError(
            f"it holds no {path.name}", file=path.parent, way_out=f"name another folder, or {hint}"
        )
    try:
        if path.stat().st_size > max_bytes:
            raise ValueError(f"it is larger than {max_bytes >> 20} MB")
        data = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse_constant)
        if not isinstance(data, dict):
            raise ValueError("it is no JSON object")
    except (OSError, ValueError, RecursionError) as error:
        raise ResultError(f"it cannot be read: {error}", file=path, way_out=hint) from error
    return data


def _refuse_constant(text: str) -> float:
    raise ValueError(f"it holds {text}")


def _accept(summary: Summary, file: Path) -> None:
    """Accept entries of all types."""


@dataclass(frozen=True)
class ResultKind:
    """A kind of result: the names of its files and their entries.

    Attributes
    ----------
    summary, arrays : names of the two files
    checksum : entry of the summary that holds the checksum of the arrays
    made_by : command that makes the files
    hint : advice where they cannot be used
    required, optional : names of the arrays
    unsealed : entries that differ between runs of one seed, which the summary's checksum leaves out
    outdated : names of files derived from an earlier summary, which are removed with it
    require_entries : function of a summary and its path that raises `ResultError` for entries of other types
    """

    summary: str
    arrays: str
    checksum: str
    made_by: str
    hint: str
    required: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    unsealed: tuple[str, ...] = ()
    outdated: tuple[str, ...] = ()
    require_entries: Callable[[Summary, Path], None] = _accept

    def write(self, folder: Path, summary: Mapping[str, Any], arrays: Mapping[str, Any]) -> Summary:
        """Write both files into an existing folder; return the sealed summary.

        The summary appears last, right after the arrays, so that an interruption is detected.

        Raises
        ------
        ResultError
            If the folder cannot be written.
        """
        sealed = {**summary, self.checksum: checksum(arrays)}
        sealed[SEAL] = self.seal(sealed)
        with whole_file(folder / self.summary, ResultError) as told:
            told.write(json.dumps(sealed, indent=2, allow_nan=False).encode() + b"\n")
            told.flush()
            os.fsync(told.fileno())  # so that nothing is left to do between the two files but to name them
            with whole_file(folder / self.arrays, ResultError) as file:
                np.savez(file, **arrays)
                for name in self.outdated:
                    with telling(folder / name, "replaced", ResultError):
                        (folder / name).unlink(missing_ok=True)
        return sealed

    def read(self, folder: str | Path, *, whole: bool = False) -> tuple[Summary, Arrays]:
        """Read the summary and the arrays from a folder.

        Parameters
        ----------
        whole : whether to refuse files that may not be shown: a checksum does not fit, or an entry is of another type

        Raises
        ------
        ResultError
            If the folder or a file is missing, incomplete or unreadable, or not whole.
        """
        summary, arrays = steadily(Path(folder), lambda: self._read(require_folder(folder, self.made_by)))
        if whole:
            for name, key, why in self._broken(summary, arrays):
                way_out = f"put the file back, or {self.hint}"
                told = why if key is None else f"it was edited: {why}"
                raise ResultError(told, file=Path(folder) / name, key=key, way_out=way_out)
            self.require_entries(summary, Path(folder) / self.summary)
        return summary, arrays

    def _read(self, folder: Path) -> tuple[Summary, Arrays]:
        summary = read_json(folder / self.summary, self.hint)
        try:
            return summary, read_arrays(folder / self.arrays, self.required, self.optional)
        except DemonstrationError as error:
            raise ResultError(
                error.message, file=folder / self.arrays, key=error.key, way_out=self.hint
            ) from error

    def seal(self, summary: Mapping[str, Any]) -> str:
        """Compute the SHA-256 of all entries that repeated runs share. The checksum itself is left out too."""
        entries = {key: value for key, value in summary.items() if key not in (SEAL, *self.unsealed)}
        return hashlib.sha256(json.dumps(entries, sort_keys=True).encode()).hexdigest()

    def broken_seals(self, summary: Mapping[str, Any], arrays: Mapping[str, Any]) -> list[str]:
        """List the checksums that do not match, in words."""
        return [f"{name} was edited: {why}" for name, _, why in self._broken(summary, arrays)]

    def _broken(
        self, summary: Mapping[str, Any], arrays: Mapping[str, Any]
    ) -> Iterator[tuple[str, str | None, str]]:
        if summary.get(self.checksum) != checksum(arrays):
            yield self.arrays, None, f"its checksum is not the one in {self.summary}"
        if summary.get(SEAL) != self.seal(summary):
            yield self.summary, SEAL, "its own checksum does not fit"

    def mistyped(self, summary: Summary) -> list[str]:
        """List the first entry of another type, in words."""
        try:
            self.require_entries(summary, Path(self.summary))
        except ResultError as error:
            return [f"{self.summary} was edited: {error.key}: {error.message}"]
        return []

    def require_shapes(
        self,
        arrays: Arrays,
        shapes: Mapping[str, tuple[int, ...]],
        folder: Path = Path(),
        *,
        fewest: int = 2,
        loose: Collection[str] = (),
        truths: Collection[str] = (),
    ) -> None:
        """Raise ResultError for unsuitable arrays: of other shape or type, or not finite unless `loose`."""
        for name, shape in shapes.items():
            found, kind = arrays[name], np.dtype(bool if name in truths else float)
            if found.shape != shape or found.dtype != kind:
                told = f"it holds {found.dtype.name} of shape {found.shape}, not {kind.name} of shape {shape}"
            elif len(found) < fewest:
                told = f"it has {len(found)} steps, and {fewest} are needed at least"
            elif name not in loose and not np.isfinite(found).all():
                told = "it holds nan or infinite numbers"
            else:
                continue
            raise ResultError(told, file=folder / self.arrays, key=name, way_out=self.hint)

    def differences(
        self,
        stated: Mapping[str, Any],
        right: Mapping[str, float | None],
        within: Callable[[str, float], float] = near,
        prefix: str = "",
    ) -> list[str]:
        """List the summary's measures that are not the motion's, in words.

        Parameters
        ----------
        stated, right : measures in the summary, and those of the motion; not finite ones are null in a summary
        within : function of name and right value of a measure that returns by how much it may differ
        prefix : beginning of the names in messages
        """
        reasons = []
        for name, value in right.items():
            said, own = stated.get(name), finite(value)
            if said is not None if own is None else not agrees(said, own, within(name, own)):
                reasons.append(
                    f"{self.summary} says {prefix}{name} = {shortened(str(said))}, the motion's is "
                    f"{own if own is None else format(own, '.9g')}"
                )
        return reasons

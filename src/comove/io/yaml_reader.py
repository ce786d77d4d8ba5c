"""Strict reader of YAML mappings that records lines of keys.

Python's YAML libraries accept duplicate keys (the last wins), read ``1e3`` as text, ``010`` as 8, ``12:30:00`` as
45000 and ``no`` as False, and follow aliases until memory is exhausted. This reader works on the parser's events: it
refuses duplicate keys, tags, several documents and deep nesting before anything is built. Values that aliases
(``*name``) repeat from an earlier anchor (``&name``), also by the merge key (``<<: *name``), are copied, up to a
total of `MAX_REPEATED` values. Plain values are read as people write them:

============================  =======================================================
written                       read as
============================  =======================================================
``3  -3  010``                int (decimal: 10)
``0.5  .5  1.  +1.5  1e3``    float
``.inf  -.inf  .nan``         float (refused later where a finite number is wanted)
``true  false``               bool (also ``True``, ``TRUE``); ``yes no on off`` are text
``null  ~`` or nothing        None
anything else                 text, ``0x10``, ``0o7``, ``1_000``, ``0,5``, ``12:30:00`` too
============================  =======================================================

Keys are always text, as written.
"""

from __future__ import annotations

import copy
import re
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import yaml

from comove.errors import SceneError, near_name

MAX_BYTES = 1_000_000
MAX_DEPTH = 64
MAX_REPEATED = 20_000  # values that aliases may repeat in all
TOO_DEEP, FLATTER = f"the nesting is deeper than {MAX_DEPTH} levels", "flatten it, or close the brackets"
SUFFIXES = (".yaml", ".yml")
MAX_NAMES = 12
"""How many files a message lists."""

Lines = dict[tuple[str | int, ...], int]
"""Key path, such as ``("obstacles", 0, "size")``, to the line it stands in, counted from 1."""

_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_MERGE = "<<"
_INT = re.compile(r"[-+]?[0-9]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
_INT_DIGITS = 300
"""Longer whole numbers exceed every float (and Python's own limit of digits)."""
_CONSTANTS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL")),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
_SYNTAX = {
    "mapping values are not allowed in this context": (
        "a ':' stands where no key can stand",
        "check the indentation, and put text that contains ': ' in quotes",
    ),
    "did not find expected ',' or ']'": (
        "the list opened with '[' lacks a ',' or its ']'",
        "close it, or separate its entries by commas",
    ),
    "did not find expected ',' or '}'": (
        "the mapping opened with '{' lacks a ',' or its '}'",
        "close it, or separate its keys by commas",
    ),
    "did not find expected key": (
        "the line does not fit the mapping it stands in",
        "write 'key: value', indented as the keys above it",
    ),
    "did not find expected '-' indicator": (
        "the line does not fit the list it stands in",
        "start the entry with '- ', indented as the entries above it",
    ),
    "found unexpected end of stream": ("a quote is opened and never closed", "close the quote"),
}


def read_yaml(path: str | Path) -> tuple[dict[str, Any], Lines]:
    """Read the mapping in the YAML file at `path`.

    Parameters
    ----------
    path
        A UTF-8 file of at most 1 MB that holds one document.

    Returns
    -------
    data : dict of str, int, float, bool, None, list and dict
    lines : the line of each key and each list entry, counted from 1, by key path

    Raises
    ------
    SceneError
        If the file cannot be read; with file, line and correction.
    """
    text = _read_text(Path(path))
    try:
        return _Builder(path).document(yaml.parse(text, Loader=_LOADER))
    except yaml.YAMLError as error:
        raise _syntax_error(error, text, path) from None


def plain_value(text: str) -> str | int | float | bool | None:
    """Read an unquoted value by the table above.

    >>> [plain_value(text) for text in ("010", "1e3", ".5", "no", "12:30:00", "0x10", "~")]
    [10, 1000.0, 0.5, 'no', '12:30:00', '0x10', None]
    """
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _INT.fullmatch(text) and len(text) <= _INT_DIGITS:
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _NOT_FINITE.fullmatch(text):
        return float(text.replace(".", ""))
    return text


def near_files(folder: Path, name: str, suffixes: tuple[str, ...]) -> str:
    """Return a text that lists similar files in a folder. It names the files with one of the `suffixes`, and the one
    nearest to `name`."""
    if not folder.is_dir():
        return f"the folder {folder} does not exist either"
    names = sorted(entry.name for entry in folder.iterdir() if entry.suffix.lower() in suffixes)
    if not names:
        return f"no {' or '.join(filter(None, suffixes)) or 'such'} file is in {folder}"
    guess, known, listed = near_name(name, names).partition("known: ")
    return guess + (known + listed if len(names) <= MAX_NAMES else f"{len(names)} such files are there")


class _Anchored(NamedTuple):
    """Anchored node: value, size, depth, and lines by path."""

    value: Any
    size: int
    depth: int
    lines: Lines


class _Builder:
    """Builder of plain data from parser events, with lines of keys."""

    def __init__(self, file: str | Path):
        self.file = file
        self.lines: Lines = {}
        self.anchors: dict[str, _Anchored] = {}
        self.repeated = 0

    def document(self, events: Iterator[yaml.Event]) -> tuple[dict[str, Any], Lines]:
        """Read the only document, which holds a mapping."""
        next(events)  # the stream starts
        if isinstance(next(events), yaml.StreamEndEvent):
            raise SceneError("the file is empty", file=self.file, way_out="write 'key: value' lines")
        event = next(events)
        data = self.node(event, events, ())
        if not isinstance(data, dict):
            found = "a list" if isinstance(data, list) else "nothing" if data is None else "a single value"
            raise self.refusal(event, f"the file holds {found}, not a mapping", "write 'key: value' lines")
        next(events)  # the document ends
        event = next(events)
        if not isinstance(event, yaml.StreamEndEvent):
            raise self.refusal(event, "a second document starts here", "keep one document, without '---'")
        return data, self.lines

    def node(self, event: yaml.Event, events: Iterator[yaml.Event], path: tuple[str | int, ...]) -> Any:
        """Read the node that starts with `event`."""
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, path)
        self._refuse_tag(event)
        before = len(self.lines)
        if isinstance(event, yaml.ScalarEvent):
            value = event.value if event.style else plain_value(event.value)
        elif len(path) >= MAX_DEPTH:
            raise self.refusal(event, TOO_DEEP, FLATTER)
        elif isinstance(event, yaml.SequenceStartEvent):
            value = self._sequence(events, path)
        else:
            value = self._mapping(events, path)
        if event.anchor is not None:
            own = islice(reversed(self.lines.items()), len(self.lines) - before)  # lines are added in order
            lines = {place[len(path) :]: line for place, line in own}
            self.anchors[event.anchor] = _Anchored(value, *_extent(value), lines)
        return value

    def _alias(self, event: yaml.Event, path: tuple[str | int, ...]) -> Any:
        """Copy the node that an alias repeats."""
        anchored = self.anchors.get(event.anchor)
        if anchored is None:
            known = f"known before it: {', '.join(self.anchors)}" if self.anchors else "write the value out"
            raise self.refusal(event, f"the alias '*{event.anchor}' repeats no anchor before it", known)
        self.repeated += anchored.size
        if self.repeated > MAX_REPEATED:
            message = f"the aliases up to '*{event.anchor}' repeat more than {MAX_REPEATED} values"
            raise self.refusal(event, message, "repeat less, or write the values out")
        if len(path) + anchored.depth > MAX_DEPTH:
            raise self.refusal(event, TOO_DEEP, FLATTER)
        self.lines |= {(*path, *place): line for place, line in anchored.lines.items()}
        return copy.deepcopy(anchored.value)

    def refusal(self, event: yaml.Event, message: str, way_out: str) -> SceneError:
        """Return an error that names the line of `event`."""
        return SceneError(message, file=self.file, key=f"line {_line(event)}", way_out=way_out)

    def _sequence(self, events: Iterator[yaml.Event], path: tuple[str | int, ...]) -> list[Any]:
        items: list[Any] = []
        while not isinstance(event := next(events), yaml.SequenceEndEvent):
            place = (*path, len(items))
            self.lines[place] = _line(event)
            items.append(self.node(event, events, place))
        return items

    def _mapping(self, events: Iterator[yaml.Event], path: tuple[str | int, ...]) -> dict[str, Any]:
        items: dict[str, Any] = {}
        merged: dict[str, Any] = {}
        while not isinstance(event := next(events), yaml.MappingEndEvent):
            key = self._key(event)
            place = (*path, key)
            if key == _MERGE and not event.style:
                merged = self._merged(event, events, path) | merged
                continue
            if key in items:
                both = f"in line {self.lines[place]} and in line {_line(event)}"
                raise self.refusal(event, f"the key {key!r} is given twice, {both}", "keep one of them")
            self.lines[place] = _line(event)
            items[key] = self.node(next(events), events, place)
        return merged | items

    def _merged(
        self, key: yaml.Event, events: Iterator[yaml.Event], path: tuple[str | int, ...]
    ) -> dict[str, Any]:
        """Read a merge key's mappings, of which the first takes precedence."""
        lines, self.lines = self.lines, {}
        value = self.node(next(events), events, path)
        lines, self.lines = self.lines, lines
        parts = value if isinstance(value, list) else [value]
        if not all(isinstance(part, dict) for part in parts):
            raise self.refusal(
                key, "the key '<<' merges no mapping", "write '<<: *NAME' of an anchor before it"
            )
        skipped = len(path) + isinstance(value, list)
        for place, line in lines.items():
            if len(place) > skipped:
                self.lines.setdefault((*path, *place[skipped:]), line)
        return {name: item for part in reversed(parts) for name, item in part.items()}

    def _key(self, event: yaml.Event) -> str:
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            raise self.refusal(event, "an alias or an anchor is used as a key", "write a name before the ':'")
        self._refuse_tag(event)
        if not isinstance(event, yaml.ScalarEvent):
            raise self.refusal(event, "a list or a mapping is used as a key", "write a name before the ':'")
        return event.value

    def _refuse_tag(self, event: yaml.Event) -> None:
        if event.tag is not None:
            way_out = "leave it out, and put text that starts with '!' in quotes"
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            raise self.refusal(event, f"the tag {tag!r} is not supported", way_out)


def _extent(value: Any) -> tuple[int, int]:
    """Return the number of values and the nesting depth of a node."""
    if not isinstance(value, list | dict):
        return 1, 0
    parts = [_extent(part) for part in (value.values() if isinstance(value, dict) else value)]
    return 1 + sum(size for size, _ in parts), 1 + max((depth for _, depth in parts), default=0)


def _line(event: yaml.Event) -> int:
    return event.start_mark.line + 1


def _read_text(path: Path) -> str:
    """Read a regular UTF-8 file of at most `MAX_BYTES`. The size is checked before anything is kept."""
    try:
        if path.is_dir():
            raise SceneError("is a folder, not a file", file=path, way_out=near_files(path, "", SUFFIXES))
        if not path.exists():
            raise SceneError(
                "there is no such file", file=path, way_out=near_files(path.parent, path.name, SUFFIXES)
            )
        if not path.is_file():
            raise SceneError("is not a regular file", file=path, way_out="name a YAML file")
        with path.open("rb") as stream:
            raw = stream.read(MAX_BYTES + 1)
    except OSError as error:
        reason = (error.strerror or "it cannot be opened").lower()
        raise SceneError(f"cannot be read: {reason}", file=path, way_out="check name and rights") from None
    if len(raw) > MAX_BYTES:
        message = f"the file is larger than {MAX_BYTES // 1_000_000} MB"
        raise SceneError(message, file=path, way_out="name a scene file; it is far smaller")
    return _decode(raw, path)


def _decode(raw: bytes, path: Path) -> str:
    try:
        return raw.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = raw.count(b"\n", 0, error.start) + 1
        message = f"the byte 0x{raw[error.start]:02x} is not UTF-8"
        way_out = "save the file as UTF-8 text"
        raise SceneError(message, file=path, key=f"line {line}", way_out=way_out) from None


def _syntax_error(error: yaml.YAMLError, text: str, file: str | Path) -> SceneError:
    """Return the parser's error as one sentence, with line and column."""
    if isinstance(error, yaml.reader.ReaderError):
        return _control_character(error, text, file)
    mark = error.problem_mark or error.context_mark
    if error.problem and "nesting depth" in error.problem:  # newer parsers give up before this module does
        return SceneError(TOO_DEEP, file=file, key=f"line {mark.line + 1}", way_out=FLATTER)
    message, way_out = _SYNTAX.get(error.problem, (f"this is not YAML ({error.problem})", "correct the line"))
    if error.problem and error.problem.startswith("found character"):
        message, way_out = _wrong_start(text[mark.index : mark.index + 1])
    if error.context_mark and error.context_mark.line < mark.line:
        message += f" (begun in line {error.context_mark.line + 1})"
    key = f"line {mark.line + 1}, column {mark.column + 1}"
    return SceneError(message, file=file, key=key, way_out=way_out)


def _wrong_start(character: str) -> tuple[str, str]:
    if character == "\t":
        return "a tab stands where a value or the indentation starts", "use spaces"
    return f"{character!r} cannot start a value", "put the value in quotes"


def _control_character(error: yaml.reader.ReaderError, text: str, file: str | Path) -> SceneError:
    character = chr(error.character) if isinstance(error.character, int) else error.character
    line = text.count("\n", 0, max(text.find(character), 0)) + 1
    message = f"the character {character!r} is not allowed"
    return SceneError(message, file=file, key=f"line {line}", way_out="delete it")

"""The layout of text tables: encoding, separators, header and preamble.

The numbers are found first: the first row that splits into numbers and is followed by rows like it. Directly above
are the rows of the header: names, and units below or bodies and quantities above them. Everything before is a
preamble, of which the sampling rate and the unit of lengths are used.
"""

from __future__ import annotations

import codecs
import csv
import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from pathlib import Path

from comove.dmp.demonstrations.columns import Kind, bare_name, read_columns
from comove.dmp.demonstrations.samples import fault
from comove.dmp.demonstrations.units import LENGTHS, UNITS
from comove.errors import DemonstrationError

PREAMBLE = 200
"""Lines before the numbers that are looked at."""
LIKE = 4
"""Rows after the first one that have to look like it."""
SEPARATORS = (";", "\t", ",", "|", " ")
COMMENTS = ("#", "%")
MISSING = ("", "nan", "-nan", "+nan", "na", "n/a", "null", "none", "-", "--")
"""Cells, in lower case, in which nothing was measured."""
_NUMBER = re.compile(r"[+-]?(?:[0-9]+[.,]?[0-9]*|[.,][0-9]+)(?:[eE][+-]?[0-9]+)?")
MAX_COLUMNS, MAX_NAME = 1000, 200
"""Columns of a file, and characters of a column's name."""
_DAY = r"(?:[0-9]{4}([-/.])[0-9]{1,2}\1[0-9]{1,2}|[0-9]{1,2}([/.])[0-9]{1,2}\2[0-9]{4})"
_HOURS = r"(?:[0-9]{1,2}:[0-9]{2}:[0-9]{2}(?:[.,][0-9]+)?|[0-9]{1,3}:[0-9]{2}[.,][0-9]+)"
_DATE = re.compile(rf"{_DAY}(?:[T ]{_HOURS} ?(?:Z|[+-][0-9]{{2}}:?[0-9]{{2}})?)?|{_HOURS}")
_QUANTITIES = {"position", "rotation", "orientation", "quaternion", "translation", "velocity", "acceleration"}
_RATES = (
    "export frame rate", "export rate", "capture frame rate", "datarate", "frequency", "frame rate", "framerate",
    "sample rate", "samplerate", "sampling rate", "sampling frequency", "update rate", "rate", "fps", "hz",
)  # fmt: skip
_LENGTH_UNITS = ("length units", "units", "unit", "length unit")
_VICON = {"trajectories", "objects", "joints", "model outputs", "global angle", "segments"}
_OF_VICON = re.compile(r"(?:global|local) angle \([^()]*\) ", re.IGNORECASE)
"""What Vicon writes before the name of a segment."""
_IDENTITIES = ("id", "parent")
"""Rows of a header that hold numbers of bodies."""
_QUALISYS = ("no_of_frames", "no_of_markers", "marker_names")


@dataclass(frozen=True)
class Header:
    """The rows of a header, and the lowest row's number of cells. Rows are () where there is none of a kind."""

    names: tuple[str, ...] = ()
    bodies: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    units: tuple[str, ...] = ()
    n_named: int = 0


@dataclass(frozen=True)
class Preamble:
    """The statements in the lines above a header.

    Attributes
    ----------
    rate : samples a second [Hz]
    unit, angles : units of lengths and of angles
    title : first line, where it describes the numbers
    """

    rate: float | None
    unit: str | None
    angles: str | None
    title: str


@dataclass(frozen=True)
class Layout:
    """Layout of the numbers of a table in its file.

    Attributes
    ----------
    path, encoding : the file and the encoding of its text
    separator : character between columns; a blank for any number of blanks
    decimal_comma : whether numbers may have commas for points
    first : number of the first row of numbers, in lines of the file from 1
    n_cells : number of columns
    header : rows directly above the numbers
    preamble : statements above the header
    sample : cells of the first rows of numbers
    """

    path: Path
    encoding: str
    separator: str
    decimal_comma: bool
    first: int
    n_cells: int
    header: Header
    preamble: Preamble
    sample: tuple[tuple[str, ...], ...]

    def rows(self) -> Iterator[tuple[int, str]]:
        """Iterate over number and text of all rows of numbers. Blank lines and comments are skipped."""
        for row, line in lines_of(self.path, self.encoding):
            if row >= self.first and line.strip() and not line.lstrip().startswith(COMMENTS):
                yield row, line

    def cells(self, line: str) -> list[str]:
        """Return the cells of a line."""
        return split(line, self.separator)

    def sampled(self, number: int) -> list[str]:
        """Return the cells of a column in the first rows."""
        return [row[number] for row in self.sample if number < len(row)]

    def is_number(self, cell: str) -> bool:
        """Return whether a cell is a number in this table."""
        return is_number(cell) and ("," not in cell or self.decimal_comma)


def lines_of(path: Path, encoding: str) -> Iterator[tuple[int, str]]:
    """Iterate over number, from 1, and text of each line.

    Raises
    ------
    DemonstrationError
        If it is no text in this encoding.
    """
    try:
        with open(path, encoding=encoding, newline=None) as file:
            yield from enumerate(file, start=1)
    except UnicodeDecodeError as error:
        raise DemonstrationError(
            f"it begins as a text in {encoding.upper()}, and is none",
            file=path,
            way_out="save it as UTF-8 text",
        ) from error


def encoding_of(path: Path) -> str:
    """Return the encoding of a text. It is that of its mark, UTF-16 where half the bytes are zero, UTF-8, or Latin-1.

    Raises
    ------
    DemonstrationError
        If the file is no text.
    """
    with open(path, "rb") as file:
        head = file.read(2**12)
        for mark, encoding in (
            (codecs.BOM_UTF8, "utf-8-sig"),
            (codecs.BOM_UTF32_LE, "utf-32"),
            (codecs.BOM_UTF16_LE, "utf-16"),
            (codecs.BOM_UTF16_BE, "utf-16"),
        ):
            if head.startswith(mark):
                return encoding
        if b"\0" in head:
            for zeros, encoding in ((head[1::2], "utf-16-le"), (head[::2], "utf-16-be")):
                if zeros.count(b"\0") > 0.9 * len(zeros):
                    return encoding
            raise fault(path, None, "it is no text", "name a text table, or give the file its right suffix")
        decoder = codecs.getincrementaldecoder("utf-8")()
        try:
            while head:
                decoder.decode(head)
                head = file.read(2**20)
            decoder.decode(b"", final=True)
        except UnicodeDecodeError:
            return "latin-1"
    return "utf-8"


def split(line: str, separator: str) -> list[str]:
    """Return a line's cells without surrounding blanks and quotation marks."""
    if separator == " ":
        parts = line.split()
    elif '"' in line:
        parts = next(csv.reader([line.strip("\r\n")], delimiter=separator, skipinitialspace=True), [])
    else:
        parts = line.split(separator)
    return [part.strip().strip('"').strip() for part in parts]


def is_number(cell: str) -> bool:
    """Return whether a cell is a finite number, with point or comma."""
    return _NUMBER.fullmatch(cell) is not None


def is_missing(cell: str) -> bool:
    """Return whether a cell marks a missing measurement."""
    return cell.strip().lower() in MISSING


def is_time(cell: str) -> bool:
    """Return whether a cell is a date or a time of day."""
    return _DATE.fullmatch(cell) is not None


def is_finite(cell: str) -> bool:
    """Return whether a cell is a finite float, or a date."""
    try:
        return bool(math.isfinite(float(cell.replace(",", "."))))
    except ValueError:
        return is_time(cell)


def layout_of(path: Path, delimiter: str | None = None) -> Layout:
    """Return the layout of a text table.

    Parameters
    ----------
    path : file that exists
    delimiter : separator of columns; found unless given

    Raises
    ------
    DemonstrationError
        If the file is empty, is no text, or there is no row of numbers in its first lines.
    """
    encoding = encoding_of(path)
    head = list(islice(lines_of(path, encoding), PREAMBLE + LIKE + 1))
    if not any(line.strip() for _, line in head):
        raise fault(path, None, "the file is empty", "name a recording")
    found = [
        (at, separator, score)
        for separator in ((delimiter,) if delimiter else SEPARATORS)
        for at, score in _first_numbers(head, separator)
    ]
    if not found:
        raise _no_numbers(path, head)
    at, separator, _ = max(found, key=lambda one: (one[2], -one[0]))
    body = [(row, line) for row, line in head[at:] if line.strip() and not line.lstrip().startswith(COMMENTS)]
    sample = [cells for _, line in body[: LIKE + 1] if _score(cells := split(line, separator))]
    n_cells = Counter(map(len, sample)).most_common(1)[0][0]
    numbers = [cell for row in sample for cell in row if is_number(cell)]
    decimal_comma = separator != "," and not any("." in cell for cell in numbers)
    header = _header(head[:at], separator, n_cells)
    _require_as_many(path, header, sample, head[: at + 1], separator)
    said = _statements([line for _, line in head[:at]], separator)
    is_qualisys = any(key in said for key in _QUALISYS)
    if is_qualisys and not header.names:
        markers = _markers(head[:at])
        if markers and n_cells == 3 * len(markers):
            bodies = tuple(marker for marker in markers for _ in "XYZ")
            header = replace(header, names=tuple("XYZ" * len(markers)), bodies=bodies)
    unit = next((UNITS.get(said[key].lower()) for key in _LENGTH_UNITS if key in said), None)
    unit = "mm" if is_qualisys else unit  # which writes lengths in mm, and says so nowhere
    preamble = Preamble(
        next((_positive(said[key]) for key in _RATES if _positive(said.get(key, "")) is not None), None),
        unit if unit in LENGTHS else None,
        {"yes": "deg", "no": "rad"}.get(said.get("indegrees", "").lower()),
        head[0][1].strip(f"{separator}\n ") if "indegrees" in said else "",
    )
    sampled = tuple(map(tuple, sample))
    return Layout(path, encoding, separator, decimal_comma, head[at][0], n_cells, header, preamble, sampled)


def _first_numbers(head: Sequence[tuple[int, str]], separator: str) -> Iterator[tuple[int, int]]:
    """Yield the place and count of the first row of numbers."""
    rows = [
        (at, split(line, separator))
        for at, (_, line) in enumerate(head)
        if line.strip() and not line.lstrip().startswith(COMMENTS)
    ]
    scores = [_score(cells) for _, cells in rows]
    for place, (at, cells) in enumerate(rows):
        if not scores[place]:
            continue
        after = range(place + 1, min(place + 1 + LIKE, len(rows)))
        alike = all(abs(len(rows[k][1]) - len(cells)) <= 1 and scores[k] for k in after)
        named = place > 0 and not scores[place - 1] and _are_names(rows[place - 1][1], len(cells))
        if alike or named or (len(after) > 1 and _is_followed(rows, scores, place)):
            yield at, scores[place]
            return


def _is_followed(rows: Sequence[tuple[int, list[str]]], scores: Sequence[int], place: int) -> bool:
    """Return whether the next row is like this one. A damaged row further down is thus reported by its number."""
    n_cells = len(rows[place][1])
    return len(rows[place + 1][1]) == n_cells and scores[place + 1] == scores[place]


def _score(cells: Sequence[str]) -> int:
    """Return a row's count of numbers, 0 if it is no recording's."""
    if len(cells) < 2:
        return 0
    numbers = sum(is_number(cell) for cell in cells)
    times = sum(is_time(cell) for cell in cells)
    measured = sum(not is_missing(cell) for cell in cells)
    leads = is_number(cells[0]) or is_time(cells[0]) or (is_missing(cells[0]) and numbers > 1)
    if not leads and (len(cells) < 3 or numbers < 2):
        return 0
    return numbers + times if 2 * (numbers + times) >= measured and numbers + times else 0


def _header(above: Sequence[tuple[int, str]], separator: str, n_cells: int) -> Header:
    """Return the rows of the header, as far as there are any."""
    rows: list[list[str]] = []
    n_named = 0
    for _, line in reversed(above):
        marked = line.lstrip().startswith(COMMENTS)
        if not line.strip(" \t\r\n;,|") or (marked and rows):
            if rows:
                break
            continue
        text = line.strip()[1:] if line.lstrip()[:2] in ("# ", "% ") or line.strip()[:1] == "#" else line
        cells = split(text.strip("\r\n"), separator)
        if not rows and (len(cells) < 2 or abs(len(cells) - n_cells) > 1):
            others = [split(text, mark) for mark in SEPARATORS]  # names may have separators of their own
            cells = next((other for other in others if len(other) == n_cells), cells)
            cells = max(others, key=len) if len(cells) < 2 else cells
        if len(cells) > n_cells:  # units behind names that are separated by blanks
            cells = _with_units(cells)
        if marked and not _are_names(cells, n_cells):
            continue
        if cells[0].lower() in _QUALISYS:
            break
        leads_blank = separator != " " and len(cells) > 2 and not cells[0]
        if not (n_cells - 1 <= len(cells) <= n_cells + 1 or (rows and leads_blank)):
            break
        label = next((cell.lower() for cell in cells[:2] if cell), "")
        if rows and label in _IDENTITIES:
            continue
        if _score(cells) if rows else any(map(is_number, cells)) and not leads_blank:
            break
        if rows and cells[0] and rows[-1][0] and sum(map(bool, cells)) == 1:  # a title
            break
        n_named = n_named or len(cells)
        rows.append((cells + [""] * n_cells)[: max(n_cells, len(cells))])
        if marked:
            break
    if not rows:
        return Header()
    units = tuple(rows.pop(0)) if len(rows) > 1 and _are_units(rows[0]) else ()
    if len(rows) > 1 and sum(map(bool, rows[0])) == 1:  # the name of the index stands below the others
        lowest = rows.pop(0)
        rows[0] = [low or above for low, above in zip(lowest, rows[0], strict=False)]
    names, above_names = rows[0], rows[1:]
    bodies: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    for row in above_names:
        label = next((cell.lower() for cell in row[:2] if cell), "")
        texts = {cell.lower() for cell in row if cell}
        if label == "type":
            types = tuple(row)
        elif texts & _QUANTITIES:
            kinds = kinds or tuple(row)
        elif not bodies:
            bodies = _filled(["" if cell.lower() == "name" else cell for cell in row], names)
    for number, name in enumerate(names):
        if not name and number < len(bodies) and number < 2:
            upper = next((row[number] for row in above_names if row[number]), "")
            if upper.lower() not in ("name", "type"):
                names[number] = upper
    bodies = tuple(
        "" if body in (name, names[n]) and n < 2 else body
        for n, (body, name) in enumerate(zip(bodies, names, strict=False))
    )
    return Header(tuple(names), bodies, kinds, types, units, n_named)


def _require_as_many(
    path: Path,
    header: Header,
    sample: Sequence[Sequence[str]],
    above: Sequence[tuple[int, str]],
    separator: str,
) -> None:
    """Raise if rows and the line of column names differ in cells."""
    names: Sequence[str] = header.names
    n_named = header.n_named
    for _, line in reversed(above[:-1]) if not names else ():
        if line.strip() and not line.lstrip().startswith(COMMENTS):
            others = [split(line, mark) for mark in (separator, *SEPARATORS)]
            names = next((one for one in others if len(one) > 1 and _are_names(one, len(one))), ())
            n_named = len(names)
            if names or not any(map(_score, others)):
                break
    n_cells = len(sample[0])
    n_named -= n_named > n_cells and not names[-1]
    n_cells -= n_cells > n_named and not any(row[-1] for row in sample)
    if names and n_named != n_cells:
        many = separator == "," and n_cells >= 2 * n_named
        raise fault(
            path,
            f"row {above[-1][0]}",
            f"it has {n_cells} cells and the header has {n_named}",
            "these look like decimal commas: separate the columns by semicolons"
            if many
            else "fill in or remove the row",
        )


def _with_units(cells: Sequence[str]) -> list[str]:
    """Return cells with units in brackets appended to their names."""
    joined: list[str] = []
    for cell in cells:
        if joined and re.fullmatch(r"[\[(].*[\])]", cell):
            joined[-1] += f" {cell}"
        else:
            joined.append(cell)
    return joined


def _filled(row: Sequence[str], names: Sequence[str]) -> tuple[str, ...]:
    """Return a row of bodies with each name repeated until the next."""
    filled, last = [], ""
    for cell, name in zip(row, names, strict=False):
        last = _OF_VICON.sub("", cell) or (last if name else "")
        filled.append(last)
    return tuple(filled)


def _are_names(cells: Sequence[str], n_cells: int) -> bool:
    if len(cells) != n_cells or any(map(is_number, cells)):
        return False
    kinds = {column.kind for column in read_columns(cells)}
    return bool(kinds & {Kind.TIME, Kind.POSITION, Kind.JOINT})


def _are_units(cells: Sequence[str]) -> bool:
    texts = [cell.strip("[]() ").lower() for cell in cells if cell.strip("[]() -")]
    return bool(texts) and all(
        text in UNITS or re.search(r"[/^]|^(n|nm|hz|%|v|mm\.n|n\.mm)$", text) for text in texts
    )


def _statements(lines: Sequence[str], separator: str) -> dict[str, str]:
    """Return a preamble's statements, `key: value`, `key, value`, or keys above values."""
    mark = separator if separator != " " else "\t"
    rows = [split(line.lstrip("#% ").rstrip(" \t\r\n;,|"), mark) for line in lines]
    said: dict[str, str] = {}
    paired: set[int] = set()
    for at, (cells, below) in enumerate(pairwise(rows)):
        if len(cells) > 2 and len(cells) == len(below) and not any(map(is_number, cells)) and _score(below):
            said |= {key.lower(): value for key, value in zip(cells, below, strict=True)}
            paired |= {at, at + 1}
        elif len(cells) == 1 and cells[0].lower() in _VICON and is_number(below[0]):
            said["rate"] = below[0]
    for at, cells in enumerate(rows):
        for key, value in zip(cells[::2], cells[1::2], strict=False) if at not in paired else ():
            said.setdefault(key.lower(), value)
        if len(cells) == 1 and (match := re.fullmatch(r"([^:=]+?)\s*[:=]\s*(.+?)", cells[0])):
            said.setdefault(match[1].lower(), match[2])
    return said


def _markers(above: Sequence[tuple[int, str]]) -> list[str]:
    for _, line in above:
        cells = split(line, "\t")
        if cells[0].upper() == "MARKER_NAMES":
            return [cell for cell in cells[1:] if cell]
    return []


def _positive(text: str) -> float | None:
    found = re.match(r"[0-9]+(?:[.,][0-9]+)?", text)
    value = float(found[0].replace(",", ".")) if found else 0.0
    return value if value > 0.0 else None


def _no_numbers(path: Path, head: Sequence[tuple[int, str]]) -> DemonstrationError:
    text = [line for _, line in head if line.strip()]
    names = max((split(line, separator) for line in text for separator in SEPARATORS), key=len)
    if len(text) == 1 and len(names) > 1:
        return fault(path, None, "there are no rows below the header", "record two rows at least")
    if sum(is_number(line.strip()) for line in text) > len(text) // 2:
        return fault(path, None, "it has a single column", "record time and positions, a row a sample")
    if text and text[0].strip() in ("header:", "---"):
        message = "it holds messages as `ros2 topic echo` prints them"
        return fault(
            path, None, message, "write a table: ros2 topic echo --csv TOPIC > FILE; or record a bag"
        )
    first = bare_name(text[0])[:40]
    return fault(
        path,
        None,
        f"there is no table of numbers in it; it begins with {first!r}",
        "give a table of a row a sample, or name the separator: --delimiter",
    )

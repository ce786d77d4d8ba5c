"""Recordings as text tables of other programs: any separator, column names, and units of length and time.

The layout is detected or given by options, in contrast to the project's own CSV (`formats.csv`): lines
before the header are skipped, units may follow a name in brackets (`X [mm]`, `t (ms)`), and where columns are not
separated by commas, numbers may have decimal commas.
"""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.formats.csv import MAX_BYTES, MAX_CELLS, MAX_COLUMNS
from comove.demonstrations.samples import AXES, MAX_ROWS, UNIT, Origin, RecordedSamples, fault
from comove.demonstrations.units import TIMES, require_unit
from comove.errors import OptionError, near_name
from comove.io.files import existing_file, telling

Array = NDArray[np.float64]

PREAMBLE = 200  # lines before the header that are passed over at most
CLOCKS = ("time", "t", "timestamp", "stamp", "seconds", "sec", "zeit", "elapsed")
SEPARATORS = (";", "\t", ",", " ")
SPELT = {"tab": "\t", "\\t": "\t", "space": " ", "comma": ",", "semicolon": ";"}
SLOW = 0.5  # s between samples: no recording of a movement is that slow
_UNIT = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]+)[\])]")


def read(
    path: str | os.PathLike[str],
    *,
    columns: Sequence[str] | None = None,
    delimiter: str | None = None,
    time: str | None = None,
    rate: float | None = None,
    unit: str | None = None,
) -> RecordedSamples:
    """Read one movement from a text table; its positions are in the unit that was given or that the header says.

    Parameters
    ----------
    path : file, UTF-8, of up to 2,000,000 rows
    columns : names, or numbers from 1, of the columns of positions; by default x, y and z in upper or lower case
    delimiter : separator of columns: a character, "tab" or "space"; by default detected
    time : name or number of the column of time, with a unit in brackets if the file does not contain it
        ("stamp [ms]"); by default found by its name
    rate : sampling rate [Hz], if there is no column of time
    unit : unit of the positions, for example "mm"; by default the one in brackets in the header, else metres

    Raises
    ------
    DemonstrationError
        If the file cannot be read with these options; names line, column and way out.
    OptionError
        If an option is out of range, or contradicts the file.
    """
    path = existing_file(Path(path), MAX_BYTES, f"keep up to {MAX_ROWS:,} rows")
    delimiter = None if delimiter is None else _separator(delimiter)
    if rate is not None and time is not None:
        raise OptionError(
            "both a column of time and a rate are given", key="rate", way_out="give one of them"
        )
    if rate is not None and (isinstance(rate, bool) or not 0 < rate < np.inf):
        raise OptionError(f"{rate!r} is no rate", key="rate", way_out="give samples a second, such as 100")
    with telling(path):
        lines = _lines(path)
    first, separator, names = _header(path, lines, columns, delimiter)
    rows = [(number, line) for number, line in lines if number >= first]
    places = _places(path, names, columns)
    clock, time_unit = (None, "s") if rate is not None else _clock(path, names, time)
    wanted = places if clock is None else [clock, *places]
    table = _numbers(path, rows, separator, wanted, names)
    seconds = np.arange(len(rows)) / rate if rate is not None else table[:, 0] * TIMES[time_unit or "s"]
    step = float(np.median(np.diff(seconds))) if len(rows) > 2 else 0.0
    if clock is not None and step > SLOW and time_unit is None:
        raise fault(
            path,
            names[clock],
            f"time passes in steps of {step:g} s, which looks like milliseconds",
            f"say so: time '{names[clock]} [ms]', or '{names[clock]} [s]' if it is right",
        )
    labels = tuple(names[place] for place in places)
    said = {found["unit"].strip().lower() for name in labels if (found := _UNIT.fullmatch(name))}
    own = unit if unit is not None else (said.pop() if len(said) == 1 else "m")
    own = require_unit(own, path)
    position = table[:, -len(places) :]
    origin = Origin(
        path,
        time=lambda sample: f"line {rows[sample][0]}, column {'' if clock is None else names[clock]}",
        position=lambda sample, dim: f"line {rows[sample][0]}, column {labels[dim]}",
    )
    stated = frozenset({UNIT} if unit is not None or said else ())
    return RecordedSamples(seconds, position, path.stem, (), own, stated=stated, origin=origin)


def _separator(text: str) -> str:
    found = SPELT.get(text.lower(), text)
    if len(found) != 1 or found.isalnum() or found in ".+-\"'#\n":
        raise OptionError(
            f"{text!r} cannot separate columns", key="delimiter", way_out="give ';', ',', 'tab' or 'space'"
        )
    return found


def _lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines with content, with their numbers from 1."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise fault(path, None, "the text is not UTF-8", "save it again as UTF-8") from error
    lines = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not lines:
        raise fault(path, None, "the file is empty", "name a recording")
    if len(lines) > MAX_ROWS + PREAMBLE:
        raise fault(path, None, f"it has more than {MAX_ROWS:,} rows", "keep every n-th row")
    return lines


def _header(
    path: Path, lines: list[tuple[int, str]], columns: Sequence[str] | None, delimiter: str | None
) -> tuple[int, str, list[str]]:
    """Return the number of the first row below the header, the separator, and the names, or numbers without names."""
    wanted = [name for name in columns or AXES[:1] if not name.isdigit()]
    seen: list[str] = []
    for number, line in lines[:PREAMBLE]:
        for separator in (delimiter,) if delimiter else SEPARATORS:
            names = _cells(line, separator)
            if len(names) > 1 and all(map(_is_number, names)) and not wanted:
                return number, separator, [str(i + 1) for i in range(len(names))]
            if wanted and len(names) > 1 and all(_found(name, names) is not None for name in wanted):
                if len(names) > MAX_COLUMNS:
                    raise fault(
                        path,
                        f"line {number}",
                        f"there are {len(names)} columns",
                        f"keep {MAX_COLUMNS} at most",
                    )
                return number + 1, separator, names
            if len(names) > len(seen) and not any(map(_is_number, names)):
                seen = names
    shown = ", ".join(name for name in seen[:12] if name)
    raise fault(
        path,
        "columns",
        f"no line names the column{'s' * (len(wanted) > 1)} {', '.join(wanted) or AXES[0]}",
        f"name those of the positions{f'; there are {shown}' if shown else ', or their numbers: 1,2,3'}",
    )


def _cells(line: str, separator: str) -> list[str]:
    parts = line.split() if separator == " " else line.split(separator)
    return [part.strip().strip('"').strip() for part in parts]


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True


def _bare(name: str) -> str:
    """Return a name without its unit, in lower case."""
    found = _UNIT.fullmatch(name)
    return (found["name"] if found else name).strip().lower()


def _found(name: str, names: list[str]) -> int | None:
    """Return the index of a column: by its exact name, its name without unit and case, or its number; else None."""
    if name in names:
        return names.index(name)
    alike = [i for i, other in enumerate(names) if _bare(other) == _bare(name)]
    if len(alike) == 1:
        return alike[0]
    if name.isdigit() and 1 <= int(name) <= len(names):
        return int(name) - 1
    return None


def _places(path: Path, names: list[str], columns: Sequence[str] | None) -> list[int]:
    """Return the indices of the columns of positions."""
    if columns is None:
        return [place for axis in AXES if (place := _found(axis, names)) is not None]
    places = []
    for name in columns:
        place = _found(name, names)
        if place is None:
            raise fault(path, "columns", f"there is no column {name!r}", near_name(name, names[:12]))
        if place in places:
            raise OptionError(f"{name!r} stands twice", key="columns", way_out="name every column once")
        places.append(place)
    return places


def _clock(path: Path, names: list[str], time: str | None) -> tuple[int, str | None]:
    """Return the column of time, and its unit; None if it is not said."""
    if time is not None:
        place = _found(time, names)
        place = _found(_bare(time), names) if place is None else place
    else:
        places = [_found(name, names) for name in CLOCKS]
        place = next((place for place in places if place is not None), None)
    if place is None:
        raise fault(
            path,
            "time",
            "there is no column of time" if time is None else f"there is no column {time!r}",
            f"name it, of {', '.join(names[:12])}; or give the rate in samples a second",
        )
    for name in (time or "", names[place]):
        if found := _UNIT.fullmatch(name):
            unit = found["unit"].strip().lower()
            if unit not in TIMES:
                raise fault(path, "time", f"the unit of time {unit!r} is not known", near_name(unit, TIMES))
            return place, unit
    return place, None


def _numbers(
    path: Path, rows: list[tuple[int, str]], separator: str, wanted: list[int], names: list[str]
) -> Array:
    """Return the wanted columns of all rows."""
    if len(rows) * len(wanted) > MAX_CELLS:
        raise fault(path, None, "it has too many numbers", "keep every n-th row")
    if not rows:
        raise fault(path, None, "there are no rows below the header", "record two at least")
    texts = [line if separator == "," else line.replace(",", ".") for _, line in rows]
    with contextlib.suppress(ValueError):
        return np.loadtxt(
            texts, delimiter=None if separator == " " else separator, usecols=wanted, comments=None, ndmin=2
        )
    for (number, _), text in zip(rows, texts, strict=True):  # the parser does not say where it stumbled
        cells = _cells(text, separator)
        if len(cells) <= max(wanted):
            raise fault(
                path,
                f"line {number}",
                f"it has {len(cells)} cells and the header has {len(names)}",
                "fill in or remove the row",
            )
        for place in wanted:
            if not _is_number(cells[place]):
                raise fault(
                    path,
                    f"line {number}, column {names[place]}",
                    f"{cells[place][:40]!r} is not a number" if cells[place] else "the cell is empty",
                    "fill in what was measured, or remove the row",
                )
    raise fault(path, None, "it cannot be read as a table of numbers", "write plain numbers")

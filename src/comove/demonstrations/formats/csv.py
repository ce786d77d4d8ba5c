"""Recordings as comma-separated text.

One movement has the header `time,x`, `time,x,y` or `time,x,y,z`; several manipulators recorded together
have `time,left.x,left.y,...,right.x,right.y,...`. The columns `qw,qx,qy,qz` (`left.qw`, ...) hold orientations,
quaternions of unit norm. Other coordinates are named with their unit: `elbow [rad]`, `left.elbow [rad]`. Time is in
seconds, positions are in metres, numbers have a decimal point, the encoding is UTF-8. Blank lines and lines that
begin with `#` are skipped. Rows are counted as in an editor: the first line of the file is row 1.

NumPy's C parser reads the rows; only if it refuses one are they searched for the bad cell.
"""

from __future__ import annotations

import contextlib
import os
import re
import warnings
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.samples import (
    AXES,
    MAX_ROWS,
    QUATERNION,
    Columns,
    Format,
    Origin,
    RecordedSamples,
    by_manipulator,
    fault,
)
from comove.errors import ComoveWarning, DemonstrationError, near_name
from comove.io.files import existing_file, telling, whole_file

MAX_BYTES = 512 * 2**20
MAX_LINE = 2**20
"""Bytes of one line."""
MAX_CELLS = 2**26
"""Numbers of one file."""
MAX_COLUMNS, MAX_NAME = 1000, 200
"""Columns of a file, and characters of a column's name."""
_UNIT = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\[\]]+)\]")
_MARKS = ",;\t\r\n"
"""What cannot stand in a name: it separates."""
_TOO_LONG = f"keep every n-th row: up to {MAX_ROWS:,} rows are read"
_PLAIN = "write commas between columns and points in numbers"
_EXAMPLE = "begin the file with a line such as time,x,y"


def read(path: str | os.PathLike[str]) -> dict[str, RecordedSamples]:
    """Read all movements of a CSV file.

    Parameters
    ----------
    path : file in the format of this module, up to 2,000,000 rows

    Returns
    -------
    demos : movement by manipulator, in the order of the columns; "" if the file names none

    Raises
    ------
    DemonstrationError
        The file cannot be read; names the row, the column and the way out.

    Warns
    -----
    ComoveWarning
        The last line has no line end: it may be incomplete.
    """
    path = existing_file(path, MAX_BYTES, _TOO_LONG)
    with telling(path):
        _check_length(path)
        names = _read_header(path)
        groups = _group(path, names)
        table = _read_table(path, names)
    return {
        manipulator: RecordedSamples(
            table[:, 0],
            name=f"{path.stem}.{manipulator}" if manipulator else path.stem,
            origin=_origin(path, [names[column] for column in group.position + group.orientation]),
            **group.of(table),
        )
        for manipulator, group in groups.items()
    }


def write(path: str | os.PathLike[str], demos: RecordedSamples | Mapping[str, RecordedSamples]) -> None:
    """Write movements to a CSV file, from which they are read again with the same numbers, bit by bit.

    Parameters
    ----------
    path : file to write; appears only when complete
    demos : one movement, or movements by manipulator with common time stamps; of up to 3 dimensions, or with
        names of the coordinates

    Raises
    ------
    DemonstrationError
        The movements do not fit into one file, or the file cannot be written.
    """
    demos = by_manipulator(demos, path)
    header, columns = ["time"], [next(iter(demos.values())).time]
    for name, demo in demos.items():
        _check_writable(path, name, demo)
        axes, unit = demo.axes or AXES[: demo.n_dims], "" if demo.unit == "m" else f" [{demo.unit}]"
        if demo.axes and not unit:
            unit = " [m]"
        columns.append(demo.position)
        cells = [f"{axis}{unit}" for axis in axes]
        if demo.orientation is not None:
            columns.append(demo.orientation)
            cells += QUATERNION
        header += [f"{name}.{cell}" if name else cell for cell in cells]
    table = np.column_stack(columns)
    with whole_file(path) as file:
        file.write(",".join(header).encode() + b"\n")
        at_a_time = 50_000  # rows
        for first in range(0, len(table), at_a_time):
            rows = table[first : first + at_a_time].tolist()
            file.write("".join([",".join(map(repr, row)) + "\n" for row in rows]).encode())


def _read_any(path: str | os.PathLike[str], **options: Any) -> dict[str, RecordedSamples]:
    from comove.demonstrations.formats import tables

    return {"": tables.read(path, **options)} if options else read(path)


FORMAT = Format(
    "text",
    _read_any,
    suffixes=(".csv",),
    write=write,
    options=frozenset({"columns", "delimiter", "time", "rate", "unit"}),
)


def _check_writable(path: object, name: str, demo: RecordedSamples) -> None:
    """Raise if the header cannot name the coordinates, the manipulator or the unit."""
    if demo.n_dims > len(AXES) and not demo.axes:
        raise fault(
            path,
            None,
            f"{demo.n_dims} dimensions without names have no columns in CSV",
            "name its axes, or use write_npz",
        )
    for what, text, marks in [
        ("manipulator's name", name, _MARKS),
        ("unit", demo.unit, _MARKS + "[]"),
        *(("axis", axis, _MARKS + ".[]") for axis in demo.axes),
    ]:
        named = bool(text) or what == "manipulator's name"
        if not named or text != text.strip(' "') or any(mark in text for mark in marks):
            raise fault(
                path,
                None,
                f"the {what} {text!r} cannot stand in a header",
                "use letters, digits and underscores",
            )


def _origin(path: Path, columns: list[str]) -> Origin:
    """Name samples by their row and column in the file."""

    def row(sample: int) -> int:
        return next(islice(_lines(path), 1 + sample, None))[0]

    return Origin(
        path,
        time=lambda sample: f"row {row(sample)}, column time",
        position=lambda sample, dim: f"row {row(sample)}, column {columns[dim]}",
        orientation=lambda sample: f"row {row(sample)}, columns {columns[-4]} to {columns[-1]}",
    )


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Iterate over (row, text) of all lines with content, the header first."""
    with open(path, encoding="utf-8-sig") as file:
        for row, line in enumerate(file, start=1):
            if line.strip() and not line.startswith("#"):
                yield row, line


def _check_length(path: Path) -> None:
    """Raise if a file has too many rows or too long a row, before any of it is parsed."""
    feeds = returns = line = 0
    with open(path, "rb") as file:
        while max(feeds, returns) <= MAX_ROWS + 1 and (chunk := file.read(2**16)):
            ends = [found for found in (chunk.find(b"\n"), chunk.find(b"\r")) if found >= 0]
            line += min(ends, default=len(chunk))
            if line > MAX_LINE:
                raise fault(
                    path,
                    f"row {max(feeds, returns) + 1}",
                    f"it has more than {MAX_LINE:,} characters",
                    f"write a row a sample, of up to {MAX_COLUMNS} columns",
                )
            if ends:
                line = len(chunk) - 1 - max(chunk.rfind(b"\n"), chunk.rfind(b"\r"))
            feeds += chunk.count(b"\n")
            returns += chunk.count(b"\r")
    if max(feeds, returns) > MAX_ROWS + 1:
        raise fault(path, None, f"it has more than {MAX_ROWS:,} rows", _TOO_LONG)


def _read_header(path: Path) -> list[str]:
    """Return the names of the columns; `time` is the first, and there are others."""
    try:
        row, line = next(_lines(path), (1, ""))
    except UnicodeDecodeError:
        raise _not_utf8(path) from None

    def wrong(message: str, way_out: str, column: str = "") -> DemonstrationError:
        key = f"header, column {column}" if column else f"row {row}"
        return fault(path, key, message, way_out)

    if not line:
        raise wrong("the file is empty", _EXAMPLE)
    names = [name.strip().strip('"').strip() for name in line.split(",", MAX_COLUMNS)]
    if len(names) > MAX_COLUMNS:
        raise wrong(
            f"there are {line.count(',') + 1} columns", f"keep those of the movement, {MAX_COLUMNS} at most"
        )
    if any(mark in line.strip() for mark in ";\t"):
        raise wrong(f"the columns are not separated by commas: {_short(line)}", _PLAIN)
    if any(map(_is_number, names)):
        raise wrong(f"numbers stand where the header is expected: {_short(line)}", _EXAMPLE)
    for column, name in enumerate(names, start=1):
        if len(name) > MAX_NAME:
            raise wrong(f"the name has {len(name)} characters", f"use {MAX_NAME} at most", str(column))
        if not name:
            raise wrong("the column has no name", f"name or remove it; {_EXAMPLE}", str(column))
        if name in names[: column - 1]:
            raise wrong(f"{name!r} names column {names.index(name) + 1} too", "rename one", str(column))
    if names[0] != "time":
        way_out = f"{near_name(names[0].lower(), ['time'])}; {_EXAMPLE}"
        raise wrong(f"the first column is {_short(names[0])}, not time", way_out, "1")
    if len(names) == 1:
        raise wrong("there are no positions beside time", _EXAMPLE)
    return names


def _group(path: Path, names: list[str]) -> dict[str, Columns]:
    """Return the columns of each manipulator, which is "" if the header names none."""
    columns: dict[str, dict[str, int]] = {}
    units: dict[str, dict[str, str | None]] = {}
    for column, name in enumerate(names[1:], start=1):
        named = _UNIT.fullmatch(name)
        manipulator, dot, axis = (named["name"] if named else name).rpartition(".")
        if not (named or axis in AXES or axis in QUATERNION) or not axis or bool(dot) != bool(manipulator):
            known = [f"{manipulator}{dot}{axis}" if manipulator else axis for axis in (*AXES, *QUATERNION)]
            raise fault(
                path,
                f"header, column {column + 1}",
                f"the name {_short(name)} is not known",
                f"{near_name(name.lower(), known)}, or a name with its unit such as elbow [rad]",
            )
        if axis in columns.setdefault(manipulator, {}):
            raise fault(path, f"header, column {column + 1}", f"{axis!r} stands twice", "rename one")
        columns[manipulator][axis] = column
        if axis not in QUATERNION or named:
            units.setdefault(manipulator, {})[axis] = named["unit"].strip() if named else None
    if "" in columns and len(columns) > 1:
        raise fault(
            path,
            "header",
            "some columns name a manipulator and some do not",
            "write NAME.x, NAME.y for every manipulator",
        )
    groups = {name: _one_group(path, name, found, units.get(name, {})) for name, found in columns.items()}
    shapes = {name: (len(group.position), len(group.orientation)) for name, group in groups.items()}
    for name, shape in shapes.items():
        largest = max(shapes.values())
        if shape != largest:
            raise _wrong_columns(path, name, columns[name])
    return groups


def _one_group(
    path: Path, manipulator: str, found: Mapping[str, int], units: Mapping[str, str | None]
) -> Columns:
    """Return the columns of one manipulator in order; columns without a unit are x, y, z in metres."""
    turned = [axis for axis in QUATERNION if axis in found and axis not in units]
    (first, unit), *others = ((axis, unit or "m") for axis, unit in units.items()) if units else [("", "m")]
    for axis, other in others:
        if other != unit:
            raise fault(
                path,
                "header",
                f"{first!r} is in {unit} and {axis!r} in {other}",
                "give all coordinates of a manipulator one unit",
            )
    bare = None in units.values()
    axes = tuple(sorted(units)) if bare else tuple(units)
    if len(turned) not in (0, 4) or not axes or (bare and axes != AXES[: len(axes)]):
        raise _wrong_columns(path, manipulator, found)
    return Columns([found[axis] for axis in axes], [found[axis] for axis in turned], axes, unit)


def _wrong_columns(path: Path, manipulator: str, found: Mapping[str, int]) -> DemonstrationError:
    return fault(
        path,
        "header",
        f"{manipulator or 'the movement'} has the columns {', '.join(sorted(found))}",
        "give x, or x and y, or x, y and z, and all of qw, qx, qy, qz or none, the same for every "
        "manipulator",
    )


def _read_table(path: Path, names: list[str]) -> NDArray[np.float64]:
    """Parse all rows below the header, shape (n_rows, n_columns), finite."""
    last = 0, ""  # row and text of the last line with content

    def below_header() -> Iterator[str]:
        nonlocal last
        for n_rows, last in enumerate(islice(_lines(path), 1, None), start=1):
            if n_rows * len(names) > MAX_CELLS:
                raise fault(path, None, f"it has more than {MAX_CELLS:,} numbers", "keep every n-th row")
            yield last[1]

    try:
        if next(below_header(), None) is None:
            raise fault(path, None, "there are no rows below the header", "record two rows at least")
        table = np.loadtxt(below_header(), delimiter=",", comments=None, ndmin=2)
    except UnicodeDecodeError:
        raise _not_utf8(path) from None
    except ValueError as error:
        raise _bad_cell(path, names) from error
    if table.shape[1] != len(names) or not np.isfinite(table).all():
        raise _bad_cell(path, names)
    if not last[1].endswith("\n"):
        warnings.warn(
            f"{path}: row {last[0]}: the last line has no end, so its last number may be cut",
            ComoveWarning,
            stacklevel=4,
        )
    return table


def _bad_cell(path: Path, names: list[str]) -> DemonstrationError:
    """Return the error that describes the first bad row."""
    for row, line in islice(_lines(path), 1, None):
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) != len(names):
            return _ragged(path, row, cells, names)
        for name, cell in zip(names, cells, strict=True):
            if not _is_number(cell) or not np.isfinite(float(cell)):
                return _not_a_number(path, f"row {row}, column {name}", cell)
    return fault(path, None, "it cannot be read as a table of numbers", _PLAIN)


def _ragged(path: Path, row: int, cells: list[str], names: list[str]) -> DemonstrationError:
    if any(mark in cell for cell in cells for mark in ";\t") or len(cells) >= 2 * len(names):
        way_out = f"these look like decimal commas or other separators: {_PLAIN}"
    else:
        way_out = "fill in or remove the row"
    return fault(path, f"row {row}", f"it has {len(cells)} cells and the header has {len(names)}", way_out)


def _not_a_number(path: Path, key: str, cell: str) -> DemonstrationError:
    if not cell:
        message, way_out = "the cell is empty", "fill in what was measured, or remove the row"
    elif _is_number(cell):
        message, way_out = f"{_short(cell)[1:-1]} is too large", "remove the row"
    elif cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        message, way_out = f"{cell} is not a finite number", "fill in what was measured, or remove the row"
    else:
        message, way_out = f"{_short(cell)} is not a number", _PLAIN
    return fault(path, key, message, way_out)


def _not_utf8(path: Path) -> DemonstrationError:
    good = 0
    with open(path, "rb") as file, contextlib.suppress(UnicodeDecodeError):
        for line in file:
            line.decode()
            good += 1
    return fault(path, f"row {good + 1}", "the text is not UTF-8", "save it again as UTF-8")


def _is_number(cell: str) -> bool:
    """Return whether NumPy's parser accepts `cell` as a number, other than nan and infinity."""
    try:
        float(cell)
    except ValueError:
        return False
    return cell.isascii() and "_" not in cell and cell.strip("+-")[0] in ".0123456789"


def _short(text: str) -> str:
    """Quote `text`, shortened to a readable length."""
    text = text.strip()
    return repr(text if len(text) <= 40 else f"{text[:37]}...")

"""Recordings as comma-separated text.

One movement has the header `time,x`, `time,x,y` or `time,x,y,z`; several manipulators recorded together
have `time,left.x,left.y,...,right.x,right.y,...`. Time in seconds, positions in metres, numbers with a
point, UTF-8. Blank lines and lines that begin with `#` are skipped. Rows are counted as an editor counts
lines: the first line of the file is row 1.

NumPy's C parser reads block by block; only a block that it refuses is searched, for the bad cell.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.cleaning import Origin, check
from comove.demonstrations.demonstration import Demonstration
from comove.demonstrations.files import existing_file, telling, together, whole_file
from comove.errors import DemonstrationError, near_name

AXES = ("x", "y", "z")
MAX_ROWS = 2_000_000
MAX_BYTES = 512 * 2**20
_BLOCK = 10_000
"""Rows that are parsed at a time."""
_TOO_LONG = f"keep every n-th row: up to {MAX_ROWS:,} rows are read"
_PLAIN = "write commas between columns and points in numbers"
_EXAMPLE = "begin the file with a line such as time,x,y"


def read_csv(path: str | os.PathLike[str]) -> dict[str, Demonstration]:
    """Read all movements of a file.

    Parameters
    ----------
    path : file as the module describes, up to 2,000,000 rows

    Returns
    -------
    demos : movement by manipulator, in the order of the columns; "" where the file names none

    Raises
    ------
    DemonstrationError
        The file cannot be read; names the row, the column and the way out.
    """
    path = existing_file(path, MAX_BYTES, _TOO_LONG)
    with telling(path):
        _check_length(path)
        names = _read_header(path)
        groups = _group(path, names)
        table = _read_table(path, names)
    demos = {}
    for manipulator, columns in groups.items():
        origin = _CsvOrigin(path, tuple(names[column] for column in columns))
        time, position = check(table[:, 0], table[:, columns], origin)
        name = f"{path.stem}.{manipulator}" if manipulator else path.stem
        demos[manipulator] = Demonstration(time, position, name)
    return demos


def write_csv(path: str | os.PathLike[str], demos: Demonstration | Mapping[str, Demonstration]) -> None:
    """Write movements so that `read_csv` returns the same numbers, bit by bit.

    Parameters
    ----------
    path : file to write; appears only when complete
    demos : one movement, or movements by manipulator with common time stamps, of up to 3 dimensions

    Raises
    ------
    DemonstrationError
        The movements do not fit into one file, or the file cannot be written.
    """
    demos = together(demos, path)
    first = next(iter(demos.values()))
    if first.n_dims > len(AXES):
        raise DemonstrationError(
            f"{first.n_dims} dimensions have no columns in CSV", file=path, way_out="use write_npz"
        )
    header = ["time"]
    for name in demos:
        if name != name.strip(' "') or any(mark in name for mark in ",;\t\r\n"):
            raise DemonstrationError(
                f"the manipulator's name {name!r} cannot stand in a header",
                file=path,
                way_out="use letters, digits and underscores",
            )
        header += [f"{name}.{axis}" if name else axis for axis in AXES[: first.n_dims]]
    table = np.column_stack([first.time, *(demo.position for demo in demos.values())])
    lines = [",".join(header), *(",".join(map(repr, row)) for row in table.tolist()), ""]
    with whole_file(path) as file:
        file.write("\n".join(lines).encode())


@dataclass(frozen=True)
class _CsvOrigin(Origin):
    """Names samples by their row and column in the file."""

    columns: tuple[str, ...] = ()

    def time(self, sample: int) -> str:
        return f"row {self._row(sample)}, column time"

    def position(self, sample: int, dim: int) -> str:
        return f"row {self._row(sample)}, column {self.columns[dim]}"

    def _row(self, sample: int) -> int:
        return next(islice(_lines(self.file), 1 + sample, None))[0]


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Iterate over (row, text) of all lines that say something, the header first."""
    with open(path, encoding="utf-8-sig") as file:
        for row, line in enumerate(file, start=1):
            if line.strip() and not line.startswith("#"):
                yield row, line


def _check_length(path: Path) -> None:
    """Refuse a file of too many rows before any of it is parsed."""
    feeds = returns = 0
    with open(path, "rb") as file:
        while max(feeds, returns) <= MAX_ROWS + 1 and (chunk := file.read(2**16)):
            feeds += chunk.count(b"\n")
            returns += chunk.count(b"\r")
    if max(feeds, returns) > MAX_ROWS + 1:
        raise DemonstrationError(f"it has more than {MAX_ROWS:,} rows", file=path, way_out=_TOO_LONG)


def _read_header(path: Path) -> list[str]:
    """Return the names of the columns; `time` is the first, and there are others."""
    try:
        row, line = next(_lines(path), (1, ""))
    except UnicodeDecodeError:
        raise _not_utf8(path) from None

    def wrong(message: str, way_out: str, column: str = "") -> DemonstrationError:
        key = f"header, column {column}" if column else f"row {row}"
        return DemonstrationError(message, file=path, key=key, way_out=way_out)

    if not line:
        raise wrong("the file is empty", _EXAMPLE)
    names = [name.strip().strip('"').strip() for name in line.split(",")]
    if any(mark in line.strip() for mark in ";\t"):
        raise wrong(f"the columns are not separated by commas: {_short(line)}", _PLAIN)
    if any(map(_is_number, names)):
        raise wrong(f"numbers stand where the header is expected: {_short(line)}", _EXAMPLE)
    for column, name in enumerate(names, start=1):
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


def _group(path: Path, names: list[str]) -> dict[str, list[int]]:
    """Return the columns of each manipulator in the order x, y, z; "" where the header names none."""
    columns: dict[str, dict[str, int]] = {}
    for column, name in enumerate(names[1:], start=1):
        manipulator, dot, axis = name.rpartition(".")
        if axis not in AXES or bool(dot) != bool(manipulator):
            known = [f"{manipulator}{dot}{axis}" for axis in AXES] if manipulator else AXES
            raise DemonstrationError(
                f"the name {_short(name)} is not known",
                file=path,
                key=f"header, column {column + 1}",
                way_out=near_name(name.lower(), known),
            )
        columns.setdefault(manipulator, {})[axis] = column
    if "" in columns and len(columns) > 1:
        raise DemonstrationError(
            "some columns name a manipulator and some do not",
            file=path,
            key="header",
            way_out="write NAME.x, NAME.y for every manipulator",
        )
    axes = sorted(max(columns.values(), key=len))
    for manipulator, found in columns.items():
        if sorted(found) != axes or axes != sorted(AXES[: len(axes)]):
            raise DemonstrationError(
                f"{manipulator or 'the movement'} has the columns {', '.join(sorted(found))}",
                file=path,
                key="header",
                way_out="give x, or x and y, or x, y and z, the same for every manipulator",
            )
    return {manipulator: [found[axis] for axis in axes] for manipulator, found in columns.items()}


def _read_table(path: Path, names: list[str]) -> NDArray[np.float64]:
    """Parse all rows below the header, shape (n_rows, n_columns), finite."""
    lines = islice(_lines(path), 1, None)
    blocks = []
    try:
        while block := list(islice(lines, _BLOCK)):
            blocks.append(_parse(path, names, block))
    except UnicodeDecodeError:
        raise _not_utf8(path) from None
    if not blocks:
        raise DemonstrationError(
            "there are no rows below the header", file=path, way_out="record two rows at least"
        )
    return np.concatenate(blocks)


def _parse(path: Path, names: list[str], block: list[tuple[int, str]]) -> NDArray[np.float64]:
    """Parse a block of (row, text), shape (n_rows, n_columns), finite."""
    try:
        table = np.loadtxt([line for _, line in block], delimiter=",", comments=None, ndmin=2)
    except ValueError as error:
        raise _bad_cell(path, names, block) from error
    if table.shape[1] != len(names) or not np.isfinite(table).all():
        raise _bad_cell(path, names, block)
    return table


def _bad_cell(path: Path, names: list[str], block: list[tuple[int, str]]) -> DemonstrationError:
    """Describe the first bad row of a block that has one."""
    for row, line in block:
        cells = [cell.strip() for cell in line.split(",")]
        if len(cells) != len(names):
            return _ragged(path, row, cells, names)
        for name, cell in zip(names, cells, strict=True):
            if not _is_number(cell) or not np.isfinite(float(cell)):
                return _not_a_number(path, f"row {row}, column {name}", cell)
    return DemonstrationError("it cannot be read as a table of numbers", file=path, way_out=_PLAIN)


def _ragged(path: Path, row: int, cells: list[str], names: list[str]) -> DemonstrationError:
    if any(mark in cell for cell in cells for mark in ";\t") or len(cells) >= 2 * len(names):
        way_out = f"these look like decimal commas or other separators: {_PLAIN}"
    else:
        way_out = "fill in or remove the row"
    return DemonstrationError(
        f"it has {len(cells)} cells and the header has {len(names)}",
        file=path,
        key=f"row {row}",
        way_out=way_out,
    )


def _not_a_number(path: Path, key: str, cell: str) -> DemonstrationError:
    if not cell:
        message, way_out = "the cell is empty", "fill in what was measured, or remove the row"
    elif _is_number(cell):
        message, way_out = f"{cell} is too large", "remove the row"
    elif cell.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        message, way_out = f"{cell} is not a finite number", "fill in what was measured, or remove the row"
    else:
        message, way_out = f"{_short(cell)} is not a number", _PLAIN
    return DemonstrationError(message, file=path, key=key, way_out=way_out)


def _not_utf8(path: Path) -> DemonstrationError:
    good = 0
    with open(path, "rb") as file, contextlib.suppress(UnicodeDecodeError):
        for line in file:
            line.decode()
            good += 1
    return DemonstrationError(
        "the text is not UTF-8", file=path, key=f"row {good + 1}", way_out="save it again as UTF-8"
    )


def _is_number(cell: str) -> bool:
    """Say whether NumPy's parser takes `cell` for a number, other than nan and infinity."""
    try:
        float(cell)
    except ValueError:
        return False
    return cell.isascii() and "_" not in cell and cell.strip("+-")[0] in ".0123456789"


def _short(text: str) -> str:
    """Quote `text`, cut to a readable length."""
    text = text.strip()
    return repr(text if len(text) <= 40 else f"{text[:37]}...")

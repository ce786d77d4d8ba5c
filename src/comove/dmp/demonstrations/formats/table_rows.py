"""Rows of text tables: their numbers, and unreadable cells.

Rows are counted as in an editor: the first line of the file is row 1. NumPy's C parser reads the numbers; only if it
refuses a row are the rows searched for the bad cell.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.dmp.demonstrations.formats.layout import (
    MAX_COLUMNS,
    SEPARATORS,
    Layout,
    is_finite,
    is_missing,
    is_time,
)
from comove.dmp.demonstrations.samples import MAX_ROWS, fault
from comove.errors import ComoveWarning, DemonstrationError

MAX_LINE = 2**20
"""Bytes of one line."""
MAX_CELLS = 2**26
"""Numbers of one file."""
TOO_LONG = f"keep every n-th row: up to {MAX_ROWS:,} rows are read"


@dataclass(frozen=True)
class TableRows:
    """The rows of numbers of a table.

    Attributes
    ----------
    layout : layout of the table
    drop_missing : whether rows with missing measurements are left out, instead of refused
    """

    layout: Layout
    drop_missing: bool = False

    def read(self, places: Sequence[int], numbers: Sequence[int]) -> tuple[list[NDArray], Array, str]:
        """Return time stamps, the wanted columns, and the rows left out.

        Parameters
        ----------
        places : numbers of the columns of time
        numbers : numbers of the other columns

        Returns
        -------
        stamps : arrays, shape (n_rows,), of whole numbers, floats, or text
        values : array, shape (n_rows, n_columns)
        said : which rows were left out, in words; "" if none

        Raises
        ------
        DemonstrationError
            If a row has cells too many or too few, or a wanted cell holds no number; names row and column.
        """
        kinds: list[Any] = [_kind_of_stamps(self.layout.sampled(number)) for number in places]
        wanted = [*places, *numbers]
        last: tuple[int, str] = (0, "")
        dropped: list[int] = []
        separator = self.layout.separator
        has_commas = separator != "," and self.layout.decimal_comma

        def lines() -> Iterator[str]:
            nonlocal last
            for row, line in self.numbered(wanted, dropped):
                last = row, line
                yield line.replace(",", ".") if has_commas else line

        def parsed(kinds: list[Any]) -> NDArray:
            dropped.clear()
            types = [(f"stamp{i}", kind) for i, kind in enumerate(kinds)]
            types += [(f"column{number}", np.float64) for number in numbers]
            return np.loadtxt(
                lines(),
                dtype=types,
                delimiter=None if separator == " " else separator,
                usecols=wanted,
                comments=None,
                quotechar='"',
                ndmin=1,
            )

        try:
            try:
                table = parsed(kinds)
            except ValueError:
                if np.int64 not in kinds:
                    raise
                table = parsed([np.float64 if kind is np.int64 else kind for kind in kinds])
        except ValueError as error:
            raise self._bad_cell(wanted) from error
        path = self.layout.path
        if not len(table):
            raise fault(path, None, "there are no rows with all numbers", "record two rows at least")
        values = np.column_stack([table[f"column{number}"] for number in numbers])
        stamps = [table[f"stamp{i}"] for i in range(len(kinds))]
        if not all(np.isfinite(one).all() for one in (values, *stamps) if one.dtype.kind == "f"):
            raise self._bad_cell(wanted)
        if last[1] and not last[1].endswith("\n"):
            _warn(path, f"row {last[0]}: the last line has no end, so its last number may be cut")
        said = ""
        if dropped:
            total = len(values) + len(dropped)
            said = f"{len(dropped)} of {total} rows without all numbers left out, rows {dropped[0]} to {dropped[-1]}"
            _warn(path, said)
        return stamps, values, said

    def numbered(self, wanted: Sequence[int], dropped: list[int] | None = None) -> Iterator[tuple[int, str]]:
        """Iterate over number and text of the rows. The numbers of those left out are added to `dropped`."""
        layout, separator, names = self.layout, self.layout.separator, self.layout.header.names
        n_columns, n_found = max(layout.n_cells, 1), 0
        for row, line in layout.rows():
            is_split = separator == " " or '"' in line or self.drop_missing
            cells = layout.cells(line) if is_split else None
            n_cells = line.count(separator) + 1 if cells is None else len(cells)
            if n_cells != layout.n_cells and abs(n_cells - layout.n_cells) <= 1:
                cells = layout.cells(line) if cells is None else cells
                n_cells -= n_cells > layout.n_cells and not cells[-1]
            if n_cells != layout.n_cells and not (n_cells == len(names) - 1 and not names[-1]):
                raise self._ragged(row, n_cells, line)
            if self.drop_missing and cells is not None and any(is_missing(cells[n]) for n in wanted):
                if dropped is not None:
                    dropped.append(row)
                continue
            n_found += 1
            if n_found > MAX_ROWS:
                raise fault(layout.path, None, f"it has more than {MAX_ROWS:,} rows", TOO_LONG)
            if n_found * n_columns > MAX_CELLS:
                message = f"it has more than {MAX_CELLS:,} numbers"
                raise fault(layout.path, None, message, "keep every n-th row")
            yield row, line

    def _bad_cell(self, wanted: Sequence[int]) -> DemonstrationError:
        """Return the error about the first bad cell of wanted columns."""
        path, names = self.layout.path, self.layout.header.names
        for row, line in self.numbered(wanted):
            cells = self.layout.cells(line)
            again = [cell for cell in cells if cell and cell in names]
            if len(again) > 1:
                order = "" if list(names) == cells else ", in another order"
                message = f"the names of the columns stand there again{order}"
                return fault(path, f"row {row}", message, "cut the file there: it holds two recordings")
            for number in wanted:
                cell = cells[number] if number < len(cells) else ""
                if (not self.layout.is_number(cell) and not is_time(cell)) or not is_finite(cell):
                    name = names[number] if number < len(names) and names[number] else str(number + 1)
                    return self._not_a_number(f"row {row}, column {name}", cell)
        return fault(path, None, "it cannot be read as a table of numbers", "write plain numbers")

    def _not_a_number(self, key: str, cell: str) -> DemonstrationError:
        options: dict[str, Any] = {"drop_missing": True} if is_missing(cell) else {}
        message, way_out = f"{_short(cell)} is not a number", "write plain numbers, such as 0.25"
        if is_missing(cell):
            message = f"{cell} is not a finite number" if cell else "the cell is empty"
            way_out = "fill in what was measured, or leave such rows out: --drop-missing"
        elif cell.lower().lstrip("+-") in ("inf", "infinity"):
            message, way_out = (
                f"{cell} is not a finite number",
                "fill in what was measured, or remove the row",
            )
        elif self.layout.is_number(cell):
            message, way_out = f"{_short(cell)[1:-1]} is too large", "remove the row"
        elif "," in cell and "." in cell and all(mark in "0123456789.,+-" for mark in cell):
            way_out = "write it without marks of thousands"
        return fault(self.layout.path, key, message, way_out, **options)

    def _ragged(self, row: int, n_cells: int, line: str) -> DemonstrationError:
        layout, way_out = self.layout, "fill in or remove the row"
        others = [mark for mark in SEPARATORS if mark not in (layout.separator, " ") and mark in line]
        if layout.separator == "," and (";" in others or n_cells >= 2 * layout.n_cells):
            way_out = "these look like decimal commas: separate the columns by semicolons"
        what = "the header has" if layout.header.names else "the rows before have"
        n_names = len(layout.header.names) or layout.n_cells
        return fault(layout.path, f"row {row}", f"it has {n_cells} cells and {what} {n_names}", way_out)


def check_length(path: Path) -> None:
    """Raise if a file has too many, or too long, rows. Nothing is parsed before."""
    most = MAX_ROWS + 1000
    feeds = returns = line = 0
    with open(path, "rb") as file:
        while max(feeds, returns) <= most and (chunk := file.read(2**16)):
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
    if max(feeds, returns) > most:
        raise fault(path, None, f"it has more than {MAX_ROWS:,} rows", TOO_LONG)


def _kind_of_stamps(cells: Sequence[str]) -> Any:
    """Return the type of parsed stamps: integers exactly, dates as text."""
    if any(map(is_time, cells)):
        return "U40"
    whole = cells and all(cell.lstrip("+-").isdigit() for cell in cells)
    return np.int64 if whole else np.float64


def _short(text: str) -> str:
    """Quote `text`, shortened to a readable length."""
    text = text.strip()
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


def _warn(path: Path, text: str) -> None:
    warnings.warn(f"{path}: {text}", ComoveWarning, stacklevel=6)

"""Recordings as text tables: any separator, any names of columns, any units of length and time.

The layout is found (`formats.layout`): separators, decimal commas, rows of the header, a preamble. The names of the
columns say what they hold (`comove.demonstrations.columns`). Without a header, three layouts are recognised by their
numbers: `time x y z`, `time x y z` with a quaternion (TUM, EuRoC), and poses of 12 numbers (KITTI). comove's own
tables (`formats.csv`) are those whose columns are exactly the ones that it writes.

Rows are counted as in an editor: the first line of the file is row 1. NumPy's C parser reads the numbers; only if it
refuses a row are the rows searched for the bad cell.
"""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.columns import (
    MATRIX,
    Body,
    Column,
    Kind,
    bare_name,
    bodies_of,
    matching_body,
    read_columns,
    spoken,
)
from comove.demonstrations.formats import csv
from comove.demonstrations.formats.layout import HOURS, SEPARATORS, Layout, is_missing, is_time, layout_of
from comove.demonstrations.plausibility import require_rate, seconds, unit_of_time
from comove.demonstrations.samples import (
    AXES,
    MAX_ROWS,
    QUATERNION,
    TIME,
    Format,
    Origin,
    RecordedSamples,
    fault,
)
from comove.demonstrations.units import LENGTHS, TIMES, is_angle, is_length, require_unit, unit_named
from comove.errors import ComoveWarning, DemonstrationError, OptionError, listed, near_name
from comove.io.files import existing_file, telling

Array = NDArray[np.float64]

MAX_BYTES = 512 * 2**20
MAX_LINE = 2**20
"""Bytes of one line."""
MAX_CELLS = 2**26
"""Numbers of one file."""
MAX_COLUMNS, MAX_NAME = 1000, 200
"""Columns of a file, and characters of a column's name."""
SPELT = {"tab": "\t", "\\t": "\t", "space": " ", "blank": " ", "comma": ",", "semicolon": ";", "pipe": "|"}
_TOO_LONG = f"keep every n-th row: up to {MAX_ROWS:,} rows are read"
_SHOWN = 12
"""Columns that a message lists."""


def read(
    path: str | os.PathLike[str],
    *,
    manipulator: str | None = None,
    columns: Sequence[str] | None = None,
    delimiter: str | None = None,
    time: str | None = None,
    rate: float | None = None,
    unit: str | None = None,
    drop_missing: bool = False,
) -> dict[str, RecordedSamples]:
    """Read the movements of a text table.

    Parameters
    ----------
    path : file of up to 2,000,000 rows
    manipulator : name of the only body to read
    columns : names, or numbers from 1, of the columns of positions or joints, or the name of a body; found by their
        names unless given
    delimiter : separator of columns: a character, "tab" or "space"; found unless given
    time : name or number of the column of time, with a unit in brackets if the file does not contain it
        ("stamp [ms]"); found by its name unless given
    rate : sampling rate [Hz], instead of a column of time
    unit : unit of positions or joints that state none, for example "mm" or "deg"
    drop_missing : whether rows in which something was not measured are left out, instead of refused

    Returns
    -------
    demos : movement by body, in the order of the columns; "" if the columns name none, or only one

    Raises
    ------
    DemonstrationError
        If the file cannot be read with these options; names row, column and what to do, with the command.
    OptionError
        If an option is out of range, or contradicts the file.

    Warns
    -----
    ComoveWarning
        If rows were left out, or the last line has no end: it may be incomplete.
    """
    path = existing_file(Path(path), MAX_BYTES, _TOO_LONG)
    request = _Request(path, manipulator, columns, delimiter, time, rate, unit, drop_missing)
    with telling(path):
        _check_length(path)
        table = _Table.of(request)
        bodies = table.bodies()
        clock = table.clock()
        together = [bodies] if not drop_missing else [{name: body} for name, body in bodies.items()]
        found: dict[str, RecordedSamples] = {}
        for some in together:
            found |= table.movements(some, clock)
    return found


def names(path: str | os.PathLike[str], **options: Any) -> tuple[str, ...]:
    """Return the names of the bodies that `read` finds with the same options; the numbers are not read."""
    path = existing_file(Path(path), MAX_BYTES, _TOO_LONG)
    with telling(path):
        _check_length(path)
        return tuple(_Table.of(_Request(path, **options)).bodies())


def is_table(path: Path) -> bool:
    """Return whether a file is a text with a table of numbers, whatever its suffix."""
    try:
        with telling(path):
            return bool(layout_of(existing_file(path, MAX_BYTES, _TOO_LONG)).sample)
    except DemonstrationError:
        return False


FORMAT = Format(
    "text table",
    read,
    suffixes=(".csv", ".tsv", ".txt", ".dat", ".asc", ".trc", ".mot", ".sto", ".tum"),
    write=csv.write,
    bodies=names,
    options=frozenset({"columns", "delimiter", "time", "rate", "unit", "drop_missing"}),
)


@dataclass(frozen=True)
class _Request:
    """What was asked for; checked."""

    path: Path
    manipulator: str | None = None
    columns: Sequence[str] | None = None
    delimiter: str | None = None
    time: str | None = None
    rate: float | None = None
    unit: str | None = None
    drop_missing: bool = False

    def __post_init__(self) -> None:
        if self.delimiter is not None:
            found = SPELT.get(self.delimiter.lower(), self.delimiter)
            if len(found) != 1 or found.isalnum() or found in ".+-\"'#%\n":
                raise OptionError(
                    f"{self.delimiter!r} cannot separate columns",
                    key="delimiter",
                    way_out="give ';', ',', 'tab' or 'space'",
                )
            object.__setattr__(self, "delimiter", found)
        if self.rate is not None and self.time is not None:
            raise OptionError(
                "both a column of time and a rate are given", key="rate", way_out="give one of them"
            )
        if self.rate is not None:
            require_rate(self.rate)
        if self.unit is not None:
            object.__setattr__(self, "unit", require_unit(self.unit, self.path))


@dataclass(frozen=True)
class _Clock:
    """Where time comes from: one column or two, or a rate.

    Attributes
    ----------
    columns : columns of time; two of them are seconds and nanoseconds, or alternatives
    unit : unit that a user states
    rate : samples a second [Hz]
    is_chosen : whether a user named the column
    """

    columns: tuple[Column, ...] = ()
    unit: str | None = None
    rate: float | None = None
    is_chosen: bool = False
    words: str = ""


@dataclass(frozen=True)
class _Table:
    """A table whose layout is known."""

    request: _Request
    layout: Layout
    columns: tuple[Column, ...]
    guessed: str = ""

    @classmethod
    def of(cls, request: _Request) -> _Table:
        """Return the table, with the meaning of its columns."""
        layout = layout_of(request.path, request.delimiter)
        if layout.n_cells > MAX_COLUMNS:
            raise fault(
                request.path,
                f"row {layout.first}",
                f"there are {layout.n_cells} columns",
                f"keep those of the movement, {MAX_COLUMNS} at most",
            )
        for number, name in enumerate(layout.names, start=1):
            if len(name) > MAX_NAME:
                message, way_out = f"the name has {len(name)} characters", f"use {MAX_NAME} at most"
                raise fault(request.path, f"header, column {number}", message, way_out)
        if not layout.names:
            columns, guessed = _by_numbers(layout)
            return cls(request, layout, columns, guessed)
        columns = read_columns(layout.names, bodies=layout.bodies, kinds=layout.kinds, units=layout.units)
        if layout.unit is not None:
            columns = tuple(
                replace(c, unit=layout.unit) if c.kind is Kind.POSITION and c.unit is None else c
                for c in columns
            )
        if layout.angles is not None:
            columns = tuple(
                replace(c, unit=layout.angles) if c.kind is Kind.JOINT and c.unit is None else c
                for c in columns
            )
        if layout.types:
            columns = _main_bodies(columns, layout)
        return cls(request, layout, columns)

    @cached_property
    def own(self) -> dict[str, Body] | None:
        """Return the bodies of a table that comove wrote, None of others."""
        is_plain = self.layout.separator == "," and not self.layout.bodies and not self.layout.units
        return csv.own_bodies(self.layout.names) if is_plain and self.layout.names else None

    def bodies(self) -> dict[str, Body]:
        """Return the bodies to read."""
        request = self.request
        if request.columns is not None:
            found = self._chosen(request.columns)
        else:
            found = self.own if self.own is not None else bodies_of(self.columns)
        found = {name: self._with_unit(body) for name, body in found.items()}
        if not found:
            raise self._no_movement()
        if request.manipulator is not None and list(found) != [""]:
            name = matching_body(request.manipulator, found)
            if name is not None:
                found = {name: found[name]}
        for name, body in found.items():
            if body.is_repeated:
                raise self._repeated(name, body)
        if "" in found and len(found) > 1:
            raise self._mixed(found)
        if len(found) == 1 and self.own is None and request.manipulator is None:
            found = {"": next(iter(found.values()))}
        return found

    def _with_unit(self, body: Body) -> Body:
        """Return a body whose joints are positions, if the user states a unit of length for columns without one."""
        unit = self.request.unit
        if unit is None:
            return body
        stated = {column.unit for column in body.moving if column.unit is not None}
        if stated and stated != {unit} and all(column.unit is not None for column in body.moving):
            raise OptionError(
                f"the header says that {spoken(body.moving)[0]} is in {listed(sorted(stated))}",
                file=self.request.path,
                key="unit",
                way_out="leave the unit out",
            )
        if is_length(unit) and body.joints and not stated and not body.position:
            return replace(body, position=body.joints, joints=())
        if is_angle(unit) and body.position and not stated:
            if self.request.columns is None:
                raise OptionError(
                    f"{spoken(body.position)[0]} is a position, which {unit} does not measure",
                    file=self.request.path,
                    key="unit",
                    way_out=f"give a length, {listed(list(LENGTHS))}",
                )
            joints = tuple(replace(column, axis=bare_name(column.name)) for column in body.position)
            return replace(body, position=(), orientation=(), joints=joints)
        return body

    # What the user names.

    def _chosen(self, wanted: Sequence[str]) -> dict[str, Body]:
        """Return the bodies that names of columns, or of bodies, stand for."""
        every = bodies_of(self.columns)
        if len(wanted) == 1 and not self._named(wanted[0]):
            name = matching_body(wanted[0], every)
            if name is not None:
                return {name: every[name]}
        places: list[Column] = []
        for name in wanted:
            found = self._named(name)
            if len(found) > 1:
                raise self._ambiguous(name, found)
            if not found:
                names = [column.label or column.name for column in self.columns]
                known = [*dict.fromkeys(n for n in names if n), *every][:_SHOWN]
                raise fault(
                    self.request.path, "columns", f"there is no column {name!r}", near_name(name, known)
                )
            if found[0] in places:
                raise OptionError(f"{name!r} stands twice", key="columns", way_out="name every column once")
            places += found
        for body in every.values():
            if body.position == tuple(places):
                return {"": body}
        are_joints = all(column.kind is Kind.JOINT or is_angle(column.unit) for column in places)
        if are_joints:
            joints = tuple(
                replace(c, axis=c.axis if c.kind is Kind.JOINT else bare_name(c.name)) for c in places
            )
            return {"": Body("", joints=joints)}
        return {"": Body("", position=tuple(places))}

    def _named(self, name: str) -> list[Column]:
        """Return the columns that a name stands for: the same name, label, bare name in any case, or number."""
        for alike in (
            [c for c in self.columns if c.name == name],
            [c for c in self.columns if name.lower() in _labels(c)],
            [c for c in self.columns if bare_name(c.name).lower() == bare_name(name).lower() and c.name],
        ):
            if alike:
                return alike
        if name.isascii() and name.isdigit() and 1 <= int(name) <= len(self.columns):
            return [self.columns[int(name) - 1]]
        return []

    # Time.

    def clock(self) -> _Clock:
        """Return where time comes from."""
        request, layout = self.request, self.layout
        if request.rate is not None:
            return _Clock(rate=float(request.rate), words=f"time at {request.rate:g} samples a second")
        if request.time is not None:
            return self._chosen_clock(request.time)
        found = [column for column in self.columns if column.kind is Kind.TIME and self._is_readable(column)]
        chosen = self._chosen_numbers()
        found = [column for column in found if column.number not in chosen]
        if (
            not found
            and not layout.names
            and not chosen & {0}
            and request.columns is not None
            and self._grows(0)
        ):
            found = [replace(self.columns[0], kind=Kind.TIME)]
        if found:
            pair = _seconds_and_nanoseconds(found)
            return _Clock(pair or tuple(found))
        if layout.rate is not None:
            frames = [c for c in self.columns if c.kind is Kind.INDEX and "frame" in c.name.lower()][:1]
            words = f"time at {layout.rate:g} samples a second, as the file says"
            return _Clock(tuple(frames), rate=layout.rate, words=words)
        raise self._no_time()

    def _chosen_numbers(self) -> set[int]:
        """Return the numbers of the columns that the user names as positions."""
        return {column.number for name in self.request.columns or () for column in self._named(name)}

    def _chosen_clock(self, time: str) -> _Clock:
        bare = bare_name(time)
        found = self._named(time) or self._named(bare)
        if not found:
            names = [column.name for column in self.columns if column.name][:_SHOWN]
            raise fault(self.request.path, "time", f"there is no column {bare!r}", near_name(bare, names))
        if len(found) > 1:
            raise self._ambiguous(bare, found, "time")
        said = time.strip().removeprefix(bare).strip().strip("[]()") if time.strip() != bare else ""
        if said and found[0].name.strip() != time.strip():
            unit = unit_named(said)
            if unit not in TIMES:
                raise fault(
                    self.request.path,
                    "time",
                    f"the unit of time {said!r} is not known",
                    near_name(said, TIMES),
                )
            return _Clock((replace(found[0], unit=None),), unit, is_chosen=True)
        pair = _seconds_and_nanoseconds([c for c in self.columns if c.kind is Kind.TIME])
        if pair and found[0] in pair:
            return _Clock(pair, is_chosen=True)
        return _Clock((found[0],), is_chosen=True)

    def _is_readable(self, column: Column) -> bool:
        cells = self._sample(column.number)
        return bool(cells) and (self.layout.is_number(cells[0]) or is_time(cells[0]))

    def _sample(self, number: int) -> list[str]:
        return [row[number] for row in self.layout.sample if number < len(row)]

    def _grows(self, number: int) -> bool:
        """Return whether the numbers of a column grow in the first rows."""
        return _grows(self._sample(number))

    def _counts(self, number: int) -> bool:
        """Return whether a column counts rows, one by one."""
        return bool((np.diff(_floats(self._sample(number))) == 1.0).all())

    # Numbers.

    def movements(self, bodies: dict[str, Body], clock: _Clock) -> dict[str, RecordedSamples]:
        """Read the numbers of some bodies."""
        request = self.request
        numbers = list(dict.fromkeys(c.number for body in bodies.values() for c in body.needed))
        stamps, values, dropped = self._numbers(clock, numbers)
        time, used, notes = self._seconds(clock, stamps, len(values))
        found = {}
        for name, body in bodies.items():
            fields = body.samples(values, numbers, request.unit)
            stated = fields.pop("stated", frozenset()) | {TIME}
            words = f"{used}, {body.words(request.unit)}" + (f" ({self.guessed})" if self.guessed else "")
            found[name] = RecordedSamples(
                time,
                name=f"{request.path.stem}.{name}" if name else request.path.stem,
                notes=(words, *notes, *filter(None, [dropped])),
                stated=stated,
                origin=self._origin(body, used, numbers, clock),
                **fields,
            )
        return found

    def _numbers(self, clock: _Clock, numbers: list[int]) -> tuple[list[NDArray], Array, str]:
        """Return the stamps of each column of time, the wanted columns of all rows, and what was left out."""
        places = [column.number for column in clock.columns]
        kinds: list[Any] = [_kind_of_stamps(self._sample(number)) for number in places]
        wanted = [*places, *numbers]
        last: tuple[int, str] = (0, "")
        dropped: list[int] = []

        def rows() -> Iterator[str]:
            nonlocal last
            for row, line in self._rows(wanted, dropped):
                last = row, line
                yield (
                    line
                    if self.layout.separator == "," or not self.layout.decimal_comma
                    else line.replace(",", ".")
                )

        def parsed(kinds: list[Any]) -> NDArray:
            dropped.clear()
            types = [(f"stamp{i}", kind) for i, kind in enumerate(kinds)]
            types += [(f"column{number}", np.float64) for number in numbers]
            separator = None if self.layout.separator == " " else self.layout.separator
            return np.loadtxt(
                rows(),
                dtype=types,
                delimiter=separator,
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
        if not len(table):
            raise fault(
                self.request.path, None, "there are no rows with all numbers", "record two rows at least"
            )
        values = np.column_stack([table[f"column{number}"] for number in numbers])
        stamps = [table[f"stamp{i}"] for i in range(len(kinds))]
        finite = np.isfinite(values).all() and all(
            np.isfinite(s).all() for s in stamps if s.dtype.kind == "f"
        )
        if not finite:
            raise self._bad_cell(wanted)
        if last[1] and not last[1].endswith("\n"):
            _warn(
                self.request.path, f"row {last[0]}: the last line has no end, so its last number may be cut"
            )
        said = ""
        if dropped:
            total = len(values) + len(dropped)
            said = f"{len(dropped)} of {total} rows without all numbers left out, rows {dropped[0]} to {dropped[-1]}"
            _warn(self.request.path, said)
        return stamps, values, said

    def _rows(self, wanted: Sequence[int], dropped: list[int]) -> Iterator[tuple[int, str]]:
        """Iterate over the rows of numbers; raise if there are too many, or a row has cells too many or too few."""
        layout, separator = self.layout, self.layout.separator
        n_columns, n_found = max(layout.n_cells, 1), 0
        for row, line in layout.rows():
            cells = (
                layout.cells(line) if separator == " " or '"' in line or self.request.drop_missing else None
            )
            n_cells = line.count(separator) + 1 if cells is None else len(cells)
            if n_cells != layout.n_cells and abs(n_cells - layout.n_cells) <= 1:
                cells = layout.cells(line) if cells is None else cells
                n_cells -= n_cells > layout.n_cells and not cells[-1]
            if n_cells != layout.n_cells and not (n_cells == len(layout.names) - 1 and not layout.names[-1]):
                raise self._ragged(row, n_cells, line)
            if self.request.drop_missing and cells is not None and any(is_missing(cells[n]) for n in wanted):
                dropped.append(row)
                continue
            n_found += 1
            if n_found > MAX_ROWS:
                raise fault(self.request.path, None, f"it has more than {MAX_ROWS:,} rows", _TOO_LONG)
            if n_found * n_columns > MAX_CELLS:
                raise fault(
                    self.request.path, None, f"it has more than {MAX_CELLS:,} numbers", "keep every n-th row"
                )
            yield row, line

    def _seconds(
        self, clock: _Clock, stamps: list[NDArray], n_rows: int
    ) -> tuple[Array, str, tuple[str, ...]]:
        """Return time [s], where it comes from in words, and notes."""
        if clock.rate is not None:
            frames = stamps[0] if stamps and stamps[0].dtype.kind in "if" else np.arange(n_rows)
            if len(frames) > 1 and (np.diff(frames) <= 0).any():
                frames = np.arange(n_rows)
            return (frames - frames[0]) / clock.rate, clock.words, ()
        if len(clock.columns) == 2 and clock.columns[1].axis == "nsecs":
            whole, rest = stamps
            if whole.dtype.kind == "i" and rest.dtype.kind == "i":
                time, notes = seconds(whole * 1_000_000_000 + rest, "ns", origin=Origin(self.request.path))
            else:
                time, notes = seconds(whole + 1e-9 * rest, "s", origin=Origin(self.request.path))
            names = " and ".join(f"`{column.name}`" for column in clock.columns)
            return time, f"time from {names} [s, ns]", notes
        found = [self._one_clock(c, s, clock) for c, s in zip(clock.columns, stamps, strict=True)]
        moving = [one for one in found if one is not None and np.ptp(one[0]) > 0.0] or [f for f in found if f]
        first = moving[0]
        for other in moving[1:]:
            passed = [one[0].max() - one[0].min() for one in (first, other)]
            if abs(passed[0] - passed[1]) > 0.01 * max(passed) + 1e-3:
                raise self._two_clocks(first, other, passed)
        time, column, unit, notes = first
        named = f"`{column.name}`" if self.layout.names else f"column {column.number + 1}"
        return time, f"time from {named} [{unit}]", notes

    def _one_clock(
        self, column: Column, stamps: NDArray, clock: _Clock
    ) -> tuple[Array, Column, str, tuple[str, ...]] | None:
        """Return the seconds of one column of time, and its unit; None where it is one of several and unclear."""
        request = self.request
        if stamps.dtype.kind == "U":
            stamps = self._dates(column, stamps)
            time, notes = seconds(stamps, "ns")
            return time, column, "date", notes
        unit = clock.unit or column.unit
        if unit is not None and unit not in TIMES:
            raise fault(
                request.path, "time", f"the unit of time {unit!r} is not known", near_name(unit, TIMES)
            )
        if unit is None:
            unit = unit_of_time(stamps)
            if unit is None and len(clock.columns) > 1:
                return None
        name = column.name or str(column.number + 1)
        time, notes = seconds(stamps, unit, name=name, origin=Origin(request.path))
        inferred = clock.unit is None and column.unit is None and unit != "s"
        return time, column, f"{unit}, after its size" if inferred else str(unit), notes

    def _dates(self, column: Column, stamps: NDArray) -> NDArray[np.int64]:
        """Return nanoseconds of dates, or of times of the day."""
        text = np.char.replace(np.char.rstrip(np.char.replace(stamps, "+00:00", ""), "Z"), " ", "T")
        text = np.char.replace(text, ",", ".")
        if HOURS.fullmatch(str(stamps[0])):
            text = np.char.add("1970-01-01T", np.char.zfill(text, np.char.str_len(text).max()))
        try:
            return text.astype("datetime64[ns]").astype(np.int64)
        except ValueError as error:
            raise fault(
                self.request.path,
                f"column {column.name}",
                f"{stamps[0]!r} and the cells below are no dates such as 2024-05-01 10:00:00.25",
                "give the samples a second instead: --rate HZ",
                time=None,
                rate=100,
            ) from error

    def _origin(self, body: Body, time: str, numbers: Sequence[int], clock: _Clock) -> Origin:
        """Name samples by their row and column in the file."""
        wanted = [*(column.number for column in clock.columns), *numbers]
        names = [column.name or str(column.number + 1) for column in body.moving]
        turned = [c.name or str(c.number + 1) for c in sorted(body.orientation, key=lambda c: c.number)]

        def row(sample: int) -> int:
            return next(islice(self._rows(wanted, []), int(sample), None))[0]

        def named(columns: Sequence[Column]) -> str:
            return columns[0].name if columns else time

        return Origin(
            self.request.path,
            time=lambda sample: f"row {row(sample)}, column {named(clock.columns)}",
            position=lambda sample, dim: f"row {row(sample)}, column {names[dim]}",
            orientation=lambda sample: f"row {row(sample)}, columns {turned[0]} to {turned[-1]}",
        )

    # What is refused.

    def _no_movement(self) -> DemonstrationError:
        names = self._shown(self.columns)
        candidates = [
            column
            for column in self.columns
            if column.kind not in (Kind.TIME, Kind.INDEX) and self._is_number(column.number) and column.name
        ]
        if not candidates:
            return fault(
                self.request.path,
                "header",
                f"there are no positions beside time in {names}",
                "record them as well",
            )
        first = candidates[0]
        time = "1" if not self.layout.names and first.number == 0 and self._grows(0) else self.request.time
        if time == "1" and len(candidates) > 1:
            candidates = candidates[1:]
        asked = [str(c.number + 1) if len(self._named(c.name)) > 1 else c.name for c in candidates[:3]]
        return fault(
            self.request.path,
            "columns",
            f"no column is named as a position or a joint is; there are {names}",
            "name those of the positions: --columns",
            columns=asked,
            time=time,
        )

    def _is_number(self, number: int) -> bool:
        return all(self.layout.is_number(cell) or is_missing(cell) for cell in self._sample(number))

    def _shown(self, columns: Sequence[Column]) -> str:
        return listed([column.name or str(column.number + 1) for column in columns], _SHOWN)

    def _repeated(self, name: str, body: Body) -> DemonstrationError:
        choices = listed([f"{column.name} (column {column.number + 1})" for column in body.moving], _SHOWN)
        by_axis: dict[str, Column] = {}
        for column in reversed(body.moving):
            by_axis[column.axis] = column
        asked = [str(by_axis[axis].number + 1) for axis in sorted(by_axis)]
        whose = f" of {name}" if name else ""
        return fault(
            self.request.path,
            "columns",
            f"several columns may be the position{whose}: {choices}",
            "name them, by numbers where names repeat: --columns",
            columns=asked,
        )

    def _ambiguous(self, name: str, found: Sequence[Column], option: str = "columns") -> DemonstrationError:
        labels = [column.label for column in found]
        by_body = len(set(labels)) == len(labels)
        known = labels if by_body else [f"{c.name} (column {c.number + 1})" for c in found]
        asked: Any = [str(found[0].number + 1)]
        if option == "time":
            asked = asked[0]
        elif by_body and found[0].body:
            asked = [found[0].body]
        else:
            asked += [n for n in self.request.columns or () if n != name and len(self._named(n)) == 1]
        return fault(
            self.request.path,
            option,
            f"{len(found)} columns are called {name!r}: {listed(known, _SHOWN)}",
            f"choose one of them{'' if option == 'time' else ', or a body'}",
            **{option: asked},
        )

    def _mixed(self, found: dict[str, Body]) -> DemonstrationError:
        plain = [column.name for column in found[""].moving]
        named = [name for name in found if name]
        return fault(
            self.request.path,
            "columns",
            f"{listed(plain, 4)} belong to no body, and others to {listed(named, 4)}",
            f"choose: --columns {','.join(plain)}, or --columns {named[0]}",
            columns=plain,
        )

    def _no_time(self) -> DemonstrationError:
        names = [column.name for column in self.columns if column.name and self.layout.names]
        near = near_name("time", names).partition("known: ")[0] if names else ""
        growing = [
            column
            for column in self.columns
            if column.kind not in (Kind.POSITION, Kind.ORIENTATION) and self._grows(column.number)
        ]
        options: dict[str, Any] = {"rate": 100}
        advice = "give the samples a second: --rate HZ"
        chosen = self._chosen_numbers()
        growing = [c for c in growing if not self._counts(c.number) and c.number not in chosen]
        if growing and not self.guessed:
            named = growing[0].name or str(growing[0].number + 1)
            advice, options = f"name it: --time {named!r}, or {advice}", {"time": named}
        message = "there is no column of time"
        if not self.layout.names:
            message = f"the columns have no names, and there is no time among {self.layout.n_cells} of them"
            message += f" ({self.guessed})" if self.guessed else ""
        return fault(self.request.path, "time", message, near + advice, **options)

    def _two_clocks(self, first: Any, other: Any, passed: Sequence[float]) -> DemonstrationError:
        one, two = first[1].name, other[1].name
        return fault(
            self.request.path,
            "time",
            f"{passed[0]:.6g} s pass in {one!r}, and {passed[1]:.6g} s in {two!r}",
            f"choose one: --time {one!r}, or --time {two!r}",
            time=one,
        )

    def _bad_cell(self, wanted: Sequence[int]) -> DemonstrationError:
        """Return the error that describes the first bad cell of the wanted columns."""
        names = self.layout.names
        for row, line in self._rows(wanted, []):
            cells = self.layout.cells(line)
            again = [cell for cell in cells if cell and cell in names]
            if len(again) > 1:
                order = "" if list(names) == cells else ", in another order"
                message = f"the names of the columns stand there again{order}"
                return fault(
                    self.request.path, f"row {row}", message, "cut the file there: it holds two recordings"
                )
            for number in wanted:
                cell = cells[number] if number < len(cells) else ""
                if (not self.layout.is_number(cell) and not is_time(cell)) or not _is_finite(cell):
                    name = names[number] if number < len(names) and names[number] else str(number + 1)
                    return self._not_a_number(f"row {row}, column {name}", cell)
        return fault(
            self.request.path, None, "it cannot be read as a table of numbers", "write plain numbers"
        )

    def _not_a_number(self, key: str, cell: str) -> DemonstrationError:
        options: dict[str, Any] = {"drop_missing": True} if is_missing(cell) else {}
        measure = "fill in what was measured, or leave such rows out: --drop-missing"
        if not cell:
            message, way_out = "the cell is empty", measure
        elif is_missing(cell):
            message, way_out = f"{cell} is not a finite number", measure
        elif cell.lower().lstrip("+-") in ("inf", "infinity"):
            message, way_out = (
                f"{cell} is not a finite number",
                "fill in what was measured, or remove the row",
            )
        elif self.layout.is_number(cell):
            message, way_out = f"{_short(cell)[1:-1]} is too large", "remove the row"
        elif "," in cell and "." in cell and all(mark in "0123456789.,+-" for mark in cell):
            message, way_out = f"{_short(cell)} is not a number", "write it without marks of thousands"
        else:
            message, way_out = f"{_short(cell)} is not a number", "write plain numbers, such as 0.25"
        return fault(self.request.path, key, message, way_out, **options)

    def _ragged(self, row: int, n_cells: int, line: str) -> DemonstrationError:
        others = [
            mark for mark in SEPARATORS if mark != self.layout.separator and mark != " " and mark in line
        ]
        if self.layout.separator == "," and (";" in others or n_cells >= 2 * self.layout.n_cells):
            way_out = "these look like decimal commas: separate the columns by semicolons"
        else:
            way_out = "fill in or remove the row"
        n_names = len(self.layout.names) or self.layout.n_cells
        what = "the header has" if self.layout.names else "the rows before have"
        return fault(self.request.path, f"row {row}", f"it has {n_cells} cells and {what} {n_names}", way_out)


def _labels(column: Column) -> set[str]:
    """Return the labels of a column in lower case; a rotation may be called so as well."""
    label = column.label.lower()
    return {label, label.replace(".orientation.", ".rotation.")}


def _main_bodies(columns: tuple[Column, ...], layout: Layout) -> tuple[Column, ...]:
    """Return columns among which only rigid bodies count, if there are any, and not the markers on them."""
    types = [text.strip().lower() for text in layout.types]
    if "rigid body" not in types:
        return columns
    return tuple(
        column
        if column.number >= len(types) or types[column.number] in ("", "type", "rigid body")
        else replace(column, kind=Kind.OTHER)
        for column in columns
    )


def _seconds_and_nanoseconds(columns: Sequence[Column]) -> tuple[Column, Column] | None:
    """Return the first pair of columns that hold seconds and nanoseconds of one time."""
    for first in columns:
        for other in columns:
            if first.axis == "secs" and other.axis == "nsecs":
                stems = [column.name.lower().rpartition("sec")[0].rstrip("nao") for column in (first, other)]
                if stems[0] == stems[1]:
                    return first, other
    return None


def _kind_of_stamps(cells: Sequence[str]) -> Any:
    """Return the type in which stamps are parsed: whole numbers exactly, dates as text."""
    if any(map(is_time, cells)):
        return "U40"
    whole = cells and all(cell.lstrip("+-").isdigit() for cell in cells)
    return np.int64 if whole else np.float64


def _floats(cells: Sequence[str]) -> Array:
    with contextlib.suppress(ValueError):
        return np.array([float(cell.replace(",", ".")) for cell in cells])
    return np.array([])


def _grows(cells: Sequence[str]) -> bool:
    values = _floats(cells)
    return len(values) > 1 and bool((np.diff(values) > 0.0).all())


def _is_finite(cell: str) -> bool:
    try:
        return bool(np.isfinite(float(cell.replace(",", "."))))
    except ValueError:
        return is_time(cell)


def _by_numbers(layout: Layout) -> tuple[tuple[Column, ...], str]:
    """Return the columns of a table without names, by its numbers, and the layout that was recognised."""
    n_columns = layout.n_cells
    plain = [Column(number, str(number + 1), Kind.OTHER) for number in range(n_columns)]
    values = [_floats(row) for row in layout.sample if len(row) == n_columns]
    sample = np.array([row for row in values if len(row) == n_columns])

    def named(
        axes: dict[int, str], time: bool, words: str, unit: str | None = None
    ) -> tuple[tuple[Column, ...], str]:
        columns = list(plain)
        if time:
            columns[0] = replace(columns[0], kind=Kind.TIME)
        for number, axis in axes.items():
            kind = Kind.POSITION if axis in AXES else Kind.ORIENTATION
            columns[number] = replace(
                columns[number], kind=kind, axis=axis, unit=unit if axis in AXES else None
            )
        return tuple(columns), words

    def are_units(first: int) -> bool:
        return bool((np.abs(np.linalg.norm(sample[:, first : first + 4], axis=1) - 1.0) < 1e-3).all())

    if sample.ndim != 2 or not len(sample):
        return tuple(plain), ""
    grows = _grows([str(value) for value in sample[:, 0]])
    if n_columns == 12:
        matrices = sample.reshape(-1, 3, 4)[:, :, :3]
        off = np.einsum("nij,nkj->nik", matrices, matrices) - np.eye(3)
        if np.abs(off).max() < 1e-3:
            axes = {4 * row + 3: AXES[row] for row in range(3)}
            axes |= {4 * (i // 3) + i % 3: axis for i, axis in enumerate(MATRIX)}
            return named(axes, False, "poses of 12 numbers, as KITTI has them", "m")
    if n_columns >= 8 and grows and are_units(4):
        is_euroc = layout.separator == "," and sample[0, 0] > 1e17
        order = QUATERNION if is_euroc else (*QUATERNION[1:], QUATERNION[0])
        if n_columns == 8 or (is_euroc and n_columns == 17):
            words = "time, x y z and quaternion " + " ".join(axis[1] for axis in order)
            words += ", as EuRoC has them" if is_euroc else ", as TUM has them"
            return named(dict(enumerate((*AXES, *order), start=1)), True, words, "m")
    if n_columns == 4 and grows and abs(np.ptp(np.diff(sample[:, 0]))) < 0.5 * np.diff(sample[:, 0]).mean():
        return named(dict(enumerate(AXES, start=1)), True, "columns without names: taken for time x y z")
    return tuple(plain), ""


def _check_length(path: Path) -> None:
    """Raise if a file has too many rows or too long a row, before any of it is parsed."""
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
        raise fault(path, None, f"it has more than {MAX_ROWS:,} rows", _TOO_LONG)


def _short(text: str) -> str:
    """Quote `text`, shortened to a readable length."""
    text = text.strip()
    return repr(text if len(text) <= 40 else f"{text[:37]}...")


def _warn(path: Path, text: str) -> None:
    warnings.warn(f"{path}: {text}", ComoveWarning, stacklevel=6)

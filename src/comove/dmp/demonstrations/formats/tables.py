"""Recordings as text tables: any separator, any names of columns, any units of length and time.

The layout is found (`formats.layout`): separators, decimal commas, rows of the header, a preamble. The names of the
columns define their meaning (`comove.dmp.demonstrations.columns`), or else their numbers (`formats.table_guesses`).
comove's own tables (`formats.csv`) are those whose columns are exactly the ones that it writes. This module selects
the columns and the source of time; `formats.table_rows` and `formats.table_time` read them.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from comove.dmp.demonstrations.bodies import (
    Body,
    ambiguous,
    as_joints,
    bodies_of,
    chosen_body,
    columns_named,
    matching_body,
    spoken,
)
from comove.dmp.demonstrations.columns import Column, Kind, bare_name, is_derived, read_columns, words_of
from comove.dmp.demonstrations.formats import csv
from comove.dmp.demonstrations.formats.layout import (
    MAX_COLUMNS,
    MAX_NAME,
    Layout,
    is_missing,
    is_time,
    layout_of,
)
from comove.dmp.demonstrations.formats.table_guesses import (
    Array,
    are_rates_of,
    columns_by_numbers,
    grows_evenly,
    numbers_of,
    tried,
    with_matrices,
)
from comove.dmp.demonstrations.formats.table_rows import TOO_LONG, TableRows, check_length
from comove.dmp.demonstrations.formats.table_time import Clock
from comove.dmp.demonstrations.plausibility import require_rate
from comove.dmp.demonstrations.samples import (
    AXES,
    HZ,
    SAY_RATE,
    SAY_UNIT,
    SHOWN,
    TIME,
    WHICH_UNIT,
    Format,
    Origin,
    RecordedSamples,
    fault,
)
from comove.dmp.demonstrations.units import LENGTHS, TIMES, is_angle, is_length, require_unit, unit_named
from comove.errors import ComoveWarning, DemonstrationError, OptionError, listed, near_name
from comove.io.files import existing_file, telling

MAX_BYTES = 512 * 2**20
SPELT = {"tab": "\t", "\\t": "\t", "space": " ", "blank": " ", "comma": ",", "semicolon": ";", "pipe": "|"}


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
    drop_missing : whether rows with missing measurements are left out, instead of refused

    Returns
    -------
    demos : movement by body, in the order of the columns; "" if the columns name none, or only one

    Raises
    ------
    DemonstrationError
        If the file cannot be read with these options; names row, column and remedy, with the command.
    OptionError
        If an option is out of range, or contradicts the file.

    Warns
    -----
    ComoveWarning
        If rows were left out, or the last line has no end: it may be incomplete.
    """
    path = existing_file(Path(path), MAX_BYTES, TOO_LONG)
    request = _Request(path, manipulator, columns, delimiter, time, rate, unit, drop_missing)
    with telling(path):
        check_length(path)
        table = _Table.of(request)
        bodies = table.bodies()
        clock = table.clock()
        together = [bodies] if not drop_missing else [{name: body} for name, body in bodies.items()]
        found: dict[str, RecordedSamples] = {}
        for some in together:
            found |= table.movements(some, clock)
    return found


def names(path: str | os.PathLike[str], **options: Any) -> tuple[str, ...]:
    """Return the names of the bodies that `read` finds. Options are the same; numbers are not read."""
    path = existing_file(Path(path), MAX_BYTES, TOO_LONG)
    with telling(path):
        check_length(path)
        return tuple(_Table.of(_Request(path, **options)).bodies())


def is_table(path: Path) -> bool:
    """Return whether a file of any suffix is a table of numbers."""
    try:
        with telling(path):
            return bool(layout_of(existing_file(path, MAX_BYTES, TOO_LONG)).sample)
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
    """Options of a reader, checked."""

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
        header, preamble = layout.header, layout.preamble
        if layout.n_cells > MAX_COLUMNS:
            raise fault(
                request.path,
                f"row {layout.first}",
                f"there are {layout.n_cells} columns",
                f"keep those of the movement, {MAX_COLUMNS} at most",
            )
        for number, name in enumerate(header.names, start=1):
            if len(name) > MAX_NAME:
                message, way_out = f"the name has {len(name)} characters", f"use {MAX_NAME} at most"
                raise fault(request.path, f"header, column {number}", message, way_out)
        if not header.names:
            columns, guessed = columns_by_numbers(layout)
            return cls(request, layout, columns, guessed)
        kinds = (preamble.title,) * len(header.names) if is_derived(preamble.title) else header.kinds
        columns = read_columns(header.names, bodies=header.bodies, kinds=kinds, units=header.units)
        columns = with_matrices(_main_bodies(columns, layout), layout)
        if preamble.angles is not None and not any(column.kind is Kind.POSITION for column in columns):
            columns = tuple(
                replace(c, kind=Kind.JOINT, axis=bare_name(c.name)) if c.kind is Kind.OTHER and c.axis else c
                for c in columns
            )
        stated = {Kind.POSITION: preamble.unit, Kind.JOINT: preamble.angles}
        columns = tuple(replace(c, unit=c.unit or stated.get(c.kind)) for c in columns)
        return cls(request, layout, columns)

    @property
    def rows(self) -> TableRows:
        """Return the rows of the table."""
        return TableRows(self.layout, self.request.drop_missing)

    @cached_property
    def own(self) -> dict[str, Body] | None:
        """Return the bodies of a table that comove wrote, None of others."""
        layout, header = self.layout, self.layout.header
        is_plain = layout.separator == "," and not (header.bodies or header.units or layout.preamble.unit)
        return csv.own_bodies(header.names) if is_plain and header.names else None

    def bodies(self) -> dict[str, Body]:
        """Return the bodies to read."""
        request = self.request
        if request.columns is not None:
            body = chosen_body(request.columns, self.columns, request.path, request.unit)
            found = {body.name: body}
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
        """Return a body, its unitless joints as positions if lengths are stated."""
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
            return replace(body, position=(), orientation=(), joints=as_joints(body.position))
        return body

    # Time.

    def clock(self) -> Clock:
        """Return the source of time."""
        request, layout = self.request, self.layout
        if request.rate is not None:
            return Clock(rate=float(request.rate), words=f"time at {request.rate:g} samples a second")
        if request.time is not None:
            return self._chosen_clock(request.time)
        found = [column for column in self.columns if column.kind is Kind.TIME and self._is_readable(column)]
        chosen = self._chosen_numbers()
        found = [column for column in found if column.number not in chosen]
        if (
            not found
            and not layout.header.names
            and not chosen & {0}
            and request.columns is not None
            and self._grows(0)
        ):
            found = [replace(self.columns[0], kind=Kind.TIME)]
        if found:
            return Clock(tuple(found))
        first, are_indices = (
            self.columns[0],
            ("", "index", "Unnamed: 0"),
        )  # of pandas, which may hold the time
        if first.kind is Kind.INDEX and first.name in are_indices and self._grows(0) and not self._counts(0):
            return Clock((replace(first, name=first.name or "1"),))
        if layout.preamble.rate is not None:
            frames = [c for c in self.columns if c.kind is Kind.INDEX and "frame" in c.name.lower()][:1]
            words = f"time at {layout.preamble.rate:g} samples a second, as the file says"
            return Clock(tuple(frames), rate=layout.preamble.rate, words=words)
        raise self._no_time()

    def _chosen_numbers(self) -> set[int]:
        return {
            column.number
            for name in self.request.columns or ()
            for column in columns_named(name, self.columns)
        }

    def _chosen_clock(self, time: str) -> Clock:
        bare = bare_name(time)
        found = columns_named(time, self.columns) or columns_named(bare, self.columns)
        if not found:
            names = [column.name for column in self.columns if column.name][:SHOWN]
            raise fault(self.request.path, "time", f"there is no column {bare!r}", near_name(bare, names))
        if len(found) > 1:
            raise ambiguous(self.request.path, "time", bare, found)
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
            return Clock((replace(found[0], unit=unit),), is_chosen=True)
        others = [c for c in self.columns if c.kind is Kind.TIME and c != found[0] and self._is_readable(c)]
        return Clock((found[0], *others), is_chosen=True)

    def _is_readable(self, column: Column) -> bool:
        cells = self.layout.sampled(column.number)
        return bool(cells) and (self.layout.is_number(cells[0]) or is_time(cells[0]))

    def _grows(self, number: int) -> bool:
        return grows_evenly(numbers_of(self.layout.sampled(number)))

    def _counts(self, number: int) -> bool:
        return bool((np.diff(numbers_of(self.layout.sampled(number))) == 1.0).all())

    def movements(self, bodies: dict[str, Body], clock: Clock) -> dict[str, RecordedSamples]:
        """Read the numbers of some bodies."""
        request = self.request
        numbers = list(dict.fromkeys(c.number for body in bodies.values() for c in body.needed))
        stamps, values, dropped = self.rows.read([column.number for column in clock.columns], numbers)
        time = clock.time(self.layout, stamps, len(values))
        if request.rate is not None:
            self._warn_of_restarts()
        found = {}
        for name, body in bodies.items():
            fields = body.samples(values, numbers, request.unit)
            stated = fields.pop("stated", frozenset()) | {TIME}
            words = f"{time.words}, {body.words(request.unit)}" + (
                f" ({self.guessed})" if self.guessed else ""
            )
            left = self._left_out(body)
            found[name] = RecordedSamples(
                time.seconds,
                name=f"{request.path.stem}.{name}" if name else request.path.stem,
                notes=(words, *time.notes, *filter(None, [left, dropped])),
                stated=stated,
                origin=self._origin(body, time.words, numbers, clock),
                **fields,
            )
        return found

    def _warn_of_restarts(self) -> None:
        """Warn if row counts restart, as where tables hold several recordings."""
        rows = tried(self.layout)
        for column in self.columns:
            if column.kind is not Kind.INDEX or not column.name or "sub" in words_of(column.name):
                continue
            counted = numbers_of([row[column.number] for row in rows])
            again = np.flatnonzero((np.diff(counted) < 0.0) & (counted[1:] == counted[0]))
            if again.size:
                warnings.warn(
                    f"{self.request.path.name}: column {column.name!r} begins again in the sample "
                    f"{again[0] + 2}: recordings in one table are learned as one; write each to a file of its own",
                    ComoveWarning,
                    stacklevel=2,
                )
                return

    def _left_out(self, body: Body) -> str:
        """Return in words which numbers beside joints or positions are left out."""
        passed = (Kind.TIME, Kind.INDEX) if body.joints else set(Kind) - {Kind.JOINT, Kind.GRIPPER}
        left = [
            column
            for column in self.columns
            if column not in body.needed and column.kind not in passed and self._is_number(column.number)
        ]
        return f"left out: {listed(spoken(left), 8)}" if left and self.request.columns is None else ""

    def _origin(self, body: Body, time: str, numbers: Sequence[int], clock: Clock) -> Origin:
        """Name samples by their row and column in the file."""
        wanted = [*(column.number for column in clock.columns), *numbers]
        names = [column.name or str(column.number + 1) for column in body.moving]
        turned = [c.name or str(c.number + 1) for c in sorted(body.orientation, key=lambda c: c.number)]

        def row(sample: int) -> int:
            return next(islice(self.rows.numbered(wanted), int(sample), None))[0]

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
            if column.kind in (Kind.OTHER, Kind.INDEX) and self._is_number(column.number)
            if column.name
            and self._may_be_anything(column)
            and column.unit not in TIMES
            and not (column.kind is Kind.INDEX and self._is_whole(column.number))
        ]
        if not candidates:
            are_lists = any(cell.startswith("[") for row in self.layout.sample for cell in row)
            message = f"there are no positions beside time in {names}"
            if are_lists:
                message = f"cells hold lists of numbers, in {names}"
            if is_derived(self.layout.preamble.title):
                message = f"its first line says that it holds {self.layout.preamble.title!r}, which are no positions"
            way_out = "write a column for each number" if are_lists else "record them as well"
            return fault(self.request.path, "header", message, way_out)
        first = candidates[0]
        is_unnamed = not self.layout.header.names
        time = "1" if is_unnamed and first.number == 0 and self._grows(0) else self.request.time
        if time == "1" and len(candidates) > 1:
            candidates = candidates[1:]
        if not self.layout.header.names:
            candidates = self._coordinates(candidates, time == "1")
        unit = self.request.unit
        chosen = candidates if is_angle(unit) else candidates[: len(AXES)]
        asked = [
            str(c.number + 1) if len(columns_named(c.name, self.columns)) > 1 else c.name for c in chosen
        ]
        advice = "name those of the positions, or of the joints, and their unit, by which they are told apart"
        is_told = unit is not None or all(column.unit is not None for column in chosen)
        return fault(
            self.request.path,
            "columns",
            f"no column is named as a position or a joint is; there are {self._with_ranges(candidates)}",
            "name those of the positions: --columns" if is_told else f"{advice}: --columns, and {SAY_UNIT}",
            columns=asked,
            time=time,
            unit=None if is_told else WHICH_UNIT,
        )

    def _with_ranges(self, columns: Sequence[Column]) -> str:
        """Return columns' names, each with its range in many rows."""
        rows = tried(self.layout)
        said = []
        for column in columns[:SHOWN]:
            values = numbers_of([row[column.number] for row in rows])
            values = values[np.isfinite(values)]
            least, most = (values.min(), values.max()) if values.size else (np.nan, np.nan)
            said.append(f"{column.name or column.number + 1} ({least:.3g} to {most:.3g})")
        return listed(said + [column.name for column in columns[SHOWN:]], SHOWN)

    def _coordinates(self, columns: Sequence[Column], is_timed: bool) -> list[Column]:
        """Return unnamed columns that may be coordinates. Leading counters and speeds are left out."""
        layout, rows = self.layout, tried(self.layout)
        stamps = numbers_of([row[0] for row in rows]) if is_timed else np.zeros(0)
        seen: list[Array] = []
        kept: list[Column] = []
        for column in columns[:SHOWN]:
            values = numbers_of([row[column.number] for row in rows])
            are_same_count = layout.sampled(column.number)[0].isdigit() and np.ptp(values) == 0.0
            are_speeds = any(are_rates_of(values, others, stamps) for others in seen)
            seen.append(values)
            if not are_speeds and (kept or not are_same_count):
                kept.append(column)
            if len(kept) == len(AXES):
                break
        return kept or list(columns)

    def _may_be_anything(self, column: Column) -> bool:
        """Return whether a column's meaning is unknown."""
        return bool(column.axis) or column.kind is Kind.INDEX or not self.layout.header.names

    def _is_whole(self, number: int) -> bool:
        return all(cell.isdigit() for cell in self.layout.sampled(number))

    def _is_number(self, number: int) -> bool:
        return all(self.layout.is_number(cell) or is_missing(cell) for cell in self.layout.sampled(number))

    def _shown(self, columns: Sequence[Column]) -> str:
        return listed([column.name or str(column.number + 1) for column in columns], SHOWN)

    def _repeated(self, name: str, body: Body) -> DemonstrationError:
        choices = listed([f"{column.name} (column {column.number + 1})" for column in body.moving], SHOWN)
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
        names = [column.name for column in self.columns if column.name and self.layout.header.names]
        near = near_name("time", names).partition("known: ")[0] if names else ""
        chosen = self._chosen_numbers()
        growing = [
            column
            for column in self.columns
            if column.kind in (Kind.INDEX, Kind.OTHER) and column.number not in chosen
            if self._may_be_anything(column)
            and self._grows(column.number)
            and not self._counts(column.number)
            and not (column.kind is Kind.INDEX and self._is_whole(column.number))
            and (np.diff(numbers_of([row[column.number] for row in tried(self.layout)])) > 0.0).all()
        ]
        options: dict[str, Any] = {"rate": HZ}
        advice = SAY_RATE
        if growing and not self.guessed:
            named = growing[0].name or str(growing[0].number + 1)
            advice, options = f"name it: --time {named!r}, or {advice}", {"time": named}
        message = "there is no column of time"
        if not self.layout.header.names:
            message = f"the columns have no names, and there is no time among {self.layout.n_cells} of them"
            message += f" ({self.guessed})" if self.guessed else ""
        return fault(self.request.path, "time", message, near + advice, **options)


def _main_bodies(columns: tuple[Column, ...], layout: Layout) -> tuple[Column, ...]:
    """Return columns of rigid bodies and bones, if any, without their markers."""
    types = [text.strip().lower() for text in layout.header.types]
    if not {"rigid body", "bone"} & set(types):
        return columns
    return tuple(
        column
        if column.number >= len(types) or types[column.number] in ("", "type", "rigid body", "bone")
        else replace(column, kind=Kind.OTHER)
        for column in columns
    )

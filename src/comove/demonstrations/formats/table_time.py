"""The time of text tables: seconds from columns of stamps, dates or times of the day, or from a rate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np
from numpy.typing import NDArray

from comove.demonstrations.columns import Column
from comove.demonstrations.formats.layout import Layout
from comove.demonstrations.plausibility import seconds, unit_of_time
from comove.demonstrations.samples import Origin, fault
from comove.demonstrations.units import TIMES
from comove.errors import DemonstrationError, near_name

Array = NDArray[np.float64]

_ZONE = re.compile(r"(?:Z|([+-])(\d{2}):?(\d{2}))$")
_DAY = 86_400_000_000_000  # ns


@dataclass(frozen=True)
class Clock:
    """Where the time of a table comes from: one column or two, or a rate.

    Attributes
    ----------
    columns : columns of time; two of them are seconds and nanoseconds, or alternatives; of a rate those of frames
    unit : unit that a user states
    rate : samples a second [Hz]
    words : what is said of a rate
    """

    columns: tuple[Column, ...] = ()
    unit: str | None = None
    rate: float | None = None
    words: str = ""

    def seconds(
        self, layout: Layout, stamps: list[NDArray], n_rows: int
    ) -> tuple[Array, str, tuple[str, ...]]:
        """Return time [s], shape (n_rows,), where it comes from in words, and notes.

        Parameters
        ----------
        layout : layout of the table
        stamps : numbers or texts of each column
        n_rows : number of rows

        Raises
        ------
        DemonstrationError
            If their unit is not known, or two columns tell different times.
        """
        if self.rate is not None:
            frames = stamps[0] if stamps and stamps[0].dtype.kind in "if" else np.arange(n_rows)
            if len(frames) > 1 and (np.diff(frames) <= 0).any():
                frames = np.arange(n_rows)
            return (frames - frames[0]) / self.rate, self.words, ()
        origin = Origin(layout.path)
        if len(self.columns) == 2 and self.columns[1].axis == "nsecs":
            whole, rest = stamps
            if whole.dtype.kind == "i" and rest.dtype.kind == "i":
                time, notes = seconds(whole * 1_000_000_000 + rest, "ns", origin=origin)
            else:
                time, notes = seconds(whole + 1e-9 * rest, "s", origin=origin)
            names = " and ".join(_spoken(column, layout) for column in self.columns)
            return time, f"time from {names} [s, ns]", notes
        found = [self._of_column(layout, *one) for one in zip(self.columns, stamps, strict=True)]
        moving = [one for one in found if one is not None and np.ptp(one[0]) > 0.0] or [f for f in found if f]
        first = moving[0]
        for other in moving[1:]:
            passed = [float(np.ptp(one[0])) for one in (first, other)]
            if abs(passed[0] - passed[1]) > 0.01 * max(passed) + 1e-3:
                one, two = first[1].name, other[1].name
                raise fault(
                    layout.path,
                    "time",
                    f"{passed[0]:.6g} s pass in {one!r}, and {passed[1]:.6g} s in {two!r}",
                    f"choose one: --time {one!r}, or --time {two!r}",
                    time=one,
                )
        time, column, unit, notes = first
        return time, f"time from {_spoken(column, layout)} [{unit}]", notes

    def _of_column(
        self, layout: Layout, column: Column, stamps: NDArray
    ) -> tuple[Array, Column, str, tuple[str, ...]] | None:
        """Return the seconds of one column of time, and its unit; None where it is one of several and unclear."""
        if stamps.dtype.kind == "U":
            time, notes = seconds(_nanoseconds(layout, column, stamps), "ns")
            return time, column, "date", notes
        unit = self.unit or column.unit
        if unit is not None and unit not in TIMES:
            raise fault(
                layout.path, "time", f"the unit of time {unit!r} is not known", near_name(unit, TIMES)
            )
        is_inferred = unit is None
        if is_inferred:
            unit = unit_of_time(stamps)
            if unit is None and len(self.columns) > 1:
                return None
        name = column.name or str(column.number + 1)
        time, notes = seconds(stamps, unit, name=name, origin=Origin(layout.path))
        return time, column, f"{unit}, after its size" if is_inferred and unit != "s" else str(unit), notes


def _spoken(column: Column, layout: Layout) -> str:
    return f"`{column.name}`" if layout.names else f"column {column.number + 1}"


def _nanoseconds(layout: Layout, column: Column, stamps: NDArray) -> NDArray[np.int64]:
    """Return nanoseconds of dates from 1970, or of times of the day, which may pass midnight."""
    zone = _ZONE.search(str(stamps[0]))
    text = np.char.strip(np.char.replace(stamps, ",", "."))
    if zone is not None:
        if not np.char.endswith(text, zone[0]).all():
            raise _no_dates(layout, column, f"the zone of time changes: not all stamps end in {zone[0]!r}")
        text = np.char.strip(np.char.replace(text, zone[0], ""))
    parts = np.char.partition(np.char.replace(text, "T", " "), " ")
    has_dates = bool((parts[:, 2] != "").all()) or "-" in str(stamps[0])
    days, clocks = (parts[:, 0], parts[:, 2]) if has_dates else (np.array([]), parts[:, 0])
    hours = np.char.partition(np.where(clocks == "", "0:00:00", clocks), ":")
    try:
        passed = np.char.add("1970-01-01T00:", hours[:, 2]).astype("datetime64[ns]").astype(np.int64)
        passed += hours[:, 0].astype(np.int64) * 3_600_000_000_000
        if not has_dates:
            return passed + _DAY * np.r_[0, np.cumsum(np.diff(passed) < -_DAY // 2)]
        unique, places = np.unique(days, return_inverse=True)
        passed += _DAY * np.array(_days(unique.tolist()))[places]
    except ValueError as error:
        message = f"{stamps[0]!r} and the cells below are no dates such as 2024-05-01 10:00:00.25"
        raise _no_dates(layout, column, message) from error
    if zone is not None and zone[1]:
        minutes = 60 * int(zone[2]) + int(zone[3])
        passed -= (1 if zone[1] == "+" else -1) * minutes * 60_000_000_000
    return passed


def _days(texts: Sequence[str]) -> list[int]:
    """Return days since 1970; of day and month in an unknown order, those that lie closest together."""
    numbers = [tuple(map(int, re.split(r"[-/.]", text))) for text in texts]
    if all(one[0] > 31 for one in numbers):
        orders = [(0, 1, 2)]
    else:
        orders = [(2, 1, 0)] if any("." in text for text in texts) else [(2, 0, 1), (2, 1, 0)]
    found = []
    for order in orders:
        try:
            dates = [date(*(one[i] for i in order)) for one in numbers]
        except ValueError:
            continue
        found.append([(day - date(1970, 1, 1)).days for day in dates])
    if not found:
        raise ValueError("no dates")
    return min(found, key=np.ptp)


def _no_dates(layout: Layout, column: Column, message: str) -> DemonstrationError:
    return fault(
        layout.path,
        f"column {column.name}",
        message,
        "give the samples a second instead: --rate HZ",
        time=None,
        rate=100,
    )

"""The time of text tables, from columns of stamps or a rate."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.clocks import Time, time_of
from comove.dmp.demonstrations.columns import Column
from comove.dmp.demonstrations.formats.layout import Layout
from comove.dmp.demonstrations.samples import HZ, SAY_RATE, Origin, fault
from comove.errors import DemonstrationError

_ZONE = re.compile(r"(?:Z|([+-])(\d{2}):?(\d{2}))$")
_DAY, _HOUR = 86_400_000_000_000, 3_600_000_000_000  # ns


@dataclass(frozen=True)
class Clock:
    """The source of a table's time: its columns, or a rate.

    Attributes
    ----------
    columns : columns of time; of a rate those of frames
    is_chosen : whether a user names the first of them
    rate : samples a second [Hz]
    words : description of a rate
    """

    columns: tuple[Column, ...] = ()
    is_chosen: bool = False
    rate: float | None = None
    words: str = ""

    def time(self, layout: Layout, stamps: Sequence[NDArray], n_rows: int) -> Time:
        """Return the time of the rows of a table.

        Parameters
        ----------
        layout : layout of the table
        stamps : arrays, shape (n_rows,), of the numbers or texts of each column
        n_rows : number of rows

        Raises
        ------
        DemonstrationError
            As `time_of`, or if texts are no dates.
        """
        if self.rate is not None:
            frames = stamps[0] if stamps and stamps[0].dtype.kind in "if" else np.arange(n_rows)
            if len(frames) > 1 and (np.diff(frames) <= 0).any():
                frames = np.arange(n_rows)
            return Time((frames - frames[0]) / self.rate, self.words)
        are_dates = [one.dtype.kind == "U" for one in stamps]
        found = [
            (replace(column, unit="ns"), _nanoseconds(layout, column, one)) if is_date else (column, one)
            for column, one, is_date in zip(self.columns, stamps, are_dates, strict=True)
        ]
        time = time_of(found, Origin(layout.path), is_chosen=self.is_chosen)
        return replace(time, words=time.words.replace("[ns]", "[date]")) if any(are_dates) else time


def _nanoseconds(layout: Layout, column: Column, stamps: NDArray) -> NDArray[np.int64]:
    """Return nanoseconds since 1970, or of times of day.

    Times of day may pass midnight, minutes and seconds a full hour.
    """
    zone = _ZONE.search(str(stamps[0]))
    text = np.char.strip(np.char.replace(stamps, ",", "."))
    if zone is not None:
        if not np.char.endswith(text, zone[0]).all():
            raise _no_dates(layout, column, f"the zone of time changes: not all stamps end in {zone[0]!r}")
        text = np.char.strip(np.char.replace(text, zone[0], ""))
    parts = np.char.partition(np.char.replace(text, "T", " "), " ")
    has_dates = bool((parts[:, 2] != "").all()) or "-" in str(stamps[0])
    days, clocks = (parts[:, 0], parts[:, 2]) if has_dates else (np.array([]), parts[:, 0])
    clocks = np.where(clocks == "", "0:00:00", clocks)
    are_minutes = np.char.count(clocks, ":") == 1  # and seconds
    clocks = np.where(are_minutes, np.char.add("0:", clocks), clocks)
    hours = np.char.partition(clocks, ":")
    try:
        passed = np.char.add("1970-01-01T00:", hours[:, 2]).astype("datetime64[ns]").astype(np.int64)
        passed += hours[:, 0].astype(np.int64) * _HOUR
        if not has_dates:
            whole = _HOUR if are_minutes.all() else _DAY
            return passed + whole * np.r_[0, np.cumsum(np.diff(passed) < -whole // 2)]
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
    """Return days since 1970; day and month are ordered such that dates are closest."""
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
        f"instead, {SAY_RATE}",
        time=None,
        rate=HZ,
    )

"""Time from a recording's columns: one, several, or seconds and fractions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.columns import Column
from comove.dmp.demonstrations.plausibility import seconds, unit_of_time
from comove.dmp.demonstrations.samples import Origin, fault
from comove.dmp.demonstrations.units import TIMES
from comove.errors import near_name

FRACTIONS = ("ms", "us", "ns")
"""Units in which a second column may hold the fraction of a second."""


@dataclass(frozen=True)
class Time:
    """The time of each sample.

    Attributes
    ----------
    seconds : array, shape (n_steps,), [s]
    words : its source
    notes : inferred facts
    is_stated : whether its unit is stated, rather than inferred
    """

    seconds: NDArray[np.float64]
    words: str
    notes: tuple[str, ...] = ()
    is_stated: bool = True


def time_of(
    found: Sequence[tuple[Column, NDArray]], origin: Origin, *, is_chosen: bool = False, way_out: str = ""
) -> Time:
    """Return the time that columns of a recording hold.

    Whole seconds and the fraction of a second in another column are added. Of several whole times the first that
    increases is used, and all have to agree.

    Parameters
    ----------
    found : columns of time with their stamps, arrays of shape (n_steps,)
    origin : place of the stamps, for messages
    is_chosen : whether the first column is the one that a user names, so that others are only its fraction
    way_out : how to state a unit; by default by the option `time`

    Raises
    ------
    DemonstrationError
        If the unit of a column is not known, or two columns hold different times.
    """
    for column, _ in found:
        if column.unit is not None and column.unit not in TIMES:
            message = f"the unit of time {column.unit!r} is not known"
            raise fault(origin.file, "time", message, near_name(column.unit, TIMES))
    pair = _parts(found)
    if pair is not None and (not is_chosen or 0 in pair):
        (whole, stamps), (rest, fractions) = (found[number] for number in pair)
        in_ns = round(TIMES[str(rest.unit)] / TIMES["ns"])
        stamps, fractions = stamps.astype(np.int64), fractions.astype(np.int64)
        time, notes = seconds(stamps * 1_000_000_000 + fractions * in_ns, "ns", origin=origin)
        return Time(time, f"time from {_spoken(whole)} and {_spoken(rest)} [s, {rest.unit}]", notes)
    read = []
    for column, stamps in found[:1] if is_chosen else found:
        unit = column.unit or unit_of_time(stamps)
        if unit is None and len(found) > 1 and not is_chosen:
            continue
        name = column.name or str(column.number + 1)
        time, notes = seconds(stamps, unit, name=name, origin=origin, way_out=way_out)
        is_inferred = column.unit is None and unit != "s"
        words = f"time from {_spoken(column)} [{unit}{', after its size' if is_inferred else ''}]"
        read.append((name, Time(time, words, notes, column.unit is not None)))
    if not read:  # of several, all unclear
        return time_of(found[:1], origin, way_out=way_out)
    passing = [one for one in read if np.ptp(one[1].seconds) > 0.0] or read
    (one, first), *others = passing
    for two, other in others:
        passed = [float(np.ptp(each.seconds)) for each in (first, other)]
        if abs(passed[0] - passed[1]) > 0.01 * max(passed) + 1e-3:
            raise fault(
                origin.file,
                "time",
                f"{passed[0]:.6g} s pass in {one!r}, and {passed[1]:.6g} s in {two!r}",
                f"choose one: --time {one!r}, or --time {two!r}",
                time=one,
            )
    return first


def _parts(found: Sequence[tuple[Column, NDArray]]) -> tuple[int, int] | None:
    """Return the columns of whole seconds and fractions with most similar names."""

    def are_whole(stamps: NDArray) -> bool:
        return stamps.dtype.kind in "iu" or bool((np.floor(stamps) == stamps).all())

    pairs = [
        (_n_alike(whole.name, rest.name), i, j)
        for i, (whole, stamps) in enumerate(found)
        for j, (rest, fractions) in enumerate(found)
        if whole.unit == "s" and rest.unit in FRACTIONS and are_whole(stamps) and are_whole(fractions)
        if len(fractions) and fractions.min() >= 0 and fractions.max() * TIMES[rest.unit] < 1.0
    ]
    best = max(pairs, key=lambda pair: pair[0], default=None)
    return None if best is None else best[1:]


def _n_alike(one: str, other: str) -> int:
    return next((i for i, pair in enumerate(zip(one, other, strict=False)) if len(set(pair)) > 1), len(one))


def _spoken(column: Column) -> str:
    return f"column {column.name}" if column.name == str(column.number + 1) else f"`{column.name}`"

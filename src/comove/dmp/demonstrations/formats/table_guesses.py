"""Columns by numbers: TUM, EuRoC, KITTI, `ros2 topic echo`, homogeneous matrices."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from itertools import islice, pairwise

import numpy as np

from comove.arrays import Array
from comove.dmp.demonstrations.columns import MATRIX, Column, Kind
from comove.dmp.demonstrations.formats.layout import Layout
from comove.dmp.demonstrations.plausibility import EPOCHS
from comove.dmp.demonstrations.samples import AXES, QUATERNION

_XYZW = (*QUATERNION[1:], QUATERNION[0])
_TRIED = 1000
"""Rows by which columns without names are told apart."""
_TOLERANCE = 1e-3
"""How far quaternions may be from unit norm, and matrices from orthogonal."""


def tried(layout: Layout) -> list[list[str]]:
    """Return the cells of many rows, more than the first ones."""
    rows = (layout.cells(line) for _, line in islice(layout.rows(), _TRIED))
    return [row for row in rows if len(row) == layout.n_cells]


def numbers_of(cells: Sequence[str]) -> Array:
    """Return the numbers in some cells; nan where there is none."""
    found = []
    for cell in cells:
        try:
            found.append(float(cell.replace(",", ".")))
        except ValueError:
            found.append(np.nan)
    return np.array(found)


def grows_evenly(values: Array) -> bool:
    """Return whether numbers increase in similar steps. Steps differ by less than half of their mean."""
    steps = np.diff(values)
    return len(steps) > 0 and bool((steps > 0.0).all() and np.ptp(steps) < 0.5 * steps.mean())


def are_rates_of(rates: Array, values: Array, stamps: Array) -> bool:
    """Return whether numbers are the rates of change of others.

    They agree within a fifth of these or of their integral. Steady ones are undecided.
    """
    steps = np.diff(stamps)
    if len(steps) < 3 or not (steps > 0.0).all():
        return False
    speeds = np.diff(values) / steps
    middle = 0.5 * (rates[1:] + rates[:-1])
    are_near = np.linalg.norm(middle - speeds) < 0.2 * np.linalg.norm(speeds)
    are_near |= np.ptp(values[1:] - np.cumsum(middle * steps)) < 0.2 * np.ptp(values)
    return bool(np.ptp(speeds) > 0.05 * np.abs(speeds).max() and are_near)


def columns_by_numbers(layout: Layout) -> tuple[tuple[Column, ...], str]:
    """Return a nameless table's columns, and the recognised layout in words."""
    n_columns = layout.n_cells
    plain = [Column(number, str(number + 1), Kind.OTHER) for number in range(n_columns)]
    sample = np.array([numbers_of(row) for row in layout.sample if len(row) == n_columns])
    if sample.ndim != 2 or len(sample) < 2:
        return tuple(plain), ""
    places = np.flatnonzero(np.isfinite(sample).all(axis=0)).tolist()
    times = _times(sample, places, layout)
    rest = places[len(times) :]
    names: dict[int, str] = {}
    is_euroc = len(times) == 1 and layout.separator == "," and sample[0, 0] > EPOCHS["ns"][0] / 10
    words = ""
    if (poses := _pose(sample, places)) is not None:
        times, names, words = {}, poses, f"poses of {len(places)} numbers, as KITTI has them"
    elif times and (poses := _pose(sample, rest)) is not None:
        names, words = poses, f"time and poses of {len(rest)} numbers"
    elif len(rest) >= 7 and times and _are_units(sample[:, rest[3:7]]):
        order = QUATERNION if is_euroc else _XYZW
        if len(times) == 2 or len(rest) == 7 or (is_euroc and len(rest) == 16):
            names = dict(zip(rest, (*AXES, *order), strict=False))
            like = (
                "EuRoC has"
                if is_euroc
                else "TUM has"
                if len(times) == 1
                else "`ros2 topic echo --csv` writes"
            )
            words = f"time, x y z and quaternion {' '.join(axis[1] for axis in order)}, as {like} them"
    elif len(rest) == 3 == n_columns - 1 and times and grows_evenly(sample[:, 0]):
        stamps, *values = (numbers_of(column) for column in zip(*tried(layout), strict=True))
        if any(are_rates_of(rates, others, stamps) for others, rates in pairwise(values)):
            return tuple(plain), ""  # one coordinate, its speed and its acceleration
        names = dict(zip(rest, AXES, strict=True))
        return _named(plain, times, names, None), "columns without names: taken for time x y z"
    if not names:
        return tuple(plain), ""
    return _named(plain, times, names, "m"), words


def _times(sample: Array, places: Sequence[int], layout: Layout) -> dict[int, str | None]:
    """Return the units of the leading time columns. They are one that grows, or seconds from 1970 and nanoseconds."""
    if places[:2] == [0, 1]:
        first, other = sample[:, 0], sample[:, 1]
        are_whole = all(cell.isdigit() for number in (0, 1) for cell in layout.sampled(number))
        in_seconds = (first >= EPOCHS["s"][0]).all() and (first < EPOCHS["s"][1]).all()
        if are_whole and in_seconds and (other >= 0).all() and (other < 1e9).all() and np.ptp(other) > 0:
            return {0: "s", 1: "ns"}
    grows = (np.diff(sample[:, 0]) > 0.0).all()
    return {0: None} if places[:1] == [0] and grows else {}


def _named(
    plain: Sequence[Column], times: dict[int, str | None], names: dict[int, str], unit: str | None
) -> tuple[Column, ...]:
    columns = list(plain)
    for number, of_time in times.items():
        columns[number] = replace(columns[number], kind=Kind.TIME, unit=of_time)
    for number, axis in names.items():
        is_position = axis in AXES
        kind = Kind.POSITION if is_position else Kind.ORIENTATION
        columns[number] = replace(columns[number], kind=kind, axis=axis, unit=unit if is_position else None)
    return tuple(columns)


def with_matrices(columns: tuple[Column, ...], layout: Layout) -> tuple[Column, ...]:
    """Return columns with homogeneous matrices, `O_T_EE[0]` to `[15]`, as positions and rotations."""
    stems: dict[str, list[Column]] = {}
    for column in columns:
        found = re.fullmatch(r"(.*?)[._\[(/ ]?\d+[\])]?", column.name)
        if found and column.kind in (Kind.OTHER, Kind.JOINT):
            stems.setdefault(found[1], []).append(column)
    changed = {column.number: column for column in columns}
    whole = [row for row in layout.sample if len(row) == layout.n_cells]
    for stem, members in stems.items():
        if len(members) not in (12, 16) or members[-1].number >= layout.n_cells:
            continue
        sample = np.column_stack([numbers_of([row[c.number] for row in whole]) for c in members])
        for place, axis in (_pose(sample, range(len(members))) or {}).items():
            kind = Kind.POSITION if axis in AXES else Kind.ORIENTATION
            column = members[place]
            changed[column.number] = replace(column, kind=kind, axis=axis, body=column.body or stem)
    return tuple(changed[column.number] for column in columns)


def _pose(sample: Array, places: Sequence[int]) -> dict[int, str] | None:
    """Return the axes of columns that are poses, else None. Poses are 12 numbers, or 16 by rows or columns.

    A rotation by columns is recognised by the translation in the last four numbers.
    """
    n = len(places)
    if n not in (12, 16):
        return None
    values = sample[:, list(places)].reshape(len(sample), -1, 4)
    cells = np.array(places).reshape(-1, 4)
    if n == 16:
        last = np.array([0.0, 0.0, 0.0, 1.0])
        if np.abs(values[:, :, 3] - last).max() < _TOLERANCE:  # by columns; a pose at the origin is either
            values, cells = values.transpose(0, 2, 1), cells.T
        if np.abs(values[:, 3] - last).max() >= _TOLERANCE:
            return None
    turned = values[:, :3, :3]
    if not np.abs(np.einsum("nij,nkj->nik", turned, turned) - np.eye(3)).max() < _TOLERANCE:
        return None
    axes = {int(cells[i, 3]): AXES[i] for i in range(3)}
    return axes | {int(cells[k // 3, k % 3]): axis for k, axis in enumerate(MATRIX)}


def _are_units(values: Array) -> bool:
    return bool((np.abs(np.linalg.norm(values, axis=1) - 1.0) < _TOLERANCE).all())

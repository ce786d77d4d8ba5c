"""comove's own text tables: writing, and recognition of their columns.

One movement has the header `time,x`, `time,x,y` or `time,x,y,z`; several manipulators recorded together have
`time,left.x,left.y,...,right.x,right.y,...`. The columns `qw,qx,qy,qz` (`left.qw`, ...) hold orientations,
quaternions of unit norm. Other coordinates are named with their unit: `elbow [rad]`, `left.elbow [rad]`. Time is in
seconds, positions are in metres, numbers have a decimal point, the encoding is UTF-8. They are read as any other
table (`formats.tables`).
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence

import numpy as np

from comove.dmp.demonstrations.bodies import Body
from comove.dmp.demonstrations.columns import Column, Kind
from comove.dmp.demonstrations.samples import AXES, QUATERNION, RecordedSamples, by_manipulator, fault
from comove.dmp.demonstrations.units import unit_named
from comove.io.files import whole_file

_UNIT = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\[\]]*[^\[\]0-9][^\[\]]*)\]")
_MARKS = ",;\t\r\n"
"""What cannot stand in a name: it separates."""


def write(path: str | os.PathLike[str], demos: RecordedSamples | Mapping[str, RecordedSamples]) -> None:
    """Write movements to a CSV file, without loss of any bit.

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


def own_bodies(names: Sequence[str]) -> dict[str, Body] | None:
    """Return the bodies of a table made by `write`, else None."""
    if len(names) < 2 or names[0] != "time":
        return None
    parts: dict[str, list[tuple[str, str | None, int]]] = {}
    for number, name in enumerate(names[1:], start=1):
        named = _UNIT.fullmatch(name)
        body, dot, axis = (named["name"] if named else name).rpartition(".")
        if not axis or bool(dot) != bool(body) or not (named or axis in AXES or axis in QUATERNION):
            return None
        parts.setdefault(body, []).append((axis, named["unit"].strip() if named else None, number))
    if "" in parts and len(parts) > 1:
        return None
    bodies = {body: _own_body(body, found, names) for body, found in parts.items()}
    known = {name: body for name, body in bodies.items() if body is not None}
    shapes = {(len(body.moving), len(body.orientation)) for body in known.values()}
    return known if len(known) == len(bodies) and len(shapes) == 1 else None


def _own_body(name: str, found: Sequence[tuple[str, str | None, int]], names: Sequence[str]) -> Body | None:
    """Return the columns of one body in order, if `write` made them."""
    axes = [axis for axis, _, _ in found]
    turned = {axis: number for axis, unit, number in found if axis in QUATERNION and unit is None}
    moved = {axis: (unit, number) for axis, unit, number in found if axis not in turned}
    units = {unit for unit, _ in moved.values()}
    if len(set(axes)) < len(axes) or len(units) != 1 or len(turned) not in (0, 4):
        return None
    unit = units.pop()
    unit = None if unit is None else unit_named(unit) or unit
    in_order = AXES[: len(moved)]
    is_position = tuple(moved) == in_order or (unit is None and set(moved) == set(in_order))
    if unit is None and not is_position:
        return None
    order = in_order if is_position else tuple(moved)
    kind = Kind.POSITION if is_position else Kind.JOINT
    moving = tuple(Column(moved[a][1], names[moved[a][1]], kind, a, name, unit) for a in order)
    turns = tuple(
        Column(turned[axis], names[turned[axis]], Kind.ORIENTATION, axis, name)
        for axis in QUATERNION
        if turned
    )
    return Body(name, moving, turns) if is_position else Body(name, (), turns, moving)


def _check_writable(path: object, name: str, demo: RecordedSamples) -> None:
    """Raise if the header cannot name coordinates, manipulator or unit."""
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

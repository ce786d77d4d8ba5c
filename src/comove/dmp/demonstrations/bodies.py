"""Bodies in a recording, and their columns.

Columns hold the position, orientation, joints and grippers of a body. `bodies_of` collects the columns of each body,
`chosen_body` those that a user names, and `Body.samples` reads the numbers from a table.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.dmp.demonstrations.columns import (
    EULER,
    MATRIX,
    ROTATION_VECTOR,
    SIDES,
    Column,
    Kind,
    bare_name,
    words_of,
)
from comove.dmp.demonstrations.samples import AXES, QUATERNION, SHOWN, UNIT, fault
from comove.dmp.demonstrations.units import TIMES, base_unit, in_base_unit, is_angle
from comove.errors import DemonstrationError, OptionError, listed, near_name
from comove.geometry.rotations import exponential, quaternion_product

_TURN = 2.2 * np.pi
"""Angles of orientations beyond this are not radians."""


@dataclass(frozen=True)
class Body:
    """The columns of one body, each kind in its usual order.

    Attributes
    ----------
    name : name of the body; "" if the names hold none
    position : columns of x, y, z, as far as recorded
    orientation : columns of a quaternion w x y z, of roll, pitch, yaw, or of a rotation vector; all or none
    joints : columns of joint coordinates, in the order of the recording
    grippers : columns of grippers
    """

    name: str = ""
    position: tuple[Column, ...] = ()
    orientation: tuple[Column, ...] = ()
    joints: tuple[Column, ...] = ()
    grippers: tuple[Column, ...] = ()

    @property
    def moving(self) -> tuple[Column, ...]:
        """Return the columns of positions, else of joints."""
        return self.position or self.joints

    @property
    def needed(self) -> tuple[Column, ...]:
        """Return all columns that `samples` reads from a table."""
        return self.moving + self.orientation

    @property
    def axes(self) -> tuple[str, ...]:
        """Return the names of joints as they are written; () of positions."""
        return () if self.position else tuple(column.axis for column in self.joints)

    @property
    def is_repeated(self) -> bool:
        """Return whether a coordinate has several columns to choose from."""
        axes = [column.axis for column in self.moving if column.axis]
        return len(set(axes)) < len(axes)

    @property
    def stated_unit(self) -> str | None:
        """Return the unit that all coordinates state, else None.

        Coordinates that state several units of one quantity are read in its base unit: metres, or radians.
        """
        units = {column.unit for column in self.moving}
        if len(units) == 1 or None in units:
            return None if None in units else units.pop()
        bases = {base_unit(str(unit)) for unit in units}
        return bases.pop() if len(bases) == 1 else None

    def samples(
        self, table: Array, numbers: Sequence[int] | None = None, unit: str | None = None
    ) -> dict[str, Any]:
        """Return the fields of `RecordedSamples` of this body in a table.

        Positions keep the unit that all columns state, and are converted to the base unit where columns differ.
        Columns without a unit are in `unit`, by default in metres, or radians of joints. Orientations become
        quaternions w x y z.

        Parameters
        ----------
        table : array, shape (n_steps, n_columns)
        numbers : numbers of the columns that the table holds; all of them in their order unless given
        unit : unit of the positions or joints that state none
        """
        places = {number: place for place, number in enumerate(numbers)} if numbers is not None else None

        def taken(columns: Iterable[Column]) -> Array:
            return table[
                :, [column.number if places is None else places[column.number] for column in columns]
            ]

        own = unit or ("m" if self.position else "rad")
        units = [column.unit or own for column in self.moving]
        values, kept = taken(self.moving), units[0] if units else own
        if len(set(units)) > 1:
            values = values * [in_base_unit(one) for one in units]
            kept = "/".join(dict.fromkeys(map(base_unit, units)))
        orientation = None
        if self.orientation:
            orientation = quaternions(taken(self.orientation), self.orientation)
        fields = {"position": values, "orientation": orientation, "axes": self.axes, "unit": kept}
        is_stated = unit is not None or self.stated_unit is not None
        return fields | ({"stated": frozenset({UNIT})} if is_stated else {})

    def words(self, unit: str | None = None) -> str:
        """Return the used columns in words: `position from X, Y, Z [mm], orientation from qx, qy, qz, qw`."""
        what = "position" if self.position else "joints"
        unit = self.stated_unit or unit or ("" if self.position else "rad, as none is stated")
        unit = f" [{unit}]" if unit else ""
        said = f"{what} from {together(spoken(self.moving))}{unit}"
        if self.orientation:
            in_file = sorted(self.orientation, key=lambda column: column.number)
            said += f", orientation from {together(spoken(in_file))} ({_form(in_file)})"
        return said


def spoken(columns: Iterable[Column]) -> list[str]:
    """Return the names of columns for messages, without their units. Labels are used where names repeat."""
    columns = list(columns)
    names = [bare_name(column.name) for column in columns]
    above = all(column.label != column.name for column in columns)
    return [column.label for column in columns] if above or len(set(names)) < len(names) else names


def together(names: Sequence[str]) -> str:
    """Return names in one line, with a long common beginning only once.

    >>> together(["field.pose.position.x", "field.pose.position.y"])
    'field.pose.position.{x, y}'
    """
    first, last = min(names), max(names)
    common = first[: next((i for i, c in enumerate(first) if last[i : i + 1] != c), 0)]
    common = common[: max(common.rfind(mark) for mark in "./_ :") + 1]
    if len(common) < 6:
        return listed(names, 8)
    return f"{common}{{{listed([name.removeprefix(common) for name in names], 8)}}}"


def _form(orientation: Sequence[Column]) -> str:
    axes = [column.axis for column in orientation]
    if axes[0] in QUATERNION:
        return "quaternion " + " ".join(axis.removeprefix("q") for axis in axes)
    if axes[0] in EULER:
        unit = orientation[0].unit or "in degrees where they are larger than radians can be"
        return f"angles about fixed x, y, z, {unit}"
    if axes[0] in MATRIX:
        return "rotation matrix"
    return "rotation vector"


def quaternions(values: Array, columns: Sequence[Column]) -> Array:
    """Return quaternions w x y z, shape (n_steps, 4), from orientation columns.

    Angles that state no unit have that of the others; if none states one they are radians, unless they are too large.

    Parameters
    ----------
    values : array, shape (n_steps, n_columns), in the order of the columns, which is that of `Body.orientation`
    columns : columns of a quaternion, of roll, pitch, yaw, or of a rotation vector
    """
    if columns[0].axis in QUATERNION:
        return values
    if columns[0].axis in MATRIX:
        return _of_matrices(values.reshape(-1, 3, 3))
    units = [column.unit for column in columns]
    usual = next(filter(None, units), None)
    if usual is None:
        with np.errstate(invalid="ignore"):
            usual = "deg" if np.nanmax(np.abs(values), initial=0.0) > _TURN else "rad"
    angles = values * [in_base_unit(unit or usual) for unit in units]
    if columns[0].axis in ROTATION_VECTOR:
        return exponential(angles)
    roll, pitch, yaw = (exponential(angles[:, i, None] * np.eye(3)[i]) for i in range(3))
    return quaternion_product(yaw, quaternion_product(pitch, roll))


def _of_matrices(matrices: Array) -> Array:
    """Return the quaternions of rotation matrices, zeros for others."""
    from scipy.spatial.transform import Rotation

    turned = np.einsum("nij,nkj->nik", matrices, matrices)
    good = (np.abs(turned - np.eye(3)).max(axis=(1, 2)) < 1e-3) & (np.linalg.det(matrices) > 0.0)
    found = np.zeros((len(matrices), 4))
    if good.any():
        found[good] = Rotation.from_matrix(matrices[good]).as_quat()[:, [3, 0, 1, 2]]
    return found


def bodies_of(columns: Iterable[Column]) -> dict[str, Body]:
    """Return the bodies of columns by name, in order.

    Only bodies with positions or joints count. An orientation without a position of its own belongs to the body whose
    name begins the same, or to the only one. Joints belong to the sides `left` and `right` if each of their names
    holds one.
    """
    columns = [column for column in columns if column.kind not in (Kind.TIME, Kind.INDEX, Kind.OTHER)]
    cartesian: dict[str, list[Column]] = {}
    for column in columns:
        if column.kind in (Kind.POSITION, Kind.ORIENTATION):
            cartesian.setdefault(column.body, []).append(column)
    placed = {name for name, found in cartesian.items() if any(c.kind is Kind.POSITION for c in found)}
    for name in [name for name in cartesian if name not in placed]:
        bare = [one for one in placed if all(c.kind is Kind.POSITION for c in cartesian[one])]
        near = [one for one in bare if one.startswith(name) or name.startswith(one)] or bare
        if len(near) == 1:
            cartesian[near[0]] += cartesian.pop(name)
    joints = [column for column in columns if column.kind in (Kind.JOINT, Kind.GRIPPER)]
    sides = sides_of(joints)
    found: dict[str, Body] = {}
    for name, members in cartesian.items():
        position = [c for axis in AXES for c in members if c.kind is Kind.POSITION and c.axis == axis]
        if position:
            grippers = [c for c in joints if c.kind is Kind.GRIPPER and _belongs(c, name, sides, len(placed))]
            found[name] = Body(name, tuple(position), _orientation(members), (), tuple(grippers))
    if found:
        return found
    for side in dict.fromkeys(sides.values()):
        own = [column for column in joints if sides[column.number] == side]
        moved = tuple(
            replace(column, axis=_without_side(column.axis, side))
            for column in own
            if column.kind is Kind.JOINT
        )
        if moved:
            found[side] = Body(side, (), (), moved, tuple(c for c in own if c.kind is Kind.GRIPPER))
    return found


def _orientation(members: Iterable[Column]) -> tuple[Column, ...]:
    """Return the columns of a whole orientation, in order, else ()."""
    by_axis: dict[str, list[Column]] = {}
    for column in members:
        if column.kind is Kind.ORIENTATION:
            by_axis.setdefault(column.axis, []).append(column)
    for axes in (QUATERNION, EULER, ROTATION_VECTOR, MATRIX):
        if all(len(by_axis.get(axis, ())) == 1 for axis in axes):
            return tuple(by_axis[axis][0] for axis in axes)
    return ()


def sides_of(columns: Sequence[Column]) -> dict[int, str]:
    """Return the side of each joint by column number. It is "" for all of them unless each name holds one."""
    for words in ({"left": "left", "right": "right"}, {"l": "left", "r": "right"}):
        sides = {
            column.number: [
                words[text] for text in (*words_of(column.body), *words_of(column.axis)) if text in words
            ]
            for column in columns
        }
        if sides and all(len(set(found)) == 1 for found in sides.values()):
            return {number: found[0] for number, found in sides.items()}
    return {column.number: "" for column in columns}


def _without_side(name: str, side: str) -> str:
    if not side:
        return name
    mark = f"(?:{side}|{side[0]})"
    return re.sub(rf"^{mark}[._/ -]+|[._/ -]+{mark}$", "", name, flags=re.IGNORECASE) or name


def _belongs(gripper: Column, body: str, sides: Mapping[int, str], n_bodies: int) -> bool:
    said = {text for text in (*words_of(gripper.body), *words_of(gripper.axis)) if text in SIDES}
    return n_bodies == 1 or bool(said & set(words_of(body)))


def matching_body(name: str, bodies: Iterable[str]) -> str | None:
    """Return the body with a given name, or the given words. Case is ignored; words must match a single body.

    >>> matching_body("left", ["left_arm_ee", "right_arm_ee"])
    'left_arm_ee'
    """
    bodies = list(bodies)
    wanted = set(words_of(name))
    for alike in (
        [body for body in bodies if body == name],
        [body for body in bodies if body.lower() == name.lower()],
        [body for body in bodies if wanted and wanted <= set(words_of(body))],
    ):
        if len(alike) == 1:
            return alike[0]
    return None


def columns_named(name: str, columns: Sequence[Column]) -> list[Column]:
    """Return the columns that a user names: name or label, in any case, or number from 1."""
    for alike in (
        [c for c in columns if c.name == name],
        [c for c in columns if name.lower() in _labels(c)],
        [c for c in columns if c.name and bare_name(c.name).lower() == bare_name(name).lower()],
    ):
        if alike:
            return alike
    is_number = name.isascii() and name.isdigit() and 1 <= int(name) <= len(columns)
    return [columns[int(name) - 1]] if is_number else []


def _labels(column: Column) -> set[str]:
    """Return the labels of a column in lower case. Orientations have "rotation" too."""
    label = column.label.lower()
    return {label, label.replace(".orientation.", ".rotation.")}


def ambiguous(
    file: object, option: str, name: str, found: Sequence[Column], others: Sequence[str] = ()
) -> DemonstrationError:
    """Return the error about a name of several columns. `others` are names that are unique."""
    labels = [column.label for column in found]
    by_body = len(set(labels)) == len(labels)
    known = labels if by_body else [f"{c.name} (column {c.number + 1})" for c in found]
    asked: Any = [found[0].body] if by_body and found[0].body else [str(found[0].number + 1), *others]
    is_one = option == "time"
    return fault(
        file,
        option,
        f"{len(found)} columns are called {name!r}: {listed(known, SHOWN)}",
        f"choose one of them{'' if is_one else ', or a body'}",
        **{option: str(found[0].number + 1) if is_one else asked},
    )


def chosen_body(
    wanted: Sequence[str], columns: Sequence[Column], file: object = None, unit: str | None = None
) -> Body:
    """Return the body that a user names by columns or name.

    Parameters
    ----------
    wanted : names of columns, as `columns_named` finds them, or one name of a body
    columns : all columns of the recording
    file : file of the recording, for messages
    unit : unit that the user states; an angle makes joints of columns of unknown meaning

    Raises
    ------
    DemonstrationError
        If a name matches no column, or several.
    OptionError
        If a column is named twice.
    """
    every = bodies_of(columns)
    if len(wanted) == 1 and not columns_named(wanted[0], columns):
        name = matching_body(wanted[0], every)
        if name is not None:
            return every[name]
    places: list[Column] = []
    for name in wanted:
        found = columns_named(name, columns)
        if len(found) > 1:
            others = [one for one in wanted if one != name and len(columns_named(one, columns)) == 1]
            raise ambiguous(file, "columns", name, found, others)
        if not found:
            known = list(dict.fromkeys(filter(None, (*(c.label for c in columns), *every))))[:SHOWN]
            near = near_name(name, known) + f"; or give numbers from 1 to {len(columns)}"
            raise fault(file, "columns", f"there is no column {name!r}", near)
        if found[0] in places:
            raise OptionError(
                f"{name!r} stands twice", file=file, key="columns", way_out="name every column once"
            )
        places += found
    for body in every.values():
        if body.position == tuple(places):
            return body
    timed = [column.name for column in places if column.kind is Kind.TIME and column.unit in TIMES]
    if timed:
        raise OptionError(
            f"{timed[0]!r} is a time, and no position",
            file=file,
            key="columns",
            way_out=f"name the positions, and the time by --time {timed[0]!r}",
        )
    movable = (Kind.JOINT, Kind.GRIPPER)
    if is_angle(unit) or all(column.kind in movable or is_angle(column.unit) for column in places):
        return Body("", joints=as_joints(places))
    if len(places) > len(AXES):
        raise OptionError(
            f"{len(places)} columns are no position",
            file=file,
            key="columns",
            way_out="give up to three, x, y and z, or of joints the unit as well: --unit rad",
        )
    return Body("", position=tuple(places))


def as_joints(columns: Iterable[Column]) -> tuple[Column, ...]:
    """Return columns as those of joints, named as the columns are."""
    return tuple(
        c
        if c.kind is Kind.JOINT
        else replace(c, kind=Kind.JOINT, axis=bare_name(c.name) or str(c.number + 1))
        for c in columns
    )

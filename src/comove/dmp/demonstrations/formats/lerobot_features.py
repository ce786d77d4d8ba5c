"""Movements in the vectors of LeRobot datasets.

Names in `meta/info.json` define the coordinates. They are lists, lists in a list, or mappings; where they are
missing, the columns are chosen by numbers. LeRobot names the joints of its own arms `shoulder_pan.pos` and keeps them
in degrees, or in percent of the range that was calibrated, without a statement which: `UNSTATED` is the unit of these
numbers, until another one is stated.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from comove.dmp.demonstrations.bodies import Body, as_joints, bodies_of, chosen_body, spoken
from comove.dmp.demonstrations.cleaning import MAX_DIMS
from comove.dmp.demonstrations.columns import Column, Kind, read_columns
from comove.dmp.demonstrations.samples import SAY_UNIT, WHICH_UNIT, fault
from comove.dmp.demonstrations.units import UNSTATED, is_length
from comove.errors import listed, near_name

STATE = "observation.state"
_OWN_ARMS = re.compile(r".*(so[_-]?10\d|koch|moss|lekiwi).*", re.IGNORECASE)
_ABOUT_UNSTATED = (
    f"joints in {UNSTATED}s: degrees, or percent of the range of each, which the dataset does not say; --unit deg if "
    "they are degrees"
)


@dataclass(frozen=True)
class Feature:
    """A vector of a dataset.

    Attributes
    ----------
    name : its name, such as `observation.state`
    width : number of its coordinates
    names : their names; None if they are missing or do not fit
    unit : unit that the dataset states for its positions or joints, as comove writes it
    """

    name: str
    width: int
    names: list[str] | None
    unit: str | None

    @classmethod
    def of(cls, file: Path, features: Mapping[str, Any], name: str | None) -> Feature:
        """Return a feature by name, or the state, or the only vector. Actions are no default.

        Raises
        ------
        DemonstrationError
            If there is none, or it is no vector; names those that are.
        """
        vectors = {key: width for key in features if (width := _width(features[key])) is not None}
        if name is None:
            own = [key for key in vectors if not key.startswith("action")]
            name = STATE if STATE in features or len(own) != 1 else own[0]
        if name not in features or not isinstance(features[name], dict):
            best = min(vectors, key=lambda key: key.startswith("action"), default=None)
            known = listed([f"{key} [{width}]" for key, width in vectors.items()], 20) or "nothing"
            near = near_name(name, list(vectors)).partition("known: ")[0]
            options = {} if best is None else {"feature": best}
            raise fault(file, "features", f"there is no {name!r}", f"{near}vectors are {known}", **options)
        if name not in vectors:
            shape = features[name].get("shape")
            message = f"it has shape {shape}, which is no vector"
            raise fault(file, f"features.{name}", message, f"choose one of {listed(list(vectors), 20)}")
        about = features[name].get("info")
        unit = about.get("unit") if isinstance(about, dict) else None
        names = _flat_names(features[name].get("names"), vectors[name])
        return cls(name, vectors[name], names, unit if isinstance(unit, str) else None)


def _width(feature: object) -> int | None:
    """Return a vector's number of coordinates, None for other features."""
    if not isinstance(feature, dict) or not str(feature.get("dtype", "float32")).startswith(("float", "int")):
        return None
    shape = feature.get("shape")
    if not isinstance(shape, list) or len(shape) != 1 or type(shape[0]) is not int or shape[0] < 1:
        return None
    return None if shape == [1] and not feature.get("names") else shape[0]


@dataclass(frozen=True)
class Movement:
    """The columns of one movement in a vector, with unit and notes."""

    body: Body
    unit: str | None
    notes: tuple[str, ...]


def movements_of(
    file: Path,
    feature: Feature,
    *,
    robot_type: str = "",
    columns: Sequence[str] | None = None,
    unit: str | None = None,
) -> dict[str, Movement]:
    """Return a vector's movements by manipulator, "" if unnamed.

    Parameters
    ----------
    file : `meta/info.json`, for messages
    robot_type : robot that recorded it
    columns : names, or numbers from 1, of the columns that are the positions, or joints
    unit : unit of positions or joints that the user states; one of angles makes joints of columns without names

    Raises
    ------
    DemonstrationError
        If the meaning of the coordinates is unknown, or a coordinate occurs twice.
    """
    key, unit = f"features.{feature.name}", unit or feature.unit
    is_joints = unit is not None and not is_length(unit)
    names = feature.names or [f"{feature.name}[{i}]" for i in range(feature.width)]
    read = read_columns(names if feature.names else [""] * feature.width)
    known = [replace(column, name=name) for column, name in zip(read, names, strict=True)]
    if columns is not None:
        bodies = {"": chosen_body(columns, known, file, "rad" if is_joints else unit)}
    else:
        bodies = bodies_of(known)
        if not bodies and is_joints:
            bodies = {"": Body("", joints=as_joints(known))}
    if not bodies or any(body.is_repeated for body in bodies.values()):
        what = (
            "its coordinates have no names" if not feature.names else f"it has the names {listed(names, 12)}"
        )
        which = "nothing says which are the position" if not bodies else "some stand twice"
        example = [str(i + 1) for i in range(min(feature.width, 3))]
        raise fault(
            file,
            key,
            f"{what}: {which}",
            f"choose its {feature.width} columns by their numbers: --columns {','.join(example)}"
            + ("" if unit is not None or bodies else f", and {SAY_UNIT}"),
            columns=example,
            unit=None if unit is not None or bodies else WHICH_UNIT,
        )
    found = {}
    for name, body in bodies.items():
        own = unit
        if not body.position:
            names_of_own = all(column.name.endswith(".pos") for column in body.joints)
            own = unit or (UNSTATED if names_of_own or _OWN_ARMS.fullmatch(robot_type) else "rad")
            if own in ("rad", UNSTATED):  # where a gripper is one coordinate more
                grippers = tuple(replace(column, axis=_joint_name(column, name)) for column in body.grippers)
                members = sorted((*body.joints, *grippers), key=lambda column: column.number)
                body = replace(body, joints=tuple(members), grippers=())
        if len(body.moving) > MAX_DIMS:
            raise fault(file, key, f"it has {len(body.moving)} coordinates", f"up to {MAX_DIMS} are read")
        notes = [body.words(own)] if columns is None and feature.names else []
        if own == UNSTATED:
            notes.append(_ABOUT_UNSTATED)
        found[name] = Movement(body, own, tuple(notes))
    taken = {column.number for one in found.values() for column in one.body.needed}
    taken |= {c.number for one in found.values() if one.body.position for c in one.body.grippers}
    left = [column for column in known if column.number not in taken and column.kind is not Kind.INDEX]
    if left and columns is None and feature.names:
        note = f"left out: {listed(spoken(left), 8)}"
        found = {name: replace(one, notes=(*one.notes, note)) for name, one in found.items()}
    return found


def _joint_name(column: Column, side: str) -> str:
    (named,) = bodies_of([replace(column, kind=Kind.JOINT)]).values()
    return named.joints[0].axis if side else column.axis


def _flat_names(names: object, n_columns: int) -> list[str] | None:
    """Return a feature's names as a list of `n_columns`, else None.

    They may be a list, a list in a list, a mapping of lists (`{"motors": [...]}`), or a mapping of names to places.
    """
    if isinstance(names, Mapping):
        if names and all(isinstance(place, int) for place in names.values()):
            in_order = sorted(names, key=lambda name: names[name])
            return _flat_names([str(name) for name in in_order], n_columns)
        sizes = [len(part) if isinstance(part, list | Mapping) else 0 for part in names.values()]
        inner = [_flat_names(part, n) for part, n in zip(names.values(), sizes, strict=True)]
        if len(inner) == 1:
            return _flat_names(inner[0], n_columns)
        flat = [
            name if str(part) in ("motors", "axes") else f"{part}_{name}"
            for part, found in zip(names, inner, strict=True)
            for name in found or ()
        ]
        return _flat_names(flat, n_columns)
    if isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
        return _flat_names(names[0], n_columns)
    if not isinstance(names, list) or len(names) != n_columns:
        return None
    return [str(name) for name in names]

"""Movements in the layouts of HDF5 files."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.dmp.demonstrations.bodies import Body, bodies_of, chosen_body
from comove.dmp.demonstrations.cleaning import MAX_DIMS
from comove.dmp.demonstrations.clocks import time_of
from comove.dmp.demonstrations.columns import Kind, is_derived, read_columns
from comove.dmp.demonstrations.formats.hdf5_access import HDF5File
from comove.dmp.demonstrations.samples import (
    AXES,
    HZ,
    SAY_RATE,
    SAY_UNIT,
    TIME,
    UNIT,
    WHICH_UNIT,
    Origin,
    RecordedSamples,
)
from comove.dmp.demonstrations.units import unit_named
from comove.errors import listed
from comove.geometry.rotations import exponential

ROBOMIMIC_RATE = 20.0
"""Rate of robosuite's controllers unless `env_args` says otherwise [Hz]."""
MANISKILL_RATE = 20.0
"""Rate of ManiSkill's controllers [Hz]."""
ALOHA_RATE = 50.0
"""Rate at which ALOHA records [Hz]."""
ALOHA_JOINTS: tuple[str, ...] = (
    "waist",
    "shoulder",
    "elbow",
    "forearm_roll",
    "wrist_angle",
    "wrist_rotate",
    "gripper",
)
FEWEST_OF_TWO = 12
"""Columns of joints, in ALOHA's layout, from which on they are those of two arms."""
RATES = ("fps", "rate", "rate_hz", "frequency", "hz", "control_freq", "sampling_rate")
"""Attributes that say how many samples a second there are."""
_EPISODE = re.compile(r"(?:(?:demo|traj|trajectory|episode|ep|run|rollout|trial)_?)?(\d+)")
_HAND = re.compile(r"(?:(?P<hand>.+?)_)?(?:(?:eef|ee|tcp)_(?P<what>pos|position|pose)|(?P<whole>tcp))")
_JOINTS = re.compile(r"(?:(?P<robot>.+?)_)?(?:joint_pos|joint_position|joint_positions|joint_states|qpos)")
_ROBOSUITE, _LIBERO = re.compile(r"robot\d+_"), re.compile(r"(ee|gripper|joint)_(pos|ori|states)")
_MANISKILL = re.compile(r"(.*/)?traj_\d+/")
_MATRIX_TOLERANCE = 1e-3
"""How far a matrix of rotation may be from orthogonal."""


def episode_groups(file: HDF5File) -> dict[str, str]:
    """Return each episode's group by name, in order of their numbers. "" is the group of the whole file."""
    if "observations" not in file.members(""):
        for above in ("data", ""):
            numbers = {
                name: int(match[1])
                for name in file.members(above)
                if (match := _EPISODE.fullmatch(name)) and file.is_group(_joined(above, name))
            }
            if numbers:
                return {name: _joined(above, name) for name in sorted(numbers, key=lambda one: numbers[one])}
    return {file.path.stem: ""}


def _joined(*parts: str) -> str:
    return "/".join(filter(None, parts))


@dataclass(frozen=True)
class EpisodeReader:
    """A reader of one episode.

    Attributes
    ----------
    group : its path in the file
    name : its name in those of its movements; "" if the file holds one
    rate : samples a second that the user states [Hz]
    unit : unit that the user states
    """

    file: HDF5File
    group: str
    name: str
    rate: float | None = None
    unit: str | None = None

    def movements(self) -> dict[str, RecordedSamples]:
        """Return the movements by manipulator, in the first layout that fits.

        Raises
        ------
        DemonstrationError
            If no layout fits, or a dataset is none; names those that can be named.
        """
        found = self._hands() or self._joints() or self._plain(self.group)
        if found:
            return found
        for name in self.file.members(self.group):
            self.file.node(_joined(self.group, name))  # which tells links that lead out
        held = listed(self.file.members(""), 10) or "nothing"
        what = f"no movement that is known in {self.group}" if self.group else "no episode"
        raise self.file.other(None, f"it holds {held}, and {what}", self.group)

    def chosen(self, dataset: str, columns: Sequence[str] | None) -> dict[str, RecordedSamples]:
        """Return the movement of a dataset, or those of a group.

        Parameters
        ----------
        dataset : path in the file, or in the episode
        columns : numbers, from 1, of the columns that hold it

        Raises
        ------
        DemonstrationError
            If there is no such dataset, or its meaning is unknown.
        """
        key = dataset.strip("/")
        if self.group and self.file.node(_joined(self.group, key)) is not None:
            key = _joined(self.group, key)
        if self.file.is_group(key):
            found = self._plain(key) if columns is None else {}
            if not found:
                message = "it is a group, whose names do not say what they hold"
                raise self.file.other(key, message, key)
            return found
        shape, stem = self.file.shape(key), key.rpartition("/")[2]
        if shape is not None and shape[1:] == (4, 4):
            return {"": self._matrices(key)}
        values = self.file.array(key)
        names = self._names(key) or _column_names(stem, values.shape[1])
        if columns is not None:
            shown = self._names(key) or [f"{stem}[{i}]" for i in range(len(names))]
            known = [replace(c, name=name) for c, name in zip(read_columns(names), shown, strict=True)]
            body = chosen_body(columns, known, self.file.path, self.unit)
            return {"": self._of_body("", body, [key] * len(names), values)}
        bodies = list(bodies_of(read_columns(names)).values())
        if len(bodies) != 1:
            if is_derived(stem):
                raise self.file.fault(key, f"{stem!r} are no positions", "name another dataset")
            example = [str(number) for number in range(1, min(values.shape[1], 3) + 1)]
            is_told = self.unit is not None or self._unit(key) is not None
            raise self.file.fault(
                key,
                f"its name does not say what its {values.shape[1]} columns hold",
                f"say which are the positions: --columns {','.join(example)}"
                + ("" if is_told else f", and {SAY_UNIT}"),
                columns=example,
                unit=None if is_told else WHICH_UNIT,
            )
        return {"": self._of_body("", bodies[0], [key] * len(names), values)}

    def _places(self, *below: str) -> list[str]:
        return [place for one in below if self.file.is_group(place := _joined(self.group, one))]

    def _names(self, key: str) -> list[str] | None:
        """Return a dataset's column names, from an attribute or another dataset. Pandas keeps them in the latter."""
        width = (self.file.shape(key) or (0, 0))[-1]
        found = self.file.attribute(key, ("columns", "column_names", "names", "labels"))
        items = self.file.texts(f"{key.removesuffix('_values')}_items") if key.endswith("_values") else None
        said = np.ravel(np.asarray(found[1])).tolist() if found else items
        names = [one.decode(errors="replace") if isinstance(one, bytes) else str(one) for one in said or ()]
        return names if len(names) == width else None

    def _hands(self) -> dict[str, RecordedSamples]:
        """Return the movements of end effectors that simulators observe."""
        for place in self._places("obs", "obs/extra", "observations", ""):
            found = {}
            for name in sorted(self.file.members(place)):
                match = _HAND.fullmatch(name)
                if match is not None and "to" not in (match["hand"] or "").split(
                    "_"
                ):  # of one body in another
                    found[match["hand"] or ""] = self._hand(place, name, match)
            if found:
                return found
        return {}

    def _hand(self, place: str, name: str, match: re.Match[str]) -> RecordedSamples:
        """Return the movement of one end effector."""
        key, hand = _joined(place, name), match["hand"] or ""
        if match["whole"] or match["what"] == "pose":
            values = self.file.array(key, (None, 7))
            if _MANISKILL.match(key):
                return self._samples(key, values[:, :3], hand, orientation=values[:, 3:], turns=key)
            return self._samples(key, values[:, :3], hand, notes=(_of_unknown_order(name),))
        position = self.file.array(key, (None, 3))
        counted = self.file.attribute(self.group, ("num_samples",))
        if counted is not None and np.ravel(np.asarray(counted[1])).tolist() != [len(position)]:
            message = f"it has {len(position)} rows and num_samples says {counted[1]}"
            raise self.file.fault(key, message, "record or convert it again")
        stem = _joined(place, name.removesuffix(match["what"]))
        if self.file.node(f"{stem}quat") is not None:
            if not _ROBOSUITE.match(name):
                return self._samples(key, position, hand, notes=(_of_unknown_order(f"{stem}quat"),))
            quaternions = self.file.array(f"{stem}quat", (None, 4))[:, [3, 0, 1, 2]]
            return self._samples(key, position, hand, orientation=quaternions, turns=f"{stem}quat")
        if self.file.node(f"{stem}ori") is not None:
            vectors = self.file.array(f"{stem}ori", (None, 3))
            return self._samples(key, position, hand, orientation=exponential(vectors), turns=f"{stem}ori")
        return self._samples(key, position, hand)

    def _joints(self) -> dict[str, RecordedSamples]:
        """Return the movements of joints, in ALOHA's or simulators' layout."""
        for place in self._places("observations", "obs", "obs/agent"):
            found = {
                match["robot"] or "": _joined(place, name)
                for name in sorted(self.file.members(place), reverse=True)
                if (match := _JOINTS.fullmatch(name)) and "gripper" not in name
            }
            if list(found) == [""] and place == "observations":
                return self._arms(found[""])
            if found:
                return {robot: self._arm(key, robot) for robot, key in sorted(found.items())}
        return {}

    def _arm(self, key: str, robot: str) -> RecordedSamples:
        values = self.file.array(key)
        return self._samples(key, values, robot, axes=_unnamed(values.shape[1]))

    def _arms(self, key: str) -> dict[str, RecordedSamples]:
        """Return the movements of one arm, or two, in ALOHA's layout."""
        qpos = self.file.array(key)
        n_columns, n_own = qpos.shape[1], len(ALOHA_JOINTS)
        is_two = n_columns >= FEWEST_OF_TWO and n_columns % 2 == 0
        n_joints = n_columns // 2 if is_two else n_columns
        axes, note = ALOHA_JOINTS, "gripper: 0 closed, 1 open"
        if n_joints != n_own:
            axes = _unnamed(n_joints)
            note = (
                f"the first {n_joints} of {n_columns} columns are taken to be the left arm's"
                if is_two
                else ""
            )
        places = {"left": 0, "right": n_joints} if is_two else {"": 0}
        return {
            arm: self._samples(
                key,
                qpos[:, first : first + n_joints],
                arm,
                axes=axes,
                numbers=range(first, first + n_joints),
                notes=(note,) * bool(note),
            )
            for arm, first in places.items()
        }

    def _plain(self, place: str) -> dict[str, RecordedSamples]:
        """Return the movements of datasets with descriptive names."""
        names, keys, lengths = list[str](), list[str](), dict[str, int]()
        for name in self.file.members(place):
            shape = self.file.shape(_joined(place, name)) or ()
            width = 1 if len(shape) == 1 else shape[1] if len(shape) == 2 else MAX_DIMS + 1
            if width <= MAX_DIMS:
                names += self._names(_joined(place, name)) or _column_names(name, width)
                keys += [_joined(place, name)] * width
                lengths[keys[-1]] = shape[0]
        found = {}
        for hand, body in bodies_of(read_columns(names)).items():
            used = dict.fromkeys(keys[column.number] for column in body.needed)
            if body.is_repeated:
                continue
            if len({lengths[key] for key in used}) > 1:
                rows = listed([f"{key} {lengths[key]}" for key in used], 10)
                raise self.file.fault(
                    place or None, f"its datasets differ in rows: {rows}", "record it again"
                )
            table = np.zeros((lengths[next(iter(used))], len(names)))
            for key in used:
                shape = self.file.shape(key) or ()
                own = [number for number, one in enumerate(keys) if one == key]
                table[:, own] = self.file.array(key, (None,) * len(shape)).reshape(len(table), -1)
            found[hand] = self._of_body(hand, body, keys, table)
        return found

    def _of_body(self, hand: str, body: Body, keys: Sequence[str], table: Array) -> RecordedSamples:
        """Return the movement of a body from a table. `keys` are the datasets of its columns."""
        fields = body.samples(table)
        needed = body.moving[0]
        turns = keys[body.orientation[0].number] if fields["orientation"] is not None else ""
        return self._samples(
            keys[needed.number],
            fields["position"],
            hand,
            orientation=fields["orientation"],
            turns=turns,
            axes=fields["axes"],
            numbers=[column.number - keys.index(keys[column.number]) for column in body.moving],
            unit=body.stated_unit and fields["unit"],
        )

    def _matrices(self, key: str) -> RecordedSamples:
        """Return the movement of matrices (n_steps, 4, 4), by rows or columns."""
        from scipy.spatial.transform import Rotation

        poses = self.file.array(key, (None, 4, 4))
        last = np.array([0.0, 0.0, 0.0, 1.0])
        if not (np.abs(poses[:, 3] - last) <= _MATRIX_TOLERANCE).all():
            poses = poses.transpose(0, 2, 1)
        turned = poses[:, :3, :3]
        products = turned @ turned.transpose(0, 2, 1)
        if (
            not (np.abs(poses[:, 3] - last) <= _MATRIX_TOLERANCE).all()
            or not (np.abs(products - np.eye(3)) <= _MATRIX_TOLERANCE).all()
            or not (np.linalg.det(turned) > 0.0).all()
        ):
            raise self.file.other(key, "its matrices are no poses")
        quaternions = Rotation.from_matrix(turned).as_quat()[:, [3, 0, 1, 2]]
        return self._samples(key, poses[:, :3, 3], orientation=quaternions, turns=key)

    def _samples(
        self,
        key: str,
        position: Array,
        hand: str = "",
        *,
        orientation: Array | None = None,
        turns: str = "",
        axes: tuple[str, ...] = (),
        numbers: Sequence[int] | None = None,
        notes: tuple[str, ...] = (),
        unit: str | None = None,
    ) -> RecordedSamples:
        """Return the movement of an end effector, or of joints (`axes`). `numbers` are those of its columns."""
        time, is_stated, said = self._time(key, len(position))
        unit = unit or self._unit(key)
        samples = RecordedSamples(
            time,
            position,
            ".".join(filter(None, (self.file.path.stem, self.name, hand))),
            (*notes, *said),
            unit or ("rad" if axes else "m"),
            orientation=orientation,
            axes=axes,
            stated=frozenset([TIME] * is_stated + [UNIT] * (unit is not None)),
            origin=Origin(
                self.file.path,
                time=lambda sample: f"row {sample} of {key}, its time",
                position=lambda sample, dim: f"{key}[{sample}, {dim if numbers is None else numbers[dim]}]",
                orientation=lambda sample: f"{turns}[{sample}]",
            ),
        )
        return samples if self.unit is None else samples.stating(self.unit)

    def _unit(self, key: str) -> str | None:
        said = self.file.attribute(key, ("unit", "units"))
        text = said[1].decode(errors="replace") if said and isinstance(said[1], bytes) else said and said[1]
        return unit_named(text) if isinstance(text, str) else None

    def _time(self, key: str, n_steps: int) -> tuple[Array, bool, tuple[str, ...]]:
        """Return each row's time, whether it is certainly seconds, and notes."""
        frames = np.arange(n_steps)
        if self.rate is not None:
            return frames / self.rate, True, ()
        named = [column for column in read_columns(self._names(key) or ()) if column.kind is Kind.TIME]
        found = [(c, self.file.array(key, exact=True)[:, c.number]) for c in named]
        above = key
        while above and not found:
            above = above.rpartition("/")[0]
            for name in self.file.members(above):
                place, (column,) = _joined(above, name), read_columns([name])
                shape = self.file.shape(place)
                if column.kind is Kind.TIME and shape in ((n_steps,), (n_steps, 1)):
                    stamps = self.file.array(place, (None,) * len(shape), exact=True).ravel()
                    found.append((replace(column, name=place, unit=self._unit(place) or column.unit), stamps))
        if found:
            time = time_of(found, Origin(self.file.path), way_out=SAY_RATE)
            return time.seconds, time.is_stated, (time.words, *time.notes)
        rate, notes = self._recorded_rate(key)
        return frames / rate, True, notes

    def _recorded_rate(self, key: str) -> tuple[float, tuple[str, ...]]:
        """Return the rate of attributes or layout [Hz], with a note."""
        above = key
        while True:
            if (said := self.file.attribute(above, RATES)) is not None:
                return self._require_rate(f"{above}, attribute {said[0]}" if above else said[0], said[1]), ()
            if not above:
                break
            above = above.rpartition("/")[0]
        name = key.rpartition("/")[2]
        if key.startswith("data/"):
            if (rate := self._control_rate()) is not None:
                return rate, ()
            if _ROBOSUITE.match(name) or _LIBERO.fullmatch(name):
                return ROBOMIMIC_RATE, (_usual(ROBOMIMIC_RATE, "robosuite"),)
        if _MANISKILL.match(key):
            return MANISKILL_RATE, (_usual(MANISKILL_RATE, "ManiSkill"),)
        if key.startswith("observations/") and self.file.shape("observations/qpos") is not None:
            return ALOHA_RATE, (_usual(ALOHA_RATE, "ALOHA"),)
        raise self.file.fault(key, "nothing says when its rows were recorded", SAY_RATE, rate=HZ)

    def _control_rate(self) -> float | None:
        """Return `control_freq` in the attribute `env_args` of `data`, or None."""
        said = self.file.attribute("data", ("env_args",))
        if said is None:
            return None
        try:
            rate = json.loads(said[1]).get("env_kwargs", {}).get("control_freq")  # type: ignore[arg-type]
        except (ValueError, TypeError, AttributeError, RecursionError) as error:
            key = "data, attribute env_args"
            raise self.file.fault(key, "it is no JSON object", SAY_RATE, rate=HZ) from error
        return None if rate is None else self._require_rate("env_args.env_kwargs.control_freq", rate)

    def _require_rate(self, key: str, rate: Any) -> float:
        if np.size(rate) == 1 and not isinstance(rate, str | bytes | bool | dict | list):
            value = np.ravel(rate)[0]
            if isinstance(value, int | float | np.number) and 0.0 < value < 1e6:
                return float(value)
        raise self.file.fault(key, f"{rate!r} is no rate", SAY_RATE, rate=HZ)


def _usual(rate: float, layout: str) -> str:
    return f"{rate:g} samples a second, as {layout} records unless it says otherwise"


def _of_unknown_order(name: str) -> str:
    return f"orientations left out: nothing says in which order {name} has its quaternions"


def _unnamed(n_joints: int) -> tuple[str, ...]:
    return tuple(f"joint{i}" for i in range(n_joints))


def _column_names(stem: str, width: int) -> list[str]:
    """Return names of a dataset's columns that `read_columns` understands."""
    if width == 1:
        return [stem]
    if stem == "orientation" and width == 4:  # as comove writes them
        return [f"{stem}.{axis}" for axis in "wxyz"]
    is_position = all(
        column.kind is Kind.POSITION for column in read_columns([f"{stem}_{i}" for i in range(3)])
    )
    if is_position and width in (2, 3):
        return [f"{stem}.{axis}" for axis in AXES[:width]]
    return [f"{stem}_{i}" for i in range(width)]

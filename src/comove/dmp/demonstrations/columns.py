"""The vocabulary of columns: the meaning of their names.

Recorders name columns in many ways: `x`, `ee.x`, `left_arm_ee_pos_x`, `field.pose.position.x`, `/pose/position/x`,
`Left X` below a row `Position`, `p_RS_R_x [m]`, `TX`; `qw`, `q_w`, `orientation.w`, `rw` beside `rx`; `roll`;
`shoulder_pan.pos`, `joint_1`, `q[0]`; `Time (Seconds)`, `time_ms`, `%time`, `secs` beside `nsecs`. `read_columns`
turns names into `Column`s; `comove.dmp.demonstrations.bodies` collects the columns of each body. Formats differ only
in the source of the names.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum

from comove.dmp.demonstrations.samples import AXES, QUATERNION
from comove.dmp.demonstrations.units import ANGLES, LENGTHS, TIMES, UNITS, is_angle, unit_named

EULER = ("roll", "pitch", "yaw")
"""Angles about the fixed axes x, y, z, in this order (REP 103 of ROS): R = Rz(yaw) Ry(pitch) Rx(roll)."""
ROTATION_VECTOR = ("rx", "ry", "rz")
MATRIX = tuple(f"r{row}{column}" for row in range(1, 4) for column in range(1, 4))
"""Numbers of a rotation matrix, row by row."""
SIDES = ("left", "right")


class Kind(StrEnum):
    """The quantity in a column."""

    TIME = "time"
    POSITION = "position"
    ORIENTATION = "orientation"
    JOINT = "joint"
    GRIPPER = "gripper"
    INDEX = "index"
    OTHER = "other"


@dataclass(frozen=True)
class Column:
    """One column of a recording.

    Attributes
    ----------
    number : place of the column, from 0
    name : name as it is written
    kind : its quantity
    axis : x, y, z of a position; qw, qx, qy, qz of a quaternion; roll, pitch, yaw; rx, ry, rz of a rotation vector;
        a joint's name without body and unit; "" of time, and of speeds, forces and others that are no coordinates
    body : name of the body or side that the column belongs to; "" if the name has none
    unit : unit in the name, or in a row of units, as `comove.dmp.demonstrations.units` spells it, else as
        written; None if nothing is stated
    """

    number: int
    name: str
    kind: Kind
    axis: str = ""
    body: str = ""
    unit: str | None = None

    @property
    def label(self) -> str:
        """Return a label that is unique among equal names: `Left.Position.X`."""
        if self.kind not in (Kind.POSITION, Kind.ORIENTATION) or not self.body or self.body in self.name:
            return self.name
        axis = self.axis.upper().removeprefix("Q") if self.axis in QUATERNION else self.axis.upper()
        return ".".join(filter(None, (self.body, self.kind.value.capitalize(), axis)))


def _all(*texts: str) -> frozenset[str]:
    return frozenset(word for text in texts for word in text.split())


# Words of names, in lower case. Those around an axis tell what it is; the others name the body.
_CLOCKS = _all("time timestamp timestamps stamp t seconds elapsed zeit datetime date clock")
_OF_CLOCKS = _all(
    "header field bag ros recv receive received log wall sim system sys host device rel relative unix epoch utc",
    "robot sample record recording frame frames camera start capture global local msg rosbag since in gps data ts tv",
)
_STAMPS = _all("time timestamp")
"""Words that make a name one of a time, whatever stands before them."""
_PARTS = _all("sec secs msec msecs usec usecs nsec nsecs nanosec nanosecs nanoseconds microseconds")
"""Units that are columns of time by themselves: seconds, and the fraction of a second."""
_INDICES = _all(
    "frame frames index idx id seq sequence row sample samples step steps n no nr number count counter i sub",
    "unnamed header field episode task iteration",
)
_DERIVED = _all(
    "vel velocity velocities speed acc accel acceleration accelerations twist angular force forces torque wrench",
    "effort gyro gyroscope",
    "imu mag magnetometer bias gravity error err residual cov covariance jerk temperature temp confidence std",
    "variance delta status valid quality qvel qd dq ddq tau voltage momentum linear displacement noise",
    "moment moments power energy fx fy fz mx my mz vx vy vz ax ay az wx wy wz",
    "speeds powers probes controls amp amps ampere amperes volt volts bat battery pwm duty",
    "emg ecg eeg adc pressure rssi rss reward loss score",
    "range distance dist",  # between two things, which are no coordinates of either
    "lat lon lng latitude longitude",  # angles on the Earth, which span no length
)
_POSITIONS = _all("pos position positions translation trans point xyz location loc coordinate coord")
_QUATERNIONS = _all("quat quaternion quaternions orientation orient ori attitude att")
_ROTATIONS, _VECTORS, _EULERS = _all("rotation rot"), _all("rotvec axisangle"), _all("euler rpy")
_STRUCTURE = (
    _all("field fields msg data pose poses transform state states observation observations obs value stamped")
    | _all("cartesian actual measured axis tf")
    | (_POSITIONS | _QUATERNIONS | _ROTATIONS | _VECTORS | _EULERS)
)
_LETTERS = {"p", "t", "q"}
"""Letters that stand for position, translation and quaternion, where they are joined to an axis by `_`."""
_JOINED = (
    {f"{word}{axis}": axis for word in ("p", "t", "pos", "position") for axis in AXES}
    | {f"{axis}pos": axis for axis in AXES}
    | {f"{word}{axis}": f"q{axis}" for word in ("q", "quat", "quaternion", "o") for axis in "wxyz"}
    | {f"r{axis}": f"r{axis}" for axis in "wxyz"}
    | {f"rot{axis}": f"rot{axis}" for axis in "wxyz"}
    | {axis: axis for axis in (*AXES, "w", *EULER)}
)
"""The axis that one word names together with its quantity."""
_GRIPPERS = _all("gripper grippers grip jaw jaws claw")
_JOINTS = _all(
    "joint joints qpos motor servo shoulder elbow forearm wrist waist hip knee ankle torso neck flex pan lift"
)
_NUMBERED = _all("j q joint theta motor dof axis servo")
_BRACKETS = re.compile(r"(?P<name>.*?)\s*[\[(](?P<unit>[^\[\]()]*)[\])]\s*")
_RATE = re.compile(r"[/^]|s-1|^(n|nm|hz|%|v|a|w|kg|c)$", re.IGNORECASE)
"""Units of what is no coordinate."""
_ENDS = _all("current currents")
"""Words of what is no coordinate where a name ends with them, `motor_current_1`; `current_x` is a position now."""
_STATISTICS = _all("mean median average avg sum total rms min max count percent weight weights gain gains")
"""Words of numbers about others, unless a position or a joint is named as well."""


@dataclass(frozen=True)
class _Word:
    text: str
    start: int
    stop: int


def read_columns(
    names: Sequence[str],
    *,
    bodies: Sequence[str] = (),
    kinds: Sequence[str] = (),
    units: Sequence[str] = (),
) -> tuple[Column, ...]:
    """Return the meaning of a recording's columns by their names.

    Parameters
    ----------
    names : names of all columns, in their order
    bodies : names of the bodies above them, "" where there is none
    kinds : words for the quantity above them, such as Position and Rotation
    units : units below them
    """

    def at(row: Sequence[str], number: int) -> str:
        return row[number].strip() if number < len(row) else ""

    columns = [
        _read_column(number, name, at(bodies, number), at(kinds, number), at(units, number))
        for number, name in enumerate(names)
    ]
    return tuple(_told_by_others(columns))


def bare_name(name: str) -> str:
    """Return a name without quotation and comment marks and unit.

    >>> [bare_name(name) for name in ("X [mm]", "# Time (Seconds)", "q[0]")]
    ['X', 'Time', 'q[0]']
    """
    return _parted(name)[0]


def _parted(name: str) -> tuple[str, str | None]:
    """Return a name without its unit in brackets, and the unit."""
    name = name.strip().strip('"').strip().lstrip("#%").strip()
    found = _BRACKETS.fullmatch(name)
    if found is None or not found["name"] or found["unit"].strip().isdigit():
        return name, None
    return found["name"], found["unit"].strip() or None


def _words(name: str) -> list[_Word]:
    return [
        _Word(found[0].lower(), found.start(), found.end())
        for found in re.finditer(r"[A-ZÄÖÜ]+(?![a-zäöü])|[A-ZÄÖÜ]?[^\W\d_A-ZÄÖÜ]+|\d+|[^\W\d_]+", name)
    ]


def _read_column(number: int, name: str, body: str, kind: str, below: str) -> Column:
    """Return the meaning of one column's name by itself."""
    core, unit = _parted(name)
    unit = below.strip("[]() ") or unit
    words = _words(core)
    texts = [word.text for word in words]
    is_time = bool(words) and not body and _is_time(texts)
    is_suffix = len(words) > 1 and texts[-1] in UNITS and texts[-1] not in ("in", "min")
    if unit is None and (is_suffix or is_time) and (texts[-1] != "m" or texts[-2] in _JOINED):
        if texts[-1] in UNITS and UNITS[texts[-1]] != "min":
            unit = texts[-1]
        if is_suffix:
            texts, core = texts[:-1], core[: words.pop().start].rstrip(" _./:-|,")
    said = None if unit is None else unit_named(unit) or unit

    def column(kind: Kind, axis: str = "", own: str = "") -> Column:
        return Column(number, name.strip(), kind, axis, body or own, said)

    if not words:
        return column(Kind.OTHER if kind else Kind.INDEX)
    if not body and texts[0] in _INDICES and all(text in _INDICES or text.isdigit() for text in texts):
        return column(Kind.INDEX)
    if is_time:
        return column(Kind.TIME)
    ends = next((text for text in reversed(texts) if not text.isdigit()), "") in _ENDS
    if ends or (said is not None and _RATE.search(said)) or _DERIVED & {*texts, *words_of(kind)}:
        return column(Kind.OTHER)
    if (found := _cartesian(core, words, kind)) is not None:
        of, axis, own = found
        if axis is not None:
            return column(of, axis, own)
    if _GRIPPERS & set(texts):
        return column(Kind.GRIPPER, core)
    if _is_joint(texts, said):
        return column(Kind.JOINT, core)
    is_other = said is not None and said not in LENGTHS and said not in ANGLES and said not in TIMES
    return column(Kind.OTHER, "" if is_other or _STATISTICS & set(texts) else core)


def words_of(text: str) -> list[str]:
    """Return the words of a name in lower case."""
    return [word.text for word in _words(text)]


def is_derived(text: str) -> bool:
    """Return whether words name speeds, forces or the like, not coordinates."""
    return bool(_DERIVED & set(words_of(text)))


def _is_time(texts: Sequence[str]) -> bool:
    """Return whether words name time, or a part of it."""
    last, rest = texts[-1], list(texts)
    is_part = last in _PARTS or (len(texts) == 1 and len(last) > 1 and UNITS.get(last) in ("ms", "us", "ns"))
    if is_part and set(texts[:-1]) <= _OF_CLOCKS | _CLOCKS:
        return True
    if UNITS.get(last) in TIMES and len(texts) > 1:
        rest = rest[:-1]
        if rest[-1] == "epoch":  # without a unit, it may count rounds of training
            return True
    is_clock = set(rest) <= _OF_CLOCKS | _CLOCKS and bool(_CLOCKS & set(rest) or rest == ["ts"])
    return is_clock or rest[-1] in _STAMPS


def _cartesian(core: str, words: Sequence[_Word], above: str) -> tuple[Kind, str, str] | None:
    """Return kind, axis and body of a Cartesian column, else None."""
    texts = [word.text for word in words]
    quantity = set(words_of(above))
    for at in (len(words) - 1, 0):  # the axis is the last word, as in left_x, or the first one, as in x_left
        axis = _JOINED.get(texts[at])
        if axis is None and at and texts[at].isdigit() and texts[at - 1] in _JOINED and len(words) == 2:
            continue
        if axis is None:
            continue
        around = texts[:at][::-1] if at else texts[1:]
        if at == 0 and len(words) > 1 and not _may_follow(axis, texts[1:]):
            continue
        kind = Kind.POSITION if axis in AXES else Kind.ORIENTATION
        if axis in (*AXES, "w"):
            word = next((w for w in around if w in _STRUCTURE - {"pose", "axis"} or w in _LETTERS), "")
            kind, axis = _told_by(axis, quantity, word, _joined_by_line(core, words, at))
        return (kind, axis, _body(core, words, at)) if axis else None
    return None


def _may_follow(axis: str, rest: Sequence[str]) -> bool:
    return axis != "w" and not _JOINTS & set(rest)


def _joined_by_line(core: str, words: Sequence[_Word], at: int) -> bool:
    return at > 0 and core[words[at - 1].stop : words[at].start] in ("_", "")


def _told_by(axis: str, quantity: set[str], word: str, joined: bool) -> tuple[Kind, str]:
    """Return an axis's kind and full name, by words for a quantity."""
    given = quantity or {word}
    if given & _POSITIONS or (word in ("p", "t") and not quantity):
        return Kind.POSITION, axis if axis != "w" else ""
    if given & _QUATERNIONS or (word == "q" and joined and not quantity):
        return Kind.ORIENTATION, f"q{axis}"
    if given & _ROTATIONS:
        return Kind.ORIENTATION, f"rot{axis}"
    if given & _VECTORS:
        return Kind.ORIENTATION, f"r{axis}"
    if given & _EULERS:
        return Kind.ORIENTATION, dict(zip((*AXES, "w"), (*EULER, ""), strict=True))[axis]
    return (Kind.ORIENTATION, "w") if axis == "w" else (Kind.POSITION, axis)


def _body(core: str, words: Sequence[_Word], at: int) -> str:
    """Return the body in a name, without axis and structural words."""
    rest = [word for place, word in enumerate(words) if place != at]
    joined = _joined_by_line(core, words, at)

    def is_structure(word: _Word) -> bool:
        return word.text in _STRUCTURE or (joined and word.text in _LETTERS)

    while rest and is_structure(rest[-1]):
        rest.pop()
    while rest and is_structure(rest[0]):
        rest.pop(0)
    return core[rest[0].start : rest[-1].stop] if rest else ""


def _is_joint(texts: Sequence[str], unit: str | None) -> bool:
    if is_angle(unit) or list(texts) == ["base"] or _JOINTS & set(texts):
        return True
    if texts[-1].isdigit() and len(texts) > 1 and texts[-2] in _NUMBERED:
        return True
    return len(texts) > 1 and texts[-1] in ("pos", "position") and not set(texts[:-1]) <= _STRUCTURE


def _told_by_others(columns: list[Column]) -> list[Column]:
    """Correct columns by neighbours: w and rw make quaternions, vectors are found by index."""
    columns = _indexed_vectors(columns)
    places = [column for column in columns if column.kind is Kind.POSITION]
    if len(places) > 1 and len({c.axis for c in places}) == 1 and all(c.body.isdigit() for c in places):
        columns = [
            replace(c, kind=Kind.OTHER, axis=bare_name(c.name)) if c.kind is Kind.POSITION else c
            for c in columns
        ]  # x1, x2, x3
    by_body: dict[str, list[Column]] = {}
    for column in columns:
        by_body.setdefault(column.body, []).append(column)
    changed = {column.number: column for column in columns}
    is_without_position = all(column.kind is not Kind.POSITION for column in columns)
    for members in by_body.values():
        for column in members:  # wrist_roll, left_hip_yaw
            is_joint = _JOINTS & set(words_of(column.body)) or (is_without_position and column.body)
            if column.axis in EULER and is_joint and all(c.kind is not Kind.POSITION for c in members):
                changed[column.number] = replace(
                    column, kind=Kind.JOINT, axis=bare_name(column.name), body=""
                )
        axes = [column.axis for column in members if column.kind in (Kind.POSITION, Kind.ORIENTATION)]
        if "rw" in axes or "rotw" in axes:
            mark = "r" if "rw" in axes else "rot"
            pairs = {f"{mark}{axis}": f"q{axis}" for axis in "wxyz"}
            found = [column for column in members if column.axis in pairs]
        elif "w" in axes and not {"qx", "qw"} & set(axes):
            pairs = {axis: f"q{axis}" for axis in "wxyz"}
            found = [c for c in members if c.axis in pairs and c.kind in (Kind.POSITION, Kind.ORIENTATION)]
            if len(found) != 4:  # x, y, z, w, x, y, z: repeated names are chosen by the user
                continue
        else:
            continue
        for column in found:
            changed[column.number] = replace(column, kind=Kind.ORIENTATION, axis=pairs[column.axis])
    return [changed[column.number] for column in columns]


def _indexed_vectors(columns: list[Column]) -> list[Column]:
    """Return columns with numbered ones as vectors: `pos_0, pos_1, pos_2`, or the start of `tcp_pose_0` to `_5`."""
    stems: dict[str, list[Column]] = {}
    names = {column.number: bare_name(column.name) for column in columns}
    is_joint_state = any(re.fullmatch(r".*\bname_?\[?0\]?", name) for name in names.values())
    for column in columns:
        found = re.fullmatch(r"(.*?)[._\[/ ]?\d+\]?", names[column.number])
        if column.kind in (Kind.OTHER, Kind.JOINT) and found:
            stems.setdefault(found[1], []).append(column)
    changed = {column.number: column for column in columns}
    for stem, members in stems.items():
        words = _words(stem)
        texts = [word.text for word in words]
        if not texts or texts[-1] not in _POSITIONS | {"pose", "p"} or _DERIVED & set(texts):
            continue
        is_pose, n = texts[-1] == "pose", len(members)
        axes = (*AXES, *ROTATION_VECTOR) if is_pose and n == 6 and "tcp" in texts else AXES
        if is_joint_state or _JOINTS & set(texts) or n not in ((6, 7) if is_pose else (3,)):
            if texts[-1] in ("position", "positions", "pos", "p"):
                changed |= {c.number: replace(c, kind=Kind.JOINT, axis=names[c.number]) for c in members}
            continue
        own = _body(stem, [*words, _Word("x", len(stem), len(stem))], len(words))
        for column, axis in zip(members, axes, strict=False):
            kind = Kind.POSITION if axis in AXES else Kind.ORIENTATION
            changed[column.number] = replace(column, kind=kind, axis=axis, body=column.body or own)
    return [changed[column.number] for column in columns]

"""The scene file as frozen models, its cross checks, and errors in plain words.

The models mirror the contract of the scene file key by key. What one key can tell alone is checked
by its type, what needs several keys by :func:`parse_scene`; what needs geometry (does the start touch
an obstacle, does it meet the constraints) is not checked here. Lengths are in metres, times in
seconds, angles in degrees where the key says so, quaternions in the order w, x, y, z.

``circle`` and ``sphere`` are one shape and read as ``sphere``, ``ellipse`` and ``ellipsoid`` as
``ellipsoid``.
"""

from __future__ import annotations

import difflib
import json
import math
import re
import reprlib
import warnings
from collections.abc import Iterable, Iterator, Sized
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, NamedTuple

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    JsonValue,
    ValidationError,
    model_validator,
)

from comove.errors import ComoveWarning, SceneError, near_name
from comove.scenes.yaml_reader import MAX_NAMES, Lines, near_files, read_yaml

MAX_NAME = 100
MAX_DURATION = 3600.0
"""[s]"""
LARGE_WORKSPACE = 50.0
"""A workspace wider than this is probably written in millimetres [m]."""
QUATERNION_TOLERANCE = 1e-3
DISTANCE_TOLERANCE = 1e-3
"""Tolerance of a distance constraint that states none, as a part of its distance."""
ROUNDING = 1e-12
"""[m]"""
MAX_TOLD = 3
"""How many errors one message tells."""

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
_AXES = {2: "planar, so write 2 numbers (x, y)", 3: "spatial, so write 3 numbers (x, y, z)"}


class _Wrong(ValueError):
    """A value that its type accepts and the contract does not; `args` are message and way out."""


def _no_minus_zero(number: float) -> float:
    return number + 0.0  # -0.0 becomes 0.0, so that equal scenes have equal checksums


def _as_tuple(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(value) if isinstance(value, list) else value


def _safe_name(name: str) -> str:
    """Accept names that can name a folder, a file, a column of a table."""
    if not re.fullmatch(r"\w[\w +-]*(\.[\w +-]+)*", name) or name.endswith(" "):
        way_out = "begin with a letter or digit; letters, digits, blanks and . _ + - may follow"
        raise _Wrong(f"{_show(name)} cannot name a file", way_out)
    if len(name) > MAX_NAME or len(name.encode()) > 2 * MAX_NAME:
        raise _Wrong(f"the name has {len(name)} characters", f"use at most {MAX_NAME} ({2 * MAX_NAME} bytes)")
    return name


def _manipulator_name(name: str) -> str:
    if "." in name or " " in name:
        raise _Wrong(f"{_show(name)} contains a point or a blank", "use letters, digits, '_', '-'")
    return _safe_name(name)


def _unit_quaternion(quaternion: tuple[float, ...]) -> tuple[float, ...]:
    if len(quaternion) != 4:
        raise _Wrong(
            f"{_show(quaternion)} has {_count(quaternion, 'number')}", "write 4, in the order w, x, y, z"
        )
    norm = math.hypot(*quaternion)
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        raise _Wrong(f"{_show(quaternion)} has the norm {norm:.6g}", "write a unit quaternion, w first")
    rounding = 1e-15  # an already normalised quaternion stays as it is
    return quaternion if abs(norm - 1.0) <= rounding else tuple(part / norm for part in quaternion)


def _distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    if not names:
        raise _Wrong("no manipulator is named", "name at least one")
    if len(set(names)) < len(names):
        raise _Wrong(f"{_show(names)} names a manipulator twice", "name different manipulators")
    return names


def _pair(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(names) != 2:
        raise _Wrong(f"{_show(names)} has {_count(names, 'name')}", "name two manipulators")
    return _distinct(names)


def _not_supported(message: str, way_out: str) -> AfterValidator:
    """Make a validator that refuses what the contract knows and this version does not do."""

    def refuse(value: Any) -> Any:
        raise _Wrong(message.format(value), way_out)

    return AfterValidator(refuse)


def _at_least(count: int, what: str) -> AfterValidator:
    def check(items: tuple[Any, ...]) -> tuple[Any, ...]:
        if len(items) < count:
            raise _Wrong(
                f"the list has {_count(items, 'entry', 'entries')}", f"write at least {count} {what}"
            )
        return items

    return AfterValidator(check)


def _version(number: int) -> int:
    if number != 1:
        raise _Wrong(f"the version {number} is not known", "write 1")
    return number


def _text_or_mapping(value: Any) -> Any:
    if not isinstance(value, str | dict | None):
        raise _Wrong(f"{_show(value)} is neither text nor a mapping", "write a name or 'key: value' lines")
    return value


def _mapping(value: Any) -> Any:
    if not isinstance(value, dict | None):
        raise _Wrong(f"{_show(value)} is not a mapping", "write 'key: value' lines")
    return value


Number = Annotated[float, AfterValidator(_no_minus_zero)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_no_minus_zero)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_no_minus_zero)]
Vector = Annotated[tuple[Number, ...], BeforeValidator(_as_tuple)]
Sizes = Annotated[tuple[Positive, ...], BeforeValidator(_as_tuple)]
Quaternion = Annotated[tuple[Number, ...], BeforeValidator(_as_tuple), AfterValidator(_unit_quaternion)]
Name = Annotated[str, AfterValidator(_manipulator_name)]
Names = Annotated[tuple[str, ...], BeforeValidator(_as_tuple), AfterValidator(_distinct)]
Pair = Annotated[tuple[str, ...], BeforeValidator(_as_tuple), AfterValidator(_pair)]


class _Part(BaseModel):
    """Frozen and strict: no unknown keys, no NaN or infinity, a bool or a text is no number."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Workspace(_Part):
    """The box that load and hands stay in [m]; two numbers a corner make the scene planar, three spatial."""

    lower: Vector
    upper: Vector


class _Turned(_Part):
    """What stands at `center` [m], turned by one of the two (`UPRIGHT` and 0 where not given)."""

    center: Vector
    rotation_deg: Number = 0.0
    """Planar scenes only, counter-clockwise [deg]."""
    quaternion_wxyz: Quaternion = UPRIGHT
    """Spatial scenes only, of unit norm."""


class BoxObstacle(_Turned):
    """A box with the full edge lengths `size` [m]."""

    shape: Literal["box"]
    size: Sizes


class SphereObstacle(_Part):
    """A circle in the plane, a sphere in space [m]."""

    shape: Annotated[Literal["sphere", "circle"], AfterValidator(lambda _: "sphere")]
    center: Vector
    radius: Positive


class CapsuleObstacle(_Turned):
    """A segment of `length`, thickened by `radius` [m]; along local x in the plane, local z in space."""

    shape: Literal["capsule"]
    radius: Positive
    length: Positive


class CylinderObstacle(_Part):
    """A cylinder along local z [m]; spatial scenes only."""

    shape: Literal["cylinder"]
    center: Vector
    radius: Positive
    height: Positive
    quaternion_wxyz: Quaternion = UPRIGHT


class EllipsoidObstacle(_Turned):
    """An ellipse in the plane, an ellipsoid in space, with the semi-axes `radii` [m]."""

    shape: Annotated[Literal["ellipsoid", "ellipse"], AfterValidator(lambda _: "ellipsoid")]
    radii: Sizes


class UnsupportedObstacle(_Part):
    """An obstacle of the contract that this version refuses; never part of a parsed scene."""

    model_config = ConfigDict(extra="allow")
    shape: Annotated[
        Literal["mesh"],
        _not_supported("{} obstacles are not supported", "approximate them by boxes, capsules or ellipsoids"),
    ]


Obstacle = Annotated[
    BoxObstacle
    | SphereObstacle
    | CapsuleObstacle
    | CylinderObstacle
    | EllipsoidObstacle
    | UnsupportedObstacle,
    Field(discriminator="shape"),
]


class BarLoad(_Part):
    """A bar between two hands `length` apart, `overhang` longer at both ends, of `radius` [m]."""

    shape: Literal["bar"]
    length: Positive
    radius: NotNegative = 0.0
    overhang: NotNegative = 0.0
    held_by: Pair | None = None


class FrameLoad(_Part):
    """Rods of `radius` [m] between the hands that `edges` names in pairs."""

    shape: Literal["frame"]
    edges: Annotated[tuple[Pair, ...], BeforeValidator(_as_tuple), _at_least(1, "pair of names")]
    radius: NotNegative = 0.0
    held_by: Names | None = None


class _Gripped(_Part):
    """A load with a frame of its own, in which `grasps` says where each hand holds it [m]."""

    grasps: dict[str, Vector] | None = None
    held_by: Names | None = None


class PolygonLoad(_Gripped):
    """A polygon of `vertices` in the load's frame, thickened by `radius` [m]; planar scenes only."""

    shape: Literal["polygon"]
    vertices: Annotated[tuple[Vector, ...], BeforeValidator(_as_tuple), _at_least(3, "vertices")]
    radius: NotNegative = 0.0


class BoxLoad(_Gripped):
    """A box with the full edge lengths `size` [m], centred on the load's frame."""

    shape: Literal["box"]
    size: Sizes


class MeshLoad(_Gripped):
    """A mesh in the load's frame, read from `file` in the scene's folder; spatial scenes only."""

    shape: Literal["mesh"]
    file: str


Load = Annotated[BarLoad | FrameLoad | PolygonLoad | BoxLoad | MeshLoad, Field(discriminator="shape")]


class Manipulator(_Part):
    """A hand that moves from `start` to `goal` [m]."""

    name: Name
    start: Vector
    goal: Vector


class Limits(_Part):
    """What each manipulator keeps: `speed` [m/s], `acceleration` [m/s^2], and the load's `clearance` [m]."""

    speed: Positive | None = None
    acceleration: Positive | None = None
    clearance: NotNegative = 0.0


class DistanceConstraint(_Part):
    """Two hands stay `distance` apart, within `tolerance` (None: not given) [m]."""

    type: Literal["distance"]
    between: Pair
    distance: Positive
    tolerance: NotNegative | None = None


class UnsupportedConstraint(_Part):
    """A constraint of the contract that this version refuses; never part of a parsed scene."""

    model_config = ConfigDict(extra="allow")
    type: Annotated[
        Literal["relative_pose", "separation", "upright"],
        _not_supported("the constraint {!r} is not supported", "only 'distance' is, by this version"),
    ]


Constraint = Annotated[DistanceConstraint | UnsupportedConstraint, Field(discriminator="type")]


class DemonstrationSource(_Part):
    """Where the taught movement comes from: a `file`, or recording `demo` of a LASA shape."""

    file: str | None = None
    lasa: str | None = None
    demo: Annotated[int, Field(ge=0, le=6)] = 0
    library: (
        Annotated[str, _not_supported("the library is not supported by this version", "use file or lasa")]
        | None
    ) = None
    plane: Literal["xy", "xz", "yz"] | None = None
    """The plane of a spatial scene in which a planar recording is laid."""
    scale: Positive | None = None
    manipulator: str | None = None

    @model_validator(mode="after")
    def _one_source(self) -> DemonstrationSource:
        if (self.file is None) == (self.lasa is None):
            found = "neither file nor lasa is" if self.file is None else "both file and lasa are"
            raise _Wrong(f"{found} given", "give one of the two")
        if self.lasa is None and self.demo:
            raise _Wrong(f"demo {self.demo} belongs to a LASA shape and none is given", "leave demo out")
        return self


class SceneFile(_Part):
    """A scene as written; :func:`load_scene_file` and :func:`parse_scene` make it and cross-check it."""

    version: Annotated[int, AfterValidator(_version)] = 1
    name: Annotated[str, AfterValidator(_safe_name)]
    duration: Annotated[float, Field(gt=0, le=MAX_DURATION), AfterValidator(_no_minus_zero)]
    """[s]"""
    workspace: Workspace
    obstacles: Annotated[tuple[Obstacle, ...], BeforeValidator(_as_tuple)] = ()
    load: Load | None = None
    manipulators: Annotated[tuple[Manipulator, ...], BeforeValidator(_as_tuple), _at_least(1, "manipulator")]
    limits: Limits = Limits()
    constraints: Annotated[tuple[Constraint, ...], BeforeValidator(_as_tuple)] = ()
    demonstration: DemonstrationSource | None = None
    robot: Annotated[JsonValue, AfterValidator(_text_or_mapping)] = None
    grasp: Annotated[JsonValue, AfterValidator(_mapping)] = None

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return len(self.workspace.lower)

    @property
    def names(self) -> tuple[str, ...]:
        """The manipulators' names, in their order."""
        return tuple(manipulator.name for manipulator in self.manipulators)

    @property
    def holders(self) -> tuple[str, ...]:
        """Who holds the load: `held_by`, or everyone where nothing is said; nobody without a load."""
        if self.load is None:
            return ()
        return self.load.held_by or self.names


def load_scene_file(path: str | Path) -> SceneFile:
    """Read and check the scene file at `path`.

    Raises
    ------
    SceneError
        One message that names file, key, line, value and way out of the first three errors.
    """
    data, lines = read_yaml(path)
    return parse_scene(data, folder=Path(path).parent, file=path, lines=lines)


def parse_scene(
    data: dict[str, Any],
    *,
    folder: str | Path | None = None,
    file: str | Path | None = None,
    lines: Lines | None = None,
) -> SceneFile:
    """Check a scene given as plain data.

    Parameters
    ----------
    data
        What a scene file holds; arrays pass for lists.
    folder
        What relative paths in the scene start from; where None, files are not looked for.
    file, lines
        Where the data comes from, for messages; `lines` as of :func:`comove.scenes.yaml_reader.read_yaml`.

    Raises
    ------
    SceneError
        One message that names file, key, line, value and way out of the first three errors.
    """
    try:
        scene = SceneFile.model_validate(data)
    except ValidationError as error:
        flaws = _explained(error, data)
    else:
        flaws = _cross_checked(scene, Path(folder) if folder is not None else None)
    if flaws:
        raise _scene_error(flaws, file, lines or {})
    _warn_of_units(scene, file)
    return scene


def canonical(scene: SceneFile) -> bytes:
    """Write the scene as canonical JSON: sorted keys, defaults filled in, floats as `repr`.

    Comments, formatting, key order and equal spellings of a number (``1e-1``, ``0.1``) do not change
    it; :func:`parse_scene` reads it back to an equal scene.
    """
    return json.dumps(scene.model_dump(), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()


# --- What is wrong, in plain words ---


_Path = tuple[str | int, ...]
_Keys = dict[_Path, list[str]]


class _Flaw(NamedTuple):
    path: _Path
    message: str
    way_out: str


_OBSTACLES = {
    "box": BoxObstacle,
    "circle": SphereObstacle,
    "sphere": SphereObstacle,
    "capsule": CapsuleObstacle,
    "cylinder": CylinderObstacle,
    "ellipsoid": EllipsoidObstacle,
    "ellipse": EllipsoidObstacle,
}
_LOADS = {"bar": BarLoad, "frame": FrameLoad, "polygon": PolygonLoad, "box": BoxLoad, "mesh": MeshLoad}
_CONSTRAINTS = {"distance": DistanceConstraint}


class _Family(NamedTuple):
    """A place whose model depends on a tag: the tag's key, the models, how deep the place lies."""

    tag: str
    models: dict[str, type[_Part]]
    depth: int


_FAMILIES = {
    "obstacles": _Family("shape", _OBSTACLES, 2),
    "load": _Family("shape", _LOADS, 1),
    "constraints": _Family("type", _CONSTRAINTS, 2),
}
_PLACES = {
    "workspace": Workspace,
    "manipulators": Manipulator,
    "limits": Limits,
    "demonstration": DemonstrationSource,
}
_PLAIN_NUMBER = "write a plain number such as 0.5: no quotes, no unit, a point for decimals"
_KINDS = {
    "float_type": ("a number", _PLAIN_NUMBER),
    "finite_number": ("a finite number", _PLAIN_NUMBER),
    "int_type": ("a whole number", "write a whole number such as 1"),
    "string_type": ("text", "write a name or text, in quotes where it looks like a number"),
    "tuple_type": ("a list", "write it in brackets, such as [0.5, 0.5]"),
    "dict_type": ("a mapping", "write 'key: value' lines"),
    "model_type": ("a mapping", "write 'key: value' lines"),
    "model_attributes_type": ("a mapping", "write 'key: value' lines"),
    "invalid_key": ("a key", "write keys as text"),
    "invalid-json-value": ("plain data", "use text, numbers, lists and mappings"),
}
_BOUNDS = {
    "greater_than": ("gt", "greater than"),
    "greater_than_equal": ("ge", "not less than"),
    "less_than_equal": ("le", "not greater than"),
}


def _show(value: Any) -> str:
    """Write a value as a scene file would, shortened; characters that could upset a terminal are escaped."""
    if value is None or isinstance(value, bool):
        return {None: "nothing", True: "true", False: "false"}[value]
    try:
        return reprlib.repr(list(value) if isinstance(value, tuple) else value)
    except ValueError:  # a whole number too long to be written
        return f"a very long {type(value).__name__}"


def _count(items: Sized, one: str, several: str | None = None) -> str:
    """Write ``1 entry``, ``2 entries``."""
    return f"{len(items)} {one if len(items) == 1 else several or one + 's'}"


def _dotted(path: Iterable[str | int]) -> str:
    """Write a key path as ``obstacles[0].size``."""
    parts = (f"[{part}]" if isinstance(part, int) else f".{_plain_key(part)}" for part in path)
    return "".join(parts).removeprefix(".")


def _plain_key(key: str) -> str:
    return key if re.fullmatch(r"[\w-]{1,40}", key) else _show(key)


def _scene_error(flaws: list[_Flaw], file: str | Path | None, lines: Lines) -> SceneError:
    """Tell the first flaws of the file in one error."""
    flaws = sorted(flaws, key=lambda flaw: lines.get(flaw.path, 0))
    keys = [_place(flaw.path, lines) for flaw in flaws]
    if len(flaws) == 1:
        return SceneError(flaws[0].message, file=file, key=keys[0], way_out=flaws[0].way_out)
    told = [
        f"{key}: {flaw.message}; {flaw.way_out}" if key else f"{flaw.message}; {flaw.way_out}"
        for key, flaw in zip(keys[:MAX_TOLD], flaws, strict=False)
    ]
    more = [f"and {len(flaws) - MAX_TOLD} more"] if len(flaws) > MAX_TOLD else []
    return SceneError("\n  ".join([f"{len(flaws)} errors", *told, *more]), file=file)


def _place(path: _Path, lines: Lines) -> str | None:
    """Write the key and its line, as far as both are known."""
    line = f" (line {lines[path]})" if path in lines else ""
    return f"{_dotted(path)}{line}" or None


def _explained(error: ValidationError, data: Any) -> list[_Flaw]:
    """Translate pydantic's errors; misspelt keys are told once, missing keys once a place."""
    details = [(_existing(detail["loc"], data), detail) for detail in error.errors(include_url=False)]
    unknown: _Keys = {}
    missing: _Keys = {}
    flaws = {}
    for path, detail in details:
        if detail["type"] == "missing":
            missing.setdefault(path, []).append(detail["loc"][-1])
        elif detail["type"] == "extra_forbidden":
            unknown.setdefault(path[:-1], []).append(path[-1])
        else:
            flaws.setdefault(path, _Flaw(path, *_translated(detail, path)))
    return [*_unknown_keys(unknown, data), *_missing_keys(missing, unknown, data), *flaws.values()]


def _existing(location: _Path, data: Any) -> _Path:
    """Strip pydantic's union tags and missing keys from an error's location."""
    family = _FAMILIES.get(location[0]) if location else None
    if family:
        location = location[: family.depth] + location[family.depth + 1 :]
    path = []
    for part in location:
        try:
            data = data[part]
        except (TypeError, KeyError, IndexError):
            continue
        path.append(part)
    return tuple(path)


def _keys(path: _Path, data: Any) -> dict[str, bool]:
    """List the keys that the contract knows for the mapping at `path`, and whether each is required."""
    if not path:
        model = SceneFile
    elif family := _FAMILIES.get(path[0]):
        part = data[path[0]] if family.depth == 1 else data[path[0]][path[1]]
        model = family.models[part[family.tag]]
    else:
        model = _PLACES[path[0]]
    return {name: field.is_required() for name, field in model.model_fields.items()}


def _unknown_keys(unknown: _Keys, data: Any) -> Iterator[_Flaw]:
    for path, keys in unknown.items():
        for key in keys:
            yield _Flaw((*path, key), *_unknown_key(key, path, data))


def _unknown_key(key: str, path: _Path, data: Any) -> tuple[str, str]:
    if key == "motion" and path[:1] == ("obstacles",):
        return "moving obstacles are not supported by this version", "leave out motion"
    if key.isdigit():
        return f"unknown key {_show(key)}", "write decimals with a point, and lists in brackets"
    return f"unknown key {_show(key)}", near_name(key, _keys(path, data))


def _missing_keys(missing: _Keys, unknown: _Keys, data: Any) -> Iterator[_Flaw]:
    for path, keys in missing.items():
        keys = [key for key in keys if not difflib.get_close_matches(key, unknown.get(path, []))]
        if keys:
            verb = "is" if len(keys) == 1 else "are"
            required = ", ".join(key for key, needed in _keys(path, data).items() if needed)
            yield _Flaw(path, f"{', '.join(map(repr, keys))} {verb} missing", f"required here: {required}")


def _translated(detail: dict[str, Any], path: _Path) -> tuple[str, str]:
    """Say in plain words what is wrong with a value, and what to write instead."""
    kind, value, context = detail["type"], detail["input"], detail.get("ctx", {})
    if kind == "value_error" and isinstance(context["error"], _Wrong):
        return context["error"].args
    if kind in _KINDS:
        wanted, way_out = _KINDS[kind]
        return f"{_show(value)} is not {wanted}", way_out
    if kind in _BOUNDS:
        bound, words = _BOUNDS[kind]
        return f"{_show(value)} is out of range", f"write a number {words} {context[bound]:g}"
    if kind in ("union_tag_invalid", "union_tag_not_found"):
        return _tag_error(value, path)
    if kind == "literal_error":
        return f"{_show(value)} is not known", f"write {context['expected']}"
    return f"{_show(value)} is not allowed here", "correct it, or leave it out"


def _tag_error(part: Any, path: _Path) -> tuple[str, str]:
    family = _FAMILIES[path[0]]
    if family.tag not in part:
        return f"the key '{family.tag}' is missing", f"write one of: {', '.join(family.models)}"
    tag = part[family.tag]
    return f"the {family.tag} {_show(tag)} is not known", near_name(tag, family.models)


# --- Checks across keys ---


def _cross_checked(scene: SceneFile, folder: Path | None) -> list[_Flaw]:
    """Find what contradicts itself; the later checks need vectors of equal length and known names."""
    flaws = [*_dimension_flaws(scene), *_name_flaws(scene)]
    if flaws:
        return flaws
    return [
        *_workspace_flaws(scene),
        *_rotation_flaws(scene),
        *_holder_flaws(scene),
        *_distance_flaws(scene),
        *_file_flaws(scene, folder),
    ]


def _vectors(scene: SceneFile) -> Iterator[tuple[_Path, tuple[float, ...]]]:
    """List all vectors that have the scene's dimension, with their paths."""
    yield ("workspace", "upper"), scene.workspace.upper
    for i, obstacle in enumerate(scene.obstacles):
        for key in ("center", "size", "radii"):
            if hasattr(obstacle, key):
                yield ("obstacles", i, key), getattr(obstacle, key)
    for i, manipulator in enumerate(scene.manipulators):
        yield ("manipulators", i, "start"), manipulator.start
        yield ("manipulators", i, "goal"), manipulator.goal
    if isinstance(scene.load, BoxLoad):
        yield ("load", "size"), scene.load.size
    for i, vertex in enumerate(getattr(scene.load, "vertices", ())):
        yield ("load", "vertices", i), vertex
    for name, grasp in (getattr(scene.load, "grasps", None) or {}).items():
        yield ("load", "grasps", name), grasp


def _dimension_flaws(scene: SceneFile) -> Iterator[_Flaw]:
    planar_or_spatial = _AXES.get(scene.dimension)
    if planar_or_spatial is None:
        message = f"{_show(scene.workspace.lower)} has {_count(scene.workspace.lower, 'number')}"
        yield _Flaw(("workspace", "lower"), message, "write 2 (planar) or 3 (spatial)")
        return
    for path, vector in _vectors(scene):
        if len(vector) != scene.dimension:
            commas = ", with decimal points" if len(vector) == 2 * scene.dimension else ""
            message = f"{_show(vector)} has {_count(vector, 'number')}"
            yield _Flaw(path, message, f"the workspace is {planar_or_spatial}{commas}")
    planar = scene.dimension == 2
    for i, obstacle in enumerate(scene.obstacles):
        if planar and isinstance(obstacle, CylinderObstacle):
            yield _Flaw(("obstacles", i, "shape"), "a cylinder needs a spatial scene", "use circle or box")
    if not planar and isinstance(scene.load, PolygonLoad):
        yield _Flaw(("load", "shape"), "a polygon needs a planar scene", "use box, mesh or frame in space")
    if planar and isinstance(scene.load, MeshLoad):
        yield _Flaw(("load", "shape"), "a mesh needs a spatial scene", "use polygon in the plane")


def _name_flaws(scene: SceneFile) -> Iterator[_Flaw]:
    first: dict[str, int] = {}
    for i, name in enumerate(scene.names):
        if first.setdefault(name, i) != i:
            message = f"the name {_show(name)} is already that of manipulators[{first[name]}]"
            yield _Flaw(("manipulators", i, "name"), message, "give each manipulator its own name")
    if len(first) < len(scene.names):
        return
    for path, name in _named(scene):
        if name not in first:
            known = scene.names[:MAX_NAMES]
            yield _Flaw(path, f"there is no manipulator {_show(name)}", near_name(name, known))


def _named(scene: SceneFile) -> Iterator[tuple[_Path, str]]:
    """List all mentions of a manipulator, with their paths."""
    for i, name in enumerate(getattr(scene.load, "held_by", None) or ()):
        yield ("load", "held_by", i), name
    for i, edge in enumerate(getattr(scene.load, "edges", ())):
        for j, name in enumerate(edge):
            yield ("load", "edges", i, j), name
    for name in getattr(scene.load, "grasps", None) or ():
        yield ("load", "grasps", name), name
    for i, constraint in enumerate(scene.constraints):
        for j, name in enumerate(constraint.between):
            yield ("constraints", i, "between", j), name
    if scene.demonstration and scene.demonstration.manipulator is not None:
        yield ("demonstration", "manipulator"), scene.demonstration.manipulator


def _workspace_flaws(scene: SceneFile) -> Iterator[_Flaw]:
    lower, upper = scene.workspace.lower, scene.workspace.upper
    for axis, low, high in zip("xyz", lower, upper, strict=False):
        if not low < high:
            yield _Flaw(("workspace",), f"{axis} goes from {low} to {high}", "lower must be less than upper")
            return


def _rotation_flaws(scene: SceneFile) -> Iterator[_Flaw]:
    for i, obstacle in enumerate(scene.obstacles):
        if scene.dimension == 3 and getattr(obstacle, "rotation_deg", 0.0) != 0.0:
            message = f"{obstacle.rotation_deg} turns about no axis, because the scene is spatial"
            yield _Flaw(("obstacles", i, "rotation_deg"), message, "use quaternion_wxyz")
        if scene.dimension == 2 and getattr(obstacle, "quaternion_wxyz", UPRIGHT) != UPRIGHT:
            message = f"{_show(obstacle.quaternion_wxyz)} turns in space, and the scene is planar"
            yield _Flaw(("obstacles", i, "quaternion_wxyz"), message, "use rotation_deg")
    plane = scene.demonstration.plane if scene.demonstration else None
    if scene.dimension == 2 and plane not in (None, "xy"):
        yield _Flaw(("demonstration", "plane"), f"{plane!r} needs a spatial scene", "leave it out")


def _holder_flaws(scene: SceneFile) -> Iterator[_Flaw]:
    load, holders = scene.load, scene.holders
    if isinstance(load, BarLoad) and len(holders) != 2:
        message = f"a bar has two holders, and the scene has {_count(holders, 'manipulator')}"
        way_out = "add held_by: [NAME, NAME]" if len(holders) > 2 else "add a second manipulator"
        yield _Flaw(("load",), message, way_out)
    if isinstance(load, FrameLoad):
        allowed = set(holders)
        for i, edge in enumerate(load.edges):
            for j, name in enumerate(edge):
                if name not in allowed:
                    message = f"{_show(name)} does not hold the load"
                    yield _Flaw(("load", "edges", i, j), message, "add it to held_by, or leave the edge out")
    grasps = getattr(load, "grasps", None)
    if grasps is not None and set(grasps) != set(holders):
        message = f"grasps are given for {_show([*grasps])}, but the load is held by {_show(holders)}"
        yield _Flaw(("load", "grasps"), message, "give one grasp to each holder, or correct held_by")


def _distance_flaws(scene: SceneFile) -> Iterator[_Flaw]:
    """Compare the explicit distances with each other and with the load's."""
    seen: dict[frozenset[str], int] = {}
    for i, constraint in enumerate(scene.constraints):
        pair, names = frozenset(constraint.between), " and ".join(constraint.between)
        if pair in seen:
            message = f"the distance between {names} is already given by constraints[{seen[pair]}]"
            yield _Flaw(("constraints", i), message, "keep one of them")
        seen.setdefault(pair, i)
        load = _load_distance(scene, constraint.between)
        tolerance = constraint.tolerance
        if tolerance is None:
            tolerance = DISTANCE_TOLERANCE * constraint.distance
        if load is not None and abs(load - constraint.distance) > tolerance + ROUNDING:
            message = f"{constraint.distance} m, but the load keeps {names} {load:.9g} m apart"
            yield _Flaw(("constraints", i, "distance"), message, "make them equal, or leave this one out")


def _load_distance(scene: SceneFile, pair: Pair) -> float | None:
    """Give the distance [m] at which the load keeps two hands; None where only the start can tell."""
    grasps = getattr(scene.load, "grasps", None) or {}
    if isinstance(scene.load, BarLoad) and set(pair) == set(scene.holders):
        return scene.load.length
    return math.dist(*(grasps[name] for name in pair)) if all(name in grasps for name in pair) else None


def _file_flaws(scene: SceneFile, folder: Path | None) -> Iterator[_Flaw]:
    for key, part in (("demonstration", scene.demonstration), ("load", scene.load)):
        name = getattr(part, "file", None)
        if name is not None and (told := _file_flaw(name, folder)):
            yield _Flaw((key, "file"), *told)


def _file_flaw(name: str, folder: Path | None) -> tuple[str, str] | None:
    """Say why the file cannot be read: not in the scene's folder (links followed), or not there."""
    outside = f"{_show(name)} lies outside the scene's folder", "move the file into it"
    if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
        return outside
    if folder is None:
        return None
    try:
        path = (folder / name).resolve()
        if not path.is_relative_to(folder.resolve()):
            return outside
        if not path.is_file():
            way_out = near_files(folder, name, (Path(name).suffix.lower(),))
            return f"there is no file {_show(name)} in the scene's folder", way_out
    except (OSError, ValueError, RuntimeError):  # name too long, a zero byte, a circle of links
        return f"{_show(name)} cannot name a file", "write a path relative to the scene's folder"
    return None


def _warn_of_units(scene: SceneFile, file: str | Path | None) -> None:
    extent = max(high - low for low, high in zip(scene.workspace.lower, scene.workspace.upper, strict=True))
    if extent > LARGE_WORKSPACE:
        place = f"{file}: workspace" if file is not None else "workspace"
        message = f"{place}: {extent:g} m wide, which looks like millimetres; lengths are in metres"
        warnings.warn(message, ComoveWarning, stacklevel=3)

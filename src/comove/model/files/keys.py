"""The scene file as frozen models.

The models mirror the format of the scene file key by key. Rules of a single key are checked by its type, rules that
compare several keys in `checks`; `messages` words the errors. Rules that need geometry (does the start touch an
obstacle, does it meet the constraints) are not checked here. Lengths are in metres, times in seconds, angles in
degrees where the key says so, quaternions in the order w, x, y, z.

``circle`` and ``sphere`` are one shape and read as ``sphere``, ``ellipse`` and ``ellipsoid`` as ``ellipsoid``.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import reduce
from operator import or_
from typing import Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Discriminator,
    Field,
    GetPydanticSchema,
    Tag,
    model_validator,
)

from comove.geometry.rotations import matrices, rotation_in_plane
from comove.io.keys import (
    UNTURNED,
    Contract,
    Entries,
    Family,
    Hands,
    Length,
    Name,
    NotNegative,
    Number,
    Pair,
    Part,
    Positive,
    PositiveLength,
    Quaternion,
    Sizes,
    Sparse,
    Vector,
    Wrong,
    as_tuple,
    at_least,
    at_most,
    counted,
    safe_name,
    show,
)
from comove.model.constraints import KINDS, ConstraintKeys
from comove.model.moving import Motion

MIN_DURATION, MAX_DURATION = 1e-3, 3600.0
"""[s]"""
MAX_MANIPULATORS = 100
"""Hands of one scene; distances grow with the square of their number."""
ROUNDING = 1e-12
"""[m], by which lengths of one file that must agree may differ."""
DEFAULT_MASS = 0.25
"""[kg], of a payload whose file does not say, on robots and in simulations."""
ROBOT_CLEARANCE = 0.005
"""[m], kept on robots where the file does not say."""


def _version(number: int) -> int:
    if number != 1:
        raise Wrong(f"the version {number} is not known", "write 2, or 1 for a file of version 1")
    return number


def _no_instant(duration: float) -> float:
    if duration < MIN_DURATION:
        raise Wrong(
            f"{show(duration)} s leaves no time to move", f"write at least {MIN_DURATION:g}, in seconds"
        )
    return duration


def _robot_name(name: str) -> str:
    if not name.strip() or not name.isprintable():
        raise Wrong(f"{show(name)} names no robot", "write a name such as baxter, or a description's path")
    return name


class Workspace(Part):
    """The box in which payload and end effectors must stay [m].

    Corners of two numbers make the scene planar, corners of three spatial.
    """

    lower: Vector
    upper: Vector


class _Obstacle(Sparse):
    """An obstacle, which moves if it has a `motion`. Messages call it by its `name`.

    Obstacles without these keys keep their checksum.
    """

    LATER: ClassVar[tuple[str, ...]] = ("name", "motion", "support")
    name: Name | None = None
    motion: Motion | None = None
    support: bool | None = None
    """Whether the payload may rest on it at start and goal; see `comove.model.resting`."""

    @model_validator(mode="after")
    def _supports_at_rest(self) -> _Obstacle:
        if self.support is False:
            object.__setattr__(self, "support", None)
        if self.support and self.motion is not None:
            raise Wrong("it moves, so no payload can rest on it", "leave out one of support and motion")
        return self


class _Turned(_Obstacle):
    """An obstacle at `center` [m], rotated by one key of two; not rotated unless given."""

    center: Vector
    rotation_deg: Number = 0.0
    """Planar scenes only, counter-clockwise [deg]."""
    quaternion_wxyz: Quaternion = UNTURNED
    """Spatial scenes only, of unit norm."""


class BoxObstacle(_Turned):
    """A box that has the full edge lengths `size` [m]."""

    shape: Literal["box"]
    size: Sizes


class SphereObstacle(_Obstacle):
    """A circle in the plane, a sphere in space, of `radius` [m]."""

    shape: Annotated[Literal["circle", "sphere"], AfterValidator(lambda _: "sphere")]
    center: Vector
    radius: PositiveLength


class CapsuleObstacle(_Turned):
    """A segment of `length`, thickened by `radius` [m]; along local x in the plane, z in space."""

    shape: Literal["capsule"]
    radius: PositiveLength
    length: PositiveLength


class CylinderObstacle(_Obstacle):
    """A cylinder that lies along local z [m]; spatial scenes only."""

    shape: Literal["cylinder"]
    center: Vector
    radius: PositiveLength
    height: PositiveLength
    quaternion_wxyz: Quaternion = UNTURNED


class EllipsoidObstacle(_Turned):
    """An ellipse, in space an ellipsoid, of semi-axes `radii` [m]."""

    shape: Annotated[Literal["ellipsoid", "ellipse"], AfterValidator(lambda _: "ellipsoid")]
    radii: Sizes


class MeshObstacle(_Obstacle):
    """A triangle mesh from `file` in the scene's folder. For spatial scenes only.

    The origin of its frame is at `center` [m]; its lengths times `scale` are metres. `part` is the number of a mesh
    in a planning scene of MoveIt.
    """

    LATER = (*_Obstacle.LATER, "part")
    shape: Literal["mesh"]
    file: str
    part: Annotated[int, Field(ge=0)] | None = None
    center: Vector
    quaternion_wxyz: Quaternion = UNTURNED
    scale: PositiveLength = 1.0
    resolution: PositiveLength | None = None
    """About how far what stands for it may reach beyond it [m]; 3 % of its longest side unless given."""


Obstacle = Annotated[
    BoxObstacle | SphereObstacle | CapsuleObstacle | CylinderObstacle | EllipsoidObstacle | MeshObstacle,
    Field(discriminator="shape"),
]


def _three(numbers: tuple[float, ...]) -> tuple[float, ...]:
    if len(numbers) != 3:
        raise Wrong(f"{show(numbers)} has {counted(numbers, 'number')}", "write 3 (x, y, z)")
    return numbers


def _three_angles(angles: tuple[float, ...]) -> tuple[float, ...]:
    if len(angles) != 3:
        wanted = "write 3: roll, pitch and yaw, about the fixed axes x, y and z"
        raise Wrong(f"{show(angles)} has {counted(angles, 'angle')}", wanted)
    return angles


Triple = Annotated[tuple[Number, ...], BeforeValidator(as_tuple), AfterValidator(_three), Entries(3, 3)]
Angles = Annotated[tuple[Number, ...], BeforeValidator(as_tuple), AfterValidator(_three_angles)]


class Turned(Sparse):
    """An orientation in a parent frame, given by at most one key."""

    LATER = ("angle_deg", "rpy_deg", "quaternion_wxyz")
    angle_deg: Number | None = None
    """In the plane, counter-clockwise [deg]."""
    rpy_deg: Angles | None = None
    """Angles about the parent's axes x, y and z, in this order, as in URDF [deg]."""
    quaternion_wxyz: Quaternion | None = None

    @model_validator(mode="after")
    def _one_orientation(self) -> Turned:
        given = [key for key in self.orientation_keys() if getattr(self, key) is not None]
        if len(given) > 1:
            raise Wrong(f"the orientation is given by {' and '.join(given)}", "give one of them")
        return self

    @classmethod
    def orientation_keys(cls) -> tuple[str, ...]:
        """Return the keys of orientations."""
        return ("angle_deg", "rpy_deg", "quaternion_wxyz")

    @property
    def turned_by(self) -> str | None:
        """Return the key that gives the orientation, or None."""
        return next((key for key in self.orientation_keys() if getattr(self, key) is not None), None)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """Return the orientation, by default the parent's; array, shape (3, 3)."""
        if self.quaternion_wxyz is not None:
            return matrices(np.array(self.quaternion_wxyz))
        x, y, z = np.deg2rad(self.rpy_deg or (0.0, 0.0, self.angle_deg or 0.0))
        about_x = np.roll(rotation_in_plane(x), (1, 1), (0, 1))
        about_y = np.roll(rotation_in_plane(y), (-1, -1), (0, 1))
        return rotation_in_plane(z) @ about_y @ about_x


class _Part(Turned):
    """A shape of a compound payload, at `position` in its frame [m]."""

    position: Vector | None = None


class BarPart(_Part):
    """A round bar with round ends along x [m]. Its full `length` is that between the centres of the ends."""

    shape: Literal["bar"]
    length: PositiveLength
    radius: Length = 0.0


class BoxPart(_Part):
    """A box of full edge lengths `size` [m]; spatial scenes only."""

    shape: Literal["box"]
    size: Sizes


class CylinderPart(_Part):
    """A cylinder along z [m], represented by a circumscribed prism. For spatial scenes only."""

    shape: Literal["cylinder"]
    radius: PositiveLength
    height: PositiveLength


class HullPart(_Part):
    """The convex hull of `vertices` [m]; spatial scenes only. `excess` is its over-approximation error [m]."""

    shape: Literal["hull"]
    vertices: Annotated[tuple[Vector, ...], BeforeValidator(as_tuple), at_least(4, "vertices")]
    excess: Length = 0.0


PartShape = Annotated[BarPart | BoxPart | CylinderPart | HullPart, Field(discriminator="shape")]


class PayloadPose(Part):
    """The pose of a payload's frame: its origin `position` [m] and its orientation.

    In the plane the quaternion turns about z.
    """

    position: Vector
    quaternion_wxyz: Quaternion = UNTURNED


class _Load(Sparse):
    """A payload of `mass` [kg], None where the file has none. Payloads without these keys keep their checksum.

    `start` and `goal` are poses of its frame, which it may reach by turning in any way. Without them they are those
    that fit the end effectors best.
    """

    LATER = ("mass", "start", "goal")
    mass: Positive | None = None
    start: PayloadPose | None = None
    goal: PayloadPose | None = None


class BarLoad(_Load):
    """A bar of `radius` [m] between two end effectors.

    The end effectors are `length` apart [m], and it reaches `overhang` [m] beyond both.
    """

    shape: Literal["bar"]
    length: PositiveLength
    radius: Length = 0.0
    overhang: Length = 0.0
    held_by: Pair | None = None


class FrameLoad(_Load):
    """A frame of rods of `radius` [m] between end effectors. `edges` names them in pairs."""

    shape: Literal["frame"]
    edges: Annotated[tuple[Pair, ...], BeforeValidator(as_tuple), at_least(1, "pair of names")]
    radius: Length = 0.0
    held_by: Hands | None = None


class Gripped(_Load):
    """A payload with its own frame and `grasps` in it [m]."""

    grasps: dict[str, Vector] | None = None
    held_by: Hands | None = None


class PolygonLoad(Gripped):
    """A polygon of `vertices`, thickened by `radius` [m]. It is in the payload's frame, for planar scenes only."""

    shape: Literal["polygon"]
    vertices: Annotated[tuple[Vector, ...], BeforeValidator(as_tuple), at_least(3, "vertices")]
    radius: Length = 0.0


class BoxLoad(Gripped):
    """A solid box of edge lengths `size` [m], centred on its frame. In the plane it is a rectangle."""

    shape: Literal["box"]
    size: Sizes


class MeshLoad(Gripped):
    """A triangle mesh from `file` in the payload's frame.

    The file is in the scene's folder; for spatial scenes only. Its lengths times `scale` are metres; `resolution` as
    of a `MeshObstacle`.
    """

    shape: Literal["mesh"]
    file: str
    scale: PositiveLength = 1.0
    resolution: PositiveLength | None = None


class PartsLoad(Gripped):
    """A rigid body of several shapes."""

    shape: Literal["parts"]
    parts: Annotated[tuple[PartShape, ...], BeforeValidator(as_tuple), at_least(1, "part")]


Load = Annotated[
    BarLoad | FrameLoad | PolygonLoad | BoxLoad | MeshLoad | PartsLoad, Field(discriminator="shape")
]


class Manipulator(Part):
    """An end effector that moves from `start` to `goal` [m]."""

    name: Name
    start: Vector
    goal: Vector


DEFAULT_LIMITS = {"speed": 1.0, "acceleration": 1.0, "jerk": 5.0}
"""Limits of hands that a scene leaves out, where its duration is open [m/s, m/s^2, m/s^3]."""


class LimitsPart(Sparse):
    """Limits of each manipulator's motion, and the payload's clearance.

    `speed` [m/s], `acceleration` [m/s^2], `jerk` [m/s^3], `clearance` [m].

    A limit that the file leaves out does not exist; the clearance is then 5 mm with robots, else 0. Where the file
    leaves the duration out, `solve` adds default limits.
    """

    LATER = ("jerk",)
    speed: PositiveLength | None = None
    acceleration: PositiveLength | None = None
    jerk: PositiveLength | None = None
    clearance: Length | None = None


_AnyConstraint = Annotated[
    ConstraintKeys,
    GetPydanticSchema(
        lambda _, handler: handler(Annotated[reduce(or_, KINDS.values()), Field(discriminator="type")])
    ),
]


class GraspPart(Sparse):
    """The orientation of the end effectors that hold the payload.

    Either they keep their tilt, which is given in one of two ways, and turn with the payload about the vertical:
    `quaternion_wxyz` is the orientation of every grasp frame (z the approach, fingers open along y) while the
    payload's heading is 0. Or they turn in any way with a payload that has poses: `frames` are the orientations of
    grasp frames in the payload's frame, by name; of end effectors that do not hold it, in the world's.
    """

    LATER: ClassVar[tuple[str, ...]] = ("frames",)
    frames: dict[str, Quaternion] | None = None
    orientation: Literal["down", "forward"] | None = None
    quaternion_wxyz: Quaternion | None = None
    yaw: Literal["load", "free"] = "load"
    offset_deg: Annotated[
        Annotated[Number, Tag("one")] | Annotated[dict[str, Number], Tag("each")],
        Discriminator(lambda value: "each" if isinstance(value, dict) else "one"),
    ] = 0.0
    """By which hands are turned about the vertical against the load's heading; one for all, or by name [deg]."""

    @model_validator(mode="before")
    @classmethod
    def _down_unless_said(cls, data: Any) -> Any:
        given = ("orientation", "quaternion_wxyz", "frames")
        if isinstance(data, dict) and all(data.get(key) is None for key in given):
            return data | {"orientation": "down"}
        return data

    @model_validator(mode="after")
    def _one_orientation(self) -> GraspPart:
        if self.orientation is not None and self.quaternion_wxyz is not None:
            raise Wrong("both orientation and quaternion_wxyz are given", "give one of the two")
        unset = {"orientation": None, "quaternion_wxyz": None, "yaw": "load", "offset_deg": 0.0}
        turned = [key for key, value in unset.items() if getattr(self, key) != value]
        if self.frames is not None and turned:
            raise Wrong(f"both frames and {' and '.join(turned)} are given", "give frames alone")
        return self


class GraspChoice(GraspPart):
    """A grasp, or several of which one is chosen. Keys beside `any_of` do not count then."""

    LATER = ("frames", "any_of")
    any_of: Annotated[tuple[GraspPart, ...], BeforeValidator(as_tuple), at_least(1, "grasp")] | None = None


class LeastJerkObjective(Part):
    """The objective of smooth motions near the demonstration. See `comove.planning.objectives.LeastJerk`."""

    type: Literal["least_jerk"]
    resemblance: Annotated[float, Field(ge=0, le=1)] | None = None
    room: Length | None = None


class LeastTimeObjective(Part):
    """The objective of the shortest duration within the limits. A duration in the scene is ignored."""

    type: Literal["least_time"]


class PaperObjective(Part):
    """The objective of equation (4): c_goal, c_vel, c_obst, and the demonstration weight."""

    type: Literal["paper"]
    goal: NotNegative = 1.0
    velocity: NotNegative = 0.01
    obstacle: NotNegative = 10.0
    resemblance: NotNegative = 0.0


Objective = Annotated[
    LeastJerkObjective | LeastTimeObjective | PaperObjective,
    Field(discriminator="type"),
]


def _names(value: Any) -> Any:
    """Return names of columns as texts, also those written as numbers."""
    several = as_tuple([value] if isinstance(value, str | int) and not isinstance(value, bool) else value)
    if not isinstance(several, tuple):
        return several
    return tuple(str(one) if isinstance(one, int) and not isinstance(one, bool) else one for one in several)


class ReadingKeys(Sparse):
    """The keys for reading a recording, as options of `comove learn`."""

    episode: str | int | None = None
    """Name or number of a recording, where `file` holds several."""
    topic: str | None = None
    """Where `file` is a bag."""
    unit: str | None = None
    """Unit of lengths, where `file` states none."""
    columns: Annotated[tuple[str, ...], BeforeValidator(_names), at_least(1, "column")] | None = None
    """Columns of the positions in a table, by name or number, or the name of a body."""
    delimiter: str | None = None
    """Separator of the columns of a table."""
    time: str | None = None
    """Column of time, with its unit where the file does not say it."""
    rate: Positive | None = None
    """Samples a second [Hz], where there is no time."""
    dataset: str | None = None
    """Dataset of an HDF5 file."""
    feature: str | None = None
    """Vector of a LeRobot dataset."""
    drop_missing: bool | None = None
    """Whether rows of a table in which something was not measured are left out."""
    clean: bool | None = None
    """Whether the movement between the pauses is taken, without its noise."""


READING = tuple(ReadingKeys.model_fields)


class DemonstrationSource(ReadingKeys):
    """The demonstration: a `file`, a LASA shape, or a library's primitive.

    A file is a recording, or the primitive that `comove learn` made of one; of a LASA shape, `demo` is the recording.
    `library` is the primitive's name in the folder `library` beside the scene file, or FOLDER/NAME.
    """

    LATER = READING
    file: str | None = None
    lasa: str | None = None
    demo: Annotated[int, Field(ge=0, le=6)] = 0
    library: str | None = None
    plane: Literal["xy", "xz", "yz"] | None = None
    """The plane of a spatial scene in which a planar recording is laid."""
    scale: Positive | None = None
    manipulator: str | None = None

    @property
    def reading(self) -> dict[str, Any]:
        """Return the given options for reading the recording."""
        given = {key: getattr(self, key) for key in READING}
        return {key: value for key, value in given.items() if value is not None and value is not False}

    @model_validator(mode="before")
    @classmethod
    def _no_robot(cls, data: Any) -> Any:
        named = data if isinstance(data, Mapping) else {}
        if "robot" in named or "arm" in named:
            arm = f" --arm {named['arm']}" if "arm" in named else ""
            command = (
                f"comove learn {named.get('file', 'RECORDING')} --robot {named.get('robot', 'ROBOT')}{arm}"
            )
            raise Wrong(
                "a recording of joints is no path of an end effector, and a scene does not compute it",
                f"run: {command} --out taught.json, and write file: taught.json",
            )
        return data

    @model_validator(mode="after")
    def _one_source(self) -> DemonstrationSource:
        given = [name for name in ("file", "lasa", "library") if getattr(self, name) is not None]
        if len(given) != 1:
            found = f"both {' and '.join(given[:2])} are" if given else "neither file nor lasa nor library is"
            raise Wrong(f"{found} given", "give one of the three")
        if self.lasa is None and self.demo:
            raise Wrong(f"demo {self.demo} belongs to a LASA shape and none is given", "leave demo out")
        for key in ("manipulator", *READING):
            if self.file is None and getattr(self, key) is not None:
                raise Wrong(
                    f"{key} {getattr(self, key)!r} belongs to a file and none is given", f"leave {key} out"
                )
        return self


class SceneKeys(Sparse):
    """The keys that scene files of all versions share."""

    LATER: ClassVar[tuple[str, ...]] = ("objective",)
    name: Annotated[str, AfterValidator(safe_name)]
    duration: Annotated[float, Field(gt=0, le=MAX_DURATION), AfterValidator(_no_instant)] | None = None
    """[s]; left open for the shortest that limits allow."""
    workspace: Workspace
    limits: LimitsPart = LimitsPart()
    constraints: Annotated[tuple[_AnyConstraint, ...], BeforeValidator(as_tuple)] = ()
    demonstration: DemonstrationSource | None = None
    robot: Annotated[str, AfterValidator(_robot_name)] | None = None
    """A robot's name, or the path of its description relative to the scene."""
    objective: Objective | None = None
    """What the motion shall be best in, unless the command says something else."""

    @property
    def dimension(self) -> int:
        """Return 2 in the plane, 3 in space."""
        return len(self.workspace.lower)


class GraspOption(Sparse):
    """A choice of grasps [m], grasp frames, and goal.

    The goal may be `free` to turn about the vertical (`yaw`), or about an axis of the payload.
    """

    LATER = ("frames", "free")
    grasps: dict[str, Vector]
    frames: dict[str, Quaternion] | None = None
    goal: PayloadPose
    free: Literal["yaw", "x", "y", "z"] | None = None


class SceneFile(SceneKeys):
    """A scene in version 1, the form that all other modules use.

    `load_scene_file` and `parse_scene` create and cross-check it, from files of either version.
    """

    LATER = (*SceneKeys.LATER, "choices")
    version: Annotated[int, AfterValidator(_version)] = 1
    obstacles: Annotated[tuple[Obstacle, ...], BeforeValidator(as_tuple)] = ()
    load: Load | None = None
    manipulators: Annotated[
        tuple[Manipulator, ...],
        BeforeValidator(as_tuple),
        at_least(1, "manipulator"),
        at_most(MAX_MANIPULATORS, "manipulators"),
    ]
    grasp: GraspChoice | None = None
    choices: Annotated[tuple[GraspOption, ...], BeforeValidator(as_tuple)] | None = None
    """Of which the planner takes one; the load, the manipulators and the grasp are those of the first."""

    @model_validator(mode="after")
    def _fill_clearance(self) -> SceneFile:
        if self.limits.clearance is None:
            limits = self.limits.model_copy(update={"clearance": ROBOT_CLEARANCE if self.on_robot else 0.0})
            object.__setattr__(self, "limits", limits)
        return self

    @property
    def on_robot(self) -> bool:
        """Return whether the end effectors are a robot's."""
        return self.robot is not None or self.grasp is not None

    @property
    def names(self) -> tuple[str, ...]:
        """Return the manipulators' names, in their order."""
        return tuple(manipulator.name for manipulator in self.manipulators)

    @property
    def holders(self) -> tuple[str, ...]:
        """Return the end effectors of `held_by`, by default all; none without a payload."""
        if self.load is None:
            return ()
        return self.load.held_by or self.names

    @property
    def holder_numbers(self) -> tuple[int, ...]:
        """Return the holders' numbers, in the order of `holders`."""
        names = self.names
        return tuple(map(names.index, self.holders))


def by_name(union: Any, key: str) -> dict[str, type[BaseModel]]:
    """Return the models of a union by the values of their key."""
    models = get_args(get_args(union)[0])
    return {name: model for model in models for name in get_args(model.model_fields[key].annotation)}


CONTRACT = Contract(
    root=SceneFile,
    families={
        "obstacles": Family("shape", by_name(Obstacle, "shape"), 2),
        "load": Family("shape", by_name(Load, "shape"), 1),
        "constraints": Family("type", KINDS, 2),
        "objective": Family("type", by_name(Objective, "type"), 1),
    },
)
"""What messages know of the keys."""


def canonical(scene: SceneFile) -> bytes:
    """Return the scene as canonical JSON.

    Keys are sorted, defaults filled in, floats as `repr`. Comments, formatting, key order and equal spellings of a
    number (``1e-1``, ``0.1``) do not change it; :func:`parse_scene` reads it back to an equal scene.
    """
    return json.dumps(scene.model_dump(), sort_keys=True, separators=(",", ":"), allow_nan=False).encode()

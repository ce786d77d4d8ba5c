"""Scene files of version 2, with payload poses and grasps.

The models mirror the file; `converted` converts them to the contents that `SceneFile` reads, the single form used
elsewhere. A frame of the payload is given by its pose at start and goal; a grasp is the pose of an end effector's
grasp frame (z the approach, fingers open along y) in the payload's frame.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from importlib import import_module
from itertools import combinations, product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from comove.arrays import Array, listed
from comove.errors import SceneError
from comove.geometry.rotations import exponential, matrices, quaternion_of_rotation
from comove.io.keys import (
    Contract,
    Family,
    Flaw,
    KeyPath,
    Length,
    Name,
    Pair,
    Part,
    Positive,
    PositiveLength,
    Sizes,
    Vector,
    Wrong,
    as_tuple,
    at_least,
    place,
    show,
)
from comove.io.yaml_reader import Lines
from comove.model.candidates import OPENING, GraspableShape, Held, on_mesh, on_pieces
from comove.model.files.imported import ImportedObstacles
from comove.model.files.keys import (
    CONTRACT,
    ROUNDING,
    BarPart,
    BoxObstacle,
    BoxPart,
    CapsuleObstacle,
    CylinderObstacle,
    CylinderPart,
    EllipsoidObstacle,
    HullPart,
    MeshObstacle,
    PayloadPose,
    SceneKeys,
    SphereObstacle,
    Triple,
    Turned,
    by_name,
)
from comove.model.files.words import Words
from comove.model.grasp import axis_of, hands_of, nearest_turn

ENDS = ("start", "goal")
MAX_CHOICES = 64
"""Ways to hold and to put down a payload among which is chosen."""
PROPOSED = 16
"""Sets of grasps that `auto` proposes at most; every one costs the inverse kinematics of both ends."""
SAME_PLACE = 1e-3
"""Distance of two grasps up to which they collide, whatever the hands [m]."""
PARALLEL = 1e-3
"""Sine of the least angle between a grasp's approach and the direction in which its fingers close."""
ASKEW = 0.0175
"""Cosine of that angle up to which the directions count as rounded: one degree from across."""


class WorldPose(Turned):
    """A pose of the payload's frame in the world [m]."""

    position: Vector


class GoalPose(WorldPose):
    """The pose at the goal, possibly free about one axis.

    `free` is `yaw`, the vertical through the payload's frame, or an axis of symmetry of the payload.
    """

    free: Literal["yaw", "x", "y", "z"] | None = None


class _Payload(Part):
    """A rigid body of `mass` [kg], moved from `start` to `goal`."""

    mass: Positive | None = None
    start: WorldPose
    goal: GoalPose
    symmetric: Literal["x", "y", "z"] | None = None
    """Axis about which it is symmetric, so that its roll at the goal does not matter."""

    @property
    def free(self) -> Literal["yaw", "x", "y", "z"] | None:
        """Return the axis about which its goal is free."""
        return self.goal.free or self.symmetric


class BarPayload(_Payload):
    """A round bar of full `length` along x [m]. It is centred on the payload's frame."""

    shape: Literal["bar"]
    length: PositiveLength
    radius: Length = 0.0


class FramePayload(_Payload):
    """A frame of rods between end effectors [m]. `edges` names them in pairs."""

    shape: Literal["frame"]
    edges: Annotated[tuple[Pair, ...], BeforeValidator(as_tuple), at_least(1, "pair of names")]
    radius: Length = 0.0


class PolygonPayload(_Payload):
    """A polygon of `vertices` in its frame, thickened by `radius` [m]. For planar scenes only."""

    shape: Literal["polygon"]
    vertices: Annotated[tuple[Vector, ...], BeforeValidator(as_tuple), at_least(3, "vertices")]
    radius: Length = 0.0


class BoxPayload(_Payload):
    """A box of full edge lengths `size` [m]. It is centred on the payload's frame, and in the plane a rectangle."""

    shape: Literal["box"]
    size: Sizes


class CylinderPayload(_Payload):
    """A cylinder along z, centred on the payload's frame [m]. For spatial scenes only."""

    shape: Literal["cylinder"]
    radius: PositiveLength
    height: PositiveLength


class MeshPayload(_Payload):
    """A triangle mesh from `file` in the payload's frame. Its lengths times `scale` are metres."""

    shape: Literal["mesh"]
    file: str
    scale: PositiveLength = 1.0
    resolution: PositiveLength | None = None


class MeshPart(Turned):
    """A triangle mesh from `file` in a payload's frame. Its lengths times `scale` are metres."""

    shape: Literal["mesh"]
    position: Vector | None = None
    file: str
    scale: PositiveLength = 1.0
    resolution: PositiveLength | None = None


AnyPart = Annotated[BarPart | BoxPart | CylinderPart | HullPart | MeshPart, Field(discriminator="shape")]


class PartsPayload(_Payload):
    """Several shapes that form one rigid body. For spatial scenes only."""

    shape: Literal["parts"] = "parts"
    parts: Annotated[tuple[AnyPart, ...], BeforeValidator(as_tuple), at_least(1, "part")]


Payload = Annotated[
    BarPayload | FramePayload | PolygonPayload | BoxPayload | CylinderPayload | MeshPayload | PartsPayload,
    Field(discriminator="shape"),
]


class Oriented(Turned):
    """The orientation of a grasp frame. It may be given by `approach` and `closing` directions."""

    approach: Triple | None = None
    closing: Triple | None = None

    @model_validator(mode="after")
    def _both_directions(self) -> Oriented:
        if (self.approach is None) != (self.closing is None):
            lone, other = ("approach", "closing") if self.closing is None else ("closing", "approach")
            raise Wrong(f"{lone} is given without {other}", f"give {other} too, a direction across it")
        if self.approach is not None and self.closing is not None:
            z, y = np.array(self.approach), np.array(self.closing)
            if not np.linalg.norm(np.cross(z, y)) > PARALLEL * np.linalg.norm(z) * np.linalg.norm(y):
                raise Wrong(
                    f"the fingers close along {show(self.closing)}, which is the direction of the approach",
                    "give a closing direction across the approach",
                )
            across = self.rotation[:, 1]
            if abs(z @ y) > ASKEW * np.linalg.norm(z) * np.linalg.norm(y):
                raise Wrong(
                    f"the fingers close along {show(self.closing)}, which is not across the approach "
                    f"{show(self.approach)}",
                    f"write closing: {listed(across, 6)}",
                )
        return self

    @classmethod
    def orientation_keys(cls) -> tuple[str, ...]:
        """Return the keys of orientations."""
        return (*super().orientation_keys(), "approach")

    @property
    def rotation(self) -> Array:
        """Return the orientation of the grasp frame in the payload's; array, shape (3, 3)."""
        if self.approach is None or self.closing is None:
            return super().rotation
        z = np.array(self.approach) / np.linalg.norm(self.approach)
        y = np.array(self.closing) - (z @ np.array(self.closing)) * z
        y /= np.linalg.norm(y)
        return np.stack([np.cross(y, z), y, z], axis=1)


class GraspKeys(Oriented):
    """The pose of a grasp frame in the payload's frame [m]. Without a robot the position suffices."""

    position: Vector


def _kind(value: Any) -> str:
    return "auto" if isinstance(value, str) else "several" if isinstance(value, list | tuple) else "one"


Candidates = Annotated[
    Annotated[GraspKeys, Tag("one")]
    | Annotated[tuple[GraspKeys, ...], BeforeValidator(as_tuple), at_least(1, "grasp"), Tag("several")]
    | Annotated[Literal["auto"], Tag("auto")],
    Discriminator(_kind),
]
"""The grasp of one arm, several of which the planner chooses, or `auto`: some are proposed."""
GraspSet = Annotated[dict[Name, Candidates], Tag("one")]
Grasps = Annotated[
    GraspSet
    | Annotated[tuple[dict[Name, Candidates], ...], BeforeValidator(as_tuple), Tag("several")]
    | Annotated[Literal["auto"], Tag("auto")],
    Discriminator(_kind),
]
"""Grasps by the arm; or a list of such sets, of which the planner chooses one. `with_arms` replaces `auto`."""


def _by_arm(value: Any) -> Any:
    """Raise if `auto` is given for all arms without a robot."""
    if isinstance(value, str):
        raise Wrong(
            f"{show(value)} does not say which arms hold the payload",
            "write {left: auto, right: auto}, or, where the scene names a robot, auto alone",
        )
    return value


class EndEffector(Oriented):
    """An end effector without payload, moved from `start` to `goal` [m]. A robot's does not turn."""

    start: Vector
    goal: Vector


AnyObstacle = Annotated[
    BoxObstacle
    | SphereObstacle
    | CapsuleObstacle
    | CylinderObstacle
    | EllipsoidObstacle
    | MeshObstacle
    | ImportedObstacles,
    Field(discriminator="shape"),
]


class SceneFile2(SceneKeys):
    """A scene file of version 2, as written."""

    version: Literal[2]
    obstacles: Annotated[tuple[AnyObstacle, ...], BeforeValidator(as_tuple)] = ()
    payload: Payload | None = None
    grasps: Annotated[Grasps, BeforeValidator(_by_arm)] | None = None
    end_effectors: Annotated[dict[Name, EndEffector], Field(default_factory=dict)]

    @property
    def sets(self) -> tuple[dict[str, Any], ...]:
        """Return the alternative sets of grasps, none without a payload."""
        given = self.grasps
        return (given,) if isinstance(given, dict) else given if isinstance(given, tuple) else ()

    @property
    def holders(self) -> tuple[str, ...]:
        """Return the names of the end effectors that hold the payload."""
        return tuple(self.sets[0]) if self.sets else ()


def with_arms(data: Mapping[str, Any], folder: Path | None) -> Mapping[str, Any]:
    """Return a file's contents with `grasps: auto` expanded. It names all arms of the scene's robot.

    Raises
    ------
    InputError
        If the robot's description cannot be read.
    """
    robot = data.get("robot")
    if data.get("grasps") != "auto" or not isinstance(robot, str):
        return data
    described = import_module("comove.robots.description")  # a room above: most scenes need none of it
    file = described.load_description(described.find_description(robot, folder))
    return {**data, "grasps": {name: "auto" for name in file.arms}}


CONTRACT_2 = Contract(
    root=SceneFile2,
    families={
        **CONTRACT.families,
        "obstacles": Family("shape", by_name(AnyObstacle, "shape"), 2),
        "payload": Family("shape", by_name(Payload, "shape"), 1),
        "payload.parts": Family("shape", by_name(AnyPart, "shape"), 3),
    },
)
"""What messages know of the keys of version 2."""


def flaws_of(scene: SceneFile2) -> Iterator[Flaw]:
    """Yield contradictions between payload, grasps and end effectors."""
    if scene.payload is None and not scene.end_effectors:
        yield Flaw((), "nothing moves", "add payload and grasps, or end_effectors")
    if scene.payload is None and scene.grasps is not None:
        yield Flaw(("grasps",), "there is no payload to hold", "add a payload, or use end_effectors")
    if scene.payload is not None and not scene.holders:
        way_out = "say who holds it where: grasps: {left: {position: [0, 0, 0]}}, in the payload's frame"
        yield Flaw(("payload",), "nothing holds it", way_out)
    for i, given in enumerate(scene.sets):
        if set(given) != set(scene.holders):
            told = f"the set names {show([*given])}, and the first one {show([*scene.holders])}"
            yield Flaw(("grasps", i), told, "name the same arms in all sets")
    for name in scene.holders:
        if name in scene.end_effectors:
            yield Flaw(
                ("end_effectors", name),
                f"'{name}' holds the payload, whose start and goal say where it is",
                "leave it out here, or in grasps",
            )
    yield from _orientation_flaws(scene)


def _orientation_flaws(scene: SceneFile2) -> Iterator[Flaw]:
    """Yield orientations of another dimension, and missing ones of robots."""
    unfit = ("rpy_deg", "quaternion_wxyz") if scene.dimension == 2 else ("angle_deg",)
    told, instead = "the scene is spatial", "use rpy_deg"
    if scene.dimension == 2:
        told, instead = "the scene is planar", "use angle_deg"
    if scene.payload is not None:
        parts = enumerate(getattr(scene.payload, "parts", ()))
        turned = [((end,), getattr(scene.payload, end)) for end in ENDS]
        for path, pose in [*turned, *((("parts", i), part) for i, part in parts)]:
            if pose.turned_by in unfit:
                yield Flaw(("payload", *path, pose.turned_by), told, instead)
        if scene.dimension == 2 and scene.payload.goal.free not in (None, "yaw"):
            yield Flaw(("payload", "goal", "free"), "the scene is planar", "write yaw")
        if scene.dimension == 2 and scene.payload.symmetric is not None:
            yield Flaw(("payload", "symmetric"), "the scene is planar", "write free: yaw at the goal")
        if scene.payload.symmetric is not None and scene.payload.goal.free not in (
            None,
            scene.payload.symmetric,
        ):
            told = (
                f"a goal is free about one axis, and the payload is symmetric about {scene.payload.symmetric}"
            )
            yield Flaw(("payload", "goal", "free"), told, "leave one of them out")
    for name, some in ((name, some) for given in scene.sets for name, some in given.items()):
        if some == "auto" and scene.dimension == 2:
            yield Flaw(
                ("grasps", name), "grasps are proposed in space, and the scene is planar", "give a position"
            )
    some_are_turned = any(grasp.turned_by is not None for _, grasp in _grasps(scene))
    some_are_turned |= any(some == "auto" for given in scene.sets for some in given.values())
    for path, grasp in _grasps(scene):
        if scene.dimension == 2 and grasp.turned_by is not None:
            told = "end effectors are points in the plane"
            yield Flaw((*path, grasp.turned_by), told, "leave the orientation out")
        elif grasp.turned_by is None and (scene.robot is not None or some_are_turned):
            told = "other grasps have an orientation, and this one has none"
            if scene.robot is not None:
                told = f"the robot '{scene.robot}' cannot know how it is to hold the payload"
            yield Flaw(path, told, "add approach and closing, such as [0, 0, -1] and [0, 1, 0]")


def _grasps(scene: SceneFile2) -> Iterator[tuple[KeyPath, GraspKeys]]:
    for i, given in enumerate(scene.sets):
        base: KeyPath = ("grasps",) if isinstance(scene.grasps, dict) else ("grasps", i)
        for name, some in given.items():
            if isinstance(some, tuple):
                yield from (((*base, name, k), grasp) for k, grasp in enumerate(some))
            elif isinstance(some, GraspKeys):
                yield (*base, name), some


def converted(
    scene: SceneFile2, folder: Path | None, file: object, lines: Lines
) -> tuple[dict[str, Any], Words]:
    """Return the contents for `SceneFile`, and the file's key names.

    Raises
    ------
    InputError
        If the obstacles of another file cannot be read, or no grasps can be proposed.
    """
    obstacles = list[Any]()
    origin = list[int]()
    for i, obstacle in enumerate(scene.obstacles):
        own: list[Any] = [obstacle]
        if isinstance(obstacle, ImportedObstacles):
            key = place(("obstacles", i, "file"), lines) or ""
            own = obstacle.obstacles(folder or Path(), file, key)
        obstacles += own
        origin += [i] * len(own)
    hands: list[KeyPath] = [("grasps", name) for name in scene.holders]
    hands += [("end_effectors", name) for name in scene.end_effectors]
    written = (
        (path[-1] if isinstance(path[-1], str) else path[-2], path, grasp) for path, grasp in _grasps(scene)
    )
    grasps = tuple((str(name), grasp.position, path) for name, path, grasp in written)
    imported = frozenset(i for i, one in enumerate(scene.obstacles) if isinstance(one, ImportedObstacles))
    words = Words(2, lines, tuple(hands), tuple(origin), imported, grasps)
    contents: dict[str, Any] = {key: getattr(scene, key) for key in SceneKeys.model_fields}
    contents |= {"obstacles": obstacles, "manipulators": []}
    others = [{"name": name, "start": e.start, "goal": e.goal} for name, e in scene.end_effectors.items()]
    if scene.payload is None:
        return contents | {"manipulators": others}, words
    held, free = _ways_to_hold(scene, folder, words.key("load.grasps"), file), scene.payload.free
    goal = {"goal": _goal(scene.payload)} | ({"free": free} if free else {})
    choices = [how | goal for how in held]
    if len(choices) > MAX_CHOICES:
        message = f"{len(choices)} ways to hold the payload are left open"
        way_out = f"write fewer grasps: at most {MAX_CHOICES} combinations"
        raise SceneError(message, file=file, key=words.key("load.grasps"), way_out=way_out)
    first, start = choices[0], _written(scene.payload.start.position, scene.payload.start.rotation)
    parts = [*_hulls(scene.payload, folder, file, lines)]
    contents["load"] = (
        _load(scene.payload, held)
        | ({"parts": parts} if parts else {})
        | {"start": start, "goal": first["goal"]}
    )
    contents["manipulators"] = [*hands_of(start, first["goal"], first["grasps"]), *others]
    if "frames" in first:
        contents["grasp"] = {"frames": first["frames"]}
    if len(choices) > 1 or free:
        contents["choices"] = choices
    return contents, words


def _written(position: tuple[float, ...], rotation: Array) -> PayloadPose:
    quaternion = tuple(quaternion_of_rotation(rotation).tolist())
    return PayloadPose(position=position, quaternion_wxyz=quaternion)


def _goal(payload: _Payload) -> PayloadPose:
    """Return the goal pose, with a free axis the nearest."""
    rotation, free = payload.goal.rotation, payload.free
    if free is not None:
        turn = matrices(exponential(nearest_turn(payload.start.rotation, rotation, free) * axis_of(free)))
        rotation = turn @ rotation if free == "yaw" else rotation @ turn
    return _written(payload.goal.position, rotation)


def _ways_to_hold(scene: SceneFile2, folder: Path | None, key: str, file: object) -> list[dict[str, Any]]:
    """Return the open combinations of grasps.

    They are `grasps` and, where they are turned, `frames`. Those with two end effectors at one place are left out.
    """
    found, same = list[dict[str, Any]](), ("", "")
    for given in scene.sets:
        auto = [name for name, some in given.items() if some == "auto"]
        written = {
            name: [_held(one) for one in ((some,) if isinstance(some, GraspKeys) else some)]
            for name, some in given.items()
            if name not in auto
        }
        for proposed in _proposed(scene, auto, folder, key, file) if auto else [()]:
            for chosen in product(*written.values()):
                poses = dict(zip(written, chosen, strict=True)) | dict(zip(auto, proposed, strict=True))
                near = [
                    (a, b)
                    for a, b in combinations(given, 2)
                    if np.linalg.norm(np.subtract(poses[a].position, poses[b].position)) < SAME_PLACE
                ]
                if near:
                    same = near[0]
                    continue
                found.append({"grasps": {name: poses[name].position for name in given}})
                if poses[next(iter(given))].quaternion:
                    found[-1]["frames"] = {name: poses[name].quaternion for name in given}
    if not found:
        message = f"'{same[0]}' and '{same[1]}' hold the payload at the same place"
        raise SceneError(message, file=file, key=key, way_out="move one of the grasps")
    return found


def _held(grasp: GraspKeys) -> Held:
    turned = grasp.turned_by is not None
    return Held(grasp.position, tuple(quaternion_of_rotation(grasp.rotation).tolist()) if turned else ())


def _proposed(
    scene: SceneFile2, names: Sequence[str], folder: Path | None, key: str, file: object
) -> list[tuple[Held, ...]]:
    """Return grasps for the arms whose grasps are `auto`.

    Raises
    ------
    SceneError
        If no two sides of the payload are near enough to each other.
    """
    payload = scene.payload
    assert payload is not None, "files without a payload have no grasps"
    up = payload.start.rotation[2]
    if isinstance(payload, MeshPayload):
        from comove.geometry.meshes import read_mesh  # most scenes need no reader of meshes

        mesh = read_mesh((folder or Path()) / payload.file, payload.scale, file=file, key=key)
        found = on_mesh(mesh.triangles, len(names), up, PROPOSED)
    else:
        found = on_pieces([*_pieces(payload)], len(names), up, PROPOSED) if scene.dimension == 3 else []
    if not found:
        raise SceneError(
            f"no grasps of {len(names)} arms are found by which fingers that open {OPENING:g} m close on two "
            f"opposite sides of the {payload.shape}",
            file=file,
            key=key,
            way_out="give them: {left: {position: [0, 0, 0], approach: [0, 0, -1], closing: [0, 1, 0]}}",
        )
    return found


def _pieces(payload: _Payload) -> Iterator[GraspableShape]:
    """Yield the boxes and cylinders that fingers can grasp."""
    if isinstance(payload, PartsPayload):
        for part in payload.parts:
            own = _piece(part)
            if own is not None:
                center = np.array(part.position or np.zeros(3))
                yield own._replace(
                    center=part.rotation @ own.center + center, rotation=part.rotation @ own.rotation
                )
    elif (own := _piece(payload)) is not None:
        yield own


def _piece(shape: Any) -> GraspableShape | None:
    if shape.shape == "box":
        return GraspableShape(shape.size, False, np.zeros(3), np.eye(3))
    if shape.shape == "cylinder":
        return GraspableShape(
            (2 * shape.radius, 2 * shape.radius, shape.height), True, np.zeros(3), np.eye(3)
        )
    if shape.shape == "bar":
        along_x = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
        return GraspableShape((2 * shape.radius, 2 * shape.radius, shape.length), True, np.zeros(3), along_x)
    return None


def _hulls(payload: _Payload, folder: Path | None, file: object, lines: Lines) -> Iterator[Part]:
    """Yield the parts of a payload, meshes as convex hulls.

    Raises
    ------
    InputError
        If a mesh cannot be read, or has no volume.
    """
    for i, part in enumerate(payload.parts if isinstance(payload, PartsPayload) else ()):
        if not isinstance(part, MeshPart):
            yield part
            continue
        from comove.geometry.meshes import read_mesh  # most scenes need no reader of meshes

        key = place(("payload", "parts", i, "file"), lines) or ""
        mesh = read_mesh((folder or Path()) / part.file, part.scale, file=file, key=key)
        if mesh.is_flat:
            told = f"'{part.file}' has no volume: all its points are in one plane"
            raise SceneError(
                told, file=file, key=key, way_out="give it a thickness, or write a box in its place"
            )
        found = mesh.decomposed(part.resolution, few=True)
        turned = {key: getattr(part, key) for key in ("position", *part.orientation_keys())}
        for polytope in found.polytopes:
            corners = tuple(map(tuple, polytope.vertices.tolist()))
            yield HullPart(shape="hull", vertices=corners, excess=found.excess, **turned)


def _load(payload: _Payload, held: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the payload as a `SceneFile`'s, with its first grasps."""
    grasps = held[0]["grasps"]
    load = {
        key: getattr(payload, key) for key in type(payload).model_fields if key not in (*ENDS, "symmetric")
    }
    load["held_by"] = tuple(grasps)
    if isinstance(payload, FramePayload):  # whose rods are where the hands are
        return load
    load["grasps"] = grasps
    if isinstance(payload, CylinderPayload):
        own = {"shape": "cylinder", "radius": load.pop("radius"), "height": load.pop("height")}
        return load | {"shape": "parts", "parts": [own]}
    if isinstance(payload, BarPayload):
        ends = _bar_between_hands(payload, held)
        if ends is not None:
            return {key: value for key, value in load.items() if key != "grasps"} | ends
        own = {"shape": "bar", "length": load.pop("length"), "radius": load.pop("radius")}
        return load | {"shape": "parts", "parts": [own]}
    return load


def _bar_between_hands(payload: BarPayload, held: Sequence[Mapping[str, Any]]) -> dict[str, Any] | None:
    """Return a bar held symmetrically as one between two end effectors. It is None for other grasps."""
    places = {tuple(sorted((tuple(place), name) for name, place in one["grasps"].items())) for one in held}
    if len(places) > 1 or len(one := next(iter(places))) != 2:
        return None
    (first, left), (last, right) = one
    beyond = payload.length / 2 - last[0]
    if first[0] != -last[0] or any((*first[1:], *last[1:])) or beyond < -ROUNDING:
        return None
    overhang = beyond if beyond > ROUNDING else 0.0
    return {"length": 2 * last[0], "overhang": overhang, "held_by": (left, right)}

"""Reading of scene files: YAML, models, cross-checks and messages."""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic import ValidationError

from comove.errors import ComoveWarning, SceneError, near_name
from comove.io.folders import scene_folder
from comove.io.keys import (
    HAND,
    LARGE,
    UNTURNED,
    VECTOR,
    Flaw,
    KeyPath,
    counted,
    explained,
    marked,
    scene_error,
    show,
)
from comove.io.yaml_reader import MAX_NAMES, Lines, near_files, read_yaml
from comove.model.constraints.kinds import DistanceKeys, UprightKeys, distance_tolerance
from comove.model.files.keys import CONTRACT, DEFAULT_MASS, ROUNDING, BarLoad, FrameLoad, GraspPart, SceneFile
from comove.model.files.words import VERSION_1, Words

NEW, FORMER = ("payload", "grasps", "end_effectors"), ("load", "manipulators", "grasp")
"""Keys that version 2 alone has, and those of version 1 in their place."""
DATA_SETS = ("meta/info.json", "metadata.yaml")
"""What marks a folder as a recording: a LeRobot dataset, a rosbag2."""
_UNFIT = {
    (2, "obstacle", "cylinder"): ("a cylinder needs a spatial scene", "use circle or box"),
    (2, "obstacle", "mesh"): ("a mesh needs a spatial scene", "use box, circle or capsule"),
    **{
        (2, "obstacle", shape): ("it needs a spatial scene", "leave it out")
        for shape in ("moveit", "urdf", "mjcf")
    },
    (2, "load", "mesh"): ("a mesh needs a spatial scene", "use polygon in the plane"),
    (2, "load", "cylinder"): ("a cylinder needs a spatial scene", "use polygon in the plane"),
    (3, "load", "polygon"): ("a polygon needs a planar scene", "use a box or a frame in space"),
}
"""Shapes that scenes of a dimension cannot hold, with what is wrong and what to write instead."""
_AXES = {2: "planar, so write 2 numbers (x, y)", 3: "spatial, so write 3 numbers (x, y, z)"}


def cross_checked(
    scene: SceneFile, folder: Path | None, *, words: Words = VERSION_1, is_stored: bool = False
) -> list[Flaw]:
    """Return the contradictions in a scene file.

    The demonstration of a stored scene is not checked, as its motion exists already. The later checks need vectors of
    equal length and known names, so they run only where the first find nothing.
    """
    flaws = [*_dimension_flaws(scene), *_name_flaws(scene, words)]
    if flaws:
        return flaws
    return [
        *_workspace_flaws(scene),
        *_rotation_flaws(scene),
        *_motion_flaws(scene),
        *_holder_flaws(scene, words),
        *_pose_flaws(scene),
        *_grasp_flaws(scene),
        *_constraint_flaws(scene, words),
        *_objective_flaws(scene),
        *_file_flaws(scene, folder, is_stored),
    ]


def _dimension_flaws(scene: Any, body: str = "load") -> Iterator[Flaw]:
    """Yield vectors and shapes of another dimension. `body` is the payload's key."""
    planar_or_spatial = _AXES.get(scene.dimension)
    if planar_or_spatial is None:
        message = f"{show(scene.workspace.lower)} has {counted(scene.workspace.lower, 'number')}"
        yield Flaw(("workspace", "lower"), message, "write 2 (planar) or 3 (spatial)")
        return
    for path, vector in marked(scene, VECTOR):
        if len(vector) != scene.dimension:
            commas = ", with decimal points" if len(vector) == 2 * scene.dimension else ""
            message = f"{show(vector)} has {counted(vector, 'number')}"
            yield Flaw(path, message, f"the workspace is {planar_or_spatial}{commas}")
    for i, obstacle in enumerate(scene.obstacles):
        if told := _UNFIT.get((scene.dimension, "obstacle", obstacle.shape)):
            yield Flaw(("obstacles", i, "shape"), *told)
    payload = getattr(scene, body)
    if payload is not None and (told := _UNFIT.get((scene.dimension, "load", payload.shape))):
        yield Flaw((body, "shape"), *told)
    for i, part in enumerate(getattr(payload, "parts", ()) if scene.dimension == 2 else ()):
        if part.shape != "bar":
            yield Flaw((body, "parts", i, "shape"), "in the plane parts are bars", "use a polygon instead")


def _name_flaws(scene: SceneFile, words: Words) -> Iterator[Flaw]:
    repeated = list(_repeated_names("manipulator", scene.names))
    yield from repeated
    yield from _repeated_names("obstacle", [obstacle.name for obstacle in scene.obstacles])
    if repeated:
        return
    for path, name in _named(scene):
        if name not in scene.names:
            known = scene.names[:MAX_NAMES]
            yield Flaw(path, f"there is no {words.hand} {show(name)}", near_name(name, known))


def _repeated_names(what: str, names: Sequence[str | None]) -> Iterator[Flaw]:
    first: dict[str, int] = {}
    for i, name in enumerate(names):
        if name is not None and first.setdefault(name, i) != i:
            message = f"the name {show(name)} is already that of {what}s[{first[name]}]"
            yield Flaw((f"{what}s", i, "name"), message, f"give each {what} its own name")


def _named(scene: SceneFile) -> Iterator[tuple[KeyPath, str]]:
    """Yield all mentions of a manipulator's name, with their key paths."""
    yield from marked(scene, HAND)
    for name in getattr(scene.load, "grasps", None) or ():
        yield ("load", "grasps", name), name
    several = scene.grasp.any_of if scene.grasp else None
    told: list[tuple[KeyPath, GraspPart]] = [(("grasp",), scene.grasp)] if scene.grasp else []
    told += [(("grasp", "any_of", i), part) for i, part in enumerate(several or ())]
    for path, part in told:
        for name in part.offset_deg if isinstance(part.offset_deg, dict) else ():
            yield (*path, "offset_deg", name), name
        for name in part.frames or ():
            yield (*path, "frames", name), name


def _workspace_flaws(scene: SceneFile) -> Iterator[Flaw]:
    lower, upper = scene.workspace.lower, scene.workspace.upper
    for axis, low, high in zip("xyz", lower, upper, strict=False):
        if not low < high:
            yield Flaw(("workspace",), f"{axis} goes from {low} to {high}", "lower must be less than upper")
            return


def _rotation_flaws(scene: SceneFile) -> Iterator[Flaw]:
    for i, obstacle in enumerate(scene.obstacles):
        angle = getattr(obstacle, "rotation_deg", 0.0)
        if scene.dimension == 3 and angle != 0.0:
            message = f"{angle} turns about no axis, because the scene is spatial"
            yield Flaw(("obstacles", i, "rotation_deg"), message, "use quaternion_wxyz")
        quaternion = getattr(obstacle, "quaternion_wxyz", UNTURNED)
        if scene.dimension == 2 and quaternion != UNTURNED:
            message = f"{show(quaternion)} turns in space, and the scene is planar"
            yield Flaw(("obstacles", i, "quaternion_wxyz"), message, "use rotation_deg")
    plane = scene.demonstration.plane if scene.demonstration else None
    if scene.dimension == 2 and plane not in (None, "xy"):
        yield Flaw(("demonstration", "plane"), f"{plane!r} needs a spatial scene", "leave it out")


def _motion_flaws(scene: SceneFile) -> Iterator[Flaw]:
    for i, obstacle in enumerate(scene.obstacles):
        first = (obstacle.motion.waypoints or [None])[0] if obstacle.motion else None
        if first is not None and math.dist(first, obstacle.center) > ROUNDING:
            message = (
                f"the motion begins at {show(first)}, and the obstacle stands at {show(obstacle.center)}"
            )
            yield Flaw(("obstacles", i, "motion", "waypoints", 0), message, "begin at its center")
        turn = obstacle.motion.turn if obstacle.motion else None
        if turn is not None and scene.dimension == 2 and turn.axis is not None:
            message = f"{show(turn.axis)} is an axis in space, and the scene is planar"
            yield Flaw(("obstacles", i, "motion", "turn", "axis"), message, "leave it out")
        if turn is not None and scene.dimension == 3 and turn.axis is None:
            message = "in space a turn needs an axis"
            yield Flaw(("obstacles", i, "motion", "turn"), message, "add one, such as axis: [0, 0, 1]")


def _holder_flaws(scene: SceneFile, words: Words) -> Iterator[Flaw]:
    load, holders = scene.load, scene.holders
    if isinstance(load, BarLoad) and len(holders) != 2:
        message = f"a bar has two holders, and the scene has {counted(holders, 'manipulator')}"
        way_out = "add held_by: [NAME, NAME]" if len(holders) > 2 else "add a second manipulator"
        yield Flaw(("load",), message, way_out)
    if isinstance(load, FrameLoad):
        allowed = set(holders)
        for i, edge in enumerate(load.edges):
            for j, name in enumerate(edge):
                if name not in allowed:
                    message = f"{show(name)} does not hold the {words.load}"
                    way_out = (
                        f"add it to {'held_by' if words.version == 1 else 'grasps'}, or leave the edge out"
                    )
                    yield Flaw(("load", "edges", i, j), message, way_out)
    grasps = getattr(load, "grasps", None)
    if grasps is not None and set(grasps) != set(holders):
        message = f"grasps are given for {show([*grasps])}, but the load is held by {show(holders)}"
        yield Flaw(("load", "grasps"), message, "give one grasp to each holder, or correct held_by")


def _pose_flaws(scene: SceneFile) -> Iterator[Flaw]:
    poses = {} if scene.load is None else {"start": scene.load.start, "goal": scene.load.goal}
    for end, other in (("start", "goal"), ("goal", "start")):
        if poses.get(end) is not None and poses[other] is None:
            yield Flaw(
                ("load",), f"the payload's {end} is given and its {other} is not", f"add load.{other} as well"
            )
    for end, pose in poses.items():
        if scene.dimension == 2 and pose is not None and any(pose.quaternion_wxyz[1:3]):
            message = f"{show(pose.quaternion_wxyz)} turns out of the plane"
            yield Flaw(("load", end, "quaternion_wxyz"), message, "write [cos(a/2), 0, 0, sin(a/2)]")


def _grasp_flaws(scene: SceneFile) -> Iterator[Flaw]:
    if scene.grasp is None:
        return
    if scene.dimension == 2:
        yield Flaw(("grasp",), "hands hold things in space, and the scene is planar", "leave grasp out")
    elif scene.load is None:
        yield Flaw(("grasp",), "there is no load to hold", "add a load, or leave grasp out")
    else:
        for path, part in _grasp_parts(scene):
            yield from _frames_flaws(scene, path, part)


def _grasp_parts(scene: SceneFile) -> Iterator[tuple[KeyPath, GraspPart]]:
    """Yield the grasps that count, with their key paths."""
    if scene.grasp is None:
        return
    several = scene.grasp.any_of
    yield from [(("grasp",), scene.grasp)] if several is None else []
    yield from ((("grasp", "any_of", i), part) for i, part in enumerate(several or ()))


def _frames_flaws(scene: SceneFile, path: KeyPath, part: GraspPart) -> Iterator[Flaw]:
    posed = scene.load is not None and scene.load.start is not None
    if part.frames is None:
        if posed:
            message = (
                "the payload has poses, and a grasp by the line between hands turns about the vertical only"
            )
            yield Flaw(path, message, "give grasp.frames, or leave load.start and load.goal out")
    elif not posed:
        message = "grasp frames are given in the payload's frame, whose poses are not given"
        yield Flaw((*path, "frames"), message, "add load.start and load.goal")
    elif missing := [name for name in scene.names if name not in part.frames]:
        message = f"{show(missing)} {'has' if len(missing) == 1 else 'have'} no grasp frame"
        yield Flaw((*path, "frames"), message, "give one to each manipulator")


def _constraint_flaws(scene: SceneFile, words: Words) -> Iterator[Flaw]:
    """Yield repeated and contradictory constraints. An upright constraint requires a payload."""
    seen: dict[tuple[str, frozenset[str]], int] = {}
    for i, constraint in enumerate(scene.constraints):
        hands = [name for _, name in marked(constraint, HAND)]
        said = constraint.type, frozenset(hands)
        if said in seen:
            between = f" between {' and '.join(hands)}" if hands else ""
            what = f"the {constraint.type.replace('_', ' ')}{between}"
            message = f"{what} is already given by constraints[{seen[said]}]"
            yield Flaw(("constraints", i), message, "keep one of them")
        seen.setdefault(said, i)
        if isinstance(constraint, UprightKeys) and scene.load is None:
            message = f"there is no {words.load} to keep upright"
            yield Flaw(("constraints", i), message, f"add a {words.load}, or leave this one out")
        if isinstance(constraint, DistanceKeys):
            yield from _distance_flaws(scene, constraint, ("constraints", i, "distance"), words)


def _distance_flaws(
    scene: SceneFile, constraint: DistanceKeys, path: KeyPath, words: Words
) -> Iterator[Flaw]:
    """Compare a stated distance with that of the payload's grasps."""
    load = _load_distance(scene, constraint.between)
    tolerance = distance_tolerance(constraint.tolerance, constraint.distance)
    if load is not None and abs(load - constraint.distance) > tolerance + ROUNDING:
        names = " and ".join(constraint.between)
        message = f"{constraint.distance} m, but the {words.load} keeps {names} {load:.9g} m apart"
        yield Flaw(path, message, "make them equal, or leave this one out")


def _load_distance(scene: SceneFile, pair: tuple[str, ...]) -> float | None:
    """Return the distance [m] of two grasps, or None. It is None where it follows only from the start."""
    grasps = getattr(scene.load, "grasps", None) or {}
    if isinstance(scene.load, BarLoad) and set(pair) == set(scene.holders):
        return scene.load.length
    return math.dist(*(grasps[name] for name in pair)) if all(name in grasps for name in pair) else None


def _file_flaws(scene: Any, folder: Path | None, is_stored: bool) -> Iterator[Flaw]:
    named: list[tuple[KeyPath, object]] = [
        (("demonstration",), None if is_stored else scene.demonstration),
        (("load",), getattr(scene, "load", None)),
        (("payload",), getattr(scene, "payload", None)),
        *((("obstacles", i), obstacle) for i, obstacle in enumerate(scene.obstacles)),
    ]
    parts = getattr(getattr(scene, "payload", None), "parts", ())
    named += [(("payload", "parts", i), part) for i, part in enumerate(parts)]
    for path, part in named:
        name = getattr(part, "file", None)
        if name is not None and (told := _file_flaw(name, folder, part is scene.demonstration)):
            yield Flaw((*path, "file"), *told)


def _objective_flaws(scene: SceneFile) -> Iterator[Flaw]:
    if getattr(scene.objective, "resemblance", None) and scene.demonstration is None:
        yield Flaw(
            ("objective", "resemblance"),
            "there is no demonstration to resemble",
            "add a demonstration, or leave the resemblance out",
        )


def _file_flaw(name: str, folder: Path | None, several: bool) -> tuple[str, str] | None:
    """Return why a file cannot be read, with advice, or None.

    It is outside the scene's folder (links followed), or does not exist. `several` allows a folder of recordings,
    other than the scene's own.
    """
    outside = f"{show(name)} lies outside the scene's folder", "move the file into it"
    if PurePosixPath(name).is_absolute() or ".." in PurePosixPath(name).parts:
        return outside
    if folder is None:
        return None
    try:
        path = (folder / name).resolve()
        if not path.is_relative_to(folder.resolve()):
            return outside
        if not path.is_file() and not any((path / mark).is_file() for mark in DATA_SETS):
            if several and path.is_dir() and path != folder.resolve():
                return (
                    outside
                    if any(not inner.resolve().is_relative_to(path) for inner in path.iterdir())
                    else None
                )
            if path.exists():
                what = "a folder" if path.is_dir() else "not a regular file"
                return f"{show(name)} is {what}", "name a file in the scene's folder"
            way_out = near_files(folder, name, (Path(name).suffix.lower(),))
            return f"there is no file {show(name)} in the scene's folder", way_out
    except (OSError, ValueError, RuntimeError):  # name too long, a zero byte, a circle of links
        return f"{show(name)} cannot name a file", "write a path relative to the scene's folder"
    return None


def warn_of_what_is_odd(scene: SceneFile, file: str | Path | None) -> None:
    """Warn of lengths in millimetres and of fast obstacles."""
    place = f"{file}: " if file is not None else ""
    extent = max(high - low for low, high in zip(scene.workspace.lower, scene.workspace.upper, strict=True))
    if extent > LARGE:
        message = f"{place}workspace: {extent:g} m wide, which looks like millimetres; lengths are in metres"
        warnings.warn(message, ComoveWarning, stacklevel=3)
    limit = scene.limits.speed
    for i, obstacle in enumerate(scene.obstacles):
        if limit is not None and obstacle.motion is not None and obstacle.motion.speed > limit * (1 + 1e-9):
            key = obstacle.name or f"obstacles[{i}]"
            message = (
                f"{place}{key}.motion: up to {obstacle.motion.speed:.3g} m/s, faster than the hands may "
                f"move ({limit:g} m/s): they cannot get away from it"
            )
            warnings.warn(message, ComoveWarning, stacklevel=3)


def warn_of_no_mass(scene: SceneFile, file: str | Path | None, words: Words) -> None:
    """Warn of a robot's payload without a mass."""
    if scene.load is not None and scene.load.mass is None:
        place = f"{file}: " if file is not None else ""
        message = (
            f"{place}{words.key('load.mass')}: it is not given, and robots take it for {DEFAULT_MASS:g} kg"
        )
        warnings.warn(
            f"{message}; write mass: {DEFAULT_MASS:g}, or what it weighs", ComoveWarning, stacklevel=3
        )


def load_scene_file(path: str | Path, changes: Mapping[str, Any] | None = None) -> SceneFile:
    """Read and check a scene file, with `changes` to its values.

    Raises
    ------
    SceneError
        One message that names file, key, line, value and correction of the first three errors.
    """
    return read_scene_file(path, changes)[0]


def read_scene_file(path: str | Path, changes: Mapping[str, Any] | None = None) -> tuple[SceneFile, Words]:
    """Read a scene file as `load_scene_file`, with its key names."""
    try:
        data, lines = read_yaml(path)
        data = _changed(data, changes or {})
        folder = scene_folder(Path(path))
        return parsed(data, folder=folder, file=path, lines=lines, is_stored=folder != Path(path).parent)
    except SceneError:
        from comove.io.kinds import PathKind, misnamed

        if (found := misnamed(Path(path), PathKind.SCENE)) is None:
            raise
        raise SceneError(found[0], file=path, way_out=found[1]) from None


def _changed(data: Any, changes: Mapping[str, Any]) -> Any:
    """Return data with other values under some keys; mappings are merged."""
    if not isinstance(data, dict):
        return data  # which is refused in words
    merged = {k: _changed(data.get(k) or {}, v) if isinstance(v, Mapping) else v for k, v in changes.items()}
    return data | merged


def parse_scene(
    data: dict[str, Any],
    *,
    folder: str | Path | None = None,
    file: str | Path | None = None,
    lines: Lines | None = None,
    is_stored: bool = False,
) -> SceneFile:
    """Check a scene given as plain data.

    Parameters
    ----------
    data
        The contents of a scene file; arrays count as lists.
    folder
        The folder to which paths in the scene are relative; where None, files are not checked.
    file, lines
        The source of the data, for messages; `lines` as :func:`comove.io.yaml_reader.read_yaml` returns them.
    is_stored
        Whether it is the scene of a result, whose demonstration need not be there.

    Raises
    ------
    SceneError
        One message that names file, key, line, value and correction of the first three errors.
    """
    return parsed(data, folder=folder, file=file, lines=lines, is_stored=is_stored)[0]


def parsed(
    data: dict[str, Any],
    *,
    folder: str | Path | None = None,
    file: str | Path | None = None,
    lines: Lines | None = None,
    is_stored: bool = False,
) -> tuple[SceneFile, Words]:
    """Check a scene as `parse_scene`, with its key names."""
    words, place = Words(), Path(folder) if folder is not None else None
    flaws = mixed_up(data) if isinstance(data, Mapping) else []
    if not flaws and isinstance(data, Mapping) and data.get("version") == 2:
        data, words, flaws = _of_version_2(data, place, file, lines or {}, is_stored)
    if not flaws:
        try:
            scene = SceneFile.model_validate(data)
        except ValidationError as error:
            flaws = explained(error, data, CONTRACT)
        else:
            found = cross_checked(scene, place, words=words, is_stored=is_stored)
            flaws = [flaw._replace(path=words.path(flaw.path)) for flaw in found]
    if flaws:
        raise scene_error(flaws, file, lines or {})
    warn_of_what_is_odd(scene, file)
    if scene.robot is not None and not is_stored:
        warn_of_no_mass(scene, file, words)
    return scene, words


def _of_version_2(
    data: Mapping[str, Any], folder: Path | None, file: str | Path | None, lines: Lines, is_stored: bool
) -> tuple[dict[str, Any], Words, list[Flaw]]:
    """Return a version 2 file's contents for `SceneFile`, key names, and flaws."""
    from comove.model.files.version2 import (  # only these files need it
        CONTRACT_2,
        SceneFile2,
        converted,
        flaws_of,
        with_arms,
    )

    data = with_arms(data, folder)
    payload = data.get("payload")
    if isinstance(payload, dict) and "parts" in payload and "shape" not in payload:
        data = {**data, "payload": {"shape": "parts", **payload}}
    try:
        scene = SceneFile2.model_validate(data)
    except ValidationError as error:
        return {}, Words(), explained(error, data, CONTRACT_2)
    flaws = [*_dimension_flaws(scene, "payload")]
    flaws = flaws or [*flaws_of(scene), *_file_flaws(scene, folder, is_stored)]
    contents, words = ({}, Words()) if flaws else converted(scene, folder, file, lines)
    return contents, words, flaws


def mixed_up(data: Mapping[str, Any]) -> list[Flaw]:
    """Return a file's keys that belong to the other version."""
    number = data.get("version", 1)
    own, other = (NEW, FORMER) if number == 2 else (FORMER, NEW)
    foreign = [key for key in other if key in data]
    if number not in (1, 2) and foreign:
        return [Flaw(("version",), f"the version {show(number)} is not known", "write version: 2")]
    if not foreign:
        return []
    way_out = f"write version: {3 - number}"
    if number == 2:
        way_out += ", and comove scene upgrade FILE writes version 2 of it"
    if any(key in data for key in own):
        way_out = f"leave it out, and say it by {', '.join(own)}"
    return [
        Flaw((key,), f"'{key}' belongs to version {3 - number}, and the file is of version {number}", way_out)
        for key in foreign
    ]

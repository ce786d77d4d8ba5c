"""A URDF before Pinocchio takes it: found, looked at, completed by the description's limits, its names prefixed.

Pinocchio's reader leaves out what it does not understand, such as a body's shape, and says so on stderr at most; here
that is an error.
"""

from __future__ import annotations

import math
import os
import re
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from comove.errors import RobotError
from comove.robots.description import JointLimits, ModelSource, Placement

MESHES = (".dae", ".obj", ".ply", ".stl")
LIMITED = ("revolute", "prismatic")
MOVING = (*LIMITED, "continuous")
LIMITS, REQUIRED = ("lower", "upper", "velocity", "effort"), ("velocity", "effort")
MAX_BYTES, MAX_MESH_BYTES = 20_000_000, 200_000_000
MAX_DEPTH = 64  # levels of elements


@dataclass(frozen=True)
class Mimic:
    """A joint that goes along with another one: `multiplier` times its value, plus `offset` [rad or m]."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Source:
    """A model as it was read.

    Attributes
    ----------
    urdf : its text, with the description's limits and prefix
    base : where it stands
    file : the URDF
    srdf : text of the SRDF with the prefix, None where there is none
    mimics : joints that go along with others, by name
    """

    urdf: str
    base: Placement
    file: Path
    srdf: str | None = None
    mimics: Mapping[str, Mimic] = field(default_factory=dict)


def package_folders(file: Path) -> list[str]:
    """Where packages may be: beside the file, in ROS's path, in installed data."""
    folders = [str(file.parent)]
    folders += [part for part in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if part]
    try:
        import cmeel_pth
    except ImportError:
        return folders
    return [*folders, str(Path(cmeel_pth.__file__).parent / "cmeel.prefix" / "share")]


def resolve(uri: str, file: Path) -> Path:
    """The path that a URI in a description or a model means.

    ``package://NAME/`` is the package that the file itself is in, or one in a folder of packages.

    Raises
    ------
    RobotError
        If there is no such file.
    """
    tail, folders = re.sub(r"^(package|file)://", "", uri), [str(file.parent)]
    if uri.startswith("package://"):
        tail = tail.lstrip("/")
        own = [str(folder.parent) for folder in file.absolute().parents if folder.name == tail.split("/")[0]]
        folders = [*own, *package_folders(file)]
    for folder in folders:
        path = Path(folder) / tail
        try:
            if path.is_file():
                return path
        except (OSError, ValueError):  # a name that is too long, or has a zero byte
            break
    raise RobotError(
        f"there is no file '{_short(uri)}'",
        file=file,
        way_out=f"correct the path or install the package; looked in {', '.join(folders)}",
    )


def read_source(source: ModelSource, limits: Mapping[str, JointLimits], file: Path, digest: Any) -> Source:
    """Read a model and what belongs to it.

    Parameters
    ----------
    limits : of the description, by joint
    file : the description
    digest : of hashlib; takes in all that was read

    Raises
    ------
    RobotError
        If something is missing or cannot be used.
    """
    path = resolve(source.urdf, file)
    tree = _tree(path)
    _require_urdf(tree, path)
    joints = [joint for joint in tree.findall("./joint") if joint.get("name")]
    for joint in joints:
        name = source.prefix + joint.get("name", "")
        _fill_limits(joint, limits.get(name))
        _check_joint(joint, name, path)
    for shape in tree.findall("./link/collision/geometry/*"):
        _check_shape(shape, path)
        if shape.tag == "mesh":
            digest.update(_mesh(shape, path, file).read_bytes())
    srdf = None if source.srdf is None else _tree(resolve(source.srdf, file))
    _prefix(source.prefix, tree, srdf)
    for part in (tree, srdf):
        digest.update(b"" if part is None else ET.tostring(part))
    for mesh in tree.findall("./link/*/geometry/mesh"):  # what nothing but pictures need may be missing
        with suppress(RobotError):
            mesh.set("filename", f"file://{_found(mesh.get('filename', ''), path, file).resolve()}")
    mimics = {joint.get("name", ""): _mimic(mimic) for joint in joints for mimic in joint.findall("mimic")}
    texts = [None if part is None else ET.tostring(part, encoding="unicode") for part in (tree, srdf)]
    return Source(texts[0], source.base, path, texts[1], mimics)


@contextmanager
def errors_of_reader() -> Iterator[list[str]]:
    """Collect the errors that Pinocchio's reader, which is no Python, prints on the process's stderr."""
    errors: list[str] = []
    if sys.stderr is not None:
        sys.stderr.flush()
    try:
        kept = os.dup(2)
    except OSError:  # a process without stderr
        kept = os.open(os.devnull, os.O_WRONLY)
    with tempfile.TemporaryFile() as file:
        os.dup2(file.fileno(), 2)
        try:
            yield errors
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            file.seek(0)
            errors += re.findall(r"^Error:\s*(.+)$", file.read().decode(errors="replace"), re.MULTILINE)


class _Builder(ET.TreeBuilder):
    """Builds a tree that is not too deep, and takes no document type, in which entities would be defined."""

    depth = 0

    def start(self, tag: Any, attributes: Any) -> ET.Element:
        """Open an element."""
        self.depth += 1
        if self.depth > MAX_DEPTH:
            raise RobotError(f"the nesting is deeper than {MAX_DEPTH} levels", way_out="flatten it")
        return super().start(tag, attributes)

    def end(self, tag: Any) -> ET.Element:
        """Close it."""
        self.depth -= 1
        return super().end(tag)

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Refuse."""
        raise RobotError(
            "it has a document type (<!DOCTYPE>)", way_out="leave it out, and write entities out"
        )


def _tree(path: Path) -> ET.Element:
    parser = ET.XMLParser(target=_Builder())
    try:
        if path.stat().st_size > MAX_BYTES:
            raise RobotError(f"it is larger than {MAX_BYTES // 1_000_000} MB", way_out="name a model")
        parser.feed(path.read_bytes())
        return parser.close()
    except ET.ParseError as error:
        raise RobotError(f"it is not XML: {error}", file=path, way_out="correct it") from None
    except (OSError, ValueError, LookupError) as error:  # the latter two: an encoding that is not known
        raise RobotError(f"it cannot be read: {error}", file=path, way_out="check name and rights") from None
    except RobotError as error:
        raise RobotError(error.message, file=path, way_out=error.way_out) from None


def _require_urdf(tree: ET.Element, path: Path) -> None:
    if any("xacro" in element.tag for element in tree.iter()):
        raise RobotError("it is a xacro", file=path, way_out="expand it first: xacro FILE > robot.urdf")
    if tree.tag != "robot":
        raise RobotError(f"it is a <{_short(tree.tag)}>, not a <robot>", file=path, way_out="name a URDF")


def _fill_limits(joint: ET.Element, given: JointLimits | None) -> None:
    """Write the description's limits into a joint; a turning joint without limits becomes a limited one."""
    values = {} if given is None else given.model_dump(include=set(LIMITS), exclude_none=True)
    if not values:
        return
    limit = joint.find("limit")
    if limit is None:
        limit = ET.SubElement(joint, "limit")
    for key, value in values.items():
        limit.set(key, repr(value))
    if joint.get("type") == "continuous" and "lower" in values and "upper" in values:
        joint.set("type", "revolute")


def _check_joint(joint: ET.Element, name: str, path: Path) -> None:
    """Limits and axis are numbers that mean something."""
    limit, wrong = joint.find("limit"), {}
    for key in LIMITS:
        text = None if limit is None else limit.get(key)
        if text is None:
            if joint.get("type") in LIMITED and key in REQUIRED:
                wrong[key] = "is missing"
        elif _number(text) is None or (key in REQUIRED and float(text) < 0):
            wrong[key] = f"is '{_short(text)}'"
    if wrong:
        told = ", ".join(f"{key} {what}" for key, what in wrong.items())
        given = ", ".join(f"{key}: NUMBER" for key in wrong)
        raise RobotError(
            f"of the limits of the joint '{name}', {told}",
            file=path,
            way_out=f"correct it, or give it in the description: limits: {{{name}: {{{given}}}}}",
        )
    axis = joint.find("axis") if joint.get("type") in MOVING else None
    if axis is not None and not any(map(_number, axis.get("xyz", "1 0 0").split())):
        raise RobotError(f"the axis of the joint '{name}' has no direction", file=path, way_out="correct it")


def _check_shape(shape: ET.Element, path: Path) -> None:
    """Sizes are positive numbers; a mesh may be mirrored."""
    for key in ("size", "radius", "length", "scale"):
        values = [_number(text) for text in shape.get(key, "").split()]
        if any(v is None or v == 0 or (v < 0 and key != "scale") for v in values):
            raise RobotError(
                f"a <{shape.tag}> has the {key} '{_short(shape.get(key, ''))}'",
                file=path,
                way_out="write positive numbers [m]" if key != "scale" else "write numbers other than 0",
            )


def _mesh(mesh: ET.Element, path: Path, file: Path) -> Path:
    """The file of a mesh that can be read."""
    named = mesh.get("filename", "")
    if Path(named).suffix.lower() not in MESHES:
        raise RobotError(
            f"the mesh '{_short(named)}' has an unknown format",
            file=path,
            way_out=f"convert it to one of {', '.join(MESHES)}",
        )
    found = _found(named, path, file)
    if found.stat().st_size > MAX_MESH_BYTES:
        raise RobotError(
            f"the mesh is larger than {MAX_MESH_BYTES // 1_000_000} MB",
            file=found,
            way_out="simplify it: its hull will do",
        )
    return found


def _found(named: str, path: Path, file: Path) -> Path:
    """What a URDF at `path` names; packages may be where the description `file` is, too."""
    try:
        return resolve(named, path)
    except RobotError:
        if named.startswith("package://"):
            return resolve(named, file)
        raise


def _prefix(prefix: str, tree: ET.Element, srdf: ET.Element | None) -> None:
    """Write a prefix before all names of links and joints."""
    if not prefix:
        return
    named = [(element, "name") for tag in ("link", "joint") for element in tree.findall(f"./{tag}")]
    named += [(end, "link") for tag in ("parent", "child") for end in tree.findall(f"./joint/{tag}")]
    named += [(mimic, "joint") for mimic in tree.findall("./joint/mimic")]
    for key in ("link1", "link2") if srdf is not None else ():
        named += [(pair, key) for pair in srdf.iter("disable_collisions")]
    for element, key in named:
        if element.get(key):
            element.set(key, prefix + element.get(key, ""))


def _mimic(mimic: ET.Element) -> Mimic:
    multiplier, offset = (
        _number(mimic.get(key, default)) for key, default in (("multiplier", "1"), ("offset", "0"))
    )
    return Mimic(mimic.get("joint", ""), 1.0 if multiplier is None else multiplier, offset or 0.0)


def _number(text: str) -> float | None:
    """A finite number, None where the text is none."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _short(text: str) -> str:
    return text if len(text) <= 100 else f"{text[:97]}..."

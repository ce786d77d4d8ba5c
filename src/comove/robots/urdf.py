"""Reader of URDF models: finds, checks and prepares models for Pinocchio.

The description's limits and the prefix are written into the model, and floating and planar joints are fixed. Right
angles of five digits, as many URDFs have them, are rounded on request of the description: an arm of five joints
cannot compensate for axes that are slightly askew. Pinocchio's reader skips unknown elements, such as a body's shape,
and at most prints a message on stderr; here that is an error (`comove.robots.soundness`). Collision meshes are
read here, since Pinocchio's reader of meshes guesses or crashes on damaged files: Pinocchio gets checked triangles.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import sys
import tempfile
import warnings
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from comove.errors import ComoveWarning, MeshError, RobotError, shortened
from comove.geometry.triangles import FORMATS, as_stl, triangles_of
from comove.geometry.triangles import MAX_BYTES as MAX_MESH_BYTES
from comove.robots.description import JointLimits, ModelSource, Placement, RobotFile, errors_in, is_file
from comove.robots.formats import SRDF, URDF, Srdf, bytes_in, elements_in, srdf_of
from comove.robots.further_limits import FurtherLimits, doubts_of_limits, further_limits
from comove.robots.soundness import FREE, LIMITS, doubts, number, require_sound

OF_JOINT = " (joint)"  # after the name of a frame that a link has, too
# rad, of each right angle in an angle of a URDF, within which its five digits were rounded or cut
ROUNDED = 1e-5


@dataclass(frozen=True)
class Mimic:
    """A joint that follows another one: `multiplier` times its value, plus `offset` [rad or m]."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Source:
    """A model as it was read from its files.

    Attributes
    ----------
    urdf : text of the URDF, with the description's limits and prefix
    base : pose of its base in the scene
    file : path of the URDF
    srdf : contents of its SRDF
    mimics : joints that follow others, by name
    limits : limits of joints that Pinocchio does not read, by name
    free : names of floating and planar joints, which are fixed in the text
    nearly_right : whether angles of joints are right angles but for rounding, and are kept so
    meshes : collision meshes as binary STL, by their names in the URDF
    files : files of the description, the model, its SRDF and its collision meshes
    gripper_links : names of the links of grippers (`comove.robots.mounting`)
    masses : masses of links whose inertia follows from their bodies, by name [kg]
    """

    urdf: str
    base: Placement
    file: Path
    srdf: Srdf = field(default_factory=Srdf)
    mimics: Mapping[str, Mimic] = field(default_factory=dict)
    limits: Mapping[str, FurtherLimits] = field(default_factory=dict)
    free: tuple[str, ...] = ()
    nearly_right: bool = False
    meshes: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    files: tuple[Path, ...] = field(default=(), repr=False)
    gripper_links: frozenset[str] = frozenset()
    masses: Mapping[str, float] = field(default_factory=dict)


def package_folders(file: Path) -> list[str]:
    """Return the folders of packages: beside the file, in ROS's paths, in installed data."""
    folders = [str(file.parent)]
    for variable, below in (("ROS_PACKAGE_PATH", ""), ("AMENT_PREFIX_PATH", "share")):
        found = os.environ.get(variable, "").split(os.pathsep)
        folders += [str(Path(part) / below) for part in found if part]
    try:
        import cmeel_pth
    except ImportError:
        return folders
    share = Path(cmeel_pth.__file__).parent / "cmeel.prefix" / "share"
    return [
        *folders,
        str(share),
        str(share / "example-robot-data" / "robots"),
    ]  # as users write names of packages


def resolve(uri: str, file: Path) -> Path:
    """Find the file of a URI in a description or model.

    ``package://NAME/`` is the package that contains the file itself, or one in a folder of packages; the path must
    stay inside the package.

    Raises
    ------
    RobotError
        If there is no such file.
    """
    tail, folders = re.sub(r"^(package|file)://", "", uri), [str(file.parent)]
    if uri.startswith("package://"):
        tail = tail.lstrip("/")
        if os.path.normpath(tail).split("/")[0] != tail.split("/")[0] or tail.startswith("."):
            raise RobotError(
                f"'{shortened(uri)}' leads out of its package", file=file, way_out="correct the path"
            )
        own = [str(folder.parent) for folder in file.absolute().parents if folder.name == tail.split("/")[0]]
        folders = [*own, *package_folders(file)]
    for folder in folders:
        path = Path(folder) / tail
        if is_file(path):
            return path
    raise RobotError(
        f"there is no file '{shortened(uri)}'",
        file=file,
        way_out=f"correct the path or install the package; looked in {', '.join(folders)}",
    )


def read_source(
    source: ModelSource, description: RobotFile, file: Path, digest: Any, *, fixed: bool = False
) -> Source:
    """Read a model, its SRDF and its collision meshes.

    Parameters
    ----------
    description : the description that names the model, with limits of joints and poses of those that float
    file : path of the description
    digest : hash object of hashlib, updated with everything that was read
    fixed : whether floating and planar joints are rejected, as in grippers

    Raises
    ------
    RobotError
        If a file is missing or cannot be used.
    """
    path = resolve(source.urdf, file)
    with errors_in(path):
        tree = elements_in(path, URDF)
    return source_of(tree, path, source, description, file, digest, fixed=fixed)


def source_of(
    tree: ET.Element,
    path: Path,
    source: ModelSource,
    description: RobotFile,
    file: Path,
    digest: Any,
    *,
    fixed: bool = False,
) -> Source:
    """Return the model of a URDF's root element. See `read_source`, which reads it from `path`."""
    with errors_in(path):
        _prefix(source.prefix, tree)
        joints = {name: joint for joint in tree.findall("./joint") if (name := joint.get("name"))}
        for name, joint in joints.items():
            _fill_limits(joint, description.limits.get(name))
        require_sound(tree)
        limits = {
            name: further_limits(joint, name, description.limits.get(name)) for name, joint in joints.items()
        }
        drop_extensions(tree)
        notes = [*doubts_of_limits(joints, limits, description.limits), *doubts(tree)]
        free = {name: joint for name, joint in joints.items() if joint.get("type") in FREE}
        if fixed and free:
            raise RobotError(
                f"the joint '{next(iter(free))}' leaves the gripper free to move",
                way_out='write type="fixed" in it: the description says where the gripper is mounted',
            )
        for name, joint in free.items():
            notes += _fix_free(joint, name, (description.poses or {}).get(name))
    for note in notes:
        warnings.warn(f"{path}: {note}", ComoveWarning, stacklevel=2)
    if source.round_right_angles:
        for origin in tree.findall("./joint/origin[@rpy]"):
            origin.set("rpy", " ".join(map(_whole, origin.get("rpy", "").split())))
    meshes: dict[str, bytes] = {}
    files = [part for part in (file, path) if is_file(part)]
    for mesh in tree.findall("./link/collision/geometry/mesh"):
        found = _mesh(mesh, path, file)
        files.append(found)
        with errors_in(found):
            data = bytes_in(found, MAX_MESH_BYTES)
            meshes[_uri(found)] = _stl(data, found.suffix.lower())
        digest.update(data)
    srdf = Srdf()
    if source.srdf is not None:
        files.append(resolve(source.srdf, file))
        srdf = _srdf(files[-1], tree, source.prefix, digest)
    digest.update(ET.tostring(tree))
    for mesh in tree.findall("./link/*/geometry/mesh"):  # what nothing but pictures need may be missing
        with suppress(RobotError):
            mesh.set("filename", _uri(_found(mesh.get("filename", ""), path, file)))
    return Source(
        ET.tostring(tree, encoding="unicode"),
        source.base,
        path,
        srdf=srdf,
        mimics={name: _mimic(mimic) for name, joint in joints.items() for mimic in joint.findall("mimic")},
        limits=limits,
        free=tuple(free),
        nearly_right=has_rounded_right_angles(tree),
        meshes=meshes,
        files=tuple(dict.fromkeys(files)),
    )


def for_pinocchio(source: Source, folder: Path) -> str:
    """Return the URDF reduced for Pinocchio, with meshes written into a folder.

    Files are named by their contents, so that a loader that remembers files loads equal meshes once.
    """
    tree = ET.fromstring(source.urdf)
    for part in [part for part in tree if part.tag not in ("link", "joint")]:
        tree.remove(part)
    for link in tree.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for joint in tree.findall("joint"):
        for safety in joint.findall("safety_controller"):
            joint.remove(safety)
    files: dict[str, Path] = {}
    for mesh in tree.findall("./link/collision/geometry/mesh"):
        name = mesh.get("filename", "")
        if name not in files:
            files[name] = folder / f"{hashlib.sha256(source.meshes[name]).hexdigest()}.stl"
            if not files[name].exists():
                files[name].write_bytes(source.meshes[name])
        mesh.set("filename", f"file://{files[name]}")
    return ET.tostring(tree, encoding="unicode")


@contextmanager
def errors_of_reader() -> Iterator[list[str]]:
    """Collect errors that Pinocchio's C++ reader prints on stderr."""
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


def _stl(data: bytes, suffix: str) -> bytes:
    try:
        return as_stl(*triangles_of(data, suffix))
    except MeshError as error:
        raise RobotError(f"the mesh cannot be read: {error.message}", way_out=error.way_out) from None


def _uri(path: Path) -> str:
    return f"file://{path.resolve()}"


def _srdf(path: Path, urdf: ET.Element, prefix: str, digest: Any) -> Srdf:
    with errors_in(path):
        root = elements_in(path, SRDF)
        digest.update(ET.tostring(root))
        return srdf_of(root, [link.get("name", "") for link in urdf.findall("./link")], prefix)


def drop_extensions(tree: ET.Element) -> None:
    """Remove other programs' elements with a prefix, such as ``drake:proximity_properties``.

    Raises
    ------
    RobotError
        If a collision body is one of them.
    """
    for link in tree.findall("./link"):
        for body in (*link.findall("visual"), *link.findall("collision")):
            shape = next((shape.tag for shape in body.findall("geometry/*") if ":" in shape.tag), None)
            if shape is not None and body.tag == "collision":
                raise RobotError(
                    f"the link '{link.get('name', '')}' has the shape <{shape}>, which is not read",
                    way_out="write it as boxes, spheres, cylinders or a mesh",
                )
            if shape is not None:
                link.remove(body)
    for parent in list(tree.iter()):
        for child in [child for child in parent if ":" in child.tag]:
            parent.remove(child)
        for name in [name for name in parent.attrib if ":" in name or name == "xmlns"]:
            del parent.attrib[name]


def _fix_free(joint: ET.Element, name: str, pose: Placement | None) -> Iterator[str]:
    """Fix a floating or planar joint at a pose; yield a note without a given pose."""
    kind = joint.get("type", "")
    joint.set("type", "fixed")
    if pose is None:
        yield (
            f"the {kind} joint '{name}' does not move, and stays where the URDF has it; say where: "
            f"poses: {{{name}: {{position: [0, 0, 0]}}}}"
        )
        return
    origin, axis = joint.find("origin"), joint.find("axis")
    if origin is None:
        origin = ET.SubElement(joint, "origin")
    normal = np.array([1.0, 0.0, 0.0] if axis is None else _vector(axis, "xyz", "1 0 0"))
    moved = Rotation.from_quat(pose.quaternion_wxyz, scalar_first=True)
    along, turned = normal @ np.array(pose.position), np.cross(normal, moved.as_rotvec())
    if kind == "planar" and max(abs(along), np.abs(turned).max()) > 1e-6 * np.linalg.norm(normal):
        raise RobotError(
            f"the pose of the planar joint '{name}' leaves its plane, whose normal is {_listed(normal)}",
            key="poses",
            way_out="give a position in the plane, and a turn about its normal",
        )
    base = Rotation.from_euler("xyz", _vector(origin, "rpy"))
    origin.set("xyz", _listed(np.array(_vector(origin, "xyz")) + base.apply(pose.position)))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # one of several triples of angles is as good
        origin.set("rpy", _listed((base * moved).as_euler("xyz")))


def _vector(element: ET.Element, key: str, default: str = "0 0 0") -> list[float]:
    return [float(part) for part in element.get(key, default).split()]


def _listed(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)


def has_rounded_right_angles(tree: ET.Element) -> bool:
    """Return whether a URDF's joints have rounded right angles."""
    angles = [angle for origin in tree.findall("./joint/origin") for angle in origin.get("rpy", "").split()]
    return any(_whole(angle) != angle for angle in angles)


def _fill_limits(joint: ET.Element, given: JointLimits | None) -> None:
    """Write the description's limits into a joint. With limits, a continuous joint becomes a revolute one."""
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


def _whole(text: str) -> str:
    """Return an angle [rad], in full if a rounded right angle."""
    value = number(text)
    if value is None:
        return text
    count = round(2.0 * value / math.pi)
    right = 0.5 * math.pi * count
    return repr(right) if 0.0 < abs(value - right) < ROUNDED * abs(count) else text


def _mesh(mesh: ET.Element, path: Path, file: Path) -> Path:
    """Return the file of a mesh whose format can be read."""
    named = mesh.get("filename", "")
    if Path(named).suffix.lower() not in FORMATS:
        raise RobotError(
            f"the mesh '{shortened(named)}' has an unknown format",
            file=path,
            way_out=f"convert it to one of {', '.join(FORMATS)}",
        )
    return _found(named, path, file)


def _found(named: str, path: Path, file: Path) -> Path:
    """Find the file that a URDF at `path` names. Packages may also be beside the description `file`."""
    try:
        return resolve(named, path)
    except RobotError:
        if named.startswith("package://"):
            return resolve(named, file)
        raise


def _prefix(prefix: str, tree: ET.Element) -> None:
    """Write a prefix before all names of links and joints."""
    if not prefix:
        return
    named = [(element, "name") for tag in ("link", "joint") for element in tree.findall(f"./{tag}")]
    named += [(end, "link") for tag in ("parent", "child") for end in tree.findall(f"./joint/{tag}")]
    named += [(mimic, "joint") for mimic in tree.findall("./joint/mimic")]
    for element, key in named:
        if element.get(key):
            element.set(key, prefix + element.get(key, ""))


def _mimic(mimic: ET.Element) -> Mimic:
    multiplier, offset = (
        float(mimic.get(key, default)) for key, default in (("multiplier", "1"), ("offset", "0"))
    )
    return Mimic(mimic.get("joint", ""), multiplier, offset)

"""Reader of URDF models: finds, checks and prepares a model before Pinocchio builds it.

The description's limits and the prefix are written into the model. Right angles of five digits, as many URDFs have
them, are made whole: an arm of five joints cannot make up for axes that are a hair askew. Pinocchio's reader skips
what it does not understand, such as a body's shape, and at most prints a message on stderr; here that is an error
(`comove.robots.soundness`). Collision meshes are read here, since Pinocchio's reader of meshes guesses or crashes on
damaged files: Pinocchio gets checked triangles.
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

from comove.errors import ComoveWarning, MeshError, RobotError, shortened
from comove.geometry.triangles import FORMATS, as_stl, triangles_of
from comove.geometry.triangles import MAX_BYTES as MAX_MESH_BYTES
from comove.robots.description import JointLimits, ModelSource, Placement, errors_in, is_file
from comove.robots.formats import SRDF, URDF, bytes_in, elements_in
from comove.robots.soundness import LIMITS, doubts, number, require_sound

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
    srdf : text of the SRDF with the prefix, None where there is none
    mimics : joints that follow others, by name
    meshes : collision meshes as binary STL, by their names in the URDF
    files : files of the description, the model, its SRDF and its collision meshes
    """

    urdf: str
    base: Placement
    file: Path
    srdf: str | None = None
    mimics: Mapping[str, Mimic] = field(default_factory=dict)
    meshes: Mapping[str, bytes] = field(default_factory=dict, repr=False)
    files: tuple[Path, ...] = field(default=(), repr=False)


def package_folders(file: Path) -> list[str]:
    """Return the folders in which packages may be: beside the file, in ROS's path, in installed data."""
    folders = [str(file.parent)]
    folders += [part for part in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if part]
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
    """Find the file that a URI in a description or a model refers to.

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


def read_source(source: ModelSource, limits: Mapping[str, JointLimits], file: Path, digest: Any) -> Source:
    """Read a model, its SRDF and its collision meshes.

    Parameters
    ----------
    limits : limits of the description, by joint
    file : path of the description
    digest : hash object of hashlib, updated with everything that was read

    Raises
    ------
    RobotError
        If something is missing or cannot be used.
    """
    path = resolve(source.urdf, file)
    with errors_in(path):
        tree = elements_in(path, URDF)
        joints = [joint for joint in tree.findall("./joint") if joint.get("name")]
        for joint in joints:
            _fill_limits(joint, limits.get(source.prefix + joint.get("name", "")))
        require_sound(tree, source.prefix)
        for origin in tree.findall("./joint/origin[@rpy]"):
            origin.set("rpy", " ".join(map(_whole, origin.get("rpy", "").split())))
    for doubt in doubts(tree, source.prefix):
        warnings.warn(f"{path}: {doubt}", ComoveWarning, stacklevel=2)
    meshes: dict[str, bytes] = {}
    files = [part for part in (file, path) if is_file(part)]
    for mesh in tree.findall("./link/collision/geometry/mesh"):
        found = _mesh(mesh, path, file)
        files.append(found)
        with errors_in(found):
            data = bytes_in(found, MAX_MESH_BYTES)
            meshes[_uri(found)] = _stl(data, found.suffix.lower())
        digest.update(data)
    srdf = None
    if source.srdf is not None:
        files.append(resolve(source.srdf, file))
        srdf = _srdf(files[-1])
    _prefix(source.prefix, tree, srdf)
    for part in (tree, srdf):
        digest.update(b"" if part is None else ET.tostring(part))
    for mesh in tree.findall("./link/*/geometry/mesh"):  # what nothing but pictures need may be missing
        with suppress(RobotError):
            mesh.set("filename", _uri(_found(mesh.get("filename", ""), path, file)))
    mimics = {joint.get("name", ""): _mimic(mimic) for joint in joints for mimic in joint.findall("mimic")}
    told = None if srdf is None else ET.tostring(srdf, encoding="unicode")
    text = ET.tostring(tree, encoding="unicode")
    return Source(text, source.base, path, told, mimics, meshes, tuple(dict.fromkeys(files)))


def for_pinocchio(source: Source, folder: Path) -> str:
    """Return the URDF reduced to what Pinocchio needs, and write the meshes of its bodies into a folder.

    Files are named by their contents, so that a loader that remembers files loads equal meshes once.
    """
    tree = ET.fromstring(source.urdf)
    for part in [part for part in tree if part.tag not in ("link", "joint")]:
        tree.remove(part)
    for link in tree.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
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
    """Collect the errors that Pinocchio's reader, which is written in C++, prints on the process's stderr."""
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
    """Convert a mesh to binary STL."""
    try:
        return as_stl(*triangles_of(data, suffix))
    except MeshError as error:
        raise RobotError(f"the mesh cannot be read: {error.message}", way_out=error.way_out) from None


def _uri(path: Path) -> str:
    return f"file://{path.resolve()}"


def _srdf(path: Path) -> ET.Element:
    with errors_in(path):
        tree = elements_in(path, SRDF)
        for pair in tree.iter("disable_collisions"):
            if not (pair.get("link1") and pair.get("link2")):
                raise RobotError(
                    "a <disable_collisions> does not name two links", way_out='write link1="" link2=""'
                )
        return tree


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


def _whole(angle: str) -> str:
    """Return an angle [rad] in full if it is right angles, rounded or cut; otherwise as it is written."""
    value = float(angle)
    count = round(2.0 * value / math.pi)
    right = 0.5 * math.pi * count
    return repr(right) if 0.0 < abs(value - right) < ROUNDED * abs(count) else angle


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
    """Find the file that a URDF at `path` names; packages may also be beside the description `file`."""
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
    if srdf is not None:
        pairs = list(srdf.iter("disable_collisions"))
        named += [(pair, key) for key in ("link1", "link2") for pair in pairs]
    for element, key in named:
        if element.get(key):
            element.set(key, prefix + element.get(key, ""))


def _mimic(mimic: ET.Element) -> Mimic:
    multiplier, offset = (
        number(mimic.get(key, default)) for key, default in (("multiplier", "1"), ("offset", "0"))
    )
    return Mimic(mimic.get("joint", ""), 1.0 if multiplier is None else multiplier, offset or 0.0)

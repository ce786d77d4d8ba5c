"""URDF models for MuJoCo, with converted meshes and fixed unused joints."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from pathlib import Path

import numpy as np
import pinocchio as pin

from comove.arrays import Array
from comove.errors import ComoveWarning, RobotError
from comove.geometry.rotations import matrices
from comove.robots.description import Placement
from comove.robots.urdf import Source, resolve
from comove.sim.meshes import coloured_parts, convex_parts_of

COMPILER = {
    "balanceinertia": "true",
    "boundmass": "1e-9",
    "boundinertia": "1e-12",
    "discardvisual": "false",
    "fusestatic": "false",
    "strippath": "false",
}
ROOT = "the scene"  # link on which the bases stand; with a blank, as no link of a URDF is called
UNREAD = ("mimic", "safety_controller", "calibration")


def for_mujoco(
    sources: Sequence[Source], posture: Mapping[str, float], moving: Collection[str], *, drawn: bool
) -> str:
    """Write all models of a robot as one URDF for MuJoCo. Each model is on its base.

    Parameters
    ----------
    posture : values of joints that do not move [rad or m], 0 where not named
    moving : names of the joints that move
    drawn : whether to keep visual meshes
    """
    whole = ET.Element("robot", name="robot")
    ET.SubElement(ET.SubElement(whole, "mujoco"), "compiler", COMPILER)
    ET.SubElement(whole, "link", name=ROOT)
    for i, source in enumerate(sources):
        tree = ET.fromstring(source.urdf)
        whole.append(_stand(tree, source.base, i))
        for joint in tree.findall("joint"):
            for tag in UNREAD:
                for child in joint.findall(tag):
                    joint.remove(child)
            if joint.get("type") != "fixed" and joint.get("name") not in moving:
                _fix(joint, posture.get(joint.get("name", ""), 0.0))
        moved = _moved(tree)
        for link in tree.findall("link"):
            for visual in link.findall("visual"):
                link.remove(visual)
                if drawn:
                    link.extend(_drawable(visual, source.file))
            for collision in link.findall("collision"):
                link.remove(collision)
                link.extend(_solid(collision, source.file, link.get("name") in moved))
            for inertia in link.findall("inertial/inertia"):
                _make_physical(inertia)
            for number, shape in enumerate(link.findall("visual") + link.findall("collision")):
                shape.set("name", f"{link.get('name')} {number}")  # names must differ
        whole.extend(part for part in tree if part.tag in ("link", "joint", "material"))
    return ET.tostring(whole, encoding="unicode")


def _make_physical(inertia: ET.Element) -> None:
    """Raise moments of inertia that are not positive. MuJoCo refuses these; the reader of the robot warns of them."""
    least = float(COMPILER["boundinertia"])
    rows, columns = np.triu_indices(3)
    names = [f"i{'xyz'[row]}{'xyz'[column]}" for row, column in zip(rows, columns, strict=True)]
    whole = np.zeros((3, 3))
    whole[rows, columns] = whole[columns, rows] = [float(inertia.get(name, "0")) for name in names]
    moments, axes = np.linalg.eigh(whole)
    if moments.min() < least:
        physical = (axes * np.maximum(moments, least)) @ axes.T
        for name, value in zip(names, physical[rows, columns], strict=True):
            inertia.set(name, repr(float(value)))


def _stand(tree: ET.Element, base: Placement, number: int) -> ET.Element:
    """Return the joint that fixes a model to its base."""
    children = {child.get("link", "") for child in tree.findall("joint/child")}
    names = [link.get("name", "") for link in tree.findall("link")]
    root = next(name for name in names if name not in children)
    joint = ET.Element("joint", name=f"{ROOT} {number}", type="fixed")
    ET.SubElement(joint, "parent", link=ROOT)
    ET.SubElement(joint, "child", link=root)
    write_origin(joint, np.array(base.position), matrices(np.array(base.quaternion_wxyz)))
    return joint


def _moved(tree: ET.Element) -> set[str]:
    """Return the names of the links that unfixed joints move."""
    found, more = set[str](), True
    while more:
        more = False
        for joint in tree.findall("joint"):
            parent, child = (joint.find(end).get("link", "") for end in ("parent", "child"))  # type: ignore[union-attr]
            if child not in found and (joint.get("type") != "fixed" or parent in found):
                found.add(child)
                more = True
    return found


def _solid(collision: ET.Element, file: Path, moves: bool) -> list[ET.Element]:
    """Split the mesh of a collision element into convex bodies."""
    mesh = collision.find("geometry/mesh")
    if mesh is None:
        return [collision]
    x, y, z = (float(value) for value in mesh.attrib.pop("scale", "1 1 1").split())
    copies = []
    for path in convex_parts_of(resolve(mesh.get("filename", ""), file), (x, y, z), moves):
        mesh.set("filename", str(path))
        copies.append(deepcopy(collision))
    return copies


def _drawable(visual: ET.Element, file: Path) -> list[ET.Element]:
    """Split a visual element by colour; return none if unreadable."""
    mesh = visual.find("geometry/mesh")
    if mesh is None:
        return [visual]
    try:
        parts = coloured_parts(resolve(mesh.get("filename", ""), file))
    except RobotError as error:
        warnings.warn(f"a part of the robot is not drawn: {error}", ComoveWarning, stacklevel=2)
        return []
    copies = []
    for path, colour in parts:
        mesh.set("filename", str(path))
        copies.append(copy := deepcopy(visual))
        if colour is not None:
            for material in copy.findall("material"):
                copy.remove(material)
            material = ET.SubElement(copy, "material", name=f"rgba {colour}")
            ET.SubElement(material, "color", rgba=" ".join(map(str, colour)))
    return copies


def _fix(joint: ET.Element, value: float) -> None:
    """Fix a joint at a value."""
    origin = joint.find("origin")
    if origin is None:
        origin = ET.Element("origin")
    else:
        joint.remove(origin)
    position, rotation = _vector(origin, "xyz"), pin.rpy.rpyToMatrix(_vector(origin, "rpy"))
    axis = joint.find("axis")
    along = np.array([1.0, 0.0, 0.0]) if axis is None else _vector(axis, "xyz")
    along = along / np.linalg.norm(along)
    if joint.get("type") == "prismatic":
        position = position + rotation @ along * value
    elif joint.get("type") in ("revolute", "continuous"):
        rotation = rotation @ pin.exp3(along * value)
    joint.set("type", "fixed")
    write_origin(joint, position, rotation)


def write_origin(element: ET.Element, position: Array, rotation: Array) -> None:
    """Add a pose to a URDF element; shapes (3,) [m] and (3, 3)."""
    ET.SubElement(element, "origin", xyz=text_of(position), rpy=text_of(pin.rpy.matrixToRpy(rotation)))


def text_of(values: Array) -> str:
    """Return numbers as URDF text, in all digits."""
    return " ".join(map(repr, np.asarray(values, dtype=np.float64).tolist()))


def _vector(element: ET.Element, key: str) -> Array:
    return np.array([float(x) for x in element.get(key, "0 0 0").split()])

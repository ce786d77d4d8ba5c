"""Grippers: models or shapes that a description fixes to arm tips.

A gripper's links and joints become part of the URDF of its arm, by a fixed joint at the tip. Search, verification,
simulators and pictures treat them as links like others. Its joints stay at the posture of the description.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from comove.errors import RobotError, near_name
from comove.robots.description import (
    ArmDescription,
    GripperDescription,
    GripperShape,
    ModelSource,
    Placement,
    RobotFile,
    errors_in,
)
from comove.robots.formats import Srdf
from comove.robots.soundness import ends_of
from comove.robots.urdf import OF_JOINT, Source, read_source, source_of

BODY = "body"  # name of the one link of shapes
COLOUR = "0.35 0.37 0.4 1"


def with_grippers(
    sources: tuple[Source, ...], description: RobotFile, file: Path, digest: Any
) -> tuple[Source, ...]:
    """Return the models with the description's grippers fixed to their arms.

    Parameters
    ----------
    file, digest : as of `comove.robots.urdf.read_source`

    Raises
    ------
    RobotError
        If a gripper or the tip of its arm is missing, or it cannot be used.
    """
    for name, arm in description.arms.items():
        if arm.gripper is None:
            continue
        gripper = _read(name, arm.gripper, description, file, digest)
        with errors_in(file):
            sources = _attached(sources, gripper, name, arm, arm.gripper)
    return sources


def _read(name: str, gripper: GripperDescription, description: RobotFile, file: Path, digest: Any) -> Source:
    """Read the gripper of an arm as a model of its own."""
    prefix = _prefix_of(name, gripper)
    try:
        if gripper.shapes is not None:
            model, tree = ModelSource(urdf=str(file), prefix=prefix), _tree_of(gripper.shapes)
            read = source_of(tree, file, model, description, file, digest)
            read = replace(read, masses={prefix + BODY: gripper.mass or 0.0})
        else:
            model = ModelSource(urdf=gripper.urdf or "", srdf=gripper.srdf, prefix=prefix)
            read = read_source(model, description, file, digest, fixed=True)
    except RobotError as error:
        if error.file in (None, file):
            error.key = error.key or f"arms.{name}.gripper"
        raise
    return read


def _prefix_of(name: str, gripper: GripperDescription) -> str:
    return f"{name}_gripper_" if gripper.prefix is None else gripper.prefix


def _free_name(name: str, taken: Collection[str]) -> str:
    return name if name not in taken else _free_name(f"{name}_", taken)


def _tip_of(trees: Sequence[ET.Element], tip: str, key: str) -> tuple[int, str]:
    """Return the model that has a frame, by number, and its link.

    A joint's frame is that of the link which it moves.
    """
    links = []
    for number, tree in enumerate(trees):
        links += [str(link.get("name")) for link in tree.findall("link")]
        if tip in links:
            return number, tip
    for number, tree in enumerate(trees):
        for joint in tree.findall("joint"):
            if joint.get("name") == tip.removesuffix(OF_JOINT):
                return number, ends_of(joint)[1]
    raise RobotError(f"there is no frame '{tip}'", key=key, way_out=near_name(tip, links))


def _tree_of(shapes: Sequence[GripperShape]) -> ET.Element:
    """Return a URDF of one link whose bodies are the shapes."""
    robot = ET.Element("robot", name="gripper")
    link = ET.SubElement(robot, "link", name=BODY)
    for shape in shapes:
        for element, place in _geometry(shape):
            for role in ("visual", "collision"):
                part = ET.SubElement(link, role)
                _write_place(part, place)
                ET.SubElement(part, "geometry").append(ET.fromstring(ET.tostring(element)))
                if role == "visual":
                    colour = ET.SubElement(part, "material", name="gripper")
                    ET.SubElement(colour, "color", rgba=COLOUR)
    return robot


def _geometry(shape: GripperShape) -> Iterator[tuple[ET.Element, Any]]:
    """Yield the URDF elements of a shape, and their placements. A capsule has three."""
    place = pin.SE3(Placement(position=shape.center, quaternion_wxyz=shape.quaternion_wxyz).homogeneous)
    radius, length = repr(shape.radius), repr(shape.height or shape.length)
    if shape.shape == "box":
        yield ET.Element("box", size=" ".join(map(repr, shape.size or ()))), place
    elif shape.shape == "mesh":
        scale = " ".join([repr(shape.scale or 1.0)] * 3)
        yield ET.Element("mesh", filename=shape.file or "", scale=scale), place
    elif shape.shape == "sphere":
        yield ET.Element("sphere", radius=radius), place
    else:
        yield ET.Element("cylinder", radius=radius, length=length), place
    if shape.length is not None:
        for end in (-0.5 * shape.length, 0.5 * shape.length):
            yield ET.Element("sphere", radius=radius), place * pin.SE3(np.eye(3), np.array([0.0, 0.0, end]))


def _write_place(element: ET.Element, place: Any) -> None:
    """Add the place of a joint or body to its URDF element."""
    xyz, rpy = (
        " ".join(map(repr, values.tolist()))
        for values in (place.translation, pin.rpy.matrixToRpy(place.rotation))
    )
    ET.SubElement(element, "origin", xyz=xyz, rpy=rpy)


def _attached(
    sources: tuple[Source, ...], gripper: Source, name: str, arm: ArmDescription, given: GripperDescription
) -> tuple[Source, ...]:
    """Return the models with a gripper in that of its arm."""
    key, prefix = f"arms.{name}.gripper", _prefix_of(name, given)
    trees = [ET.fromstring(source.urdf) for source in sources]
    at, link = _tip_of(trees, arm.tip, f"arms.{name}.tip")
    source, tree, part = sources[at], trees[at], ET.fromstring(gripper.urdf)
    taken = {str(element.get("name")) for one in trees for element in one if element.tag in ("link", "joint")}
    own = [str(element.get("name")) for element in part if element.tag in ("link", "joint")]
    if twice := [one for one in own if one in taken]:
        raise RobotError(
            f"there is a link or joint '{twice[0]}' in the models or another gripper",
            key=f"{key}.prefix",
            way_out=f"give this gripper another prefix: prefix: {name}_{prefix}",
        )
    links = [str(element.get("name")) for element in tree.findall("link")]
    for touched in given.touch_links:
        if touched not in links:
            raise RobotError(
                f"there is no link '{touched}' in the model of the arm",
                key=f"{key}.touch_links",
                way_out=near_name(touched, links),
            )
    children = {child.get("link") for child in part.findall("joint/child")}
    hands = [str(element.get("name")) for element in part.findall("link")]
    root = next(hand for hand in hands if hand not in children)
    for material in part.iter("material"):  # the arm may have others of their names
        material.set("name", prefix + material.get("name", ""))
    joint = ET.SubElement(tree, "joint", name=_free_name(f"{prefix}mount", taken.union(own)), type="fixed")
    ET.SubElement(joint, "parent", link=link)
    ET.SubElement(joint, "child", link=root)
    _write_place(joint, pin.SE3(given.mount.homogeneous))
    tree.extend(part)
    touching = {frozenset((hand, touched)) for hand in hands for touched in given.touch_links}
    disabled = source.srdf.disabled | gripper.srdf.disabled | touching
    # The last joint's neighbours are kept apart from it too: only by mistake does a gripper touch them.
    enabled = {
        frozenset((hand, other)) for hand in hands for other in links if other not in source.gripper_links
    }
    whole = replace(
        source,
        urdf=ET.tostring(tree, encoding="unicode"),
        srdf=Srdf(
            disabled, source.srdf.enabled | (enabled - disabled), (*source.srdf.states, *gripper.srdf.states)
        ),
        mimics={**source.mimics, **gripper.mimics},
        limits={**source.limits, **gripper.limits},
        meshes={**source.meshes, **gripper.meshes},
        files=tuple(dict.fromkeys([*source.files, *gripper.files])),
        gripper_links=source.gripper_links | set(hands),
        masses={**source.masses, **gripper.masses},
    )
    return (*sources[:at], whole, *sources[at + 1 :])

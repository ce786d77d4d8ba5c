"""A URDF of a robot's surroundings, as obstacles of a scene."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.errors import RobotError, shortened
from comove.geometry.rotations import quaternion_of_rotation
from comove.model.files.keys import Turned
from comove.robots.description import errors_in
from comove.robots.formats import URDF, elements_in
from comove.robots.soundness import ends_of, require_sound
from comove.robots.urdf import drop_extensions, resolve


def obstacles_in(path: Path) -> list[dict[str, Any]]:
    """Return the collision bodies of a URDF as obstacles. Joints are at 0; `file` is the path of a mesh.

    Raises
    ------
    RobotError
        If it cannot be read, or has a body that cannot be an obstacle.
    """
    with errors_in(path):
        tree = elements_in(path, URDF)
        require_sound(tree)
        drop_extensions(tree)
        joints = [(*ends_of(joint), _origin(joint)) for joint in tree.findall("./joint")]
        parents = {child: (parent, origin) for parent, child, origin in joints}
        found = [
            _obstacle(collision, link.get("name", ""), _placed(link.get("name", ""), parents), path)
            for link in tree.findall("./link")
            for collision in link.findall("collision")
        ]
        if not found:
            raise RobotError("no link has a collision body", way_out="add <collision> to its links")
    return found


def _origin(element: ET.Element) -> Array:
    """Return the pose in an element's <origin>; array, shape (4, 4)."""
    origin, pose = element.find("origin"), np.eye(4)
    if origin is not None:
        angles = np.rad2deg([float(part) for part in origin.get("rpy", "0 0 0").split()])
        pose[:3, :3] = Turned(rpy_deg=tuple(angles.tolist())).rotation
        pose[:3, 3] = [float(part) for part in origin.get("xyz", "0 0 0").split()]
    return pose


def _placed(link: str, parents: dict[str, tuple[str, Array]]) -> Array:
    """Return the pose of a link in the frame of the model; array, shape (4, 4)."""
    pose = np.eye(4)
    while link in parents:
        link, above = parents[link]
        pose = above @ pose
    return pose


def _obstacle(collision: ET.Element, link: str, pose: Array, path: Path) -> dict[str, Any]:
    """Return a collision element of a link at `pose` as an obstacle."""
    pose = pose @ _origin(collision)
    (shape,) = collision.findall("geometry/*")
    entry: dict[str, Any] = {"name": collision.get("name") or link, "center": pose[:3, 3]}
    size = {key: float(value) for key, value in shape.items() if key in ("radius", "length")}
    if shape.tag == "box":
        entry |= {"shape": "box", "size": [float(edge) for edge in shape.get("size", "").split()]}
    elif shape.tag == "sphere":
        return entry | {"shape": "sphere", **size}
    elif shape.tag == "cylinder":
        entry |= {"shape": "cylinder", "radius": size["radius"], "height": size["length"]}
    elif shape.tag == "capsule":
        entry |= {"shape": "capsule", **size}
    elif shape.tag == "mesh":
        x, y, z = (float(part) for part in shape.get("scale", "1 1 1").split())
        if not x == y == z > 0.0:
            raise RobotError(
                f"the mesh of the link '{link}' has the scale {x:g} {y:g} {z:g}",
                way_out="scale the mesh itself, so that one number above 0 will do",
            )
        entry |= {"shape": "mesh", "file": resolve(shape.get("filename", ""), path), "scale": x}
    else:
        raise RobotError(
            f"the link '{link}' has the shape <{shortened(shape.tag)}>, and no obstacle has",
            way_out="write it as boxes, spheres, cylinders or a mesh",
        )
    return entry | {"quaternion_wxyz": quaternion_of_rotation(pose[:3, :3]).tolist()}

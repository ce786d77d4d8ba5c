"""Robots as drawn by a page: visible bodies and joint poses.

The meshes of a URDF have far more triangles than a page needs. Corners within one cell of a lattice are merged, and
the cells grow until the whole robot has few enough triangles.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import ComoveError, ExtraError, MeshError, RobotError
from comove.geometry.triangles import triangles_of
from comove.model.scene import Scene
from comove.view.figures.shapes import hull_faces
from comove.view.workbench.geometry import AROUND, Surface, ball, colour_of, rod

if TYPE_CHECKING:
    from comove.robots import Robot

Colour = tuple[int, int, int]

PLAIN = colour_of("#b4b9c1")  # of what a URDF gives no colour


@dataclass(frozen=True, eq=False)
class LinkSurface:
    """Surface of all bodies of one joint and colour.

    Attributes
    ----------
    joint : number of the joint in the robot's order, from 0; -1 for the static ones
    colour : red, green, blue, from 0 to 255
    surface : its triangles in the frame of the joint, or of the scene
    """

    joint: int
    colour: Colour
    surface: Surface


def robot_of(scene: Scene) -> Robot | None:
    """Return the robot that a scene names; None without one.

    Raises
    ------
    ExtraError
        If robots are not installed.
    RobotError
        If there is no such robot.
    """
    if scene.file.robot is None:
        return None
    try:
        from comove.robots import Robot
    except ExtraError:
        raise ExtraError(f"to show the robot '{scene.file.robot}'", "robot") from None
    return Robot.load(scene.file.robot, scene.folder)


def bodies_of(
    robot: Robot, *, most_triangles: int = 60_000, cell: float = 0.003, growth: float = 1.3
) -> tuple[LinkSurface, ...]:
    """Return the simplified visible bodies of a robot's links. Unreadable ones are left out.

    Parameters
    ----------
    most_triangles : triangles of the whole robot
    cell : initial side of the cells in which corners are merged [m]
    growth : factor by which cells grow while there are too many triangles
    """
    parts: dict[tuple[int, Colour], list[Array]] = {}
    for joint, colour, triangles in _visible(robot):
        parts.setdefault((joint, colour), []).append(triangles)
    simple = {key: Surface.of(np.concatenate(found)) for key, found in parts.items()}
    many = True
    while many:
        simple = {key: simplified(surface, cell) for key, surface in simple.items()}
        many = sum(len(surface.faces) for surface in simple.values()) > most_triangles
        cell *= growth
    return tuple(LinkSurface(*key, surface) for key, surface in simple.items() if len(surface.faces))


def poses_of(robot: Robot, position: Array) -> Array:
    """Compute the poses of a robot's joints in the scene.

    Parameters
    ----------
    position : array, shape (n_steps, n_joints), joint positions [rad, m for prismatic joints]

    Returns
    -------
    array, shape (n_steps, n_joints, 7), position x y z [m] and orientation w x y z
    """
    import pinocchio as pin

    data = robot.model.createData()
    poses = np.empty((*position.shape, 7))
    for step, q in enumerate(np.asarray(position, dtype=float)):
        pin.forwardKinematics(robot.model, data, q)
        for joint in range(position.shape[1]):
            poses[step, joint] = pin.SE3ToXYZQUAT(data.oMi[joint + 1])[[0, 1, 2, 6, 3, 4, 5]]
    return poses


def simplified(surface: Surface, cell: float) -> Surface:
    """Merge all corners of a surface within each cell of a lattice. A merged corner is at their mean.

    Parameters
    ----------
    cell : side of the cells [m]
    """
    lattice = np.floor(surface.vertices / cell).astype(np.int64)
    _, place, count = np.unique(_keys(lattice), return_inverse=True, return_counts=True)
    middle = np.stack([np.bincount(place, axis) for axis in surface.vertices.T], axis=1) / count[:, None]
    faces = place[surface.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    faces = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    _, first = np.unique(_keys(faces), return_index=True)
    used, faces = np.unique(faces[first], return_inverse=True)
    return Surface(middle[used], faces.reshape(-1, 3))


def _keys(rows: Integers) -> Integers:
    if not len(rows):
        return np.zeros(0, dtype=np.int64)
    rows = rows - rows.min(axis=0)
    _, high, highest = rows.max(axis=0) + 1
    return (rows[:, 0] * high + rows[:, 1]) * highest + rows[:, 2]


def _visible(robot: Robot) -> Iterator[tuple[int, Colour, Array]]:
    """Yield joint, colour and triangles of a robot's visible bodies. Triangles are in the joint's frame."""
    import pinocchio as pin

    for source in robot.sources:
        tree = ET.fromstring(source.urdf)
        materials = {m.get("name"): m for m in tree.findall("material")}
        for link in tree.findall("link"):
            frame = robot.model.frames[robot.model.getFrameId(link.get("name", ""), pin.FrameType.BODY)]
            for visual in link.findall("visual") or link.findall("collision"):
                placement = frame.placement * _origin(visual.find("origin"))
                for triangles, colour in _triangles(visual.find("geometry"), source.file):
                    turned = triangles @ placement.rotation.T + placement.translation
                    yield frame.parentJoint - 1, colour or _material(visual, materials), turned


def _origin(origin: ET.Element | None) -> Any:
    import pinocchio as pin

    if origin is None:
        return pin.SE3.Identity()
    place, turn = (_numbers(origin.get(key, "0 0 0")) for key in ("xyz", "rpy"))
    return pin.SE3(pin.rpy.rpyToMatrix(turn), place)


def _numbers(text: str) -> Array:
    return np.array([float(part) for part in text.split()])


def _material(visual: ET.Element, materials: Mapping[str | None, ET.Element]) -> Colour:
    """Return the colour of a URDF's visual body."""
    own = visual.find("material")
    named = None if own is None else materials.get(own.get("name"))
    for material in (own, named):
        colour = None if material is None else material.find("color")
        if colour is not None:
            return _bytes(_numbers(colour.get("rgba", "0.7 0.7 0.7 1")))
    return PLAIN


def _bytes(colour: Iterable[float]) -> Colour:
    red, green, blue = (round(255 * min(max(part, 0.0), 1.0)) for part in list(colour)[:3])
    return red, green, blue


def _triangles(geometry: ET.Element | None, file: Path) -> Iterator[tuple[Array, Colour | None]]:
    """Yield triangles of a geometry in its own frame, with colours. Arrays, shape (n, 3, 3) [m]."""
    shape = None if geometry is None else next(iter(geometry), None)
    if shape is None:
        return
    if shape.tag == "mesh":
        scale = _numbers(shape.get("scale", "1 1 1"))
        for triangles, colour in _mesh(shape.get("filename", ""), file):
            yield triangles * scale, colour
    elif shape.tag == "box":
        corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
        yield hull_faces(0.5 * corners * _numbers(shape.get("size", "0 0 0"))), None
    elif shape.tag == "sphere":
        surface = ball(float(shape.get("radius", 0)))
        yield surface.vertices[surface.faces], None
    elif shape.tag == "cylinder":
        radius, length = float(shape.get("radius", 0)), float(shape.get("length", 0))
        angle = np.linspace(0.0, 2 * np.pi, AROUND, endpoint=False)
        ring = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle], axis=1)
        yield hull_faces(np.concatenate([ring + [0, 0, z] for z in (-0.5 * length, 0.5 * length)])), None
    elif shape.tag == "capsule":
        surface = rod(float(shape.get("length", 0)), float(shape.get("radius", 0)))
        yield surface.vertices[surface.faces], None


def _mesh(named: str, file: Path) -> Iterator[tuple[Array, Colour | None]]:
    """Yield a mesh by colour, in one piece if colours are unreadable."""
    from comove.robots.urdf import resolve
    from comove.sim.meshes import as_obj, coloured_parts

    try:
        path = resolve(named, file)
        try:
            parts = coloured_parts(path)
        except ComoveError:
            parts = [(as_obj(path), None)]
        for part, colour in parts:
            yield _corners(part), None if colour is None else _bytes(colour)
    except (RobotError, MeshError, OSError):  # pictures need not be whole
        return


@lru_cache(maxsize=64)
def _corners(part: Path) -> Array:
    """Return a mesh part's triangles, shape (n, 3, 3) [m]. They are cached, since equal arms share their meshes."""
    vertices, faces = triangles_of(part.read_bytes(), part.suffix)
    return vertices[faces]

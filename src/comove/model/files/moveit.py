"""Planning scenes of MoveIt: the text format (.scene), and messages in bags of ROS 2.

Both readers return a `PlanningScene`, whose objects become obstacles here. Positions are in metres, orientations
rotation matrices, together homogeneous matrices.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import SceneError, listed, shortened
from comove.geometry.meshes import MAX_FACES
from comove.geometry.rotations import matrices, quaternion_of_rotation
from comove.io.files import telling
from comove.io.keys import QUATERNION_TOLERANCE

Triangles = tuple[Array, Integers]
"""Vertices of a mesh [m], and three of them for each triangle."""

FLOOR, THICK = 10.0, 0.1
"""Half the width of a plane, and its thickness as a box [m]."""
OCTOMAP = "<octomap>"
"""Name of the object that stands for the octomap, as in MoveIt."""
N_SIZES = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2, "plane": 4}
"""Numbers that give a shape's size, in the order of the text format: of cylinders and cones radius, length."""
BAGS = (".mcap", ".db3", ".bag")
MARK = "metadata.yaml"
"""What marks a folder as a bag."""


class PlacedShape(NamedTuple):
    """A shape at a pose in its object's frame. `where` is its place in the file, for messages."""

    kind: str
    sizes: Array
    pose: Array
    where: str
    mesh: Triangles | None = None


class CollisionObject(NamedTuple):
    """An object at a pose in a `frame`; an empty name is that of the planning frame."""

    name: str
    pose: Array
    shapes: tuple[PlacedShape, ...]
    frame: str = ""


class AttachedObject(NamedTuple):
    """An object that moves with a `link`, and may touch others; `mass` is 0 if it is unknown [kg]."""

    object: CollisionObject
    link: str
    touch_links: tuple[str, ...] = ()
    mass: float = 0.0


@dataclass(frozen=True)
class PlanningScene:
    """A planning scene.

    Attributes
    ----------
    objects : objects in the world
    frame : name of the planning frame; empty if it is unknown
    transforms : poses of other frames in the planning frame, by name
    joints : joint positions of the robot, by name [rad, m]
    attached : objects attached to the robot
    allowed : pairs of links or objects that may touch; one name alone may touch all others
    compared : names of the allowed collision matrix, whose other pairs may not touch
    padded : links that are padded or scaled
    """

    objects: tuple[CollisionObject, ...] = ()
    frame: str = ""
    transforms: Mapping[str, Array] = field(default_factory=dict)
    joints: Mapping[str, float] = field(default_factory=dict)
    attached: tuple[AttachedObject, ...] = ()
    allowed: frozenset[frozenset[str]] = frozenset()
    compared: frozenset[str] = frozenset()
    padded: frozenset[str] = frozenset()

    def pose_of(self, one: CollisionObject) -> Array:
        """Return the pose of an object in the planning frame; array, shape (4, 4).

        Raises
        ------
        SceneError
            If its frame is not known.
        """
        if one.frame in ("", self.frame):
            return one.pose
        if one.frame in self.transforms:
            return self.transforms[one.frame] @ one.pose
        known = listed([repr(name) for name in (self.frame, *self.transforms) if name], 8) or "none"
        raise SceneError(
            f"the object '{shortened(one.name)}' is in the frame '{shortened(one.frame)}', whose place in the "
            f"scene is not given (frames known: {known})",
            way_out=f"add it to fixed_frame_transforms, or {leaving_out(one.name)}",
        )


def leaving_out(name: str) -> str:
    """Return the advice to leave an object out."""
    return f"leave it out: leave_out: [{shortened(name)!r}]"


def planning_scene_in(path: Path) -> PlanningScene:
    """Read a planning scene: a bag of ROS 2 (folder, .mcap, .db3), or the text format.

    Raises
    ------
    InputError
        If it cannot be read, or is a bag without a planning scene.
    """
    with telling(path, error=SceneError):
        files = sorted(path.iterdir()) if path.is_dir() else [path]
        stats = [file.stat() for file in files if file.exists()]
    return _read(
        path, tuple((stat.st_ino, stat.st_mtime_ns, stat.st_ctime_ns, stat.st_size) for stat in stats)
    )


@lru_cache(maxsize=2)  # asked for again by every mesh in it
def _read(path: Path, _: tuple[tuple[int, ...], ...]) -> PlanningScene:
    if path.suffix.lower() in BAGS or (path / MARK).is_file():
        from comove.model.files import moveit_bags  # most scenes need none of them

        return moveit_bags.read(path)
    from comove.model.files import moveit_text

    return moveit_text.read(path)


def obstacles_in(path: Path) -> list[dict[str, Any]]:
    """Return the objects of a planning scene as obstacles.

    Meshes are given by their number in the file, `part`. An entry `refused` is the error of a shape that no obstacle
    can have, or of an object in an unknown frame.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    scene, found, part = planning_scene_in(path), list[dict[str, Any]](), 0
    for one in scene.objects:
        for shape in one.shapes:
            entry: dict[str, Any] = {"name": one.name}
            if shape.mesh is not None:
                entry["part"], part = part, part + 1
            try:
                found.append(entry | obstacle_of(one.name, shape, scene.pose_of(one)))
            except SceneError as error:
                found.append(entry | {"refused": error})
    return found


def mesh_in(path: Path, part: int) -> bytes:
    """Return a planning scene's mesh `part` in the format OFF.

    Raises
    ------
    SceneError
        If there is no such mesh.
    """
    scene = planning_scene_in(path)
    meshes = [shape.mesh for one in scene.objects for shape in one.shapes if shape.mesh is not None]
    if part >= len(meshes):
        raise SceneError(f"it has {len(meshes)} meshes", file=path, way_out=f"name one below {len(meshes)}")
    return as_off(meshes[part])


def as_off(mesh: Triangles) -> bytes:
    """Return a mesh in the format OFF."""
    vertices, faces = mesh
    rows = [f"OFF\n{len(vertices)} {len(faces)} 0"]
    rows += [" ".join(map(repr, vertex)) for vertex in vertices.tolist()]
    rows += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    return "\n".join(rows).encode()


def obstacle_of(name: str, shape: PlacedShape, pose: Array) -> dict[str, Any]:
    """Return a shape of an object at `pose` as an obstacle.

    Parameters
    ----------
    name : name of the object, for messages
    pose : array, shape (4, 4), pose of the object

    Raises
    ------
    SceneError
        If no obstacle has the shape; it names its place in the file.
    """
    pose = pose @ shape.pose
    if shape.kind == "plane":
        pose, shape = _slab(name, shape, pose)
    if shape.mesh is not None and (fault := fault_of_mesh(*map(len, shape.mesh))) is not None:
        raise SceneError(fault[0], key=shape.where, way_out=f"{fault[1]}, or {leaving_out(name)}")
    keys = {"box": ("size",), "sphere": ("radius",), "cylinder": ("radius", "height"), "mesh": ()}.get(
        shape.kind
    )
    if keys is None:
        told = f"no obstacle has the shape {shortened(shape.kind)!r}"
        way_out = f"write it as a box, a cylinder, a sphere or a mesh, or {leaving_out(name)}"
        if shape.kind == "octomap":
            told, way_out = (
                "its octomap is not read",
                leaving_out(OCTOMAP) + ", and add what is in it as boxes",
            )
        raise SceneError(told, key=shape.where, way_out=way_out)
    sizes = [shape.sizes.tolist()] if shape.kind == "box" else shape.sizes.tolist()
    entry = {"shape": shape.kind, **dict(zip(keys, sizes, strict=False)), "center": pose[:3, 3]}
    if shape.kind != "sphere":
        entry["quaternion_wxyz"] = quaternion_of_rotation(pose[:3, :3]).tolist()
    return entry


def _slab(name: str, shape: PlacedShape, pose: Array) -> tuple[Array, PlacedShape]:
    """Return a plane as a box and its pose. It is solid below its points, n x + d = 0."""
    n, d = shape.sizes[:3], float(shape.sizes[3])
    size = float(np.linalg.norm(n))
    if not size > 0.0:
        raise SceneError(
            "the plane has no normal", key=shape.where, way_out=f"correct it, or {leaving_out(name)}"
        )
    n = n / size
    x = np.cross(n, np.eye(3)[np.abs(n).argmin()])
    x /= np.linalg.norm(x)
    own = np.eye(4)
    own[:3, :3] = np.stack([x, np.cross(n, x), n], axis=1)
    own[:3, 3] = -(d / size + 0.5 * THICK) * n
    return pose @ own, shape._replace(kind="box", sizes=np.array([2 * FLOOR, 2 * FLOOR, THICK]))


def homogeneous(position: Array, quaternion_xyzw: Array) -> Array | None:
    """Return a pose, shape (4, 4). It is None for a quaternion far from the norm 1."""
    norm = float(np.linalg.norm(quaternion_xyzw))
    if not abs(norm - 1.0) <= QUATERNION_TOLERANCE:
        return None
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = matrices(np.roll(quaternion_xyzw, 1) / norm), position
    return pose


def fault_of_mesh(n_vertices: int, n_faces: int) -> tuple[str, str] | None:
    """Return why a mesh is too large, with advice, or None."""
    if n_faces <= MAX_FACES and n_vertices <= 3 * MAX_FACES:
        return None
    told = f"the mesh has {n_faces} triangles and {n_vertices} vertices"
    return told, f"decimate it to {MAX_FACES} triangles or fewer"


def fault_of_triangles(n_vertices: int, faces: Integers) -> str | None:
    """Return why the triangles of a mesh are none, or None."""
    if len(faces) and faces.min() >= 0 and faces.max() < n_vertices:
        return None
    return f"the mesh of {n_vertices} vertices has triangles of others, or none"

"""Planning scenes in MoveIt's text format (.scene).

RViz and `PlanningScene::saveGeometryToStream` write them. After the scene's name each object begins with ``* NAME``,
and a point ends the file. Since MoveIt 1.1 an object has a pose of its own, to which those of its shapes are
relative, and subframes after its shapes; a blank in the line after the first name distinguishes the formats, as in
MoveIt. Quaternions are x, y, z, w.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import SceneError, shortened
from comove.geometry.rotations import matrices, quaternion_of_rotation
from comove.io.files import existing_file
from comove.io.keys import QUATERNION_TOLERANCE

Triangles = tuple[Array, Integers]
"""Vertices of a mesh [m], and three of them for each triangle."""

MAX_BYTES = 100_000_000
FLOOR, THICK = 10.0, 0.1
"""Half the width of a plane, and its thickness as a box [m]."""
SAYS = "write it again by MoveIt, or correct it"


class _Words:
    """The words of a file, one after the other, with their lines."""

    def __init__(self, path: Path):
        self.path = existing_file(path, MAX_BYTES, "leave objects out", SceneError)
        self.lines = self.path.read_text(encoding="utf-8", errors="replace").splitlines()
        self.number, self.rest = 0, list[str]()

    def error(self, message: str, way_out: str = SAYS) -> SceneError:
        """Return an error in the line that is read."""
        return SceneError(message, file=self.path, key=f"line {self.number}", way_out=way_out)

    def line(self) -> str:
        """Return the rest of the line."""
        said, self.rest = " ".join(self.rest), []
        return said

    def word(self) -> str:
        """Return the next word."""
        while not self.rest:
            if self.number >= len(self.lines):
                raise self.error("the file ends before its last point, '.'")
            self.number += 1
            self.rest = self.lines[self.number - 1].split()
        return self.rest.pop(0)

    def count(self, most: int) -> int:
        """Return the next whole number."""
        word = self.word()
        if not word.isdigit() or int(word) > most:
            raise self.error(f"{shortened(word)!r} is no whole number up to {most}")
        return int(word)

    def numbers(self, n: int) -> Array:
        """Return the next numbers; array, shape (n,)."""
        words = [self.word() for _ in range(n)]
        try:
            found = np.array([float(word) for word in words])
        except ValueError:
            raise self.error(f"{shortened(' '.join(words))!r} are not {n} numbers") from None
        if not np.isfinite(found).all():
            raise self.error(f"{shortened(' '.join(words))!r} are not finite")
        return found

    def pose(self) -> tuple[Array, Array]:
        """Return the next pose: position [m] and rotation matrix."""
        position, quaternion = self.numbers(3), np.roll(self.numbers(4), 1)
        norm = float(np.linalg.norm(quaternion))
        if abs(norm - 1.0) > QUATERNION_TOLERANCE:
            raise self.error(f"the quaternion has the norm {norm:.6g}", "write a unit quaternion, w last")
        return position, matrices(quaternion / norm)


def obstacles_in(path: Path) -> list[dict[str, Any]]:
    """Return the objects of a planning scene as obstacles. Meshes are given by their number in the file, `part`.

    Raises
    ------
    SceneError
        If the file cannot be read, or has a shape that no obstacle has; it names the line.
    """
    return [entry for entry, _ in _objects(path)]


def mesh_in(path: Path, part: int) -> bytes:
    """Return a planning scene's mesh `part` in the format OFF.

    Raises
    ------
    SceneError
        If there is no such mesh.
    """
    meshes = [mesh for _, mesh in _objects(path) if mesh is not None]
    if part >= len(meshes):
        raise SceneError(f"it has {len(meshes)} meshes", file=path, way_out=f"name one below {len(meshes)}")
    vertices, faces = meshes[part]
    rows = [f"OFF\n{len(vertices)} {len(faces)} 0"]
    rows += [" ".join(map(repr, vertex)) for vertex in vertices.tolist()]
    rows += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    return "\n".join(rows).encode()


def _objects(path: Path) -> Iterator[tuple[dict[str, Any], Triangles | None]]:
    """Yield the shapes as obstacles, with vertices and triangles of meshes."""
    words, n_meshes, has_poses = _Words(path), 0, False
    words.number = min(1, len(words.lines))  # whose first is the scene's name
    first = True
    while (marker := words.word()) != ".":
        if marker != "*":
            raise words.error(f"{shortened(marker)!r} begins neither an object, '*', nor the end, '.'")
        name = words.line()
        if first:
            following = words.lines[words.number].strip() if words.number < len(words.lines) else ""
            has_poses, first = " " in following, False
        position, turn = words.pose() if has_poses else (np.zeros(3), np.eye(3))
        for _ in range(words.count(100_000)):
            entry, mesh = _shape(words)
            if mesh is not None:
                entry["part"], n_meshes = n_meshes, n_meshes + 1
            own, turned = words.pose()
            words.numbers(4)  # its colour
            whole = turn @ turned
            center = position + turn @ own + whole @ entry.pop("offset", np.zeros(3))
            whole = whole @ entry.pop("turn", np.eye(3))
            entry |= {"name": name, "center": center}
            if entry["shape"] != "sphere":
                entry["quaternion_wxyz"] = quaternion_of_rotation(whole).tolist()
            yield entry, mesh
        for _ in range(words.count(100_000) if has_poses else 0):
            words.word()
            words.pose()


def _shape(words: _Words) -> tuple[dict[str, Any], Triangles | None]:
    """Return the next shape as an obstacle, without its pose. Of a mesh also vertices and triangles are returned."""
    kind = words.word()
    if kind == "box":
        return {"shape": "box", "size": words.numbers(3).tolist()}, None
    if kind == "sphere":
        return {"shape": "sphere", "radius": float(words.numbers(1)[0])}, None
    if kind == "cylinder":
        radius, height = words.numbers(2).tolist()
        return {"shape": "cylinder", "radius": radius, "height": height}, None
    if kind == "plane":  # of the points n x + d = 0, below which it is solid
        *normal, d = words.numbers(4).tolist()
        n = np.array(normal)
        size = float(np.linalg.norm(n))
        if not size > 0.0:
            raise words.error("the plane has no normal")
        aside = np.eye(3)[np.abs(n).argmin()]
        x = np.cross(n, aside) / np.linalg.norm(np.cross(n, aside))
        turn = np.stack([x, np.cross(n / size, x), n / size], axis=1)
        offset = -(d / size + 0.5 * THICK) * n / size
        return {"shape": "box", "size": [2 * FLOOR, 2 * FLOOR, THICK], "offset": offset, "turn": turn}, None
    if kind == "mesh":
        n_vertices, n_faces = words.count(1_000_000), words.count(1_000_000)
        vertices = words.numbers(3 * n_vertices).reshape(-1, 3)
        faces = words.numbers(3 * n_faces).reshape(-1, 3).astype(np.int64)
        if not n_faces or faces.min() < 0 or faces.max() >= n_vertices:
            raise words.error(f"the mesh of {n_vertices} vertices has triangles of others, or none")
        return {"shape": "mesh"}, (vertices, faces)
    raise words.error(
        f"no obstacle has the shape {shortened(kind)!r}", "write it as a box, a cylinder, a sphere or a mesh"
    )

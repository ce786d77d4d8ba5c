"""Planning scenes in MoveIt's text format (.scene).

RViz and `PlanningScene::saveGeometryToStream` write them. After the scene's name each object begins with ``* NAME``,
and a point ends the file. Since MoveIt 1.1 an object has a pose of its own, to which those of its shapes are
relative, and subframes after its shapes; a blank in the line after the first name distinguishes the formats, as in
MoveIt. Quaternions are x, y, z, w. There are no frames, and there is no robot.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from comove.arrays import Array
from comove.errors import SceneError, shortened
from comove.io.files import existing_file
from comove.model.files.moveit import (
    N_SIZES,
    CollisionObject,
    PlacedShape,
    PlanningScene,
    fault_of_mesh,
    fault_of_triangles,
    homogeneous,
)

MAX_BYTES = 100_000_000
MAX_COUNT = 100_000
SAYS = "write it again by MoveIt, or correct it"


class _Words:
    """The words of a file, one after the other, with their lines."""

    def __init__(self, path: Path):
        self.path = existing_file(path, MAX_BYTES, "leave objects out", SceneError)
        self.lines = self.path.read_text(encoding="utf-8", errors="replace").splitlines()
        self.number, self.rest = 0, list[str]()

    @property
    def place(self) -> str:
        """Return the line that is read."""
        return f"line {self.number}"

    def error(self, message: str, way_out: str = SAYS) -> SceneError:
        """Return an error in the line that is read."""
        return SceneError(message, file=self.path, key=self.place, way_out=way_out)

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

    def count(self, most: int | None = MAX_COUNT) -> int:
        """Return the next whole number, up to `most` if given."""
        word = self.word()
        if not (word.isascii() and word.isdigit() and len(word) < 19) or (
            most is not None and int(word) > most
        ):
            up_to = "" if most is None else f" up to {most}"
            raise self.error(f"{shortened(word)!r} is no whole number{up_to}")
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

    def pose(self) -> Array:
        """Return the next pose; array, shape (4, 4)."""
        position, quaternion = self.numbers(3), self.numbers(4)
        pose = homogeneous(position, quaternion)
        if pose is None:
            norm = float(np.linalg.norm(quaternion))
            raise self.error(f"the quaternion has the norm {norm:.6g}", "write a unit quaternion, w last")
        return pose


def read(path: Path) -> PlanningScene:
    """Read a planning scene in the text format.

    Raises
    ------
    SceneError
        If it cannot be read; it names the line.
    """
    words, found = _Words(path), list[CollisionObject]()
    words.number = min(1, len(words.lines))  # whose first is the scene's name
    has_poses = False
    while (marker := words.word()) != ".":
        if marker != "*":
            raise words.error(f"{shortened(marker)!r} begins neither an object, '*', nor the end, '.'")
        name = words.line()
        if not found:
            following = words.lines[words.number].strip() if words.number < len(words.lines) else ""
            has_poses = " " in following
        pose = words.pose() if has_poses else np.eye(4)
        shapes = tuple(_shape(words) for _ in range(words.count()))
        for _ in range(words.count() if has_poses else 0):
            words.word()
            words.pose()
        found.append(CollisionObject(name, pose, shapes))
    return PlanningScene(tuple(found))


def _shape(words: _Words) -> PlacedShape:
    """Return the next shape."""
    kind, where, sizes, mesh = words.word(), words.place, np.empty(0), None
    if kind == "mesh":
        n_vertices, n_faces = words.count(None), words.count(None)
        if (fault := fault_of_mesh(n_vertices, n_faces)) is not None:
            raise words.error(*fault)
        vertices = words.numbers(3 * n_vertices).reshape(-1, 3)
        faces = words.numbers(3 * n_faces).reshape(-1, 3).astype(np.int64)
        if (told := fault_of_triangles(n_vertices, faces)) is not None:
            raise words.error(told)
        mesh = vertices, faces
    elif kind in N_SIZES:
        sizes = words.numbers(N_SIZES[kind])
    else:
        raise words.error(
            f"no obstacle has the shape {shortened(kind)!r}",
            "write it as a box, a cylinder, a sphere or a mesh",
        )
    pose = words.pose()
    words.numbers(4)  # its colour
    return PlacedShape(kind, sizes, pose, where, mesh)

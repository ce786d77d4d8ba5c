"""The shapes of a scene for kernels: body, obstacle table, meshes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.errors import SceneError
from comove.geometry import distances as sd
from comove.geometry.rotations import matrices, rotation_in_plane
from comove.geometry.solids import N_CORNERS
from comove.geometry.surfaces import Placed
from comove.io.keys import UNTURNED
from comove.model.files.keys import (
    BarLoad,
    BarPart,
    BoxLoad,
    BoxPart,
    FrameLoad,
    HullPart,
    Load,
    MeshLoad,
    MeshObstacle,
    Obstacle,
    PartsLoad,
    PolygonLoad,
    SceneFile,
)
from comove.model.files.words import VERSION_1, Words
from comove.model.groups import RigidGroup

if TYPE_CHECKING:
    from comove.geometry.convex_decomposition import ConvexDecomposition
    from comove.geometry.meshes import Mesh

    Meshes = dict[int | str, tuple[Mesh, MeshObstacle | MeshLoad]]

LOAD = "load"
N_SIDES = 16
"""Sides of the prism around a cylinder, which reaches 2 % of the radius beyond it."""
FAR = 1e6  # m, how far a planar scene's boxes reach along z


@dataclass(frozen=True)
class MovingBody:
    """The geometry that must avoid obstacles: thick segments and solids.

    Segments are between nodes. Nodes are the end effectors in the order of the manipulators, then the corners of the
    payload.

    Attributes
    ----------
    edges : array of int, shape (n_edges, 2), nodes at the ends of the segments; equal ends make a point
    radii : array, shape (n_edges,), radii of the segments [m]
    n_nodes : int, keypoints that belong to no edge and no solid included
    filled : bool, whether the edges are the border of a filled polygon
    solids : array of int, shape (n_solids, 8), corners of boxes, numbered as in `comove.geometry.solids`;
        or (n_solids, n), nodes at the vertices of convex hulls, where the last node may be repeated
    """

    edges: Integers
    radii: Array
    n_nodes: int
    filled: bool = False
    solids: Integers = field(default_factory=lambda: np.zeros((0, N_CORNERS), dtype=np.int64))

    @property
    def border(self) -> Integers:
        """Return the first nodes of edges, without points; shape (n_edges,)."""
        first, second = self.edges.T
        return first[first != second]


def read_meshes(file: SceneFile, folder: Path, path: Path | None, words: Words = VERSION_1) -> Meshes:
    """Return a scene's meshes with their parts of the file.

    Keys are numbers of obstacles, or "load". Errors name keys of `SceneFile`, warnings those of the file, given by
    `words`.
    """
    parts: list[tuple[int | str, str, Obstacle | Load | None]] = [
        (i, f"obstacles[{i}]", obstacle) for i, obstacle in enumerate(file.obstacles)
    ]
    meshes: Meshes = {}
    for whose, key, part in (*parts, (LOAD, "load", file.load)):
        if isinstance(part, (MeshObstacle, MeshLoad)):
            from comove.geometry.meshes import read_mesh  # most scenes need no reader of meshes

            data = None
            if isinstance(part, MeshObstacle) and part.part is not None:
                from comove.model.files.moveit import mesh_in

                data = mesh_in(folder / part.file, part.part), ".off"
            mesh = read_mesh(
                folder / part.file,
                part.scale,
                file=path,
                key=f"{key}.file",
                data=data,
                called=words.key(f"{key}.file"),
            )
            if part.resolution is not None and not part.resolution < mesh.width:
                raise SceneError(
                    f"'{part.file}' is {mesh.width:.3g} m long, and the resolution is {part.resolution:g} m",
                    file=path,
                    key=f"{key}.resolution",
                    way_out="give a finer resolution",
                )
            if isinstance(part, MeshLoad) and words.version == 2 and mesh.is_flat:
                raise SceneError(
                    f"'{part.file}' has no volume: all its points are in one plane",
                    file=path,
                    key=f"{key}.file",
                    way_out="give it a thickness, or write a box in its place",
                )
            meshes[whose] = mesh, part
    return meshes


def placed(meshes: Meshes, owners: Integers) -> list[Placed]:
    """Return the meshes of obstacles at their positions at 0 s. `owners` are the obstacles of the table's rows."""
    return [
        Placed(
            mesh.parts,
            np.array(part.center),
            matrices(np.array(part.quaternion_wxyz)),
            int(number),
            int(np.argmax(owners == number)),
        )
        for number, (mesh, part) in meshes.items()
        if isinstance(part, MeshObstacle)
    ]


def body_of(
    file: SceneFile, groups: list[RigidGroup], decomposition: ConvexDecomposition | None = None
) -> MovingBody:
    """Return the body of payload and end effectors.

    It consists of the payload's edges between nodes, or its solids. An end effector that is not the end of an edge is
    a point of its own.
    """
    load, names, radius = file.load, file.names, 0.0
    edges, radii = list[tuple[int, int]](), list[float]()
    solids: list[list[int]] = []
    n_corners = sum(len(g.corners) for g in groups)
    corners = list(range(len(names), len(names) + n_corners))
    if isinstance(load, (BarLoad, FrameLoad, PolygonLoad)):
        radius = load.radius
    if isinstance(load, BarLoad):
        first, second = (
            corners[:2] if load.overhang else [names.index(name) for name in (load.held_by or names)]
        )
        edges = [(first, second)]
    elif isinstance(load, FrameLoad):
        edges = [(names.index(a), names.index(b)) for a, b in load.edges]
    elif isinstance(load, BoxLoad) and file.dimension == 3:
        solids = [corners]
    elif isinstance(load, PartsLoad):
        parts = parts_of(load)
        edges = [(corners[a], corners[b]) for a, b, _ in parts.rods]
        radii = [thick for _, _, thick in parts.rods]
        boxes = not any(isinstance(part, HullPart) for part in load.parts)
        hulls = [[corners[i] for i in hull] for hull in parts.hulls]
        solids = _padded(hulls, at_least=0 if boxes else N_CORNERS + 1) if hulls else []
    elif decomposition is not None:
        solids = _hulls(decomposition, len(names))
    elif load is not None:
        edges = list(zip(corners, corners[1:] + corners[:1], strict=True))
    radii = radii or [radius] * len(edges)
    touched = {node for edge in edges for node in edge}
    points = [(i, i) for i in range(len(names)) if i not in touched]
    return MovingBody(
        edges=np.array(edges + points, dtype=np.int64).reshape(-1, 2),
        radii=np.array(radii + [0.0] * len(points)),
        n_nodes=len(names) + n_corners,
        filled=file.dimension == 2 and isinstance(load, (PolygonLoad, BoxLoad)),
        solids=np.array(solids, dtype=np.int64).reshape(-1, len(solids[0]) if solids else N_CORNERS),
    )


def _hulls(decomposition: ConvexDecomposition, first: int) -> list[list[int]]:
    """Return the nodes of a payload's polytopes, from `first` on."""
    ends = first + np.cumsum([0, *(len(polytope.vertices) for polytope in decomposition.polytopes)])
    return _padded([list(range(a, b)) for a, b in pairwise(ends.tolist())], at_least=N_CORNERS + 1)


def _padded(hulls: list[list[int]], at_least: int = 0) -> list[list[int]]:
    """Return lists of nodes padded to equal length, longer than boxes'. The last node is repeated."""
    width = max([at_least, *map(len, hulls)])
    return [own + [own[-1]] * (width - len(own)) for own in hulls]


class CompoundParts(NamedTuple):
    """A payload of several shapes in its own frame.

    Attributes
    ----------
    corners : array, shape (n_corners, 3), [m]
    rods : two corners of each rod, and its radius [m]
    hulls : corners of each solid, those of boxes numbered as in `comove.geometry.solids`
    excess : over-approximation error of the solids [m]
    """

    corners: Array
    rods: list[tuple[int, int, float]]
    hulls: list[list[int]]
    excess: float


def parts_of(load: PartsLoad) -> CompoundParts:
    """Return the corners of a payload's shapes. Cylinders are contained in prisms of `N_SIDES` sides."""
    corners, rods, hulls, excess = list[Array](), list[tuple[int, int, float]](), list[list[int]](), 0.0
    for part in load.parts:
        first = sum(map(len, corners))
        if isinstance(part, BarPart):
            own = np.array([[-0.5 * part.length, 0.0, 0.0], [0.5 * part.length, 0.0, 0.0]])
            rods.append((first, first + 1, part.radius))
        elif isinstance(part, BoxPart):
            own = box_corners(part.size)
        elif isinstance(part, HullPart):
            own, excess = np.array(part.vertices), max(excess, part.excess)
        else:
            turn, wide = 2 * np.pi * np.arange(N_SIDES) / N_SIDES, part.radius / np.cos(np.pi / N_SIDES)
            ring = np.stack([wide * np.cos(turn), wide * np.sin(turn), 0.0 * turn], axis=1)
            own = np.concatenate([ring + [0.0, 0.0, side * 0.5 * part.height] for side in (-1, 1)])
            excess = max(excess, wide - part.radius)
        if not isinstance(part, BarPart):
            hulls.append(list(range(first, first + len(own))))
        center = np.zeros(3) if part.position is None else spatial(np.array(part.position))
        corners.append(center + own @ part.rotation.T)
    return CompoundParts(np.concatenate(corners), rods, hulls, excess)


def box_corners(size: tuple[float, ...]) -> Array:
    """Return a box's corners, numbered as in `comove.geometry.solids`; array, shape (8, 3)."""
    sides = 1.0 - 2.0 * (np.arange(N_CORNERS)[:, None] >> np.arange(3) & 1)
    return -0.5 * sides * np.array(size)


def obstacle_table(
    file: SceneFile, decompositions: dict[int | str, ConvexDecomposition]
) -> tuple[Array, Integers]:
    """Return the table of obstacles (`comove.geometry.distances`), and the obstacle of each row."""
    rows: list[Array] = []
    for i, obstacle in enumerate(file.obstacles):
        if isinstance(obstacle, MeshObstacle):
            from comove.geometry.polytopes import rows_of

            turn = matrices(np.array(obstacle.quaternion_wxyz))
            rows.append(rows_of(list(decompositions[i].polytopes), np.array(obstacle.center), turn))
        else:
            rows.append(_row(obstacle, file.dimension)[None])
    width = max((own.shape[1] for own in rows), default=sd.N_COLUMNS)
    table = np.zeros((sum(map(len, rows)), width))
    owners = np.repeat(np.arange(len(rows)), [len(own) for own in rows])
    for i, own in enumerate(rows):
        table[owners == i, : own.shape[1]] = own
    return table, owners


def _row(obstacle: Any, n_dims: int) -> Array:
    """Return the row of an obstacle that is not a mesh; array, shape (N_COLUMNS,)."""
    row = np.zeros(sd.N_COLUMNS)
    kind, size, reach = _SHAPES[obstacle.shape](obstacle)
    if n_dims == 2:
        rotation = rotation_in_plane(np.deg2rad(getattr(obstacle, "rotation_deg", 0.0)))
        if kind == sd.CAPSULE:  # the kernel's capsule lies along z, the planar one along x
            rotation = rotation @ np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
        if len(size) == 2 and kind in (sd.BOX, sd.ELLIPSOID):
            size = (*size, FAR if kind == sd.BOX else max(size))
    else:
        rotation = matrices(np.array(getattr(obstacle, "quaternion_wxyz", (1.0, 0, 0, 0))))
    row[sd.KIND], row[sd.REACH] = kind, reach
    row[sd.CENTER : sd.CENTER + 3] = spatial(np.array(obstacle.center))
    row[sd.ROTATION : sd.ROTATION + 9] = rotation.ravel()
    row[sd.SIZE : sd.SIZE + len(size)] = size
    return row


# Kind, size and reach of an obstacle of each shape.
_SHAPES: dict[str, Callable[[Any], tuple[int, tuple[float, ...], float]]] = {
    "box": lambda o: (sd.BOX, tuple(x / 2 for x in o.size), hypot(*o.size) / 2),
    "sphere": lambda o: (sd.SPHERE, (o.radius,), o.radius),
    "capsule": lambda o: (sd.CAPSULE, (o.radius, o.length / 2), o.radius + o.length / 2),
    "cylinder": lambda o: (sd.CYLINDER, (o.radius, o.height / 2), hypot(o.radius, o.height / 2)),
    "ellipsoid": lambda o: (sd.ELLIPSOID, tuple(o.radii), max(o.radii)),
}


def in_space(obstacle: Any) -> Array:
    """Return the orientation of an obstacle in the file; array, shape (4,), w x y z."""
    half = 0.5 * np.deg2rad(getattr(obstacle, "rotation_deg", 0.0))
    w, *xyz = getattr(obstacle, "quaternion_wxyz", UNTURNED)
    return np.array([np.cos(half), 0.0, 0.0, np.sin(half)]) if half else np.array([w, *xyz])


def inside_polygon(vertices: Array, points: Array) -> NDArray[np.bool_]:
    """Return which points (n, 3) lie inside a polygon in xy."""
    a, b = vertices, np.roll(vertices, -1, axis=0)
    x, y = points[:, None, 0], points[:, None, 1]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return (crosses & (x < at)).sum(axis=1) % 2 == 1


def spatial(vectors: Array, fill: float = 0.0) -> Array:
    """Return planar vectors with `fill` as third coordinate."""
    if vectors.shape[-1] == 3:
        return np.array(vectors, dtype=float)
    return np.concatenate([vectors, np.full((*vectors.shape[:-1], 1), fill)], axis=-1)

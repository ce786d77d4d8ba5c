"""The shapes of a scene as kernels take them: the body of load and hands, the table of obstacles, meshes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import hypot
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import SceneError
from comove.geometry import distances as sd
from comove.geometry.rotations import matrices, rotation_in_plane
from comove.geometry.solids import N_CORNERS
from comove.geometry.surfaces import Placed
from comove.scenes.groups import RigidGroup
from comove.scenes.model import (
    BarLoad,
    BoxLoad,
    FrameLoad,
    Load,
    MeshLoad,
    MeshObstacle,
    Obstacle,
    PolygonLoad,
    SceneFile,
)

if TYPE_CHECKING:
    from comove.geometry.convex_decomposition import ConvexDecomposition
    from comove.geometry.meshes import Mesh

    Meshes = dict[int | str, tuple[Mesh, MeshObstacle | MeshLoad]]

Array = NDArray[np.float64]

LOAD = "load"
FAR = 1e6  # m, how far a planar scene's boxes reach along z


@dataclass(frozen=True)
class MovingBody:
    """The geometry that must keep clear of obstacles: thickened segments between nodes, and solids.

    Nodes are the hands in the order of the manipulators, then the corners of the load.

    Attributes
    ----------
    edges : array of int, shape (n_edges, 2), nodes at the ends of the segments; equal ends make a point
    radii : array, shape (n_edges,), radii of the segments [m]
    n_nodes : int, keypoints that belong to no edge and no solid included
    filled : bool, whether the edges are the border of a filled polygon
    solids : array of int, shape (n_solids, 8), corners of boxes, numbered as in `comove.geometry.solids`;
        or (n_solids, n), nodes at the vertices of convex hulls, where the last node may be repeated
    """

    edges: NDArray[np.int64]
    radii: Array
    n_nodes: int
    filled: bool = False
    solids: NDArray[np.int64] = field(default_factory=lambda: np.zeros((0, N_CORNERS), dtype=np.int64))

    @property
    def border(self) -> NDArray[np.int64]:
        """Return the nodes at which its edges begin, without the hands, which are points; array, shape (n_edges,)."""
        first, second = self.edges.T
        return first[first != second]


def read_meshes(file: SceneFile, folder: Path, path: Path | None) -> Meshes:
    """Return the meshes of a scene and the parts of the file that name them, by number of the obstacle or "load"."""
    parts: list[tuple[int | str, str, Obstacle | Load | None]] = [
        (i, f"obstacles[{i}]", obstacle) for i, obstacle in enumerate(file.obstacles)
    ]
    meshes: Meshes = {}
    for whose, key, part in (*parts, (LOAD, "load", file.load)):
        if isinstance(part, (MeshObstacle, MeshLoad)):
            from comove.geometry.meshes import read_mesh  # most scenes need no reader of meshes

            mesh = read_mesh(folder / part.file, part.scale, file=path, key=f"{key}.file")
            if part.resolution is not None and not part.resolution < mesh.width:
                raise SceneError(
                    f"'{part.file}' is {mesh.width:.3g} m long, and the resolution is {part.resolution:g} m",
                    file=path,
                    key=f"{key}.resolution",
                    way_out="give a finer resolution",
                )
            meshes[whose] = mesh, part
    return meshes


def placed(meshes: Meshes, owners: NDArray[np.int64]) -> list[Placed]:
    """Return the meshes of obstacles at their positions at 0 s; `owners` are the obstacles of the table's rows."""
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
    """Return the body of load and hands: edges of the load between nodes, or its solids, and hands as points.

    A hand that is not the end of an edge is a point of its own.
    """
    load, names, radius = file.load, file.names, 0.0
    edges: list[tuple[int, int]] = []
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
    elif decomposition is not None:
        solids = _hulls(decomposition, len(names))
    elif load is not None:
        edges = list(zip(corners, corners[1:] + corners[:1], strict=True))
    touched = {node for edge in edges for node in edge}
    points = [(i, i) for i in range(len(names)) if i not in touched]
    return MovingBody(
        edges=np.array(edges + points, dtype=np.int64).reshape(-1, 2),
        radii=np.array([radius] * len(edges) + [0.0] * len(points)),
        n_nodes=len(names) + n_corners,
        filled=file.dimension == 2 and isinstance(load, (PolygonLoad, BoxLoad)),
        solids=np.array(solids, dtype=np.int64).reshape(-1, len(solids[0]) if solids else N_CORNERS),
    )


def _hulls(decomposition: ConvexDecomposition, first: int) -> list[list[int]]:
    """Return the nodes of every polytope of a load, padded to equal length by repeating the last one.

    Parameters
    ----------
    first : node of the first corner
    """
    counts = [len(polytope.vertices) for polytope in decomposition.polytopes]
    width, hulls = max(*counts, N_CORNERS + 1), []
    for count in counts:
        own = list(range(first, first + count))
        hulls.append(own + [own[-1]] * (width - count))
        first += count
    return hulls


def obstacle_table(
    file: SceneFile, decompositions: dict[int | str, ConvexDecomposition]
) -> tuple[Array, NDArray[np.int64]]:
    """Return the table of obstacles, as `comove.geometry.distances` describes it, and the obstacle of each row."""
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


def inside_polygon(vertices: Array, points: Array) -> NDArray[np.bool_]:
    """Return which of `points` lie inside the polygon; both arrays of shape (n, 3), the plane is xy."""
    a, b = vertices, np.roll(vertices, -1, axis=0)
    x, y = points[:, None, 0], points[:, None, 1]
    crosses = (a[:, 1] > y) != (b[:, 1] > y)
    with np.errstate(divide="ignore", invalid="ignore"):
        at = a[:, 0] + (y - a[:, 1]) * (b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1])
    return (crosses & (x < at)).sum(axis=1) % 2 == 1


def spatial(vectors: Array, fill: float = 0.0) -> Array:
    """Return vectors with `fill` appended as third coordinate where they are planar."""
    if vectors.shape[-1] == 3:
        return np.array(vectors, dtype=float)
    return np.concatenate([vectors, np.full((*vectors.shape[:-1], 1), fill)], axis=-1)

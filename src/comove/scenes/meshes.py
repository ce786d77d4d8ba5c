"""Triangle meshes from files: read, checked, closed and turned outwards.

STL, OBJ, PLY and OFF are read (by trimesh, which brings no parsers that execute anything). What holes leave open has
no inside, so that nobody could say whether something is in it: such a part is replaced by its convex hull, which
holds it, with a warning.
"""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import ComoveWarning, ExtraError, SceneError
from comove.scenes.cover import Cover, cover_of, parts_of, volume_of
from comove.scenes.polytopes import hull_of

Array = NDArray[np.float64]

FORMATS = ("stl", "obj", "ply", "off")
MAX_BYTES = 100_000_000
MAX_FACES = 50_000
STL_HEADER, STL_FACE = 84, 50  # bytes
LARGE = 50.0  # m, wider than this is probably written in millimetres
SAME = 1e-9  # of a mesh's size, within which vertices are one


@dataclass(frozen=True, eq=False)
class Mesh:
    """Closed triangles, turned outwards.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3) [m]
    faces : array of int, shape (n_faces, 3)
    sha256 : of the file
    """

    vertices: Array
    faces: NDArray[np.int64]
    sha256: str


def mesh_cover(
    path: Path, scale: float, resolution: float | None, *, file: object, key: str
) -> tuple[Cover, str]:
    """The cover of the mesh in a file, and the file's checksum.

    Parameters
    ----------
    scale : of the file's lengths, to metres
    resolution : as `comove.scenes.cover.cover_of` takes it [m]
    file, key : where the mesh is named, for messages

    Raises
    ------
    SceneError
        If the file holds no mesh that can be used.
    ExtraError
        If what reads meshes is not installed.
    """

    def wrong(message: str, way_out: str) -> SceneError:
        return SceneError(f"'{path.name}' {message}", file=file, key=key, way_out=way_out)

    data = _bytes_of(path, wrong)
    cover, told = _cover(data, path.suffix.lower().lstrip("."), scale, resolution)
    if cover is None:
        raise wrong(*told)
    place = ": ".join(str(part) for part in (file, key) if part is not None)
    for message in told:
        warnings.warn(f"{place}: '{path.name}' {message}", ComoveWarning, stacklevel=6)
    return cover, hashlib.sha256(data).hexdigest()


class _Refused(Exception):
    """Why a mesh cannot be used, and the way out."""


@lru_cache(maxsize=16)  # the same file is often several obstacles, or asked for again
def _cover(
    data: bytes, suffix: str, scale: float, resolution: float | None
) -> tuple[Cover | None, tuple[str, ...]]:
    """The cover and what there is to say of it; or None, why there is none and the way out."""
    try:
        vertices, faces, told = closed(*_triangles(data, suffix))
        vertices = vertices * scale
        width = float(np.ptp(vertices, axis=0).max())
        if resolution is not None and not resolution < width:
            raise _Refused(
                f"is {width:.3g} m long, and the resolution is {resolution:g} m", "give a finer resolution"
            )
        if width > LARGE:
            told = (
                *told,
                f"is {width:g} m long, which looks like millimetres; lengths are in metres, or add scale: 0.001",
            )
        cover = cover_of(vertices, faces, resolution)
        if cover is None:
            raise _Refused("lies in a plane", "give it a thickness")
    except _Refused as error:
        return None, error.args
    return cover, told


def _bytes_of(path: Path, wrong: Callable[[str, str], SceneError]) -> bytes:
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in FORMATS:
        raise wrong(
            "is no mesh that can be read", f"write it as {', '.join(f.upper() for f in FORMATS[:-1])} or OFF"
        )
    try:
        size = path.stat().st_size
        if size > MAX_BYTES:
            raise wrong(f"has {size / 1e6:.0f} MB", f"decimate it to {MAX_FACES} triangles or fewer")
        data = path.read_bytes()
    except OSError as error:
        raise wrong(f"cannot be read: {error.strerror}", "correct the path or its rights") from None
    if suffix == "stl" and not data[:5].lower().startswith(b"solid"):
        claimed = int.from_bytes(data[STL_HEADER - 4 : STL_HEADER], "little")
        held = max(0, len(data) - STL_HEADER) // STL_FACE
        if claimed > held or len(data) < STL_HEADER:
            raise wrong(
                f"claims {claimed} triangles and has room for {held}",
                "write it anew: it is cut off or damaged",
            )
    return data


def _triangles(data: bytes, suffix: str) -> tuple[Array, NDArray[np.int64]]:
    """Vertices as they are written and faces."""
    try:
        import trimesh
    except ImportError as error:
        raise ExtraError("a mesh in a scene", "mesh") from error
    import io

    try:
        loaded: Any = trimesh.load(
            io.BytesIO(data), file_type=suffix, process=False, maintain_order=True, skip_materials=True
        )
        pieces = loaded.dump() if hasattr(loaded, "dump") else [loaded]
        pieces = [piece for piece in pieces if len(getattr(piece, "faces", ()))]
    except Exception as error:  # a reader of foreign formats may raise anything
        reason = str(error).strip().splitlines()[0][:100] if str(error).strip() else type(error).__name__
        raise _Refused(f"cannot be read: {reason}", "repair it, or write it anew") from None
    if not pieces:
        raise _Refused("holds no triangles", "write it anew: a mesh is a list of triangles")
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    vertices = np.concatenate([np.asarray(piece.vertices, dtype=float) for piece in pieces])
    faces = [
        np.asarray(piece.faces, dtype=np.int64) + start for piece, start in zip(pieces, starts, strict=False)
    ]
    return vertices, np.concatenate(faces)


def closed(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64], tuple[str, ...]]:
    """The same triangles with vertices at one place made one, every part closed and turned outwards; what was done.

    Raises
    ------
    _Refused
        If there is nothing to close.
    """
    if len(faces) > MAX_FACES:
        raise _Refused(f"has {len(faces)} triangles", f"decimate it to {MAX_FACES} or fewer")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise _Refused("has a triangle of vertices that it does not have", "write it anew")
    used = np.unique(faces)
    if not np.isfinite(vertices[used]).all():
        bad = int(used[~np.isfinite(vertices[used]).all(axis=1)][0])
        raise _Refused(f"has a vertex {bad} that is no place", "write finite numbers")
    width = float(np.ptp(vertices[used], axis=0).max())
    if not width > 0.0:
        raise _Refused("is a point", "write it anew")
    grid = np.round(vertices / (SAME * width)).astype(np.int64)
    _, first, place = np.unique(grid, axis=0, return_index=True, return_inverse=True)
    vertices, faces = vertices[first], place.reshape(-1)[faces]
    distinct = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    faces = faces[distinct]
    if not len(faces):
        raise _Refused("holds no triangles with three corners", "write it anew")
    kept, n_open, told = [], 0, ()
    for part in parts_of(vertices, faces, together=False):
        if not is_closed(part):
            turned = _turned_alike(part)
            if turned is None:
                hull = hull_of(vertices[np.unique(part)])
                if hull is None:
                    raise _Refused("has a part that lies in a plane", "give it a thickness")
                n_open += 1
                part, vertices = _as_triangles(vertices, np.unique(part))
            else:
                part = turned
        kept.append(part)
    if n_open:
        which = "" if n_open == len(kept) == 1 else f" of {n_open} of its {len(kept)} parts"
        told = (f"has holes: the convex hull{which} is taken; close it to have its own shape",)
    return vertices, _outwards(vertices, kept), told


def is_closed(faces: NDArray[np.int64]) -> bool:
    """Whether every edge is run through as often one way as the other."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    n = int(faces.max()) + 1
    there, back = np.sort(edges[:, 0] * n + edges[:, 1]), np.sort(edges[:, 1] * n + edges[:, 0])
    return bool((there == back).all())


def _turned_alike(faces: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """The faces of one part turned so that neighbours agree, None where that does not close them."""
    faces, neighbours = faces.copy(), {}
    for k, face in enumerate(faces.tolist()):
        for i in range(3):
            neighbours.setdefault(frozenset((face[i], face[i - 1])), []).append(k)
    if any(len(both) != 2 for both in neighbours.values()):
        return None
    done, waiting = {0}, [0]
    while waiting:
        k = waiting.pop()
        face = faces[k].tolist()
        for i in range(3):
            a, b = face[i - 1], face[i]
            (other,) = {*neighbours[frozenset((a, b))]} - {k} or {k}
            if other not in done:
                there = faces[other].tolist()
                if any(there[j - 1] == a and there[j] == b for j in range(3)):  # the same way: it must turn
                    faces[other] = faces[other][::-1]
                done.add(other)
                waiting.append(other)
    return faces if is_closed(faces) else None


def _as_triangles(vertices: Array, used: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """The hull of some vertices as triangles turned outwards."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(vertices[used])
    faces = used[hull.simplices]
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return faces, vertices


def _outwards(vertices: Array, parts: list[NDArray[np.int64]]) -> NDArray[np.int64]:
    """All parts, those turned the other way that hold more than they leave open; cavities stay as they are."""
    boxes = [(vertices[part].min(axis=(0, 1)), vertices[part].max(axis=(0, 1))) for part in parts]
    turned = []
    for k, part in enumerate(parts):
        low, high = boxes[k]
        within = any(
            (other[0] < low).all() and (other[1] > high).all() for i, other in enumerate(boxes) if i != k
        )
        turned.append(part[:, ::-1] if volume_of(vertices[part]) < 0 and not within else part)
    return np.concatenate(turned)

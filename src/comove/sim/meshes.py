"""OBJ meshes for MuJoCo, converted once into the user's cache.

An entry is named after the SHA-256 of its source and of the code that converts it, and ends with the SHA-256 of its
own contents, so a truncated or damaged entry is detected and made again. It is written atomically: two processes at
once, or a killed one, leave complete entries only.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from pkgutil import get_data
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.errors import ExtraError, MeshError, RobotError
from comove.geometry.polytopes import hull_triangles
from comove.geometry.triangles import FORMATS, MAX_BYTES, triangles_of
from comove.io.files import telling, whole_file
from comove.robots.search.capsules import convex_parts

KINDS = ("reader", *FORMATS.values())
MAKERS = ("comove.sim.meshes", "comove.robots.search.capsules", "comove.geometry.polytopes")
READERS = tuple(f"comove.geometry.triangles.{kind}" for kind in KINDS)
SEAL = b"# sha256 "
MATERIALS = ".mtl"  # the only files that a mesh may bring along
MAX_MATERIALS, MAX_CHANGES = 1_000_000, 1000  # bytes of such a file; changes of material in a mesh

Colour = tuple[float, ...]
Part = tuple[Path, Colour | None]
Triangles = tuple[NDArray[np.float64], NDArray[np.int64]]


@cache
def made_by() -> bytes:
    """Return a checksum of the conversion code. Other versions of comove may convert differently."""
    files = [name.rpartition(".") for name in (*MAKERS, *READERS)]
    sources = [get_data(package, f"{module}.py") or b"" for package, _, module in files]
    return hashlib.sha256(b"".join(sources)).digest()


def cache_folder(kind: str = "meshes") -> Path:
    """Return the folder of converted files of a kind: $XDG_CACHE_HOME/comove/KIND, else ~/.cache/comove/KIND."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "comove" / kind


def as_obj(mesh: Path) -> Path:
    """Convert a mesh, in metres, to one OBJ file in the cache.

    Raises
    ------
    RobotError
        If the mesh cannot be read or holds no triangles, or the cache cannot be written.
    """
    return _cached(mesh, "whole", lambda data: [(_obj([_triangles(mesh, data)]), None)])[0][0]


def convex_parts_of(mesh: Path, scale: tuple[float, float, float], moves: bool) -> list[Path]:
    """Convert a mesh to OBJ files of convex bodies that contain it.

    MuJoCo uses the hull of a mesh, which fills hollows: the elbow of a link, the space below a table.

    Parameters
    ----------
    scale : factors of the coordinates, to metres
    moves : whether the link moves; the larger bodies of fixed links are cut finer
    """

    def hulls(data: bytes) -> list[tuple[bytes, Colour | None]]:
        vertices, triangles = _triangles(mesh, data)
        parts = convex_parts(vertices * np.array(scale), triangles, moves)
        return [(_obj([hull_triangles(part)]), None) for part in parts]

    return [path for path, _ in _cached(mesh, f"hulls {scale} {moves}", hulls)]


def coloured_parts(mesh: Path) -> list[Part]:
    """Convert a mesh to one OBJ file for each colour. Return them with their colours (red, green, blue, alpha), None
    without one."""
    return _cached(mesh, "coloured", lambda data: _by_colour(mesh, data))


def _cached(
    mesh: Path, what: str, convert: Callable[[bytes], list[tuple[bytes, Colour | None]]]
) -> list[Part]:
    """Return a mesh's conversion, from the cache if present."""
    data, suffix = _bytes_of(mesh), mesh.suffix.lower()
    key = hashlib.sha256(b"|".join([made_by(), what.encode(), suffix.encode(), data])).hexdigest()
    folder = cache_folder()
    parts = _read_parts(folder, key)
    if parts is None:
        bodies = convert(data)
        names = [f"{key}-{i}.obj" for i in range(len(bodies))]
        try:
            with telling(folder, "made", RobotError):
                folder.mkdir(parents=True, exist_ok=True)
            for name, (body, _) in zip(names, bodies, strict=True):
                _write_whole(folder / name, body)
            index = [[name, colour] for name, (_, colour) in zip(names, bodies, strict=True)]
            _write_whole(folder / f"{key}.json", json.dumps(index).encode() + b"\n")
        except RobotError as error:
            raise RobotError(
                f"converted meshes cannot be kept: {error.message}",
                file=folder,
                way_out="let XDG_CACHE_HOME name a folder that you may write",
            ) from error
        parts = [(folder / name, colour) for name, (_, colour) in zip(names, bodies, strict=True)]
    return parts


def _bytes_of(mesh: Path) -> bytes:
    """Read a file, up to one byte beyond the size limit."""
    try:
        with open(mesh, "rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise RobotError(
            f"the mesh cannot be read: {error.strerror}", file=mesh, way_out="check its rights"
        ) from error


def _read_parts(folder: Path, key: str) -> list[Part] | None:
    """Read the cached parts of a mesh; None if missing or damaged."""
    index = _read_whole(folder / f"{key}.json")
    if index is None:
        return None
    parts = [(folder / name, None if colour is None else tuple(colour)) for name, colour in json.loads(index)]
    return parts if all(_read_whole(path) is not None for path, _ in parts) else None


def _triangles(mesh: Path, data: bytes) -> Triangles:
    try:
        return triangles_of(data, mesh.suffix.lower())
    except MeshError as error:
        raise RobotError(
            f"the mesh cannot be read: {error.message}", file=mesh, way_out=error.way_out
        ) from error


def _by_colour(mesh: Path, data: bytes) -> list[tuple[bytes, Colour | None]]:
    """Convert the mesh's pieces to OBJ by colour, without materials."""
    whole = _triangles(mesh, data)
    if data.count(b"usemtl") > MAX_CHANGES:  # which take trimesh quadratic time
        return [(_obj([whole]), None)]
    groups: dict[Colour | None, list[Triangles]] = {}
    for piece in _pieces(mesh, data):
        groups.setdefault(_colour(piece), []).append((piece.vertices, piece.faces))
    return [(_obj(group), colour) for colour, group in groups.items()]


@dataclass(frozen=True)
class _Beside:
    """Resolver that gives trimesh the material files beside a mesh."""

    folder: Path

    def __getitem__(self, name: str) -> bytes:
        """Read a file, as `get` does."""
        return self.get(name)

    def get(self, name: str) -> bytes:
        """Read a material file."""
        path = self.folder / str(name).strip()
        beside = path.suffix == MATERIALS and path.resolve().parent == self.folder.resolve()
        if not (beside and path.is_file()):
            raise FileNotFoundError(name)
        with open(path, "rb") as file:
            return file.read(MAX_MATERIALS)


def _pieces(mesh: Path, data: bytes) -> list[Any]:
    """Return the mesh's pieces with their materials, as trimesh reads them."""
    try:
        import trimesh
    except ImportError as error:
        raise ExtraError("simulation", "sim") from error

    suffix = mesh.suffix.lower()
    try:
        beside: Any = _Beside(mesh.parent)  # trimesh asks no more of a resolver
        scene = trimesh.load_scene(io.BytesIO(data), file_type=suffix[1:], resolver=beside)
        if suffix == ".dae" and scene.units not in (None, "meters", "meter"):
            scene = scene.convert_units("meters")
        pieces = [piece for piece in scene.dump() if len(getattr(piece, "faces", ()))]
        if not pieces:
            raise ValueError("it holds no triangles")
    except Exception as error:  # a reader of foreign formats may raise anything
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise RobotError(f"the mesh cannot be read: {reason}", file=mesh, way_out="repair it") from error
    return pieces


def _colour(piece: Any) -> Colour | None:
    colour = getattr(getattr(piece.visual, "material", None), "main_color", None)
    if colour is None:
        return None
    darkest = 0.08  # what is black in a mesh: true black has no shape in a picture
    *rgb, alpha = (float(part) / 255 for part in colour)
    return (*(round(darkest + (1 - darkest) * part, 3) for part in rgb), round(alpha, 3))


def _obj(pieces: list[Triangles]) -> bytes:
    """Write pieces as one OBJ, with coincident vertices merged."""
    starts = np.cumsum([0] + [len(vertices) for vertices, _ in pieces])
    corners = np.concatenate([vertices for vertices, _ in pieces])
    faces = np.concatenate([faces + start for (_, faces), start in zip(pieces, starts, strict=False)])
    vertices, place = np.unique(corners, axis=0, return_inverse=True)
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in vertices]
    lines += ["f {} {} {}".format(*face) for face in place.reshape(-1)[faces] + 1]
    return "\n".join(lines).encode() + b"\n"


def _read_whole(path: Path) -> bytes | None:
    try:
        body, _, seal = path.read_bytes().rpartition(SEAL)
    except OSError:
        return None
    return body if body and SEAL + seal == _seal(body) else None


def _seal(body: bytes) -> bytes:
    return SEAL + hashlib.sha256(body).hexdigest().encode() + b"\n"


def _write_whole(path: Path, body: bytes) -> None:
    with whole_file(path, RobotError) as file:
        file.write(body + _seal(body))

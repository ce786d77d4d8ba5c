"""Readers of the triangles of a mesh in any of the known formats."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np

from comove.errors import MeshError
from comove.geometry.triangles.checks import ANEW, SIMPLER, Array, Ints, require_few

FORMATS = {".dae": "collada", ".obj": "obj", ".off": "off", ".ply": "ply", ".stl": "stl"}
"""Formats by the suffix of their files; each has a module, which is loaded with the first such file."""
MAX_BYTES = 50_000_000
FARTHEST = 1e9  # largest coordinate; larger ones are no lengths, and overflow single precision


def read_bytes(path: Path) -> bytes:
    """Return the bytes of a file, of which at most `MAX_BYTES` + 1 are read."""
    try:
        if not path.is_file():
            raise MeshError("it is no file", way_out="name a mesh")
        with open(path, "rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise MeshError(f"it cannot be read: {error.strerror}", way_out="check its rights") from error


def triangles_of(data: bytes, suffix: str) -> tuple[Array, Ints]:
    """Return vertices and faces of a mesh, from a file's bytes and the suffix of its name.

    Returns
    -------
    vertices : array, shape (n_vertices, 3), in the file's unit; of COLLADA in metres
    faces : array of int, shape (n_faces, 3), each of three different vertices

    Raises
    ------
    MeshError
        If they cannot be read, or hold no mesh.
    """
    if len(data) > MAX_BYTES:
        raise MeshError(f"it is larger than {MAX_BYTES // 1_000_000} MB", way_out=SIMPLER)
    with np.errstate(all="ignore"):  # overflow is reported below
        vertices, faces = _reader(FORMATS[suffix])(data)
    require_few(len(faces))
    if not len(faces):
        raise MeshError("it holds no triangles", way_out=ANEW)
    if faces.min() < 0 or faces.max() >= len(vertices):
        bad = faces.min() if faces.min() < 0 else faces.max()
        raise MeshError(f"a face has the corner {bad} of {len(vertices)}", way_out=ANEW)
    far = ~(np.abs(vertices) < FARTHEST).all(axis=1)
    if far.any():
        place = ", ".join(f"{x:g}" for x in vertices[far][0])
        raise MeshError(f"its vertex {int(far.argmax())} is at ({place})", way_out="write finite numbers")
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    if not len(faces):
        raise MeshError("it holds no triangle with three corners", way_out=ANEW)
    return vertices, faces


def _reader(name: str) -> Callable[[bytes], tuple[Array, Ints]]:
    """Return the reader of a format."""
    reader: Callable[[bytes], tuple[Array, Ints]] = getattr(
        import_module(f"comove.geometry.triangles.{name}"), f"read_{name}"
    )
    return reader


def as_stl(vertices: Array, faces: Ints) -> bytes:
    """Return triangles as a binary STL."""
    from comove.geometry.triangles.stl import HEADER

    rows = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    rows["corners"] = vertices[faces]
    return b"\0" * (HEADER - 4) + len(faces).to_bytes(4, "little") + rows.tobytes()

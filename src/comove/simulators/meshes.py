"""Meshes as MuJoCo reads them: OBJ, converted once and kept in the user's cache.

An entry is named after the SHA-256 of what it was made from and ends with the SHA-256 of what stands in it, so that
a truncated or damaged one is noticed and made anew. It is written under another name and renamed: two processes at
once, or one that is killed, leave whole entries only.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from comove.errors import ExtraError, RobotError

VERSION = b"3"  # of the conversion
SEAL = b"# sha256 "
DARKEST = 0.08  # what is black in a mesh: true black has no shape in a picture

Colour = tuple[float, ...]
Part = tuple[Path, Colour | None]


def cache_folder() -> Path:
    """Where converted meshes are kept: $XDG_CACHE_HOME/comove/meshes, else ~/.cache/comove/meshes."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "comove" / "meshes"


def as_obj(mesh: Path) -> Path:
    """The mesh, in metres, as one OBJ file in the cache.

    Raises
    ------
    RobotError
        If it cannot be read or holds no triangles, or the cache cannot be written.
    """
    return _cached(mesh, by_colour=False)[0][0]


def coloured_parts(mesh: Path) -> list[Part]:
    """The mesh as one OBJ file a colour, and the colours (red, green, blue, alpha), None where it has none.

    Raises
    ------
    RobotError
        As `as_obj`.
    """
    return _cached(mesh, by_colour=True)


def _cached(mesh: Path, *, by_colour: bool) -> list[Part]:
    suffix = mesh.suffix.lower().encode()
    key = hashlib.sha256(b"|".join([VERSION, str(by_colour).encode(), suffix, mesh.read_bytes()])).hexdigest()
    folder = cache_folder()
    parts = _read_parts(folder, key)
    if parts is None:
        bodies = _converted(mesh, by_colour)
        names = [f"{key}-{i}.obj" for i in range(len(bodies))]
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for name, (body, _) in zip(names, bodies, strict=True):
                _write_whole(folder / name, body)
            index = [[name, colour] for name, (_, colour) in zip(names, bodies, strict=True)]
            _write_whole(folder / f"{key}.json", json.dumps(index).encode() + b"\n")
        except OSError as error:
            raise RobotError(
                f"converted meshes cannot be kept: {error.strerror}",
                file=folder,
                way_out="let XDG_CACHE_HOME name a folder that you may write",
            ) from error
        parts = [(folder / name, colour) for name, (_, colour) in zip(names, bodies, strict=True)]
    return parts


def _read_parts(folder: Path, key: str) -> list[Part] | None:
    """What the cache holds, None where it is not all there and whole."""
    index = _read_whole(folder / f"{key}.json")
    if index is None:
        return None
    parts = [(folder / name, None if colour is None else tuple(colour)) for name, colour in json.loads(index)]
    return parts if all(_read_whole(path) is not None for path, _ in parts) else None


def _converted(mesh: Path, by_colour: bool) -> list[tuple[bytes, Colour | None]]:
    """The mesh's pieces as OBJ, vertices and triangles alone, with their colours."""
    try:
        import trimesh
    except ImportError as error:
        raise ExtraError("simulation", "sim") from error
    try:
        scene = trimesh.load_scene(mesh)
        if mesh.suffix.lower() == ".dae" and scene.units not in (None, "meters", "meter"):
            scene = scene.convert_units("meters")
        pieces = [piece for piece in scene.dump() if len(getattr(piece, "faces", ()))]
        if not pieces:
            raise ValueError("it holds no triangles")
    except Exception as error:  # a reader of foreign formats may raise anything
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise RobotError(f"the mesh cannot be read: {reason}", file=mesh, way_out="repair it") from error
    groups: dict[Colour | None, list[Any]] = {}
    for piece in pieces:
        groups.setdefault(_colour(piece) if by_colour else None, []).append(piece)
    return [(_obj(group), colour) for colour, group in groups.items()]


def _colour(piece: Any) -> Colour | None:
    colour = getattr(getattr(piece.visual, "material", None), "main_color", None)
    if colour is None:
        return None
    *rgb, alpha = (float(part) / 255 for part in colour)
    return (*(round(DARKEST + (1 - DARKEST) * part, 3) for part in rgb), round(alpha, 3))


def _obj(pieces: list[Any]) -> bytes:
    """Vertices and triangles of pieces as one OBJ; vertices at one place become one."""
    starts = np.cumsum([0] + [len(piece.vertices) for piece in pieces])
    corners = np.concatenate([piece.vertices for piece in pieces])
    faces = np.concatenate([piece.faces + start for piece, start in zip(pieces, starts, strict=False)])
    vertices, place = np.unique(corners, axis=0, return_inverse=True)
    lines = ["v {:.9g} {:.9g} {:.9g}".format(*vertex) for vertex in vertices]
    lines += ["f {} {} {}".format(*face) for face in place.reshape(-1)[faces] + 1]
    return "\n".join(lines).encode() + b"\n"


def _read_whole(path: Path) -> bytes | None:
    """The body of an entry, None where it is missing or damaged."""
    try:
        body, _, seal = path.read_bytes().rpartition(SEAL)
    except OSError:
        return None
    return body if body and seal == hashlib.sha256(body).hexdigest().encode() + b"\n" else None


def _write_whole(path: Path, body: bytes) -> None:
    handle, draft = tempfile.mkstemp(prefix=f".{path.name[:8]}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(body + SEAL + hashlib.sha256(body).hexdigest().encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    except BaseException:
        Path(draft).unlink(missing_ok=True)
        raise

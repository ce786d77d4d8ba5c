"""Meshes as MuJoCo reads them: OBJ, converted once and kept in the user's cache.

An entry is named after the SHA-256 of what it was made from and ends with the SHA-256 of what stands in it, so that
a truncated or damaged one is noticed and made anew. It is written under another name and renamed: two processes at
once, or one that is killed, leave whole entries only.
"""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path

from comove.errors import ComoveError, ExtraError, RobotError

VERSION = b"1"  # of the conversion
SEAL = b"# sha256 "


def cache_folder() -> Path:
    """Where converted meshes are kept: $XDG_CACHE_HOME/comove, else ~/.cache/comove."""
    base = os.environ.get("XDG_CACHE_HOME", "")
    return (Path(base) if os.path.isabs(base) else Path.home() / ".cache") / "comove" / "meshes"


def as_obj(mesh: Path) -> Path:
    """The mesh, in metres, as an OBJ file in the cache.

    Raises
    ------
    RobotError
        If it cannot be read or holds no triangles.
    """
    source = mesh.read_bytes()
    path = cache_folder() / f"{hashlib.sha256(VERSION + mesh.suffix.encode() + source).hexdigest()}.obj"
    if not _is_whole(path):
        _write_whole(path, _converted(mesh))
    return path


def _converted(mesh: Path) -> bytes:
    """The mesh as OBJ: vertices and triangles alone."""
    try:
        import trimesh
    except ImportError as error:
        raise ExtraError("simulation", "sim") from error
    try:
        loaded = trimesh.load(mesh, force="mesh", process=False)
        loaded.merge_vertices(merge_tex=True, merge_norm=True)
        if len(loaded.faces) == 0:
            raise ValueError("it holds no triangles")
    except ComoveError:
        raise
    except Exception as error:  # a reader of foreign formats may raise anything
        reason = str(error).strip().splitlines()[0] if str(error).strip() else type(error).__name__
        raise RobotError(f"the mesh cannot be read: {reason}", file=mesh, way_out="repair it") from error
    if mesh.suffix.lower() == ".dae" and loaded.units not in (None, "meters", "meter"):
        loaded.convert_units("meters")
    text = trimesh.exchange.obj.export_obj(
        loaded, include_normals=False, include_color=False, include_texture=False
    )
    return text.encode()


def _is_whole(path: Path) -> bool:
    try:
        body, _, seal = path.read_bytes().rpartition(SEAL)
    except OSError:
        return False
    return bool(body) and seal.strip() == hashlib.sha256(body).hexdigest().encode()


def _write_whole(path: Path, body: bytes) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, draft = tempfile.mkstemp(prefix=f".{path.stem[:8]}.", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(body + SEAL + hashlib.sha256(body).hexdigest().encode() + b"\n")
            file.flush()
            os.fsync(file.fileno())
        os.replace(draft, path)
    except BaseException:
        Path(draft).unlink(missing_ok=True)
        raise

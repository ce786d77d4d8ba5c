"""Meshes of a scene: their triangles, in metres, and solids and sheets."""

from __future__ import annotations

import hashlib
import warnings
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from comove.arrays import Array
from comove.errors import ComoveWarning, MeshError, SceneError
from comove.geometry.convex_decomposition import SETTINGS, ConvexDecomposition, decompose
from comove.geometry.topology import Parts, solids_and_sheets
from comove.geometry.triangles import FORMATS, read_bytes, triangles_of
from comove.io.keys import LARGE

MAX_FACES = 50_000
FLAT = 1e-9
"""Share of its length below which the thickness of a mesh is rounding."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """A mesh that was read from a file, in metres.

    Attributes
    ----------
    triangles : array, shape (n_triangles, 3, 3), all triangles of the file [m]
    parts : the solids and sheets that they form
    width : longest side of the box around them [m]
    sha256 : checksum of the file
    """

    triangles: Array
    parts: Parts
    width: float
    sha256: str

    @property
    def is_flat(self) -> bool:
        """Return whether all points are in one plane, up to rounding."""
        points = self.triangles.reshape(-1, 3)
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        return bool(spread[2] <= FLAT * spread[0])

    def decomposed(self, resolution: float | None, *, few: bool) -> ConvexDecomposition:
        """Return convex polytopes that contain the mesh. See `comove.geometry.convex_decomposition.decompose`."""
        return _decomposed(self, resolution, few)


def read_mesh(
    path: Path,
    scale: float,
    *,
    file: object,
    key: str,
    data: tuple[bytes, str] | None = None,
    called: str | None = None,
) -> Mesh:
    """Read the mesh in a file.

    Parameters
    ----------
    scale : factor from the file's lengths to metres
    file, key : scene file and key that name the mesh, for messages
    data : contents and suffix of a mesh that is a part of the file
    called : the key in warnings, if it is called differently there

    Raises
    ------
    SceneError
        If the file holds no mesh that can be used.
    """

    try:
        suffix = path.suffix.lower()
        if data is None and suffix not in FORMATS:
            known = ", ".join(name[1:].upper() for name in FORMATS)
            raise MeshError("it is no mesh that can be read", way_out=f"write it in one of {known}")
        contents, suffix = data or (read_bytes(path), suffix)
        mesh, told = _read(contents, suffix, scale)
    except MeshError as error:
        raise SceneError(
            f"'{path.name}': {error.message}", file=file, key=key, way_out=error.way_out
        ) from None
    place = ": ".join(str(part) for part in (file, called or key) if part is not None)
    for message in told:
        warnings.warn(f"{place}: '{path.name}' {message}", ComoveWarning, stacklevel=6)
    return mesh


@lru_cache(maxsize=16)  # the same file is often several obstacles, or asked for again
def _read(data: bytes, suffix: str, scale: float) -> tuple[Mesh, tuple[str, ...]]:
    """Return the mesh and its warnings."""
    vertices, faces = triangles_of(data, suffix)
    if len(faces) > MAX_FACES:
        raise MeshError(f"it has {len(faces)} triangles", way_out=f"decimate it to {MAX_FACES} or fewer")
    triangles = scale * vertices[faces]
    with np.errstate(over="ignore", invalid="ignore"):
        width = float(np.ptp(triangles, axis=(0, 1)).max())
    if not 0.0 < width < np.inf:
        raise MeshError(
            "it is a point" if width == 0.0 else "it has no size", way_out="write it anew, or another scale"
        )
    parts = solids_and_sheets(scale * vertices, faces)
    told: tuple[str, ...] = ()
    n_parts, n_sheets = len(parts.solids) + len(parts.sheets), len(parts.sheets)
    if n_sheets:
        which = "" if n_sheets == n_parts else f" in {n_sheets} of its {n_parts} parts"
        told = (
            f"is not closed{which}: what is open counts as thin walls (as a load {SETTINGS.sheet * width:.2g} m "
            "thick), and nothing is inside it; close it if it is a solid",
        )
    if width > LARGE:
        told = (
            *told,
            f"is {width:g} m long, which looks like millimetres; lengths are in metres, or add scale: 0.001",
        )
    return Mesh(triangles, parts, width, hashlib.sha256(data).hexdigest()), told


@lru_cache(maxsize=16)
def _decomposed(mesh: Mesh, resolution: float | None, few: bool) -> ConvexDecomposition:
    return decompose(mesh.parts, resolution, few=few)

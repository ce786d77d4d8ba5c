"""Strict readers of mesh files, which refuse damaged files."""

from comove.geometry.triangles.reader import elements_of
from comove.geometry.triangles.reader import (
    FORMATS,
    MAX_BYTES,
    as_stl,
    read_bytes,
    triangles_of,
)

__all__ = [
    "FORMATS",
    "MAX_BYTES",
    "as_stl",
    "elements_of",
    "read_bytes",
    "triangles_of",
]

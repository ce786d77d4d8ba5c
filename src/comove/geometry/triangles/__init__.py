"""Strict readers of triangles from mesh files: damaged files and false claims are refused, in one sentence."""

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

"""Reader of meshes in all known formats, with shared checks.

XML is read safely from hostile files: no document type, limited depth, limited number of elements. Namespaces are not
resolved: names are kept as they are written, as in ``drake:acceleration``. So prefixes need not be declared, which
many robot models omit.
"""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import MeshError

MAX_FACES = 1_000_000
ANEW = "write it anew: it is cut off or damaged"
SIMPLER = "simplify it: its hull will do"
_DECIMAL = b"0123456789+-.eE "


def numbers(texts: Sequence[bytes]) -> Array:
    """Return plain decimal numbers from texts. NaN, infinity, underscores and decimal commas are refused."""
    joined = b" ".join(texts)
    if not joined.translate(None, _DECIMAL):
        with suppress(ValueError, DeprecationWarning), warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # raised for no number; error in new NumPy
            values = np.fromstring(joined, sep=" ")
            if len(values) == len(texts):
                return values
    bad = next(text for text in texts if not _is_number(text))
    raise MeshError(f"'{shown(bad)}' is no number", way_out=ANEW)


def _is_number(text: bytes) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return not text.translate(None, _DECIMAL)


def whole(text: bytes, what: str, largest: int) -> int:
    """Return a whole number from 0 to `largest`, the available items."""
    if not text.isdigit() or len(text) > 18:
        raise MeshError(f"'{shown(text)}' is no number of {what}", way_out=ANEW)
    if int(text) > largest:
        raise MeshError(f"it claims {int(text)} {what} and has room for {largest}", way_out=ANEW)
    return int(text)


def shown(text: bytes) -> str:
    """Return a file's text, shortened and printable, to quote in messages."""
    words = text[:40].decode(errors="replace")
    return "".join(c if c.isprintable() else "?" for c in words) + ("..." if len(text) > 40 else "")


def fans(sizes: Integers, corners: Integers) -> Integers:
    """Return the triangles (n, 3) of polygons, split into fans. A fan also covers a concave polygon.

    Parameters
    ----------
    sizes : number of corners of each polygon
    corners : corners of all polygons, one after the other
    """
    if len(sizes) and sizes.min() < 3:
        raise MeshError(f"a face has {sizes.min()} corners", way_out="write triangles")
    starts = np.cumsum(sizes) - sizes
    require_few(int((sizes - 2).sum()))
    polygon = np.repeat(np.arange(len(sizes)), sizes - 2)
    first = starts[polygon]
    step = np.arange(len(polygon)) - np.repeat(np.cumsum(sizes - 2) - (sizes - 2), sizes - 2)
    return np.stack([corners[first], corners[first + step + 1], corners[first + step + 2]], axis=1)


def require_few(n_faces: int) -> None:
    """Raise MeshError for more than `MAX_FACES` faces."""
    if n_faces > MAX_FACES:
        raise MeshError(f"it has {n_faces} triangles, more than {MAX_FACES}", way_out=SIMPLER)


MAX_DEPTH = 64  # levels of elements
MAX_ELEMENTS = 300_000
MAX_ATTRIBUTES = 64  # of one element


def elements_of(data: bytes) -> ET.Element:
    """Return the root element of a document; names keep their prefixes.

    Raises
    ------
    MeshError
        If it is not XML, has a document type, or exceeds a limit of size.
    """
    builder, parser = _Builder(), expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = builder.start, builder.end
    parser.CharacterDataHandler, parser.StartDoctypeDeclHandler = builder.data, _refuse_doctype
    try:
        parser.Parse(data, True)
        return builder.close()
    except expat.ExpatError as error:
        raise MeshError(f"it is not XML: {error}", way_out="correct it") from None
    except (ValueError, LookupError) as error:  # an encoding that is not known
        raise MeshError(f"it cannot be read: {error}", way_out="write it in UTF-8") from None


def _refuse_doctype(*_: Any) -> None:
    raise MeshError("it has a document type (<!DOCTYPE>)", way_out="leave it out, and write entities out")


class _Builder(ET.TreeBuilder):
    """A builder of trees of limited size."""

    depth = n_elements = 0

    def start(self, tag: Any, attributes: Any) -> ET.Element:
        """Open an element, or raise MeshError where a limit is exceeded."""
        self.depth += 1
        self.n_elements += 1
        if self.depth > MAX_DEPTH:
            raise MeshError(f"the nesting is deeper than {MAX_DEPTH} levels", way_out="flatten it")
        if self.n_elements > MAX_ELEMENTS:
            raise MeshError(
                f"it has more than {MAX_ELEMENTS} elements", way_out="leave out what is not needed"
            )
        if len(attributes) > MAX_ATTRIBUTES:
            raise MeshError(
                f"an element has {len(attributes)} attributes", way_out=f"write at most {MAX_ATTRIBUTES}"
            )
        return super().start(tag, attributes)

    def end(self, tag: Any) -> ET.Element:
        """Close an element."""
        self.depth -= 1
        return super().end(tag)


FORMATS = {".dae": "collada", ".obj": "obj", ".off": "off", ".ply": "ply", ".stl": "stl"}
"""Formats by the suffix of their files; each has a module, which is loaded with the first such file."""
MAX_BYTES = 50_000_000
FARTHEST = 1e9  # largest coordinate; larger ones are no lengths, and overflow single precision


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes, at most `MAX_BYTES` + 1."""
    try:
        if not path.is_file():
            raise MeshError("it is no file", way_out="name a mesh")
        with open(path, "rb") as file:
            return file.read(MAX_BYTES + 1)
    except OSError as error:
        raise MeshError(f"it cannot be read: {error.strerror}", way_out="check its rights") from error


def triangles_of(data: bytes, suffix: str) -> tuple[Array, Integers]:
    """Return vertices and faces of a mesh, from bytes and suffix.

    Returns
    -------
    vertices : array, shape (n_vertices, 3), in the file's unit; of COLLADA in metres
    faces : array of int, shape (n_faces, 3); some may be degenerate

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
    if not (faces != np.roll(faces, 1, axis=1)).all(axis=1).any():
        raise MeshError("it holds no triangle with three corners", way_out=ANEW)
    return vertices, faces


def _reader(name: str) -> Callable[[bytes], tuple[Array, Integers]]:
    reader: Callable[[bytes], tuple[Array, Integers]] = getattr(
        import_module(f"comove.geometry.triangles.{name}"), f"read_{name}"
    )
    return reader


def as_stl(vertices: Array, faces: Integers) -> bytes:
    """Return triangles as a binary STL."""
    rows = np.zeros(len(faces), dtype=[("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("rest", "<u2")])
    rows["corners"] = vertices[faces]
    return bytes(80) + len(faces).to_bytes(4, "little") + rows.tobytes()

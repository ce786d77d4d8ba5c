"""Reader of PLY files: text, and binary of either byte order."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import MeshError
from comove.geometry.triangles.reader import ANEW, fans, numbers, shown, whole

MAX_HEADER = 65_536  # bytes
MAX_PARTS = 256  # elements, and properties of one
TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
ORDERS = {b"ascii": "", b"binary_little_endian": "<", b"binary_big_endian": ">"}
INDICES = ("vertex_indices", "vertex_index")
_WAY_OUT = "write vertices with x, y, z and faces with vertex_indices"


@dataclass
class _Property:
    """A property of a row: a number, or a list with `length` type."""

    name: str
    kind: str
    length: str = ""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def read_ply(data: bytes) -> tuple[Array, Integers]:
    """Return vertices and faces; further elements and properties are ignored."""
    order, elements, start = _header(data)
    body = _Body(data, start, order)
    vertices, faces = None, None
    for element in elements:
        columns = body.columns(element)
        if element.name == "vertex":
            vertices = _vertices(element, columns)
        if element.name == "face":
            faces = _faces(columns)
    if body.at < len(body.cells):
        raise MeshError("it holds more than its header says", way_out=ANEW)
    if vertices is None or faces is None:
        raise MeshError("it has no vertices, or no faces", way_out=_WAY_OUT)
    return vertices, faces


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Return byte order ("" for text), elements, and the data's position."""
    if data[:3] != b"ply":
        raise MeshError(
            "it is no PLY: it does not begin with 'ply'", way_out="correct its name, or write it anew"
        )
    end = data.find(b"end_header", 0, MAX_HEADER)
    if end < 0:
        raise MeshError("its header has no end", way_out=ANEW)
    after = end + len(b"end_header")
    start = after + (2 if data[after : after + 2] == b"\r\n" else 1)
    order, elements = None, []
    for line in data[:end].replace(b"\r", b"\n").split(b"\n")[1:]:
        words = line.split()
        if not words or words[0] in (b"comment", b"obj_info"):
            continue
        if words[0] == b"format" and len(words) == 3 and words[1] in ORDERS:
            order = ORDERS[words[1]]
        elif words[0] == b"element" and len(words) == 3:
            elements.append(_Element(words[1].decode(errors="replace"), whole(words[2], "rows", len(data))))
        elif words[0] == b"property" and elements:
            elements[-1].properties.append(_property(words[1:]))
        else:
            raise MeshError(f"its header says '{shown(line)}'", way_out=ANEW)
        if max(len(elements), *(len(e.properties) for e in elements[-1:]), 0) > MAX_PARTS:
            raise MeshError(f"its header has more than {MAX_PARTS} elements or properties", way_out=_WAY_OUT)
    names = [element.name for element in elements]
    if order is None or len(set(names)) < len(names):
        raise MeshError("its header names no format, or an element twice", way_out=ANEW)
    return order, elements, start


def _property(words: list[bytes]) -> _Property:
    texts = [word.decode(errors="replace") for word in words]
    match texts:
        case ["list", length, kind, name] if TYPES.get(length, "f")[0] in "iu" and kind in TYPES:
            return _Property(name, TYPES[kind], TYPES[length])
        case [kind, name] if kind in TYPES:
            return _Property(name, TYPES[kind])
    raise MeshError(f"it has the property '{shown(b' '.join(words))}'", way_out=ANEW)


Columns = dict[str, tuple[Integers, Array]]
"""By property: how many numbers each row has, and all of them."""


def _vertices(element: _Element, columns: Columns) -> Array:
    plain = {p.name for p in element.properties if not p.length}
    if not plain >= {"x", "y", "z"}:
        raise MeshError("its vertices have no x, y and z", way_out=_WAY_OUT)
    return np.stack([columns[axis][1] for axis in "xyz"], axis=1)


def _faces(columns: Columns) -> Integers:
    for name in INDICES:
        if name in columns:
            sizes, corners = columns[name]
            if not (corners == np.round(corners)).all():
                raise MeshError("a face has a corner that is no whole number", way_out=ANEW)
            return fans(sizes, corners.astype(np.int64))
    raise MeshError("its faces have no vertex_indices", way_out=_WAY_OUT)


class _Body:
    """The data of a file: numbers, read one element after the other."""

    def __init__(self, data: bytes, start: int, order: str):
        self.order, self.at = order, start if order else 0
        self.cells = np.frombuffer(data, np.uint8) if order else numbers(data[start:].split())

    def columns(self, element: _Element) -> Columns:
        """Return all rows of an element, by property.

        They are read at once where all are as long as the first, else one after the other.
        """
        names, count, start = [p.name for p in element.properties], element.count, self.at
        if not count:
            return dict.fromkeys(names, (np.zeros(0, np.int64), np.zeros(0)))
        rows = [self._row(element)]
        width = self.at - start
        if count * width <= len(self.cells) - start:
            table, left, found, alike = (
                self.cells[start : start + count * width].reshape(count, -1),
                0,
                {},
                True,
            )
            for p, own in zip(element.properties, rows[0], strict=True):
                if p.length:
                    left += self._width(p.length)
                    sizes = self._numbers(table[:, left - self._width(p.length) : left], p.length)
                    alike &= bool((sizes == len(own)).all())
                left += len(own) * self._width(p.kind)
                values = self._numbers(table[:, left - len(own) * self._width(p.kind) : left], p.kind)
                found[p.name] = np.full(count, len(own)), values.ravel()
            if alike:
                self.at = start + count * width
                return found
        rows += [self._row(element) for _ in range(count - 1)]
        return {
            name: (np.array([len(values) for values in column], np.int64), np.concatenate(column))
            for name, column in zip(names, zip(*rows, strict=True), strict=True)
        }

    def _row(self, element: _Element) -> list[Array]:
        """Return the numbers of each property in the present row."""
        row = []
        for p in element.properties:
            size = float(self._taken(p.length, 1)[0]) if p.length else 1.0
            if not (0.0 <= size < np.inf and size.is_integer()):
                raise MeshError(f"it claims a list of {size:g}", way_out=ANEW)
            row.append(self._taken(p.kind, int(size)))
        return row

    def _taken(self, kind: str, n: int) -> Array:
        first, self.at = self.at, self.at + n * self._width(kind)
        if self.at > len(self.cells):
            raise MeshError("it ends before all that its header claims", way_out=ANEW)
        return self._numbers(self.cells[first : self.at], kind)

    def _width(self, kind: str) -> int:
        return np.dtype(kind).itemsize if self.order else 1

    def _numbers(self, cells: np.ndarray, kind: str) -> Array:
        if self.order:
            cells = np.ascontiguousarray(cells).view(self.order + kind)
        return cells.astype(np.float64)

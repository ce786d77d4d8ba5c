"""Reader of PLY files: text, and binary of either byte order."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from comove.errors import MeshError
from comove.geometry.triangles.reader import ANEW, Array, Ints, fans, numbers, shown, whole

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
    """A property that has one number per row, or a list of numbers whose length has the type `length`."""

    name: str
    kind: str
    length: str = ""


@dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property] = field(default_factory=list)


def read_ply(data: bytes) -> tuple[Array, Ints]:
    """Return vertices and faces; further elements and properties are ignored."""
    order, elements, start = _header(data)
    body: _Text | _Binary = _Text(data[start:]) if not order else _Binary(data, start, order)
    vertices, faces = None, None
    for element in elements:
        columns = body.columns(element)
        if element.name == "vertex":
            vertices = _vertices(element, columns)
        if element.name == "face":
            faces = _faces(columns)
    body.require_end()
    if vertices is None or faces is None:
        raise MeshError("it has no vertices, or no faces", way_out=_WAY_OUT)
    return vertices, faces


def _header(data: bytes) -> tuple[str, list[_Element], int]:
    """Return the byte order ("" for text), the elements, and the position at which their data begin."""
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


Columns = dict[str, tuple[Ints, Array]]
"""By property: how many numbers each row has, and all of them."""


def _vertices(element: _Element, columns: Columns) -> Array:
    plain = {p.name for p in element.properties if not p.length}
    if not plain >= {"x", "y", "z"}:
        raise MeshError("its vertices have no x, y and z", way_out=_WAY_OUT)
    return np.stack([columns[axis][1] for axis in "xyz"], axis=1)


def _faces(columns: Columns) -> Ints:
    for name in INDICES:
        if name in columns:
            sizes, corners = columns[name]
            if not (corners == np.round(corners)).all():
                raise MeshError("a face has a corner that is no whole number", way_out=ANEW)
            return fans(sizes, corners.astype(np.int64))
    raise MeshError("its faces have no vertex_indices", way_out=_WAY_OUT)


class _Text:
    """A reader of the words after the header."""

    def __init__(self, data: bytes):
        self.words, self.at = data.split(), 0

    def columns(self, element: _Element) -> Columns:
        """Return all rows of an element, by property."""
        width = len(element.properties)
        if all(not p.length for p in element.properties):
            rows = self._taken(element.count * width)
            return {
                p.name: (np.ones(element.count, np.int64), numbers(rows[i::width]))
                for i, p in enumerate(element.properties)
            }
        found: dict[str, tuple[list[int], list[bytes]]] = {p.name: ([], []) for p in element.properties}
        for _ in range(element.count):
            for p in element.properties:
                left = len(self.words) - self.at - 1
                size = whole(self._taken(1)[0], "corners", left) if p.length else 1
                found[p.name][0].append(size)
                found[p.name][1].extend(self._taken(size))
        return {name: (np.array(s, np.int64), numbers(words)) for name, (s, words) in found.items()}

    def _taken(self, n: int) -> list[bytes]:
        if n > len(self.words) - self.at:
            raise MeshError("it ends before all that its header claims", way_out=ANEW)
        self.at += n
        return self.words[self.at - n : self.at]

    def require_end(self) -> None:
        """Refuse data that the header does not declare."""
        if self.at < len(self.words):
            raise MeshError("it holds more than its header says", way_out=ANEW)


class _Binary:
    """A reader of the bytes after the header."""

    def __init__(self, data: bytes, start: int, order: str):
        self.data, self.at, self.order = data, start, order

    def columns(self, element: _Element) -> Columns:
        """Return all rows of an element, by property.

        They are read at once where all are as long as the first, else one after the other.
        """
        if not element.count:
            return {p.name: (np.zeros(0, np.int64), np.zeros(0)) for p in element.properties}
        start = self.at
        dtype = np.dtype(self._row(element))
        self.at, n_bytes = start, element.count * dtype.itemsize
        if n_bytes <= len(self.data) - start:
            rows = np.frombuffer(self.data, dtype, element.count, start)
            if all(
                (rows[f"{p.name} n"] == rows[f"{p.name} n"][0]).all() for p in element.properties if p.length
            ):
                self.at += n_bytes
                return {p.name: _column(rows[p.name]) for p in element.properties}
        found: dict[str, list[Array]] = {p.name: [] for p in element.properties}
        for _ in range(element.count):
            before = self.at
            row = np.frombuffer(self.data, np.dtype(self._row(element)), 1, before)[0]
            for p in element.properties:
                found[p.name].append(np.atleast_1d(row[p.name]))
        return {
            name: (np.array([len(v) for v in values], np.int64), np.concatenate(values).astype(np.float64))
            for name, values in found.items()
        }

    def _row(self, element: _Element) -> list[tuple]:
        """Return the fields of the row that begins at the present position, and move to its end."""
        fields: list[tuple] = []
        for p in element.properties:
            if not p.length:
                fields.append((p.name, self.order + p.kind))
                self._skip(np.dtype(p.kind).itemsize)
                continue
            (size,) = np.frombuffer(self._skip(np.dtype(p.length).itemsize), self.order + p.length)
            if size < 0:
                raise MeshError(f"it claims a list of {size}", way_out=ANEW)
            fields += [(f"{p.name} n", self.order + p.length), (p.name, self.order + p.kind, (int(size),))]
            self._skip(int(size) * np.dtype(p.kind).itemsize)
        return fields

    def _skip(self, n: int) -> bytes:
        if n > len(self.data) - self.at:
            raise MeshError("it ends before all that its header claims", way_out=ANEW)
        self.at += n
        return self.data[self.at - n : self.at]

    def require_end(self) -> None:
        """Refuse data that the header does not declare."""
        if self.at < len(self.data):
            raise MeshError("it holds more than its header says", way_out=ANEW)


def _column(values: np.ndarray) -> tuple[Ints, Array]:
    size = values.shape[1] if values.ndim == 2 else 1
    return np.full(len(values), size, np.int64), values.astype(np.float64).ravel()

"""Reader of COLLADA files: the triangles of their scene, in metres.

As everywhere in ROS, `up_axis` is ignored: a mesh is placed in its link's frame by its numbers alone.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np

from comove.errors import MeshError
from comove.geometry.triangles.reader import (
    ANEW,
    MAX_DEPTH,
    Array,
    Integers,
    elements_of,
    fans,
    numbers,
    require_few,
    shown,
)

MAX_NODES = 10_000
_EMPTY = ("lines", "linestrips")


def read_collada(data: bytes) -> tuple[Array, Integers]:
    """Return vertices [m] and faces of the scene that the file shows."""
    root = elements_of(data)
    for element in root.iter():
        element.tag = element.tag.rpartition(":")[2]
    if root.tag != "COLLADA":
        raise MeshError(f"it is a <{shown(root.tag.encode())}>, not a <COLLADA>", way_out="correct its name")
    document = _Document(root)
    shapes = list(document.shapes(_scene(root, document), np.eye(4), 0))
    if not shapes:
        raise MeshError("its scene shows nothing", way_out="write triangles into it")
    vertices = np.concatenate(shapes).reshape(-1, 3) * _metres(root)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _metres(root: ET.Element) -> float:
    unit = root.find("asset/unit")
    metres = 1.0 if unit is None else numbers([unit.get("meter", "1").strip().encode()])[0]
    if not 0.0 < metres < 1e6:
        raise MeshError(f"its unit has {metres:g} m", way_out='write how many metres it has: meter="0.001"')
    return float(metres)


def _scene(root: ET.Element, document: _Document) -> ET.Element:
    shown_scene = root.find("scene/instance_visual_scene")
    if shown_scene is not None:
        return document.named(shown_scene, "visual_scene")
    first = root.find("library_visual_scenes/visual_scene")
    if first is None:
        raise MeshError("it has no scene", way_out=ANEW)
    return first


class _Document:
    """A document that finds elements by name and caches geometries."""

    def __init__(self, root: ET.Element):
        self.by_id = {element.get("id"): element for element in root.iter() if element.get("id")}
        self.read: dict[str, Array] = {}
        self.n_nodes = self.n_faces = 0

    def named(self, reference: ET.Element, tag: str, key: str = "url") -> ET.Element:
        """Return the element to which an element refers."""
        name = reference.get(key, "")
        found = self.by_id.get(name.removeprefix("#"))
        if not name.startswith("#") or found is None or found.tag != tag:
            raise MeshError(f"there is no <{tag}> '{shown(name.encode())}' in it", way_out=ANEW)
        return found

    def shapes(self, node: ET.Element, place: Array, depth: int) -> Iterator[Array]:
        """Yield the triangles (n, 3, 3) of all geometries below a node. The nodes' transformations are applied."""
        self._count(depth)
        for part in node:
            if part.tag in _TRANSFORMS:
                place = place @ _transform(part)
            elif part.tag in ("lookat", "skew", "instance_controller"):
                raise MeshError(
                    f"it holds a <{part.tag}>, which is not read", way_out="write plain triangles"
                )
        for part in node:
            if part.tag == "node":
                yield from self.shapes(part, place, depth + 1)
            elif part.tag == "instance_node":
                yield from self.shapes(self.named(part, "node"), place, depth + 1)
            elif part.tag == "instance_geometry":
                triangles = self.geometry(self.named(part, "geometry"))
                self._count(depth)
                self.n_faces += len(triangles)
                require_few(self.n_faces)
                yield triangles @ place[:3, :3].T + place[:3, 3]

    def _count(self, depth: int) -> None:
        self.n_nodes += 1
        if self.n_nodes > MAX_NODES or depth > MAX_DEPTH:
            raise MeshError(
                "its nodes go round in a circle, or are too many", way_out="write each shape once"
            )

    def geometry(self, element: ET.Element) -> Array:
        """Return the triangles of a geometry in its own frame; array, shape (n, 3, 3)."""
        name = element.get("id", "")
        if name not in self.read:
            mesh = element.find("mesh")
            if mesh is None:
                raise MeshError(
                    f"the geometry '{shown(name.encode())}' is no <mesh>", way_out="write triangles"
                )
            lists = [part for part in mesh if part.tag not in ("source", "vertices", "extra", *_EMPTY)]
            self.read[name] = np.concatenate([np.zeros((0, 3, 3)), *map(self._triangles, lists)])
        return self.read[name]

    def _triangles(self, part: ET.Element) -> Array:
        if part.tag not in ("triangles", "polylist", "polygons", "tristrips", "trifans"):
            raise MeshError(
                f"it holds <{shown(part.tag.encode())}>, which is not read", way_out="write triangles"
            )
        vertices, offset, stride = self._input(part)
        runs = [_indices(p.text, stride)[:, offset] for p in part.findall("p")]
        if part.find("ph") is not None:
            raise MeshError("it holds polygons with holes", way_out="write triangles")
        corners = np.concatenate([np.zeros(0, np.int64), *runs])
        if part.tag == "triangles":
            faces = _whole_rows(corners)
        elif part.tag == "polylist":
            sizes = _indices(part.findtext("vcount"), 1)[:, 0]
            if sizes.sum() != len(corners):
                raise MeshError(
                    f"its polygons claim {sizes.sum()} corners and have {len(corners)}", way_out=ANEW
                )
            faces = fans(sizes, corners)
        elif part.tag == "tristrips":
            faces = np.concatenate(
                [np.zeros((0, 3), np.int64)]
                + [np.stack([run[:-2], run[1:-1], run[2:]], axis=1) for run in runs]
            )
        else:
            faces = fans(np.array([len(run) for run in runs], np.int64), corners)
        if len(faces) and faces.max() >= len(vertices):
            raise MeshError(f"a face has the corner {faces.max()} of {len(vertices)}", way_out=ANEW)
        return vertices[faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]]

    def _input(self, part: ET.Element) -> tuple[Array, int, int]:
        """Return a face list's vertices, and index offset and stride per corner."""
        inputs = part.findall("input")
        offsets = [_whole(one, "offset") for one in inputs]
        vertex = [k for k, one in enumerate(inputs) if one.get("semantic") == "VERTEX"]
        if len(vertex) != 1:
            raise MeshError("its faces do not say which vertices they have", way_out=ANEW)
        positions = self.named(inputs[vertex[0]], "vertices", "source").findall("input[@semantic='POSITION']")
        if len(positions) != 1:
            raise MeshError("its vertices have no positions", way_out=ANEW)
        source = self.named(positions[0], "source", "source")
        return self._places(source), offsets[vertex[0]], max(offsets) + 1

    def _places(self, source: ET.Element) -> Array:
        accessor = source.find("technique_common/accessor")
        if accessor is None:
            raise MeshError("its vertices have no positions", way_out=ANEW)
        array = self.named(accessor, "float_array", "source")
        values = numbers((array.text or "").encode().split())
        count, stride = _whole(accessor, "count"), _whole(accessor, "stride", 1)
        first = _whole(accessor, "offset", 0)
        if stride < 3 or len(values) != _whole(array, "count") or first + count * stride > len(values):
            raise MeshError(
                f"it claims {count} vertices of {stride} numbers and holds {len(values)} numbers",
                way_out=ANEW,
            )
        return values[first : first + count * stride].reshape(count, stride)[:, :3]


def _whole(element: ET.Element, key: str, default: int | None = None) -> int:
    text = element.get(key, "" if default is None else str(default)).strip()
    if not text.isascii() or not text.isdigit() or len(text) > 9:
        raise MeshError(f"a <{element.tag}> has the {key} '{shown(text.encode())}'", way_out=ANEW)
    return int(text)


def _indices(text: str | None, stride: int) -> Integers:
    """Return whole numbers from 0 on, in rows of `stride`."""
    values = numbers((text or "").encode().split())
    if len(values) % stride or (values != np.round(values)).any() or values.min(initial=0.0) < 0:
        raise MeshError("the corners of its faces are no whole numbers, or too few", way_out=ANEW)
    if values.max(initial=0.0) >= 2**31:
        raise MeshError(f"a face has the corner {values.max():g}", way_out=ANEW)
    return values.astype(np.int64).reshape(-1, stride)


def _whole_rows(corners: Integers) -> Integers:
    if len(corners) % 3:
        raise MeshError("its last triangle is not whole", way_out=ANEW)
    return corners.reshape(-1, 3)


_TRANSFORMS = {"matrix": 16, "translate": 3, "rotate": 4, "scale": 3}


def _transform(element: ET.Element) -> Array:
    """Return the transformation that an element of a node describes; array, shape (4, 4)."""
    values = numbers((element.text or "").encode().split())
    if len(values) != _TRANSFORMS[element.tag]:
        raise MeshError(f"a <{element.tag}> has {len(values)} numbers", way_out=ANEW)
    matrix = np.eye(4)
    if element.tag == "matrix":
        return values.reshape(4, 4)
    if element.tag == "translate":
        matrix[:3, 3] = values
    elif element.tag == "scale":
        matrix[:3, :3] = np.diag(values)
    elif np.linalg.norm(values[:3]) > 0.0:
        x, y, z = values[:3] / np.linalg.norm(values[:3])
        across, angle = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]), np.radians(values[3])
        matrix[:3, :3] += np.sin(angle) * across + (1.0 - np.cos(angle)) * across @ across
    return matrix

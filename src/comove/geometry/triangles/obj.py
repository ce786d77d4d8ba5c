"""Reader of OBJ files: vertices and faces.

Materials and groups do not affect the shape, and the files that they name are not opened.
"""

from __future__ import annotations

import re

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import MeshError
from comove.geometry.triangles.reader import ANEW, fans, numbers, shown

LEFT_ALONE = frozenset(
    b"vt vn vp g o s l p mg mtllib usemtl maplib usemap lod bevel c_interp d_interp shadow_obj trace_obj".split()
)
_INDEX = re.compile(rb"-?[0-9]{1,10}(?=/|$)")


def read_obj(data: bytes) -> tuple[Array, Integers]:
    """Return vertices and faces; negative numbers in a face count back from its line."""
    places: list[bytes] = []
    sizes: list[int] = []
    corners: list[int] = []
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    for number, line in enumerate(data.replace(b"\\\n", b" ").split(b"\n"), start=1):
        words = line.partition(b"#")[0].split()
        if not words:
            continue
        kind = words[0]
        if kind == b"v":
            # A vertex may have a weight, or a colour as some tools write it.
            if len(words) not in (4, 7) and (len(words) != 5 or float(numbers(words[4:])[0]) != 1.0):
                raise MeshError(
                    f"line {number}: a vertex has {len(words) - 1} numbers",
                    way_out="write three: x, y, z",
                )
            places += words[1:4]
        elif kind == b"f":
            sizes.append(len(words) - 1)
            corners += _corners(words[1:], len(places) // 3, number)
        elif kind not in LEFT_ALONE:
            raise MeshError(
                f"line {number}: '{shown(kind)}' is not known", way_out="write vertices and faces alone"
            )
    return numbers(places).reshape(-1, 3), fans(np.array(sizes, dtype=np.int64), np.array(corners, np.int64))


def _corners(words: list[bytes], n_vertices: int, number: int) -> list[int]:
    """Return a face's vertex indices, from 0, without texture and normal."""
    said = [int(found[0]) for found in map(_INDEX.match, words) if found]
    if len(said) < len(words):
        raise MeshError(f"line {number}: '{shown(b' '.join(words))}' is no face", way_out=ANEW)
    found = [k - 1 if k > 0 else n_vertices + k for k in said]
    if 0 in said or min(found, default=0) < 0:
        bad = said[min(range(len(said)), key=lambda i: (said[i] != 0, found[i]))]
        raise MeshError(f"line {number}: there is no vertex {bad}", way_out=ANEW)
    return found

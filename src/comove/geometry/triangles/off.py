"""Reader of OFF files: counts, vertices, then faces by the numbers of their vertices."""

from __future__ import annotations

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import MeshError
from comove.geometry.triangles.reader import ANEW, fans, numbers, shown, whole


def read_off(data: bytes) -> tuple[Array, Integers]:
    """Return vertices and faces; colours after a face are ignored."""
    lines = [line.partition(b"#")[0].split() for line in data.replace(b"\r", b"\n").split(b"\n")]
    lines = [words for words in lines if words]
    if not lines or lines[0][0] != b"OFF":
        raise MeshError(
            "it is no OFF: it does not begin with 'OFF'", way_out="correct its name, or write it anew"
        )
    lines[0] = lines[0][1:]  # the counts may stand on the first line
    lines = lines if lines[0] else lines[1:]
    if not lines or len(lines[0]) not in (2, 3):
        raise MeshError("it does not say how many vertices and faces it has", way_out=ANEW)
    n_vertices = whole(lines[0][0], "vertices", len(lines))
    n_faces = whole(lines[0][1], "faces", len(lines))
    if len(lines) < 1 + n_vertices + n_faces:
        raise MeshError(f"it claims {n_vertices + n_faces} lines and holds {len(lines) - 1}", way_out=ANEW)
    rows = lines[1 : 1 + n_vertices]
    for k, words in enumerate(rows):
        if len(words) < 3:
            raise MeshError(
                f"vertex {k} is '{shown(b' '.join(words))}'", way_out="write three numbers: x, y, z"
            )
    vertices = numbers([word for words in rows for word in words[:3]]).reshape(-1, 3)
    sizes, corners = [], []
    for k, words in enumerate(lines[1 + n_vertices : 1 + n_vertices + n_faces]):
        size = whole(words[0], "corners", len(words) - 1)
        sizes.append(size)
        own = [whole(word, "vertices", len(data)) for word in words[1 : 1 + size]]
        if max(own, default=0) >= n_vertices:
            raise MeshError(f"face {k} has the corner {max(own)} of {n_vertices}", way_out=ANEW)
        corners += own
    return vertices, fans(np.array(sizes, dtype=np.int64), np.array(corners, dtype=np.int64))

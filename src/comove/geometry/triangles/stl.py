"""Reader of STL files, binary and as text."""

from __future__ import annotations

import re

import numpy as np

from comove.arrays import Array, Integers
from comove.errors import MeshError
from comove.geometry.triangles.reader import ANEW, numbers, require_few, shown

HEADER, FACE = 84, 50  # bytes
_NAMES = re.compile(rb"^[ \t]*(end)?solid\b[^\r\n]*", re.MULTILINE)
_WORDS = {
    **{0: b"facet", 1: b"normal", 5: b"outer", 6: b"loop", 19: b"endloop", 20: b"endfacet"},
    **{7: b"vertex", 11: b"vertex", 15: b"vertex"},
}
_FACET = 21  # words


def read_stl(data: bytes) -> tuple[Array, Integers]:
    """Return vertices, three per face, and faces; the normals in the file are ignored."""
    claimed = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    held = (len(data) - HEADER) // FACE
    if len(data) >= HEADER and claimed == held:
        require_few(claimed)
        rows = np.frombuffer(data, dtype=np.uint8, count=claimed * FACE, offset=HEADER).reshape(claimed, FACE)
        vertices = np.ascontiguousarray(rows[:, 12:48]).view("<f4").astype(np.float64).reshape(-1, 3)
    elif data[:5].lower() == b"solid":
        vertices = _text(data)
    elif len(data) < HEADER:
        raise MeshError(f"it has {len(data)} bytes, and the header of an STL has {HEADER}", way_out=ANEW)
    else:
        raise MeshError(f"it claims {claimed} triangles and holds {held}", way_out=ANEW)
    return vertices, np.arange(len(vertices)).reshape(-1, 3)


def _text(data: bytes) -> Array:
    words = _NAMES.sub(b"", data.lower().replace(b"\r", b"\n")).split()
    n_faces, rest = divmod(len(words), _FACET)
    require_few(n_faces)
    for place, word in _WORDS.items():
        for k, found in enumerate(words[place::_FACET]):
            if found != word:
                raise MeshError(
                    f"facet {k + 1} has '{shown(found)}' where '{word.decode()}' belongs", way_out=ANEW
                )
    if rest:
        raise MeshError(f"its facet {n_faces + 1} is not whole", way_out=ANEW)
    corners = [numbers(words[place::_FACET]) for place in (8, 9, 10, 12, 13, 14, 16, 17, 18)]
    return np.stack(corners, axis=1).reshape(-1, 3)

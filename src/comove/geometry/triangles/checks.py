"""Checks of numbers and faces that the readers of all formats share."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from comove.errors import MeshError

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

MAX_FACES = 1_000_000
ANEW = "write it anew: it is cut off or damaged"
SIMPLER = "simplify it: its hull will do"
_DECIMAL = b"0123456789+-.eE "


def numbers(texts: Sequence[bytes]) -> Array:
    """Return plain decimal numbers from their texts: no NaN, no infinity, no underscores, no decimal commas."""
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
    """Return a whole number from 0 to `largest`, the number of items for which there is room."""
    if not text.isdigit() or len(text) > 18:
        raise MeshError(f"'{shown(text)}' is no number of {what}", way_out=ANEW)
    if int(text) > largest:
        raise MeshError(f"it claims {int(text)} {what} and has room for {largest}", way_out=ANEW)
    return int(text)


def shown(text: bytes) -> str:
    """Return the first characters of a text in a file, made safe to be quoted in a message."""
    words = text[:40].decode(errors="replace")
    return "".join(c if c.isprintable() else "?" for c in words) + ("..." if len(text) > 40 else "")


def fans(sizes: Ints, corners: Ints) -> Ints:
    """Return the triangles (n, 3) of polygons, each split into a fan from its first corner.

    A fan also covers a concave polygon.

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
    """Refuse more than `MAX_FACES` faces."""
    if n_faces > MAX_FACES:
        raise MeshError(f"it has {n_faces} triangles, more than {MAX_FACES}", way_out=SIMPLER)

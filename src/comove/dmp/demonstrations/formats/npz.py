"""Recordings as NumPy archives, in the layout of comove's `solution.npz`.

One movement: `time` (n_steps,) [s] and `position` (n_steps, n_dims) [m]. Several manipulators recorded
together: `position` (n_steps, n_manipulators, n_dims) and their names in `manipulators`
(n_manipulators,). Optional: `orientation`, of the shape of `position` except for the last axis of length 4,
quaternions w x y z; `axes`, the names of the coordinates, (n_dims,) or (n_manipulators, n_dims); `unit`, the
unit of `position`, one for all or one per manipulator. Further arrays are ignored.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.dmp.demonstrations.plausibility import require_rate, seconds
from comove.dmp.demonstrations.samples import (
    AXES,
    TIME,
    UNIT,
    Format,
    Origin,
    RecordedSamples,
    by_manipulator,
    fault,
)
from comove.dmp.demonstrations.units import TIMES, unit_named
from comove.errors import OptionError
from comove.io.arrays import read_arrays
from comove.io.files import whole_file


def read(
    path: str | os.PathLike[str], *, time: str | None = None, rate: float | None = None
) -> dict[str, RecordedSamples]:
    """Read all movements of an archive.

    Parameters
    ----------
    path : archive in the layout of this module, up to 256 MB unpacked
    time : unit of `time` in brackets, "time [ms]"; seconds, or a unit inferred from its size, unless given
    rate : sampling rate [Hz], instead of `time`

    Returns
    -------
    demos : movement by manipulator, in the order of `manipulators`; "" if the archive names none

    Raises
    ------
    DemonstrationError
        If the archive cannot be read or is too large, or an array is missing or has a wrong shape; names it.
    """
    path = Path(path)
    arrays = read_arrays(path, ("time", "position"), ("manipulators", "orientation", "axes", "unit"))
    arrays["time"], notes = _seconds(path, arrays["time"], time, rate)
    position = arrays["position"]
    names = [""] if position.ndim != 3 else _manipulators(path, arrays)
    return {name: _movement(path, arrays, index, name, notes) for index, name in enumerate(names)}


def _seconds(
    path: Path, stamps: NDArray, time: str | None, rate: float | None
) -> tuple[NDArray, tuple[str, ...]]:
    """Return an archive's stamps in seconds, and notes. Arrays that are no stamps are left to the checks."""
    if stamps.ndim != 1 or stamps.dtype.kind not in "iuf" or (rate is not None and time is not None):
        if rate is None or time is None:
            return stamps, ()
        raise OptionError("both a time and a rate are given", key="rate", way_out="give one of them")
    if rate is not None:
        require_rate(rate)
        return np.arange(len(stamps)) / rate, (f"time at {rate:g} samples a second",)
    named, _, said = (time or "time").partition("[")
    unit = unit_named(said.rstrip("] ")) if said else None
    if named.strip() not in ("time", "") or (said and unit not in TIMES):
        raise OptionError(
            f"{time!r} is no time of the archive", file=path, key="time", way_out="give its unit: 'time [ms]'"
        )
    signed = stamps.astype(np.int64) if stamps.dtype.kind in "iu" else stamps
    return seconds(signed, unit, origin=Origin(path))


def write(path: str | os.PathLike[str], demos: RecordedSamples | Mapping[str, RecordedSamples]) -> None:
    """Write movements to an archive, without loss of any bit.

    Parameters
    ----------
    path : file to write; appears only when complete
    demos : one movement, or movements by manipulator with common time stamps

    Raises
    ------
    DemonstrationError
        The movements do not fit into one file, or the file cannot be written.
    """
    demos = by_manipulator(demos, path)
    single = list(demos) == [""]
    movements = list(demos.values())
    first = movements[0]

    def stacked(arrays: list[NDArray]) -> NDArray:
        return arrays[0] if single else np.stack(arrays, axis=1)

    arrays: dict[str, Any] = {
        "time": first.time,
        "position": stacked([demo.position for demo in movements]),
    }
    if not single:
        arrays["manipulators"] = np.array(list(demos))
    if first.orientation is not None:
        arrays["orientation"] = stacked([np.asarray(demo.orientation) for demo in movements])
    if any(demo.axes for demo in movements):
        arrays["axes"] = _text(
            path, "axes", [demo.axes or _unnamed(demo.n_dims) for demo in movements], single
        )
    if any(demo.unit != "m" for demo in movements):
        arrays["unit"] = _text(path, "unit", [demo.unit for demo in movements], single)
    with whole_file(path) as file:
        np.savez(file, **arrays)


FORMAT = Format("NPZ", read, suffixes=(".npz",), write=write, options=frozenset({"time", "rate"}))


def _unnamed(n_dims: int) -> tuple[str, ...]:
    return tuple(f"axis {dim}" for dim in range(n_dims)) if n_dims > 3 else AXES[:n_dims]


def _text(path: object, key: str, texts: list, single: bool) -> NDArray:
    """Return texts as an array; only the first one if `single`."""
    array = np.array(texts[0] if single else texts)
    if array.tolist() != (np.array(texts[0] if single else texts, dtype=object)).tolist():
        raise fault(path, key, "a name ends in a null character", "use letters, digits and underscores")
    return array


def _movement(
    path: Path, arrays: Mapping[str, NDArray], index: int, name: str, notes: tuple[str, ...]
) -> RecordedSamples:
    """Build the movement of one manipulator from the arrays of all."""
    origin, position, orientation = Origin(path), arrays["position"], arrays.get("orientation")
    if position.ndim == 3:
        origin = Origin(
            path,
            position=lambda sample, dim: f"position[{sample}, {index}, {dim}]",
            orientation=lambda sample: f"orientation[{sample}, {index}]",
        )
        if orientation is not None and orientation.shape[:2] != position.shape[:2]:
            raise fault(
                path,
                "orientation",
                f"has shape {orientation.shape} and position {position.shape}",
                "give one quaternion w x y z a row and manipulator",
            )
        position = position[:, index]
        orientation = None if orientation is None else orientation[:, index]
    unit, axes = arrays.get("unit"), arrays.get("axes")
    for key, texts, shapes in [
        ("unit", unit, [(), arrays["position"].shape[1:-1]]),
        ("axes", axes, [arrays["position"].shape[-1:], arrays["position"].shape[1:]]),
    ]:
        if texts is not None and (texts.dtype.kind != "U" or texts.shape not in shapes):
            raise fault(
                path,
                key,
                f"it holds {texts.dtype.name} of shape {texts.shape}, not texts that belong to position",
                f"save texts of shape {' or '.join(map(str, dict.fromkeys(shapes)))}",
            )
    return RecordedSamples(
        arrays["time"],
        position,
        f"{path.stem}.{name}" if name else path.stem,
        notes,
        unit="m" if unit is None else str(unit[index] if unit.ndim else unit),
        orientation=orientation,
        axes=() if axes is None else tuple((axes[index] if axes.ndim == 2 else axes).tolist()),
        stated=frozenset({TIME} if unit is None else {TIME, UNIT}),
        origin=origin,
    )


def _manipulators(path: Path, arrays: Mapping[str, NDArray]) -> list[str]:
    """Return the names along the second axis of `position`."""
    n_manipulators = arrays["position"].shape[1]
    names = arrays.get("manipulators")
    if names is None:
        message = f"the names of {n_manipulators} manipulators are missing"
    elif names.dtype.kind != "U" or names.ndim != 1:
        message = f"it holds {names.dtype.name} of shape {names.shape}, not names"
    elif len(names) != n_manipulators or not n_manipulators:
        message = f"it has {len(names)} names and position has {n_manipulators} manipulators"
    elif len(set(names.tolist())) < len(names) or "" in names:
        message = f"the names {', '.join(map(repr, names.tolist()))} are not distinct"
    else:
        return names.tolist()
    raise fault(path, "manipulators", message, "give one name, as text, for each manipulator")

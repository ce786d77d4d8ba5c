"""Plausibility of a recording: units, gaps, jumps, and lack of motion.

Recordings of all formats are checked here. Readers convert their stamps by `seconds`, which infers an unstated unit
where the numbers leave no doubt, and refuses them otherwise. `doubts` finds faults in a movement that is already in
metres (or radians) and seconds: a `Demonstration` warns of them, and commands that store movements refuse them where
`Doubt.is_unit` holds. Statements of a file or a user are never questioned.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array
from comove.dmp.demonstrations.samples import (
    HZ,
    IN_MEMORY,
    SAY_RATE,
    TIME,
    UNIT,
    WHICH_UNIT,
    Origin,
    fault,
)
from comove.dmp.demonstrations.units import ANGLES, LENGTHS, TIMES
from comove.errors import DemonstrationError, OptionError

SLOW = 1.0
"""Steps of a recorded movement are shorter than this [s]."""
STEPS = (4e-3, 0.1)
"""Steps by which an unstated unit of time is recognised [s]: 10 to 250 samples a second."""
SHORTEST_INFERRED = 0.2
"""A recording whose unit of time is inferred lasts at least as long [s]."""
FEW, WAYPOINTS = 20, 60.0
"""With fewer samples, and steps shorter than this [s], they may be way-points, which are seconds apart."""
EPOCHS = {"s": (1e9, 1e10), "ms": (1e12, 1e13), "us": (1e15, 1e16), "ns": (1e18, 1e19)}
"""Stamps between these count from 1970, in this unit: they lie between the years 2001 and 2286."""
EXTENTS = {"m": 5.0, "rad": 4.0 * np.pi}
"""A movement of a hand or a joint with a larger extent than this was probably recorded in another unit."""
SLOWEST_HAND = 2.0
"""Numbers that change more slowly than this [1/s] are hardly the millimetres of a hand, but metres of a vehicle."""
LOOKS_LIKE = {"m": "looks like millimetres", "rad": "looks like degrees"}
"""What a movement in this unit looks like when its numbers are too large."""
STILL = 1e-6
"""Movements with a smaller extent are none [m or rad]."""


@dataclass(frozen=True)
class Doubt:
    """A suspected fault of a recording.

    Attributes
    ----------
    mark : the phrase by which notes show that this was reported before
    message : the fault, its place and size
    way_out : the remedy
    key : option that settles it; "" if none does
    options : the same with a value, for the command that is printed
    """

    mark: str
    message: str
    way_out: str
    key: str = ""
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def is_unit(self) -> bool:
        """Return whether a wrong unit is suspected, of all numbers."""
        return bool(self.key)

    def __str__(self) -> str:
        return f"{self.message}; {self.way_out}"


def unit_of_time(stamps: NDArray) -> str | None:
    """Return the unit of stamps if their size proves it, else None.

    Stamps of the order of 1e9, 1e12, 1e15 or 1e18 count s, ms, us or ns from 1970. Steps below `SLOW` are seconds.
    Steps that are 4 to 100 ms (or us, ns) are these, unless the whole recording would be shorter than 0.2 s; a few
    samples are way-points then.

    Parameters
    ----------
    stamps : array, shape (n_steps,), of integers or floats
    """
    first = float(np.abs(stamps[0])) if len(stamps) else 0.0
    for unit, (least, most) in EPOCHS.items():
        if least <= first < most:
            return unit
    passed = np.diff(stamps).astype(np.float64)
    step = float(np.median(passed[passed > 0.0])) if (passed > 0.0).any() else 0.0
    if step < SLOW:
        return "s"
    for unit in ("ms", "us", "ns"):
        is_usual = STEPS[0] <= step * TIMES[unit] <= STEPS[1] * (1.0 + 1e-9)
        if is_usual and passed.sum() * TIMES[unit] >= SHORTEST_INFERRED:
            return unit
    return "s" if len(stamps) < FEW and step < WAYPOINTS else None


def seconds(
    stamps: NDArray,
    unit: str | None = None,
    *,
    name: str = "time",
    origin: Origin = IN_MEMORY,
    way_out: str = "",
) -> tuple[Array, tuple[str, ...]]:
    """Return stamps in seconds, and notes on inferred units.

    Stamps that count from 1970 become seconds since the first one, computed from integers where they are integers, so
    that no nanosecond is lost.

    Parameters
    ----------
    stamps : array, shape (n_steps,), of integers or floats
    unit : unit that is stated, one of `TIMES`; inferred by `unit_of_time` if None
    name : name of the stamps in messages
    origin : place of the stamps, for messages
    way_out : how to state the unit; by default by the option `time`

    Raises
    ------
    DemonstrationError
        If no unit is stated and the numbers do not show one.
    """
    notes: list[str] = []
    if len(stamps) == 0 or not np.isfinite(stamps[0]):
        return np.asarray(stamps, dtype=np.float64), ()  # the checks of a `Demonstration` tell
    found = unit or unit_of_time(stamps)
    if found is None:
        raise doubtful_time(stamps, name, origin, way_out)
    if unit is None and found != "s":
        notes.append(f"{name} is taken to be in {found}, after its size")
    least, most = EPOCHS.get(found, (np.inf, np.inf))
    if least <= abs(float(stamps[0])) < most:
        begin = datetime.fromtimestamp(float(stamps[0]) * TIMES[found], UTC)
        notes.append(f"time counts from {begin:%Y-%m-%d %H:%M:%S} UTC")
        stamps = stamps - stamps[0]
    return np.asarray(stamps, dtype=np.float64) * TIMES[found], tuple(notes)


def doubtful_time(stamps: NDArray, name: str, origin: Origin, way_out: str = "") -> DemonstrationError:
    """Return the error about stamps of unknown unit."""
    passed, bare = np.diff(stamps).astype(np.float64), name.partition("[")[0].strip()
    step = float(np.median(passed[passed > 0.0])) if (passed > 0.0).any() else 0.0
    return fault(
        origin.file,
        name,
        f"its steps are {step:g}, and nothing says whether these are milliseconds, seconds or frames",
        way_out
        or f"replace {WHICH_UNIT} by s, ms, us or ns: --time '{bare} [{WHICH_UNIT}]'; or of frames {SAY_RATE}",
        **({"time": None, "rate": HZ} if step == 1.0 or way_out else {"time": f"{bare} [{WHICH_UNIT}]"}),
    )


def require_rate(rate: float) -> float:
    """Raise unless a sampling rate [Hz] is valid; return it."""
    if isinstance(rate, bool) or not 0 < rate < np.inf:
        raise OptionError(f"{rate!r} is no rate", key="rate", way_out="give samples a second, such as 100")
    return float(rate)


def doubts(
    time: Array,
    position: Array,
    unit: str = "m",
    orientation: Array | None = None,
    *,
    stated: Collection[str] = (),
    origin: Origin = IN_MEMORY,
) -> tuple[Doubt, ...]:
    """Return the suspected faults of a movement.

    Parameters
    ----------
    time : array, shape (n_steps,), [s], increasing
    position : array, shape (n_steps, n_dims), in `unit`
    unit : unit of `position`
    orientation : array, shape (n_steps, 4), unit quaternions; None if none was recorded
    stated : certain facts: `TIME`, `UNIT`
    origin : names of the samples in messages
    """
    extent = float(np.ptp(position, axis=0).max())
    found = [_still(extent, unit, orientation)]
    if UNIT not in stated:
        found.append(_wrong_unit(time, position, extent, unit))
    if TIME not in stated:
        found.append(_wrong_time(time))
    found += [_hole(time, origin), _jump(time, position, unit, extent, origin)]
    return tuple(doubt for doubt in found if doubt is not None)


def _wrong_unit(time: Array, position: Array, extent: float, unit: str) -> Doubt | None:
    """Return the doubt about a movement too large for its unit.

    Metres read as millimetres would yield a tiny movement that any robot can perform, without any later warning.
    """
    if extent <= EXTENTS.get(unit, np.inf):
        return None
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    if len(steps) >= FEW:
        steps = steps[steps < 0.1 * extent]  # what is longer may be a jump
    speed = float(steps.sum() / (time[-1] - time[0]))
    if unit == "m" and speed < SLOWEST_HAND:
        message = f"the movement spans {extent:.4g} m at {speed:.2g} m/s: too large for a hand"
        way_out = "give the unit: --unit m if it is right, or --unit mm"
        return Doubt("too large for a hand", message, way_out, "--unit", {"unit": "m"})
    smaller = "mm" if unit in LENGTHS else "deg"
    return Doubt(
        LOOKS_LIKE[unit],
        f"the movement spans {extent:.4g} {unit}: {LOOKS_LIKE[unit]}",
        f"give the unit: --unit {smaller}, or --unit {unit} if it is right",
        "--unit",
        {"unit": smaller},
    )


def _wrong_time(time: Array) -> Doubt | None:
    step = float(np.median(np.diff(time)))
    if step < SLOW or len(time) < FEW:
        return None
    years = float(time[-1]) / (365.25 * 86400.0)
    lasts = f"{years:.3g} years" if years > 1.0 else f"{time[-1]:.4g} s"
    return Doubt(
        "in steps of",
        f"time passes in steps of {step:.4g} s, {lasts} in all",
        f"give its unit, --time 'NAME [ms]', or {SAY_RATE}",
        "--time",
        {"rate": HZ},
    )


def _still(extent: float, unit: str, orientation: Array | None) -> Doubt | None:
    if extent > STILL or (orientation is not None and np.ptp(orientation, axis=0).max() > STILL):
        return None
    if unit not in LENGTHS and unit not in ANGLES:
        return None
    return Doubt(
        "nothing moves",
        f"nothing moves in it: the position stays within {extent:.2g} {unit}",
        "choose other columns, or another recording",
    )


def _hole(time: Array, origin: Origin) -> Doubt | None:
    """Return the doubt about time without samples: 25 usual steps, and 1 s at least."""
    steps = np.diff(time)
    if len(steps) < 10:
        return None
    usual = float(np.median(steps))
    long = np.flatnonzero(steps > max(25.0 * usual, 1.0))
    if not long.size:
        return None
    at = int(long[np.argmax(steps[long])])
    others = f", and {len(long) - 1} shorter ones" if len(long) > 1 else ""
    return Doubt(
        "without samples",
        f"{steps[at]:.4g} s without samples from {time[at]:.4g} s on, among steps of {usual:.2g} s "
        f"({origin.time(at + 1)}){others}",
        "cut the recording there",
    )


def _jump(time: Array, position: Array, unit: str, extent: float, origin: Origin) -> Doubt | None:
    """Return the doubt about a jump: a tenth of the extent, and 20 times the usual step around it."""
    lengths = np.linalg.norm(np.diff(position, axis=0), axis=1)
    half = 5
    if len(lengths) < 6 * half or extent <= STILL:
        return None
    padded = np.pad(lengths, half, mode="edge")
    usual = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    steps = np.diff(time)
    is_step = steps < 5.0 * np.median(steps)  # across a hole it may have moved
    jumps = np.flatnonzero((lengths > 0.1 * extent) & (lengths > 20.0 * usual) & is_step)
    if not jumps.size:
        return None
    at = int(jumps[np.argmax(lengths[jumps])])
    return Doubt(
        "it jumps",
        f"it jumps by {lengths[at]:.3g} {unit} at {time[at + 1]:.4g} s ({origin.position(at + 1, 0)})",
        "cut the recording there, or take out what the tracker lost",
    )

"""Alignment in time of several recordings of one movement.

Shares of the time from start to end are aligned. The alignment `duration` divides the time of each recording by its
duration. `warping` also moves the instants between the ends, so that equal places are met at equal shares (dynamic
time warping, Sakoe and Chiba, 1978, with paces from a half to twice). Warps are relative to their mean: the aligned
movement has the mean pace of the recordings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from comove.arrays import Array
from comove.dmp.arguments import NamedOption, numbers, require_numbers
from comove.errors import DemonstrationError, OptionError
from comove.trajectory import interpolated

NEVER = 1e-9  # share of the movement's extent below which a standard deviation counts as none


class Alignment(NamedOption):
    """The alignment of recordings in time."""

    DURATION = "duration"
    WARPING = "warping"


@dataclass(frozen=True)
class WarpingSettings:
    """Settings of dynamic time warping.

    Attributes
    ----------
    n_instants : even instants between which a warp is linear
    n_rounds : times that recordings are warped to their mean, which gets sharper each time
    slope_weight : weight of velocities beside positions, both relative to their own spread over time
    """

    n_instants: int = 201
    n_rounds: int = 3
    slope_weight: float = 0.3

    def __post_init__(self) -> None:
        require_numbers(self)


def together(demonstrations: object) -> tuple[tuple[str, ...], list[Array], list[Array]]:
    """Return manipulators, times and positions of recordings that belong together."""
    if not isinstance(demonstrations, (list, tuple)):
        raise OptionError(f"demonstrations = {demonstrations!r}", way_out="give a list of recordings")
    if len(demonstrations) < 2:
        raise DemonstrationError(
            f"{len(demonstrations)} recording has no spread", way_out="give two or more, or use DMP.fit"
        )
    found = [one_recording(demonstration, i) for i, demonstration in enumerate(demonstrations)]
    names, _, first, unit = found[0]
    for i, (others, _, position, own) in enumerate(found):
        for what, one, other in (
            ("is of", ", ".join(names) or "one hand", ", ".join(others) or "one hand"),
            ("has", f"{first.shape[1]} coordinates", f"{position.shape[1]} coordinates"),
            ("is in", unit, own),
        ):
            if one != other:
                raise DemonstrationError(
                    f"recording {i} {what} {other}, recording 0 {what} {one}",
                    way_out="give recordings of one kind",
                )
    return names, [time for _, time, _, _ in found], [position for _, _, position, _ in found]


def require_spread(times: list[Array], positions: list[Array]) -> None:
    """Raise DemonstrationError if the recordings do not differ."""
    seen: dict[bytes, int] = {}
    for i, (time, position) in enumerate(zip(times, positions, strict=True)):
        before = seen.setdefault((time - time[0]).tobytes() + position.tobytes(), i)
        if before != i:
            raise DemonstrationError(
                f"recordings {before} and {i} are one and the same", way_out="give each recording once"
            )
    curves = _at_even_shares(times, positions, 101)
    if curves.std(axis=0).max() <= NEVER * np.ptp(curves, axis=(0, 1)).max():
        raise DemonstrationError(
            f"the {len(times)} recordings are the same movement and have no spread",
            way_out="record it anew each time, or use DMP.fit",
        )


def one_recording(demonstration: object, number: int) -> tuple[tuple[str, ...], Array, Array, str]:
    """Return manipulators, times, positions and unit of one recording."""
    parts: Mapping[str, Any] = demonstration if isinstance(demonstration, Mapping) else {"": demonstration}
    if not parts or not all(hasattr(p, "time") and hasattr(p, "position") for p in parts.values()):
        raise OptionError(
            f"recording {number} is {type(demonstration).__name__}",
            key="demonstrations",
            way_out="give Demonstrations, or mappings of them by the names of manipulators",
        )
    names = () if set(parts) == {""} else tuple(map(str, parts))
    each = [(numbers(part.time), numbers(part.position)) for part in parts.values()]
    time = each[0][0]
    for name, (own, position) in zip(parts, each, strict=True):
        who = f"recording {number}" + (f", {name!r}," if name else "")
        if own.ndim != 1 or position.ndim != 2 or len(own) != len(position) or len(own) < 2:
            raise DemonstrationError(f"{who} is no movement", way_out="give two samples or more of each")
        bad = np.flatnonzero(~(np.isfinite(position).all(axis=1) & np.isfinite(own)))
        if bad.size:
            raise DemonstrationError(
                f"{who} holds what is no number in row {bad[0]}", way_out="clean it, or leave it out"
            )
        if not (np.diff(own) > 0).all():
            raise DemonstrationError(f"{who} stands still in time", way_out="give increasing times")
        if not np.array_equal(own, time):
            raise DemonstrationError(
                f"{who} has other time stamps than {next(iter(parts))!r}",
                way_out="bring both to the same duration and resampled(n_steps)",
            )
    units = [getattr(part, "unit", "m") for part in parts.values()]
    if len(set(units)) > 1:
        raise DemonstrationError(
            f"recording {number} is in {' and '.join(sorted(set(units)))}", way_out="give one unit"
        )
    widths = {position.shape[1] for _, position in each}
    if len(widths) > 1:
        raise DemonstrationError(
            f"recording {number} has manipulators with {' and '.join(map(str, sorted(widths)))} coordinates",
            way_out="give all the same",
        )
    return names, time, np.concatenate([position for _, position in each], axis=1), units[0]


def aligned(
    times: Sequence[Array],
    positions: Sequence[Array],
    alignment: Alignment,
    warping: WarpingSettings = WarpingSettings(),
) -> list[Array]:
    """Return the aligned share, 0 to 1, of every recording's samples.

    Parameters
    ----------
    times : arrays, shape (n_steps,), increasing [s]
    positions : arrays, shape (n_steps, n_columns)
    warping : settings, where instants between the ends are moved

    Returns
    -------
    list of arrays, shape (n_steps,)
    """
    shares = [_share(time) for time in times]
    if alignment is Alignment.DURATION:
        return shares
    even, curves = (
        np.linspace(0.0, 1.0, warping.n_instants),
        _at_even_shares(times, positions, warping.n_instants),
    )
    warps = np.repeat(even[None], len(curves), axis=0)  # the recording's share at a share of the course
    for _ in range(warping.n_rounds):
        mean = np.mean([_played(curve, warp) for curve, warp in zip(curves, warps, strict=True)], axis=0)
        warps = np.stack([_warp(mean, curve, warping.slope_weight) for curve in curves])
        usual = warps.mean(axis=0)  # where recordings are, on average: it becomes the course's own time
        warps = np.stack([np.interp(even, usual, warp) for warp in warps])
    return [np.interp(share, warp, even) for share, warp in zip(shares, warps, strict=True)]


def _share(time: Array) -> Array:
    return (time - time[0]) / (time[-1] - time[0])


def _at_even_shares(times: Sequence[Array], positions: Sequence[Array], n: int) -> Array:
    """Return the positions at even shares of the durations; array, shape (n_recordings, n, n_columns)."""
    even = np.linspace(0.0, 1.0, n)
    both = zip(times, positions, strict=True)
    return np.stack([interpolated(even, _share(time), position) for time, position in both])


def _played(curve: Array, warp: Array) -> Array:
    return interpolated(warp, np.linspace(0.0, 1.0, len(curve)), curve)


def _warp(reference: Array, curve: Array, slope_weight: float) -> Array:
    """Warp a curve in time to a reference, at even shares.

    Every step leads one sample ahead in both, or two in one of them, so the pace stays between a half and two.
    """
    n = len(reference)
    one, other = (_features(each, reference, slope_weight) for each in (reference, curve))
    cost = ((one[:, None] - other[None]) ** 2).sum(axis=2)
    total = np.full((n, n), np.inf)
    total[0, 0] = cost[0, 0]
    steps = ((1, 1), (1, 2), (2, 1))
    for i in range(1, n):
        for back, aside in steps:
            if i >= back:
                reached = total[i - back, :-aside] + (back + aside) / 2 * cost[i, aside:]
                total[i, aside:] = np.minimum(total[i, aside:], reached)
    i = j = n - 1
    path = [(i, j)]
    while i > 0 or j > 0:
        before = [
            (total[i - b, j - a] + (a + b) / 2 * cost[i, j], b, a) for b, a in steps if i >= b and j >= a
        ]
        _, back, aside = min(before)
        i, j = i - back, j - aside
        path.append((i, j))
    at, seen = np.array(path[::-1], dtype=float).T / (n - 1)
    return np.interp(np.linspace(0.0, 1.0, n), at, seen)


def _features(curve: Array, reference: Array, slope_weight: float) -> Array:
    """Return positions and velocities relative to the reference's spread over time."""
    parts = []
    for weight, values, others in (
        (1.0, curve, reference),
        (slope_weight, np.gradient(curve, axis=0), np.gradient(reference, axis=0)),
    ):
        size = np.sqrt(((others - others.mean(axis=0)) ** 2).sum(axis=1).mean())
        parts.append(weight * values / (size if size > 0 else 1.0))
    return np.concatenate(parts, axis=1)

"""Alignment in time: several recordings of one movement, brought to equal shares of one course.

`duration` divides the time of each recording by its duration. `warping` also moves the instants between the ends, so
that equal places are met at equal shares (dynamic time warping, Sakoe and Chiba, 1978, with paces from a half to
twice). Warps are relative to their mean: the aligned movement has the mean pace of the recordings.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from comove.primitives.arguments import NamedOption
from comove.trajectory import interpolated

Array = NDArray[np.float64]

N_WARPED = 201  # even instants between which a warp is linear
ROUNDS = 3  # of warping to the mean, which gets sharper each time
SLOPE_WEIGHT = 0.3  # of velocities beside positions, both relative to their own spread over time


class Alignment(NamedOption):
    """A way in which recordings are aligned in time."""

    DURATION = "duration"
    WARPING = "warping"


def aligned(times: Sequence[Array], positions: Sequence[Array], alignment: Alignment) -> list[Array]:
    """Return the share of the course at every sample of every recording, from 0 to 1.

    Parameters
    ----------
    times : arrays, shape (n_steps,), increasing [s]
    positions : arrays, shape (n_steps, n_columns)

    Returns
    -------
    list of arrays, shape (n_steps,)
    """
    shares = [(time - time[0]) / (time[-1] - time[0]) for time in times]
    if alignment is Alignment.DURATION:
        return shares
    even = np.linspace(0.0, 1.0, N_WARPED)
    curves = np.stack(
        [interpolated(even, share, position) for share, position in zip(shares, positions, strict=True)]
    )
    warps = np.repeat(even[None], len(curves), axis=0)  # the recording's share at a share of the course
    for _ in range(ROUNDS):
        mean = np.mean([_played(curve, warp) for curve, warp in zip(curves, warps, strict=True)], axis=0)
        warps = np.stack([_warp(mean, curve) for curve in curves])
        usual = warps.mean(
            axis=0
        )  # at which the recordings are, on average: it becomes the course's own time
        warps = np.stack([np.interp(even, usual, warp) for warp in warps])
    return [np.interp(share, warp, even) for share, warp in zip(shares, warps, strict=True)]


def _played(curve: Array, warp: Array) -> Array:
    return interpolated(warp, np.linspace(0.0, 1.0, len(curve)), curve)


def _warp(reference: Array, curve: Array) -> Array:
    """Return the share of a curve at even shares of the reference, by dynamic time warping.

    Every step leads one sample ahead in both, or two in one of them, so the pace stays between a half and two.
    """
    n = len(reference)
    one, other = _features(reference, reference), _features(curve, reference)
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


def _features(curve: Array, reference: Array) -> Array:
    """Return positions and velocities of a curve, relative to the reference's spread over time."""
    parts = []
    for weight, values, others in (
        (1.0, curve, reference),
        (SLOPE_WEIGHT, np.gradient(curve, axis=0), np.gradient(reference, axis=0)),
    ):
        size = np.sqrt(((others - others.mean(axis=0)) ** 2).sum(axis=1).mean())
        parts.append(weight * values / (size if size > 0 else 1.0))
    return np.concatenate(parts, axis=1)

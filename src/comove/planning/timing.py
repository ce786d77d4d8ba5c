"""Times of nodes: obstacle displacements between them, and the payload's speed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.compiled import kernel
from comove.contacts.displaced import RESTING, instant_at
from comove.geometry.distances import REACH
from comove.model.moving import Displacements


class Timing(NamedTuple):
    """The normalised times of nodes, and the motion of the obstacles. A time is a node's last value.

    Nodes without times have a `Timing` as well, so that kernels are compiled once for both.

    Attributes
    ----------
    timed : whether nodes have times
    moved : displacements of the obstacles at even times
    fastest : largest speed of a point of an obstacle [m a duration]
    speed : limit of the speed of a payload's keypoint [m a duration]
    share : of their limits of speed that joints may use
    duration : of the movement [s]
    time_step, waiting : as in `spacetime.SpaceTimeSettings`
    """

    timed: bool
    moved: Displacements
    fastest: float
    speed: float
    share: float
    duration: float
    time_step: float
    waiting: float

    @classmethod
    def none(cls, resting: Displacements) -> Timing:
        """Return the timing of nodes without times, among obstacles that rest."""
        return cls(False, resting, 0.0, np.inf, 1.0, np.inf, 1.0, 0.0)


def fastest_point(table: Array, moved: Displacements) -> float:
    """Bound the obstacle points' speed between samples from above [m a duration].

    Parameters
    ----------
    table : array, shape (n_rows, n_columns), the obstacles at 0 s
    moved : their displacements at even times, linear in between
    """
    ways = np.linalg.norm(np.diff(moved.offsets, axis=0), axis=2)
    ways = ways + table[:, REACH] * np.abs(np.diff(moved.angles, axis=0))
    return float(ways.max(initial=0.0)) * max(len(moved.offsets) - 1, 0)


@kernel
def instant_of(timing, node):
    """Return the instant of a node. Obstacles rest without times."""
    if not timing.timed:
        return RESTING
    return instant_at(timing.moved, node[-1])


@kernel
def time_for_joints(timing, p, q):
    """Return the time of joints between two nodes at their limits [s]. It is 1e9 without times."""
    if not timing.timed:
        return 1e9
    return timing.share * timing.duration * abs(q[-1] - p[-1])


@kernel
def drift(timing, p, q):
    """Bound an obstacle point's displacement between two nodes from above [m]."""
    if not timing.timed:
        return 0.0
    return timing.fastest * abs(q[-1] - p[-1])


@kernel
def too_fast(timing, moved, p, q):
    """Return whether a displacement [m] takes longer than two nodes allow. It is False without times."""
    if not timing.timed:
        return False
    return moved > timing.speed * abs(q[-1] - p[-1])


@kernel
def write_time(timing, p, q, share, out):
    """Write the time at a share of an edge into node `out`. Nothing is written without times."""
    if not timing.timed:
        return
    out[-1] = q[-1] if share == 1.0 else p[-1] + share * (q[-1] - p[-1])


@kernel
def share_of_step(timing, p, q, steps):
    """Return the share of an edge of some steps in time. It is at most 1, and 1 without times."""
    if not timing.timed:
        return 1.0
    return min(1.0, timing.time_step * steps / max(abs(q[-1] - p[-1]), 1e-12))

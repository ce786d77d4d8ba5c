"""Times of nodes: where obstacles are at a share of a movement, how far they come, and how fast a payload may be."""

from __future__ import annotations

from math import cos, sin
from typing import NamedTuple

import numpy as np

from comove.arrays import Array
from comove.compiled import kernel
from comove.contacts.displaced import angle_at, instant_at, offset_at, turned
from comove.geometry.distances import CENTER, REACH, ROTATION
from comove.model.moving import Displacements


class Timing(NamedTuple):
    """The times of nodes, normalised to the movement, whose last value they are, and what moves meanwhile.

    Attributes
    ----------
    resting : array, shape (n_rows, n_columns), table of the obstacles at 0 s
    moved : their displacements at even times
    fastest : largest speed of a point of an obstacle [m a duration]
    speed : limit of the speed of a payload's node [m a duration]
    share : of their limits of speed that joints may use
    duration : of the movement [s]
    time_step, waiting : as in `spacetime.SpaceTimeSettings`
    """

    resting: Array
    moved: Displacements
    fastest: float
    speed: float
    share: float
    duration: float
    time_step: float
    waiting: float


def fastest_point(table: Array, moved: Displacements) -> float:
    """Return an upper bound of the speed of the obstacles' points between samples [m a duration].

    Parameters
    ----------
    table : array, shape (n_rows, n_columns), the obstacles at 0 s
    moved : their displacements at even times, on straight lines between them
    """
    ways = np.linalg.norm(np.diff(moved.offsets, axis=0), axis=2)
    ways = ways + table[:, REACH] * np.abs(np.diff(moved.angles, axis=0))
    return float(ways.max(initial=0.0)) * max(len(moved.offsets) - 1, 0)


@kernel
def place_obstacles(resting, moved, share, table):
    """Write centres and orientations of obstacles at a share of the movement; nothing where none moves.

    Parameters
    ----------
    resting : array, shape (n_rows, n_columns), the table at 0 s
    moved : Displacements, at even times
    share : normalised time
    table : result, array, shape (n_rows, n_columns), at first a copy of `resting`, or a result at another time
    """
    last = moved.offsets.shape[0] - 1
    if last < 0:
        return
    instant = instant_at(moved, share)
    for j in range(resting.shape[0]):
        for k in range(3):
            table[j, CENTER + k] = resting[j, CENTER + k] + offset_at(moved, j, instant, k)
        if moved.angles[0, j] != 0.0 or moved.angles[last, j] != 0.0:  # it turns, at a constant rate
            axis, angle = moved.axes[j], angle_at(moved, j, instant)
            cosine, sine = cos(angle), sin(angle)
            for c in range(ROTATION, ROTATION + 3):  # columns of the matrix, whose rows follow each other
                x, y, z = turned(axis, cosine, sine, resting[j, c], resting[j, 3 + c], resting[j, 6 + c])
                table[j, c], table[j, 3 + c], table[j, 6 + c] = x, y, z


@kernel
def set_time(timing, table, node):
    """Move the obstacles of a table to where they are at the time of a node."""
    if timing is None:
        return
    place_obstacles(timing.resting, timing.moved, node[-1], table)


@kernel
def time_for_joints(timing, p, q):
    """Return the time that joints have between two nodes at their limits of speed [s]; 1e9 without times."""
    if timing is None:
        return 1e9
    return timing.share * timing.duration * abs(q[-1] - p[-1])


@kernel
def drift(timing, p, q):
    """Return how far a point of an obstacle comes between two nodes, at most [m]."""
    if timing is None:
        return 0.0
    return timing.fastest * abs(q[-1] - p[-1])


@kernel
def too_fast(timing, moved, p, q):
    """Return whether a displacement `moved` [m] takes longer than there is between two nodes; never without times."""
    if timing is None:
        return False
    return moved > timing.speed * abs(q[-1] - p[-1])


@kernel
def write_time(timing, p, q, share, out):
    """Write the time at a share of the edge from node p to node q in node `out`; nothing without times."""
    if timing is None:
        return
    out[-1] = q[-1] if share == 1.0 else p[-1] + share * (q[-1] - p[-1])


@kernel
def share_of_step(timing, p, q, steps):
    """Return the share of an edge that so many steps in time make, at most 1; 1 without times."""
    if timing is None:
        return 1.0
    return min(1.0, timing.time_step * steps / max(abs(q[-1] - p[-1]), 1e-12))

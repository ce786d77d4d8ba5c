"""Covers of point clouds by few spheres.

A sphere about some points is halved, along the longest side of their box, while its surface lies farther than
`detail` from the nearest of them, the worst first. So a disc or a ball seen from all around stays one sphere, and a
wall becomes a row of small ones. Every sphere is found by Badoiu & Clarkson's (2003) iteration, and its radius is the
distance of the farthest point: the union always contains all points.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.geometry.rotations import evenly_spread


class CoverEffort(NamedTuple):
    """Settings of the search for spheres, as kernels take them.

    Attributes
    ----------
    hollow : largest radius of a sphere, as a multiple of the detail: larger ones might contain unseen obstacles
    n_iterations : steps of the search for the centre of a sphere
    n_directions : directions in which a sphere's over-approximation error is measured
    """

    hollow: float = 10.0
    n_iterations: int = 24
    n_directions: int = 26


COVER_EFFORT = CoverEffort()


class Cells(NamedTuple):
    """Points reduced to one mean per cell of a grid.

    Attributes
    ----------
    point : array, shape (n_cells, 3), means [m]
    key : array of int, shape (n_cells, 3), positions of the cells in the grid
    of : array of int, shape (n_points,), the cell of every point
    """

    point: Array
    key: Integers
    of: Integers


class SphereCover(NamedTuple):
    """Spheres that together contain a cloud.

    Attributes
    ----------
    center : array, shape (n_spheres, 3), [m]
    radius : array, shape (n_spheres,), [m]
    group : array of int, shape (n_spheres,), the group whose points a sphere contains
    """

    center: Array
    radius: Array
    group: Integers


def thinned(points: Array, edge: float) -> Cells:
    """Sort points (n_points, 3) into grid cells of an edge [m]."""
    key = np.floor(points / edge).astype(np.int64)
    low = key.min(axis=0, initial=0)
    span = key.max(axis=0, initial=0) - low + 1
    flat = ((key[:, 0] - low[0]) * span[1] + key[:, 1] - low[1]) * span[2] + key[:, 2] - low[2]
    _, first, of = np.unique(flat, return_index=True, return_inverse=True)
    counts = np.bincount(of, minlength=len(first))
    sums = [np.bincount(of, weights=column, minlength=len(first)) for column in points.T]
    return Cells(np.stack(sums, axis=1) / np.maximum(counts, 1)[:, None], key[first], of)


def covered(
    points: Array,
    cells: Cells,
    group: Integers,
    detail: float,
    most: int,
    effort: CoverEffort = COVER_EFFORT,
) -> SphereCover:
    """Return spheres that contain all points, each of one group.

    Parameters
    ----------
    points : array, shape (n_points, 3), [m]
    cells : cells of these points
    group : array of int, shape (n_cells,), group of each cell, numbered from 0 without gaps
    detail : largest distance of a sphere's surface from the nearest point [m]
    most : largest number of spheres, exceeded only where there are more groups
    """
    if not len(points):
        return SphereCover(np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=np.int64))
    counts = np.bincount(group)
    order = np.argsort(group, kind="stable")
    ends = np.cumsum(counts)
    directions = evenly_spread(effort.n_directions, 2 if np.ptp(cells.point[:, 2]) == 0.0 else 3)
    spans, most = np.stack([ends - counts, ends], axis=1), max(most, len(counts))
    center, sphere, n = _split(cells.point, order, spans, detail, most, directions, effort)
    center, mine = center[:n], sphere[cells.of]
    radius = np.zeros(n)
    np.maximum.at(radius, mine, np.linalg.norm(points - center[mine], axis=1))
    owner = np.zeros(n, dtype=np.int64)
    owner[sphere] = group
    return SphereCover(center, radius * (1 + 1e-12), owner)


@kernel
def _split(points, order, spans, detail, most, directions, effort):
    """Return sphere centres (most, 3), every point's sphere, and the number.

    Parameters
    ----------
    order : array of int, shape (n_points,), indices of the points group by group; it is rearranged
    spans : array of int, shape (n_groups, 2), where each group begins and ends in `order`
    directions : array, shape (n_directions, 3), unit vectors in which errors are measured
    """
    center, excess = np.zeros((most, 3)), np.zeros(most)
    first, last = np.zeros(most, dtype=np.int64), np.zeros(most, dtype=np.int64)
    n = spans.shape[0]
    for k in range(n):
        first[k], last[k] = spans[k]
        excess[k] = _sphere(points, order[first[k] : last[k]], directions, detail, effort, center[k])
    while n < most:
        k = excess[:n].argmax()
        if not excess[k] > detail:
            break
        middle = _halved(points, order, first[k], last[k])
        first[n], last[n], last[k] = middle, last[k], middle
        for i in (k, n):
            excess[i] = _sphere(points, order[first[i] : last[i]], directions, detail, effort, center[i])
        n += 1
    sphere = np.zeros(points.shape[0], dtype=np.int64)
    for k in range(n):
        for i in range(first[k], last[k]):
            sphere[order[i]] = k
    return center, sphere, n


@kernel
def _sphere(points, own, directions, detail, effort, center):
    """Compute a sphere about points; return its over-approximation error [m].

    Its centre is written in `center`; `own` holds the numbers of the points.
    """
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for i in own:
        for axis in range(3):
            low[axis], high[axis] = min(low[axis], points[i, axis]), max(high[axis], points[i, axis])
    here, best = 0.5 * (low + high), np.inf
    for step in range(effort.n_iterations):
        farthest, at = -1.0, own[0]
        for i in own:
            square = square_of(points[i], here)
            if square > farthest:
                farthest, at = square, i
        if farthest < best:
            best = farthest
            center[:] = here
        for axis in range(3):
            here[axis] += (points[at, axis] - here[axis]) / (step + 3)
    radius, out = sqrt(best), 0.0
    if radius <= 0.5 * detail or own.shape[0] == 1:
        return 0.0
    if radius > effort.hollow * detail:
        return radius
    for k in range(directions.shape[0]):
        here[:] = center + radius * directions[k]
        nearest = np.inf
        for i in own:
            nearest = min(nearest, square_of(points[i], here))
            if nearest <= out:  # elsewhere it sticks out more
                break
        out = max(out, nearest)
    return sqrt(out)


@kernel
def _halved(points, order, first, last):
    """Sort points by halves of their box; return the second's start."""
    axis, low, longest = 0, 0.0, -1.0
    for column in range(3):
        least, most = np.inf, -np.inf
        for i in range(first, last):
            least, most = min(least, points[order[i], column]), max(most, points[order[i], column])
        if most - least > longest:
            axis, low, longest = column, least, most - least
    i, j = first, last - 1
    while i <= j:
        if points[order[i], axis] <= low + 0.5 * longest:
            i += 1
        else:
            order[i], order[j] = order[j], order[i]
            j -= 1
    return min(max(i, first + 1), last - 1)


@kernel
def square_of(p, q):
    """Return the squared distance [m^2] of two points."""
    return (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2

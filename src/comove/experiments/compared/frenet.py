"""Frenet-Serret frames along paths."""

from __future__ import annotations

from math import sqrt

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

STILL, STRAIGHT = 1e-6, 1e-6  # shares of the largest slope and bend below which they have no direction


def frenet_frames(slope: Array, bend: Array) -> Array:
    """Compute tangent, normal and binormal at every sample of a path.

    The normal is perpendicular to the tangent and points to the side to which the path bends. In the plane it is the
    tangent, turned to the left by 90 degrees. Where the path stands still, the nearest tangent is taken; where it is
    straight, the normal is transported along it with the least rotation (Bishop, 1975).

    Parameters
    ----------
    slope, bend : arrays, shape (n_steps, n_dims), first and second derivatives of the path by any parameter

    Returns
    -------
    array, shape (n_steps, n_dims, n_dims), with the columns tangent, normal (and binormal)
    """
    tangent = _tangents(slope)
    if slope.shape[1] == 2:
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        return np.stack([tangent, normal], axis=2)
    across = bend - (bend * tangent).sum(axis=1, keepdims=True) * tangent
    speed = np.linalg.norm(slope, axis=1)
    size = np.linalg.norm(across, axis=1)
    # A curvature counts where the path moves and turns noticeably in the time that it takes.
    bent = (size > STRAIGHT * max(np.linalg.norm(bend, axis=1).max(), 1e-300)) & (speed > STILL * speed.max())
    across[bent] /= size[bent, None]
    normal = _normals(tangent, across, bent)
    return np.stack([tangent, normal, np.cross(tangent, normal)], axis=2)


def _tangents(slope: Array) -> Array:
    """Return unit tangents: the nearest one where the path stands still, the x axis if it never moves."""
    speed = np.linalg.norm(slope, axis=1)
    moving = np.flatnonzero(speed > STILL * max(speed.max(), 1e-300))
    if not len(moving):
        return np.tile(np.eye(slope.shape[1])[0], (len(slope), 1))
    steps = np.arange(len(slope))
    after = np.searchsorted(moving, steps).clip(max=len(moving) - 1)
    before = (after - 1).clip(min=0)
    nearer = np.abs(moving[after] - steps) <= np.abs(moving[before] - steps)
    nearest = np.where(nearer, moving[after], moving[before])
    return slope[nearest] / speed[nearest, None]


@numba.njit(cache=True, error_model="numpy")
def _normals(tangent, across, bent):
    """Return unit normals, (n_steps, 3): `across` where the path bends, else the last normal transported along it."""
    n_steps = tangent.shape[0]
    normal = np.empty((n_steps, 3))
    first = 0
    while first < n_steps and not bent[first]:
        first += 1
    last = np.zeros(3)
    if first < n_steps:
        last[:] = across[first]
    else:  # straight all along: any normal
        smallest = 0
        for axis in range(3):
            if abs(tangent[0, axis]) < abs(tangent[0, smallest]):
                smallest = axis
        last[smallest] = 1.0
    for k in range(n_steps):
        if bent[k]:
            last[:] = across[k]
        along, square = 0.0, 0.0
        for axis in range(3):
            along += last[axis] * tangent[k, axis]
        for axis in range(3):
            normal[k, axis] = last[axis] - along * tangent[k, axis]
            square += normal[k, axis] ** 2
        length = sqrt(square)
        for axis in range(3):
            normal[k, axis] /= length
            last[axis] = normal[k, axis]
    return normal

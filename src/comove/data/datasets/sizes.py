"""Sizes of obstacles and payload, in equal values for every shape."""

from __future__ import annotations

from typing import Any

import numpy as np

from comove.arrays import Array
from comove.geometry.rotations import matrices
from comove.model.files.keys import BarLoad, BoxLoad, PartsLoad, PolygonLoad
from comove.model.scene import Scene
from comove.model.shapes import parts_of


def obstacle_names(scene: Scene) -> list[str]:
    """Return a unique name for each obstacle. Where it has none of its own, it is obstacle0, obstacle1, ..."""
    found = [obstacle.name or f"obstacle{i}" for i, obstacle in enumerate(scene.file.obstacles)]
    return [name if found.count(name) == 1 else f"obstacle{i}" for i, name in enumerate(found)]


def obstacle_sizes(scene: Scene, time: Array) -> list[Array]:
    """Return the extents of each obstacle along its axes, and orientation.

    Parameters
    ----------
    time : array, shape (n_times,) [s]

    Returns
    -------
    list of arrays, one for each obstacle: shape (n_times, 3) in the plane, two extents [m] and an angle [rad]; shape
    (n_times, 7) in space, three extents [m] and a quaternion w x y z
    """
    found, angles, turned = [], scene.turns(time)[..., 2:], scene.orientations(time)
    for i, obstacle in enumerate(scene.file.obstacles):
        extents = np.tile(_extents(scene, i, obstacle), (len(time), 1))
        turn = turned[:, i]
        if scene.n_dims == 2:
            turn = np.deg2rad(getattr(obstacle, "rotation_deg", 0.0)) + angles[:, i]
        found.append(np.concatenate([extents, turn], axis=1))
    return found


def payload_size(scene: Scene) -> Array:
    """Return the payload's extents along its own axes, else zeros. Array, shape (n_dims,) [m]. Those of a mesh or
    frame are along the axes in which it is grasped."""
    load, n = scene.file.load, scene.n_dims
    if load is None:
        return np.zeros(n)
    radius = getattr(load, "radius", 0.0)
    if isinstance(load, BoxLoad):
        return np.array(load.size, dtype=float)
    if isinstance(load, BarLoad):
        return np.array([load.length + 2 * load.overhang, *[0.0] * (n - 1)]) + 2 * radius
    if isinstance(load, PolygonLoad):
        return np.ptp(np.array(load.vertices, dtype=float), axis=0) + 2 * radius
    if isinstance(load, PartsLoad):
        parts = parts_of(load)
        thick = np.zeros((len(parts.corners), 1))
        for a, b, rod in parts.rods:
            thick[[a, b]] = rod
        return ((parts.corners + thick).max(axis=0) - (parts.corners - thick).min(axis=0))[:n]
    holders = set(scene.file.holder_numbers)
    group = next(g for g in scene.groups if holders <= set(g.members))
    points = group.corners if len(group.corners) else group.grasps
    return np.ptp(points, axis=0)[:n] + 2 * radius


def _extents(scene: Scene, number: int, obstacle: Any) -> Array:
    """Return the extents of an obstacle along its own axes; array, shape (n_dims,) [m]."""
    n, shape = scene.n_dims, obstacle.shape
    if shape == "box":
        return np.array(obstacle.size, dtype=float)
    if shape == "ellipsoid":
        return 2 * np.array(obstacle.radii, dtype=float)
    if shape == "mesh":
        mesh = int(np.flatnonzero(scene.surfaces.owner == number)[0])
        own = scene.surfaces.of(mesh).reshape(-1, 3) - scene.surfaces.center[mesh]
        return np.ptp(own @ matrices(np.array(obstacle.quaternion_wxyz, dtype=float)), axis=0)
    across = np.full(n, 2 * obstacle.radius)
    if shape == "cylinder":
        across[-1] = obstacle.height
    elif shape == "capsule":  # along local x in the plane, local z in space
        across[0 if n == 2 else -1] += obstacle.length
    return across

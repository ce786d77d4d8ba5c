"""The collision bodies of a robot as points that hold them."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from comove.robots.model import Robot
from comove.robots.search.capsules import vertices_of

Array = NDArray[np.float64]


def placed_bodies(robot: Robot, q: Array) -> Iterator[tuple[str, Array]]:
    """Yield the link of every collision body and points whose hull holds it; arrays, shape (n, 3) [m].

    Parameters
    ----------
    q : array, shape (n_joints,) [rad, m]
    """
    geometry = robot.collision
    data, placed = robot.model.createData(), geometry.createData()
    pin.updateGeometryPlacements(robot.model, data, geometry, placed, q)
    for item, place in zip(geometry.geometryObjects, placed.oMg, strict=True):
        yield link_of(item.name), _points_around(item.geometry) @ place.rotation.T + place.translation


def link_of(geometry: str) -> str:
    """Return the link of a collision body, which Pinocchio numbers."""
    return geometry.rpartition("_")[0]


def _points_around(shape: coal.CollisionGeometry) -> Array:
    """Return the vertices of a mesh, or the corners of the box about another body; array, shape (n, 3) [m]."""
    if isinstance(shape, coal.BVHModelBase | coal.ConvexBase):
        return vertices_of(shape)
    shape.computeLocalAABB()
    return np.array(list(product(*zip(shape.aabb_local.min_, shape.aabb_local.max_, strict=True))))

"""The poses of a scene's rigid groups in a configuration of its coordinates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.coordination.coordinates import ANGLE, DIRECTION, QUATERNION, Coordinates
from comove.errors import OptionError
from comove.primitives.arguments import numbers

Array = NDArray[np.float64]


class HandPoses(NamedTuple):
    """The poses of the rigid groups of a scene, in their order.

    Attributes
    ----------
    center : array, shape (n_groups, 3), origins of the groups' frames [m]
    quaternion : array, shape (n_groups, 4), w x y z, of unit length; in the plane turns about z
    """

    center: Array
    quaternion: Array


def poses_at(coordinates: Coordinates, q: ArrayLike) -> HandPoses:
    """Return the poses of the groups in configurations of the scene's coordinates.

    Parameters
    ----------
    q : array, shape (..., n_columns), one configuration or many

    Returns
    -------
    HandPoses, whose arrays have the same leading axes

    Raises
    ------
    OptionError
        If `q` is not a configuration in these coordinates, or they are those of free hands.
    """
    q = numbers(q)
    if q.shape[-1:] != (coordinates.n_columns,) or not np.isfinite(q).all():
        raise OptionError(
            f"a configuration of shape {q.shape}", way_out=f"give {coordinates.n_columns} finite numbers"
        )
    if coordinates.kind == "arms":
        raise OptionError("free hands have no poses", way_out="use the load's coordinates, or poses_of")
    n, n_groups = coordinates.n_dims, len(coordinates.parts)
    center, quaternion = np.zeros((*q.shape[:-1], n_groups, 3)), np.zeros((*q.shape[:-1], n_groups, 4))
    quaternion[..., 0] = 1.0
    for g, (kind, columns, _, _) in enumerate(coordinates.parts):
        center[..., g, :n], turn = q[..., columns][..., :n], q[..., columns][..., n:]
        if kind == ANGLE:
            quaternion[..., g, 0], quaternion[..., g, 3] = np.cos(turn[..., 0] / 2), np.sin(turn[..., 0] / 2)
        elif kind == QUATERNION:
            quaternion[..., g, :] = turn / np.linalg.norm(turn, axis=-1, keepdims=True)
        elif kind == DIRECTION:
            quaternion[..., g, :] = _pointing(turn / np.linalg.norm(turn, axis=-1, keepdims=True))
    return HandPoses(center, quaternion)


def _pointing(direction: Array) -> Array:
    """Return the smallest rotations from the x axis to unit vectors, as quaternions; about z for the opposite one.

    Parameters
    ----------
    direction : array, shape (..., 2 or 3)

    Returns
    -------
    array, shape (..., 4), w x y z
    """
    y, z = (
        direction[..., 1],
        direction[..., 2] if direction.shape[-1] == 3 else np.zeros(direction.shape[:-1]),
    )
    sine = np.hypot(y, z)
    half, known = 0.5 * np.arctan2(sine, direction[..., 0]), sine > 0.0
    scale = np.sin(half) / np.where(known, sine, 1.0)
    about_z = np.where(known, y * scale, np.sin(half))
    return np.stack([np.cos(half), np.zeros_like(half), -z * scale, about_z], axis=-1)

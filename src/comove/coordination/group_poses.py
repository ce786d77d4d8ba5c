"""The poses of a scene's rigid groups in a configuration of its coordinates."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.coordination.coordinates import ANGLE, DIRECTION, QUATERNION, Coordinates
from comove.errors import OptionError
from comove.geometry.rotations import quaternion_of_rotation, similarity
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
    """Return the poses of the groups in a configuration of the scene's coordinates, array of shape (n_columns,).

    Raises
    ------
    OptionError
        If `q` is not a configuration in these coordinates, or they are those of free hands.
    """
    q = numbers(q)
    if q.shape != (coordinates.n_columns,) or not np.isfinite(q).all():
        raise OptionError(
            f"a configuration of shape {q.shape}", way_out=f"give {coordinates.n_columns} finite numbers"
        )
    if coordinates.kind == "arms":
        raise OptionError("free hands have no poses", way_out="use the load's coordinates, or poses_of")
    n = coordinates.n_dims
    center, quaternion = np.zeros((len(coordinates.parts), 3)), np.zeros((len(coordinates.parts), 4))
    for g, (kind, columns, _, _) in enumerate(coordinates.parts):
        center[g, :n], turn = np.split(q[columns], [n])
        rotation = np.eye(3)
        if kind == ANGLE:
            quaternion[g] = np.cos(turn[0] / 2), 0.0, 0.0, np.sin(turn[0] / 2)
            continue
        if kind == QUATERNION:
            quaternion[g] = turn / np.linalg.norm(turn)
            continue
        if kind == DIRECTION:
            x = np.eye(3)[0]
            rotation = similarity(x, np.append(turn, np.zeros(3 - n)) / np.linalg.norm(turn))
        quaternion[g] = quaternion_of_rotation(rotation)
    return HandPoses(center, quaternion)

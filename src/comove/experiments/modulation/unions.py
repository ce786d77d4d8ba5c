"""Overlapping obstacles united to one star-shaped body by a common reference point.

Where two obstacles overlap, a point can pass between them under the product of their matrices: in the notch between
them no obstacle has its full weight. From a point in the overlap, though, both are star-shaped, and so is their union
(Huber, Slotine & Billard, 2019, IV-C). Turned away from this point, velocities pass both in the same sense around the
union.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from comove.errors import ComoveWarning
from comove.experiments.modulation import levels as lv
from comove.experiments.modulation.obstacles import MovingObstacle, table_of
from comove.geometry import distances as sd

Array = NDArray[np.float64]


def united(obstacles: Sequence[MovingObstacle]) -> tuple[MovingObstacle, ...]:
    """Return the obstacles, with those that overlap put in groups about a common point.

    Margins are part of the obstacles, and the point is inside all obstacles of the group.

    References and groups that were given before are replaced. Call it again when obstacles have moved against each
    other. Overlapping obstacles that have no common point, such as three in a row, form groups as far as they have
    one; where two of different groups overlap, there is a warning, as a point can pass between them.

    Raises
    ------
    OptionError
        If the obstacles do not all have one dimension.
    """
    obstacles = tuple(obstacles)
    if not obstacles:
        return ()
    table = table_of(obstacles, obstacles[0].n_dims)
    groups: list[list[int]] = []
    for j in range(len(obstacles)):
        for members in groups:
            if _common(table, [*members, j]) is not None:
                members.append(j)
                break
        else:
            groups.append([j])
    for a, one in enumerate(groups):
        for other in groups[a + 1 :]:
            for i in one:
                for j in other:
                    if _common(table, [i, j]) is not None:
                        warnings.warn(
                            f"obstacles {i} and {j} overlap and belong to no common star-shaped body; "
                            "between them the modulation can let through",
                            ComoveWarning,
                            stacklevel=2,
                        )
    made = list(obstacles)
    for group, members in enumerate(groups):
        point = _common(table, members) if len(members) > 1 else None
        for j in members:
            obstacle, reference = obstacles[j], None
            if point is not None:
                reference = obstacle.rotation.T @ (point[: obstacle.n_dims] - obstacle.center)
            made[j] = replace(obstacle, reference=reference, group=None if point is None else group)
    return tuple(made)


def _common(table: Array, members: list[int]) -> Array | None:
    """Return a point inside all of these obstacles; array, shape (3,), [m]; None if there is none."""
    rows = table[members]
    apart = np.linalg.norm(
        rows[:, None, sd.CENTER : sd.CENTER + 3] - rows[:, sd.CENTER : sd.CENTER + 3], axis=2
    )
    if (apart > rows[:, None, sd.REACH] + rows[:, sd.REACH]).any():
        return None
    point = np.empty(3)
    return point if lv.common_point(table, np.array(members), point) < 1.0 else None

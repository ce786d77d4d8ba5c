"""How well a motion keeps the constraints of its scene at every instant.

What a block of the coordinates holds by construction is looked up in the block itself: hands of one block are images
of fixed points under one rigid motion, and a block that only shifts, or only turns about the vertical, tilts nothing.
Whatever hands of different blocks keep is bounded by their derivatives between the knots.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations
from math import degrees
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import ANGLE, DIRECTION, POINT, Part
from comove.coordination.motion import CoordinatedMotion
from comove.primitives.forcing import INTERVAL
from comove.scenes.constraints import (
    Constraint,
    DistanceConstraint,
    RelativePoseConstraint,
    SameHeightConstraint,
    SeparationConstraint,
    UprightConstraint,
)
from comove.verification.bounds import NodeBounds, distance_error, largest_size, least_distance, lengths

Array = NDArray[np.float64]

ROUNDING = 1e-9  # m or rad, allowed where a tolerance of nothing is asked for


class Finding(NamedTuple):
    """What was found about one constraint.

    Attributes
    ----------
    constraint : which one
    measure : bound of its error; of a separation what is kept beyond the least distance
    reason : why it does not hold, in words; empty where it does
    """

    constraint: Constraint
    measure: float
    reason: str


def examine(motion: CoordinatedMotion, bounds: NodeBounds, position: Array) -> list[Finding]:
    """Judge every constraint of the motion's scene over continuous time.

    Parameters
    ----------
    bounds : those of `motion`
    position : array, shape (n_knots, n_manipulators, 3), of the hands at the knots [m]
    """
    return [Finding(c, *_EXAMINERS[type(c)](motion, c, bounds, position)) for c in motion.scene.constraints]


def _distance(
    motion: CoordinatedMotion, c: DistanceConstraint, bounds: NodeBounds, position: Array
) -> tuple[float, str]:
    (first, i), (second, j) = (_block(motion, hand) for hand in (c.first, c.second))
    error = np.inf
    if first is second:
        apart = _apart(position, c.first, c.second)
        held = float(np.linalg.norm(first.points[i] - first.points[j]))
        error = float(np.abs(np.append(apart, held) - c.distance).max())
    elif first.kind == POINT and second.kind == POINT:
        relative = motion.knots[:, :, first.columns] - motion.knots[:, :, second.columns]
        relative[0] += (first.points[i] - second.points[j])[: motion.scene.n_dims]
        error = distance_error(relative, c.distance)
    kept = error <= max(c.tolerance, ROUNDING)
    names = _names(motion, c)
    return error, "" if kept else (
        f"the distance between {names} is off by up to {error:.3g} m (tolerance {c.tolerance:g} m)"
    )


def _relative_pose(
    motion: CoordinatedMotion, c: RelativePoseConstraint, bounds: NodeBounds, position: Array
) -> tuple[float, str]:
    """One block moves them; in space not one that leaves the roll open. In the plane a distance is enough."""
    (first, _), (second, _) = (_block(motion, hand) for hand in (c.first, c.second))
    kept = motion.scene.n_dims == 2 or (first is second and first.kind != DIRECTION)
    return (
        0.0,
        "" if kept else f"the motion's coordinates do not hold the relative pose of {_names(motion, c)}",
    )


def _separation(
    motion: CoordinatedMotion, c: SeparationConstraint, bounds: NodeBounds, position: Array
) -> tuple[float, str]:
    if _block(motion, c.first)[0] is _block(motion, c.second)[0]:
        least = float(_apart(position, c.first, c.second).min())
    else:
        bend = bounds.acceleration[:, c.first] + bounds.acceleration[:, c.second]
        least = least_distance(position[:, c.first] - position[:, c.second], bend)
    return least - c.least, "" if least - c.least >= -ROUNDING else (
        f"{_names(motion, c)} come as near as {least:.4g} m (at least {c.least:g} m asked for)"
    )


def _upright(
    motion: CoordinatedMotion, c: UprightConstraint, bounds: NodeBounds, position: Array
) -> tuple[float, str]:
    """Largest change of inclination of a line between two holders; infinite where the block may tilt.

    A block that only shifts, or in space turns about the vertical, keeps what lies across and along the vertical.
    """
    n_dims, (part, _) = motion.scene.n_dims, _block(motion, c.members[0])
    if not set(c.members) <= set(part.nodes.tolist()) or not _keeps_tilt(part, n_dims):
        return np.inf, "the motion's coordinates let the load tilt, and it must stay upright"
    tilt = 0.0
    for i, j in combinations(c.members, 2):
        line = position[:, i] - position[:, j]
        x, y = (line[:, 0], line[:, 1]) if n_dims == 2 else (np.hypot(line[:, 0], line[:, 1]), line[:, 2])
        change = np.arctan2(np.abs(x[0] * y - y[0] * x), x[0] * x + y[0] * y)
        tilt = max(tilt, float(change.max()))
    return tilt, "" if tilt <= max(c.tolerance, ROUNDING) else (
        f"the load tilts by up to {degrees(tilt):.3g} deg (tolerance {degrees(c.tolerance):g} deg)"
    )


def _same_height(
    motion: CoordinatedMotion, c: SameHeightConstraint, bounds: NodeBounds, position: Array
) -> tuple[float, str]:
    n_dims, columns = motion.scene.n_dims, np.arange(motion.coordinates.n_columns)
    blocks = [_block(motion, hand) for hand in (c.first, c.second)]
    if all(_keeps_tilt(part, n_dims) for part, _ in blocks):  # a height is a column of q and a constant
        first, second = (motion.knots[:, :, columns[part.columns][n_dims - 1]] for part, _ in blocks)
        relative = first - second
        relative[0] += np.subtract(*(part.points[i, n_dims - 1] for part, i in blocks))
        error = largest_size(relative)
    else:
        gap = np.abs(position[:, c.first, n_dims - 1] - position[:, c.second, n_dims - 1])
        bulge = INTERVAL**2 / 8 * (bounds.acceleration[:, c.first] + bounds.acceleration[:, c.second])
        error = float((np.maximum(gap[1:], gap[:-1]) + bulge).max())
    return error, "" if error <= max(c.tolerance, ROUNDING) else (
        f"the heights of {_names(motion, c)} differ by up to {error:.3g} m (tolerance {c.tolerance:g} m)"
    )


_EXAMINERS: dict[type, Callable[..., tuple[float, str]]] = {
    DistanceConstraint: _distance,
    RelativePoseConstraint: _relative_pose,
    SeparationConstraint: _separation,
    UprightConstraint: _upright,
    SameHeightConstraint: _same_height,
}


def _block(motion: CoordinatedMotion, hand: int) -> tuple[Part, int]:
    """The block that moves a hand, and which of its points the hand is."""
    for part in motion.coordinates.parts:
        found = np.flatnonzero(part.nodes == hand)
        if len(found):
            return part, int(found[0])
    raise LookupError(f"no block moves hand {hand}")


def _keeps_tilt(part: Part, n_dims: int) -> bool:
    """Whether a block keeps the tilt of what it moves, whatever q is."""
    return part.kind == POINT or (part.kind == ANGLE and n_dims == 3)


def _apart(position: Array, i: int, j: int) -> Array:
    return lengths(position[:, i] - position[:, j])


def _names(motion: CoordinatedMotion, c: Constraint) -> str:
    names = motion.scene.manipulators
    return f"'{names[c.first]}' and '{names[c.second]}'"

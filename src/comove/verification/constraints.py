"""Bounds of how far a motion violates the constraints of its scene, at every instant.

Constraints that a block of the coordinates keeps by construction are read off from the block: hands of one block are
images of fixed points under one rigid motion, and a block that only shifts, or only turns about the vertical, keeps
all tilts. Constraints between hands of different blocks are bounded by the hands' derivatives between the knots.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations
from math import degrees
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import ANGLE, DIRECTION, POINT, Block
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
    """The result of the check of one constraint.

    Attributes
    ----------
    constraint : the constraint
    measure : bound of its error; of a separation, the least spare beyond the required distance
    reason : why it does not hold, in words; empty where it does
    """

    constraint: Constraint
    measure: float
    reason: str


def examine(motion: CoordinatedMotion, bounds: NodeBounds, position: Array) -> list[Finding]:
    """Judge every constraint of the motion's scene over continuous time.

    Parameters
    ----------
    bounds : bounds of `motion`
    position : array, shape (n_knots, n_manipulators, 3), positions of the hands at the knots [m]
    """
    names = motion.scene.manipulators
    return [
        judged(c, _MEASURES[type(c)](motion, c, bounds, position), names) for c in motion.scene.constraints
    ]


def judged(c: Constraint, measure: float, manipulators: Sequence[str]) -> Finding:
    """Return the finding on a constraint whose `measure` is its error or, of a separation, the spare beyond it."""
    reason = ""
    if isinstance(c, SeparationConstraint):
        if not measure >= -ROUNDING:
            names = _names(c, manipulators)
            reason = f"{names} come as near as {measure + c.least:.4g} m (at least {c.least:g} m asked for)"
    elif not measure <= max(c.tolerance, ROUNDING):
        reason = _TOLD[type(c)](c, measure, manipulators)
    return Finding(c, measure, reason)


def worst(findings: list[Finding], kind: type, worst: Callable[..., float]) -> float | None:
    """Return the worst measure of the constraints of one kind, None where there is none.

    Parameters
    ----------
    worst : `max`, or `min` where less is worse
    """
    return worst((f.measure for f in findings if isinstance(f.constraint, kind)), default=None)


def _distance(motion: CoordinatedMotion, c: DistanceConstraint, bounds: NodeBounds, position: Array) -> float:
    (first, i), (second, j) = (_block(motion, hand) for hand in (c.first, c.second))
    if first is second:
        apart = _apart(position, c.first, c.second)
        held = float(np.linalg.norm(first.points[i] - first.points[j]))
        return float(np.abs(np.append(apart, held) - c.distance).max())
    if first.kind == POINT and second.kind == POINT:
        relative = motion.knots[:, :, first.columns] - motion.knots[:, :, second.columns]
        relative[0] += (first.points[i] - second.points[j])[: motion.scene.n_dims]
        return distance_error(relative, c.distance)
    return np.inf


def _relative_pose(
    motion: CoordinatedMotion, c: RelativePoseConstraint, bounds: NodeBounds, position: Array
) -> float:
    """Return 0 where the relative pose of two hands holds by construction, else infinity.

    It holds for hands of one block, in space unless the block leaves the roll open. In the plane a distance is
    enough.
    """
    (first, _), (second, _) = (_block(motion, hand) for hand in (c.first, c.second))
    kept = motion.scene.n_dims == 2 or (first is second and first.kind != DIRECTION)
    return 0.0 if kept else np.inf


def _separation(
    motion: CoordinatedMotion, c: SeparationConstraint, bounds: NodeBounds, position: Array
) -> float:
    if _block(motion, c.first)[0] is _block(motion, c.second)[0]:
        return float(_apart(position, c.first, c.second).min()) - c.least
    bend = bounds.acceleration[:, c.first] + bounds.acceleration[:, c.second]
    return least_distance(position[:, c.first] - position[:, c.second], INTERVAL**2 / 8 * bend) - c.least


def _upright(motion: CoordinatedMotion, c: UprightConstraint, bounds: NodeBounds, position: Array) -> float:
    """Return an upper bound of the load's tilt [rad], infinite where the load may tilt.

    A block that only shifts, or in space turns about the vertical, keeps the inclination of every line in it; and so
    do hands in space that are at one height because they share the column of q that describes the height.
    """
    n_dims, (part, _) = motion.scene.n_dims, _block(motion, c.members[0])
    together = set(c.members) <= set(part.nodes.tolist()) and _keeps_tilt(part, n_dims)
    if not together and not _is_level(motion, c.members):
        return np.inf
    return float(tilts(position, c.members, n_dims).max())


def _is_level(motion: CoordinatedMotion, members: Sequence[int]) -> bool:
    """Return whether hands in space are at one height, whatever q is."""
    columns = np.arange(motion.coordinates.n_columns)
    blocks = [_block(motion, hand) for hand in members]
    if motion.scene.n_dims != 3 or not all(_keeps_tilt(part, 3) for part, _ in blocks):
        return False
    return len({(int(columns[part.columns][2]), float(part.points[i, 2])) for part, i in blocks}) == 1


def tilts(position: Array, members: Sequence[int], n_dims: int) -> Array:
    """Return the largest change, since the start, of the inclination of a line between two members [rad].

    Parameters
    ----------
    position : array, shape (n_steps, n_manipulators, 3), positions of the hands [m]

    Returns
    -------
    array, shape (n_steps,)
    """
    tilt = np.zeros(len(position))
    for i, j in combinations(members, 2):
        line = position[:, i] - position[:, j]
        x, y = (line[:, 0], line[:, 1]) if n_dims == 2 else (np.hypot(line[:, 0], line[:, 1]), line[:, 2])
        tilt = np.maximum(tilt, np.arctan2(np.abs(x[0] * y - y[0] * x), x[0] * x + y[0] * y))
    return tilt


def _same_height(
    motion: CoordinatedMotion, c: SameHeightConstraint, bounds: NodeBounds, position: Array
) -> float:
    n_dims, columns = motion.scene.n_dims, np.arange(motion.coordinates.n_columns)
    blocks = [_block(motion, hand) for hand in (c.first, c.second)]
    if all(_keeps_tilt(part, n_dims) for part, _ in blocks):  # a height is a column of q and a constant
        first, second = (motion.knots[:, :, columns[part.columns][n_dims - 1]] for part, _ in blocks)
        relative = first - second
        relative[0] += np.subtract(*(part.points[i, n_dims - 1] for part, i in blocks))
        return largest_size(relative)
    gap = np.abs(position[:, c.first, n_dims - 1] - position[:, c.second, n_dims - 1])
    bulge = INTERVAL**2 / 8 * (bounds.acceleration[:, c.first] + bounds.acceleration[:, c.second])
    return float((np.maximum(gap[1:], gap[:-1]) + bulge).max())


_MEASURES: dict[type, Callable[..., float]] = {
    DistanceConstraint: _distance,
    RelativePoseConstraint: _relative_pose,
    SeparationConstraint: _separation,
    UprightConstraint: _upright,
    SameHeightConstraint: _same_height,
}


def _names(c: Constraint, manipulators: Sequence[str]) -> str:
    return f"'{manipulators[c.first]}' and '{manipulators[c.second]}'"


def _distance_off(c: DistanceConstraint, error: float, manipulators: Sequence[str]) -> str:
    names = _names(c, manipulators)
    off = f"off by up to {error:.3g} m" if np.isfinite(error) else "off by more than can be bounded"
    return f"the distance between {names} is {off} (tolerance {c.tolerance:g} m)"


def _pose_not_held(c: RelativePoseConstraint, _: float, manipulators: Sequence[str]) -> str:
    return f"the motion's coordinates do not hold the relative pose of {_names(c, manipulators)}"


def _tilted(c: UprightConstraint, tilt: float, _: Sequence[str]) -> str:
    if not np.isfinite(tilt):
        return "the motion's coordinates let the load tilt, and it must stay upright"
    return f"the load tilts by up to {degrees(tilt):.3g} deg (tolerance {degrees(c.tolerance):g} deg)"


def _heights_differ(c: SameHeightConstraint, error: float, manipulators: Sequence[str]) -> str:
    names = _names(c, manipulators)
    return f"the heights of {names} differ by up to {error:.3g} m (tolerance {c.tolerance:g} m)"


_TOLD: dict[type, Callable[..., str]] = {
    DistanceConstraint: _distance_off,
    RelativePoseConstraint: _pose_not_held,
    UprightConstraint: _tilted,
    SameHeightConstraint: _heights_differ,
}


def _block(motion: CoordinatedMotion, hand: int) -> tuple[Block, int]:
    """Return the block that moves a hand, and the hand's index among the block's points."""
    for part in motion.coordinates.parts:
        found = np.flatnonzero(part.nodes == hand)
        if len(found):
            return part, int(found[0])
    raise LookupError(f"no block moves hand {hand}")


def _keeps_tilt(part: Block, n_dims: int) -> bool:
    """Return whether a block keeps the tilt of the body that it moves, whatever q is."""
    return part.kind == POINT or (part.kind == ANGLE and n_dims == 3)


def _apart(position: Array, i: int, j: int) -> Array:
    return lengths(position[:, i] - position[:, j])

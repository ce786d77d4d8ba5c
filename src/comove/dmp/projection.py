"""Constraints between manipulators that move independently, and the projection onto them.

A constraint is a function of the manipulators' poses whose values vanish where it is met; the value of an inequality
is the amount by which it is violated, ``max(0, h)``. `project` moves all poses of all samples to a near point where
every constraint is met, by Gauss-Newton on positions and orientations. Each step is the least correction that meets
the linearised constraints,

    xi = -W J^T (J W J^T)^+ residual,      y <- y + xi_y,      R <- exp(xi_r) R,

with a metric W in which a radian counts as some length, times the mobility of each manipulator: a leader has
none and keeps its pose, and of two followers the one with twice the mobility makes way twice as far. J is computed by
central differences.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from comove.dmp.arguments import is_number, numbers, require_numbers
from comove.dmp.poses import VERTICAL, Pose
from comove.errors import ConstraintError, OptionError, near_name
from comove.geometry.rotations import conjugate, exponential, matrices, quaternion_product
from comove.ties import first_largest

Array = NDArray[np.float64]

TOLERANCE = 1e-12  # m or rad, below which a constraint is met
DIFFERENCE = 1e-6  # m or rad, of the central differences


@dataclass(frozen=True)
class ProjectionSettings:
    """Settings of how poses are moved onto constraints.

    Attributes
    ----------
    turn_length : length that a radian counts as, about the way from a wrist to what the hand holds [m]
    n_iterations : Gauss-Newton steps at most; where the constraints can be met, a handful are enough
    stretch : ratio of the hands' speed after the projection to that before from which on they jump
    small_way : ways by the projection between two samples that are not looked at for jumps [m]
    n_halvings : times that an interval in which hands may jump is halved
    """

    turn_length: float = 0.3
    n_iterations: int = 50
    stretch: float = 10.0
    small_way: float = 1e-3
    n_halvings: int = 16

    def __post_init__(self) -> None:
        require_numbers(self)


@dataclass(frozen=True, eq=False)
class Poses:
    """The poses of several manipulators at several samples, which are the argument of every constraint.

    Attributes
    ----------
    manipulators : names
    positions : array, shape (n_steps, n_manipulators, 3), [m]
    orientations : array, shape (n_steps, n_manipulators, 4), unit quaternions w x y z
    """

    manipulators: tuple[str, ...]
    positions: Array
    orientations: Array

    def position(self, name: str) -> Array:
        """Return the positions of one manipulator; array, shape (n_steps, 3), [m]."""
        return self.positions[:, self._index(name)]

    def rotation(self, name: str) -> Array:
        """Return the rotation matrices of one manipulator; array, shape (n_steps, 3, 3)."""
        return matrices(self.orientations[:, self._index(name)])

    def orientation(self, name: str) -> Array:
        """Return the unit quaternions (w x y z) of one manipulator; array, shape (n_steps, 4)."""
        return self.orientations[:, self._index(name)]

    def _index(self, name: str) -> int:
        if name not in self.manipulators:
            raise OptionError(f"there is no manipulator {name!r}", way_out=near_name(name, self.manipulators))
        return self.manipulators.index(name)


Constraint = Callable[[Poses], Array]
"""Takes `Poses`, gives an array (n_steps,) or (n_steps, n_values) that is zero where the constraint is met."""


@dataclass(frozen=True)
class HandDistance:
    """A constraint that keeps two hands `distance` apart [m]."""

    first: str
    second: str
    distance: float

    def __post_init__(self) -> None:
        _require_length(self.distance)

    def __call__(self, poses: Poses) -> Array:
        return (
            np.linalg.norm(poses.position(self.second) - poses.position(self.first), axis=1) - self.distance
        )


@dataclass(frozen=True)
class Separation:
    """A constraint that keeps two hands at least `distance` apart [m]."""

    first: str
    second: str
    distance: float

    def __post_init__(self) -> None:
        _require_length(self.distance)

    def __call__(self, poses: Poses) -> Array:
        return np.maximum(0.0, -HandDistance(self.first, self.second, self.distance)(poses))


@dataclass(frozen=True)
class SameHeight:
    """A constraint that keeps two hands at the same height."""

    first: str
    second: str

    def __call__(self, poses: Poses) -> Array:
        return poses.position(self.second)[:, 2] - poses.position(self.first)[:, 2]


@dataclass(frozen=True, eq=False)
class RelativePose:
    """A constraint that keeps the second hand at `pose` in the frame of the first."""

    first: str
    second: str
    pose: Pose

    def __post_init__(self) -> None:
        if not isinstance(self.pose, Pose) or len(self.pose.position) != 3:
            raise OptionError(f"pose = {self.pose!r}", way_out="give a Pose in space")

    def __call__(self, poses: Poses) -> Array:
        away = poses.position(self.second) - poses.position(self.first)
        missed = np.einsum("tji,tj->ti", poses.rotation(self.first), away) - self.pose.position
        relative = quaternion_product(
            conjugate(poses.orientation(self.first)), poses.orientation(self.second)
        )
        turn = quaternion_product(relative, conjugate(self.pose.orientation))
        return np.concatenate([missed, 2 * turn[:, 1:] * np.where(turn[:, :1] < 0, -1.0, 1.0)], axis=1)


@dataclass(frozen=True)
class Upright:
    """A constraint that makes `axis`, given in the hand's own frame, point up, as for a tray that stays level."""

    name: str
    axis: tuple[float, float, float] = VERTICAL

    def __post_init__(self) -> None:
        axis = numbers(self.axis)
        if axis.shape != (3,) or not 0 < np.linalg.norm(axis) < np.inf:
            raise OptionError(f"axis = {self.axis!r}", way_out="give three numbers, not all of them zero")

    def __call__(self, poses: Poses) -> Array:
        pointing = poses.rotation(self.name) @ (np.asarray(self.axis) / np.linalg.norm(self.axis))
        aside = np.linalg.norm(pointing[:, :2], axis=1, keepdims=True)
        # The angle, not its sine, which is blind at right angles and upside down.
        angle = np.arctan2(aside, pointing[:, 2:])
        return pointing[:, :2] * np.where(aside > 1e-9, angle / np.maximum(aside, 1e-9), 1.0)


def project(
    poses: Poses,
    constraints: Sequence[Constraint],
    mobility: Sequence[float] | None = None,
    settings: ProjectionSettings = ProjectionSettings(),
) -> Poses:
    """Return the poses moved onto all constraints, at every sample.

    Parameters
    ----------
    mobility : of every manipulator, how readily it moves relative to the others, 0 for one that must not; all alike
        by default
    settings : what a radian counts as, and the number of steps

    Raises
    ------
    ConstraintError
        If the constraints cannot be met together; the message names the one that is violated most.
    OptionError
        If a constraint does not return one row of finite numbers per sample.
    """
    if not constraints:
        return poses
    moves = np.ones(len(poses.manipulators)) if mobility is None else numbers(mobility)
    if moves.shape != (len(poses.manipulators),) or not (np.isfinite(moves) & (moves >= 0)).all():
        raise OptionError(
            f"mobility = {mobility!r}", way_out=f"give {len(poses.manipulators)} numbers, 0 or more"
        )
    metric = np.tile(np.repeat([1.0, settings.turn_length**-2], 3), len(poses.manipulators)) * np.repeat(
        moves, 6
    )
    still = moves == 0
    residual = _residual(poses, constraints)
    for _ in range(settings.n_iterations):
        off = np.flatnonzero(np.abs(residual).max(axis=1) > TOLERANCE)
        if not off.size:
            return poses
        part = Poses(poses.manipulators, poses.positions[off], poses.orientations[off])
        jacobian = _jacobian(part, constraints)
        weighted = metric[:, None] * jacobian.transpose(0, 2, 1)
        step = -weighted @ (np.linalg.pinv(jacobian @ weighted, rcond=1e-9) @ residual[off, :, None])
        moved = _moved(part, step[:, :, 0])
        positions, orientations = poses.positions.copy(), poses.orientations.copy()
        positions[off] = moved.positions
        orientations[off] = np.where(still[:, None], orientations[off], moved.orientations)
        poses = Poses(poses.manipulators, positions, orientations)
        residual = _residual(poses, constraints)
    worst = np.abs(residual).max()
    if worst <= 1e3 * TOLERANCE:  # rounding of large coordinates
        return poses
    sizes = [np.abs(_rows(constraint, poses)).max() for constraint in constraints]
    missed = constraints[first_largest(sizes)]
    raise ConstraintError(
        f"the constraints cannot be met together: {missed} is missed by {max(sizes):.3g}",
        way_out="drop one, or begin from a movement that nearly meets them",
    )


def _require_length(distance: float) -> None:
    if not is_number(distance) or not distance > 0:
        raise OptionError(f"distance = {distance!r}", way_out="give a positive number of metres")


def _residual(poses: Poses, constraints: Sequence[Constraint]) -> Array:
    return np.concatenate([_rows(constraint, poses) for constraint in constraints], axis=1)


def _rows(constraint: Constraint, poses: Poses) -> Array:
    n_steps = len(poses.positions)
    try:
        values = np.asarray(constraint(poses), dtype=float)
    except (TypeError, ValueError) as error:
        raise OptionError(
            f"the constraint {constraint} gives no numbers: {error}",
            way_out="give finite numbers, of shape (n_steps,) or (n_steps, n_values)",
        ) from error
    if (
        values.ndim not in (1, 2)
        or not values.size
        or len(values) != n_steps
        or not np.isfinite(values).all()
    ):
        raise OptionError(
            f"the constraint {constraint} gives an array of shape {values.shape} for {n_steps} samples",
            way_out="give finite numbers, of shape (n_steps,) or (n_steps, n_values)",
        )
    return values.reshape(n_steps, -1)


def _jacobian(poses: Poses, constraints: Sequence[Constraint]) -> Array:
    """Return the derivatives of the residuals; array, shape (n_steps, n_residuals, 6 n_manipulators)."""
    width = 6 * len(poses.manipulators)
    columns = []
    for j in range(width):
        step = np.zeros((len(poses.positions), width))
        step[:, j] = DIFFERENCE
        ahead, behind = (_residual(_moved(poses, side * step), constraints) for side in (1, -1))
        columns.append((ahead - behind) / (2 * DIFFERENCE))
    return np.stack(columns, axis=2)


def _moved(poses: Poses, step: Array) -> Poses:
    """Return the poses after translations and rotations, `step` of shape (n_steps, 6 n_manipulators) [m, rad]."""
    step = step.reshape(len(step), -1, 6)
    turned = quaternion_product(exponential(step[..., 3:]), poses.orientations)
    return Poses(poses.manipulators, poses.positions + step[..., :3], turned)

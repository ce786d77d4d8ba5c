"""Dynamic modulation of velocities by moving obstacles (Khansari-Zadeh & Billard, 2012).

A desired velocity f at a point becomes

    xdot = M (f - xdot_o) + xdot_o,    M = E D E^-1,    E = [r, e_1, ...],    D = diag(lambda_1, lambda_i, ...),

with xdot_o the velocity of the obstacle, e_i tangents to its level Gamma (see `levels`), r the normal n or the
direction from a reference point inside (Huber, Slotine & Billard, 2019), and

    lambda_1 = 1 - w / Gamma^(1/rho),    lambda_i = 1 + w / Gamma^(1/rho).

On the surface the velocity into the obstacle vanishes; far away M is the identity. All lambda_i are equal, so

    M = lambda_i I + (lambda_1 - lambda_i) r n^T / (n^T r)

needs no basis of tangents. For several obstacles k, M is the product of their matrices, with weights

    w_k = prod_(i != k) (Gamma_i - 1) / ((Gamma_k - 1) + (Gamma_i - 1)),

and xdot_o is the mean of their velocities with these weights. Obstacles of a group (`united`) count as one there,
with the least of their levels; within the group their matrices are averaged with weights 1 / (Gamma_k - 1).

Inside an obstacle, where Gamma < 1, the formula would reverse velocities without bound. There lambda_1 is 0 for
velocities that lead further in and 1 for those that lead out, and `escape` pushes outwards. docs/modulation.md states
the limits of the method.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from math import sqrt
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.dmp.arguments import is_number
from comove.errors import OptionError
from comove.geometry.distances import CENTER, REACH, TINY
from comove.lab.modulation.levels import GROUP, REFERENCE, TURN, VELOCITY, level_at
from comove.lab.modulation.obstacles import MovingObstacle, points_of, table_of
from comove.model.shapes import spatial

E = TypeVar("E", bound=StrEnum)

GRAZING = 1e-3  # least n^T r at which the reference direction is used; else the normal


class Directions(StrEnum):
    """Direction along which the velocity into an obstacle is removed.

    REFERENCE
        Away from the obstacle's reference point (Huber, Slotine & Billard, 2019): motions pass around flat faces and
        unions.
    NORMAL
        Along the normal of the level (Khansari-Zadeh & Billard, 2012). For a sphere with its reference at the centre,
        both directions are equal.
    """

    REFERENCE = "reference"
    NORMAL = "normal"


class Sharing(StrEnum):
    """Assignment of modulation matrices to several points.

    SAME
        All points use the matrix of the point with the least level, which is modulated most (the paper's III-B and
        Fig. 2). Then d/dt(y1 - y2) = M (f1 - f2): distances are kept where all points have the same desired velocity,
        and change where the payload rotates. The other points may be led into the obstacle.
    OWN
        Each point uses its own matrix. None enters the obstacle; distances change even in a pure translation.
    NONE
        Velocities stay as desired.
    """

    SAME = "same"
    OWN = "own"
    NONE = "none"


def _member(kind: type[E], name: str, value: object) -> E:
    try:
        return kind(str(value))
    except ValueError:
        raise OptionError(f"{name} = {value!r}", key=name, way_out=f"give one of {', '.join(kind)}") from None


@dataclass(frozen=True)
class Modulation:
    """Settings of the modulation of velocities.

    Attributes
    ----------
    reactivity : rho, positive; the greater, the farther away obstacles act
    tail : whether obstacles also act on motions away from them; if not, lambda_1 = 1 for these
    directions : see `Directions`
    escape : velocity out of an obstacle at its very centre [m/s]; it fades as 1 - Gamma towards the surface
    """

    reactivity: float = 1.0
    tail: bool = True
    directions: Directions = Directions.REFERENCE
    escape: float = 0.0

    def __post_init__(self) -> None:
        if not (is_number(self.reactivity) and self.reactivity > 0):
            raise OptionError(
                f"reactivity = {self.reactivity!r}", key="reactivity", way_out="give a positive number"
            )
        if not (is_number(self.escape) and self.escape >= 0):
            raise OptionError(f"escape = {self.escape!r}", key="escape", way_out="give 0 or a speed [m/s]")
        if not isinstance(self.tail, (bool, np.bool_)):
            raise OptionError(f"tail = {self.tail!r}", key="tail", way_out="give True or False")
        object.__setattr__(self, "directions", _member(Directions, "directions", self.directions))


@dataclass(frozen=True, eq=False)
class Field:
    """Affine map by which obstacles modulate velocities. It is ``xdot = matrix f + drift``.

    Attributes
    ----------
    matrix : array, shape (..., n_dims, n_dims), M
    drift : array, shape (..., n_dims), (I - M) xdot_o plus the escape velocity [m/s]
    level : array, shape (...), least Gamma of all obstacles; infinite without any
    """

    matrix: Array
    drift: Array
    level: Array

    def __call__(self, velocity: Array) -> Array:
        """Return the modulated velocities [m/s]. The shapes are (..., n_dims) -> (..., n_dims)."""
        return (self.matrix @ velocity[..., None])[..., 0] + self.drift


DEFAULT = Modulation()


def field(
    position: ArrayLike,
    velocity: ArrayLike,
    obstacles: Sequence[MovingObstacle],
    modulation: Modulation = DEFAULT,
) -> Field:
    """Return the matrix and drift of the modulation at points.

    Parameters
    ----------
    position : array, shape (..., n_dims), [m]
    velocity : array, shape (..., n_dims), desired velocities, which determine whether a point moves towards an
        obstacle [m/s]
    obstacles : the obstacles at this instant
    modulation : settings of the modulation

    Raises
    ------
    OptionError
        If shapes or dimensions do not agree, or numbers are not finite.
    """
    position, velocity = _points_and_velocities(position, velocity)
    shape, n = position.shape, position.shape[-1]
    matrix, drift, level = _fields(
        table_of(tuple(obstacles), n),
        spatial(position.reshape(-1, n)),
        spatial(velocity.reshape(-1, n)),
        float(modulation.reactivity),
        bool(modulation.tail),
        modulation.directions is Directions.REFERENCE,
        float(modulation.escape),
    )
    return Field(matrix[:, :n, :n].reshape(*shape, n), drift[:, :n].reshape(shape), level.reshape(shape[:-1]))


def modulated(
    position: ArrayLike,
    velocity: ArrayLike,
    obstacles: Sequence[MovingObstacle],
    *,
    sharing: Sharing = Sharing.SAME,
    modulation: Modulation = DEFAULT,
) -> Array:
    """Return the modulated velocities of all points of one body.

    Parameters
    ----------
    position : array, shape (..., n_points, n_dims), end effectors and, optionally, points of the payload [m]
    velocity : array, shape (..., n_points, n_dims), desired velocities [m/s]
    obstacles : the obstacles at this instant
    sharing : assignment of matrices to points
    modulation : settings of the modulation

    Returns
    -------
    array, shape (..., n_points, n_dims), [m/s]

    Raises
    ------
    OptionError
        If shapes or dimensions do not agree, or numbers are not finite.
    """
    sharing = _member(Sharing, "sharing", sharing)
    position, velocity = _points_and_velocities(position, velocity)
    if sharing is Sharing.NONE:
        return velocity
    at = field(position, velocity, obstacles, modulation)
    if sharing is Sharing.OWN:
        return at(velocity)
    if position.ndim < 2 or position.shape[-2] == 0:
        raise OptionError(
            f"position of shape {position.shape}", key="position", way_out="give (..., n_points, n_dims)"
        )
    nearest = (*np.indices(at.level.shape[:-1], sparse=True), at.level.argmin(axis=-1))
    return velocity @ np.swapaxes(at.matrix[nearest], -1, -2) + at.drift[nearest][..., None, :]


def _points_and_velocities(position: ArrayLike, velocity: ArrayLike) -> tuple[Array, Array]:
    position = points_of("position", position)
    velocity = points_of("velocity", velocity, position.shape[-1])
    if position.shape != velocity.shape:
        raise OptionError(
            f"velocity of shape {velocity.shape} at positions of shape {position.shape}",
            key="velocity",
            way_out="give one velocity a point",
        )
    return position, velocity


@kernel
def _fields(
    table: Array,
    points: Array,
    velocities: Array,
    reactivity: float,
    tail: bool,
    by_reference: bool,
    escape: float,
) -> tuple[Array, Array, Array]:
    """Return matrix, drift and least level at every point. Their shapes are (n_points, 3, 3), (n_points, 3) and
    (n_points,)."""
    n_points, n_obstacles = points.shape[0], table.shape[0]
    matrix, drift, least = np.empty((n_points, 3, 3)), np.zeros((n_points, 3)), np.full(n_points, np.inf)
    head = _heads(table)
    level, excess = np.empty(n_obstacles), np.empty(n_obstacles)
    share, weight = np.empty(n_obstacles), np.empty(n_obstacles)
    normal, away, carried = np.empty((n_obstacles, 3)), np.empty((n_obstacles, 3)), np.empty((n_obstacles, 3))
    own, total, product = np.empty((3, 3)), np.eye(3), np.empty((3, 3))
    for i in range(n_points):
        deepest = -1
        for j in range(n_obstacles):
            level[j] = _directions(table, j, points[i], by_reference, normal[j], away[j], carried[j])
            if level[j] < least[i]:
                least[i], deepest = level[j], j
        _weigh(level, head, excess, share, weight)
        vx, vy, vz = _mean_velocity(carried, head, share, weight)
        fx, fy, fz = velocities[i, 0] - vx, velocities[i, 1] - vy, velocities[i, 2] - vz
        total[:] = np.eye(3)  # of groups before this one
        for g in range(n_obstacles):
            if head[g] != g:
                continue
            own[:] = 0.0
            for j in range(g, n_obstacles):
                if head[j] != g:
                    continue
                fade = weight[g] * max(level[j], 1.0) ** (-1.0 / reactivity)
                leaves = normal[j, 0] * fx + normal[j, 1] * fy + normal[j, 2] * fz >= 0.0
                along = 1.0 if leaves and (not tail or level[j] < 1.0) else 1.0 - fade
                across = 1.0 + fade
                for a in range(3):
                    own[a, a] += share[j] * across
                    for b in range(3):
                        own[a, b] += share[j] * (along - across) * away[j, a] * normal[j, b]
            for a in range(3):
                for b in range(3):
                    product[a, b] = (
                        own[a, 0] * total[0, b] + own[a, 1] * total[1, b] + own[a, 2] * total[2, b]
                    )
            total[:] = product
        matrix[i] = total
        for a in range(3):
            moved = total[a, 0] * vx + total[a, 1] * vy + total[a, 2] * vz
            drift[i, a] = (vx, vy, vz)[a] - moved
        if escape > 0.0 and deepest >= 0 and level[deepest] < 1.0:
            push = escape * (1.0 - level[deepest])
            out = away[deepest]
            length = sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2])
            for a in range(3):
                drift[i, a] += push * out[a] / length
    return matrix, drift, least


@kernel
def _heads(table: Array) -> Integers:
    """Return the head of each obstacle's group. The head is the first obstacle of a group, and represents it."""
    head = np.empty(table.shape[0], dtype=np.int64)
    for j in range(table.shape[0]):
        head[j] = j
        for i in range(j):
            if table[j, GROUP] >= 0.0 and table[i, GROUP] == table[j, GROUP]:
                head[j] = head[i]
                break
    return head


@kernel
def _directions(
    table: Array, j: int, point: Array, by_reference: bool, normal: Array, away: Array, carried: Array
) -> float:
    """Return an obstacle's level at a point, and write three vectors. These are its normal n, r / (n^T r) and its
    velocity, in the last three arguments."""
    level, _, nx, ny, nz = level_at(table, j, point[0], point[1], point[2])
    normal[0], normal[1], normal[2] = nx, ny, nz
    away[:] = normal
    if by_reference:
        rx, ry, rz = (
            point[0] - table[j, REFERENCE],
            point[1] - table[j, REFERENCE + 1],
            point[2] - table[j, REFERENCE + 2],
        )
        slope = nx * rx + ny * ry + nz * rz
        if slope > max(GRAZING * sqrt(rx * rx + ry * ry + rz * rz), TINY):
            away[0], away[1], away[2] = rx / slope, ry / slope, rz / slope
    # The lever arm ends at the obstacle's reach, so that an obstacle's rotation does not move points far away.
    x, y, z = point[0] - table[j, CENTER], point[1] - table[j, CENTER + 1], point[2] - table[j, CENTER + 2]
    arm = min(1.0, table[j, REACH] / max(sqrt(x * x + y * y + z * z), TINY))
    u, v, w = table[j, TURN], table[j, TURN + 1], table[j, TURN + 2]
    carried[0] = table[j, VELOCITY] + arm * (v * z - w * y)
    carried[1] = table[j, VELOCITY + 1] + arm * (w * x - u * z)
    carried[2] = table[j, VELOCITY + 2] + arm * (u * y - v * x)
    return level


@kernel
def _weigh(level: Array, head: Integers, excess: Array, share: Array, weight: Array) -> None:
    """Write the weights of obstacles within groups, and of groups. Those in `share` sum to 1 within a group. Those
    of groups are in `weight`, at the index of the head. `excess` is the least Gamma - 1 of a group, 0 inside."""
    n = level.shape[0]
    excess[:], weight[:] = np.inf, 0.0  # the latter at first the sums of shares
    for j in range(n):
        beyond = max(level[j] - 1.0, 0.0)
        share[j] = 1.0 / (beyond + TINY)
        weight[head[j]] += share[j]
        excess[head[j]] = min(excess[head[j]], beyond)
    for j in range(n):
        share[j] /= weight[head[j]]
    for g in range(n):
        if head[g] == g:
            weight[g] = 1.0
            for k in range(n):
                if head[k] == k and k != g:
                    both = excess[g] + excess[k]
                    weight[g] *= excess[k] / both if both > 0.0 else 0.5


@kernel
def _mean_velocity(carried: Array, head: Integers, share: Array, weight: Array) -> tuple[float, float, float]:
    """Return the mean (3) of the obstacles' velocities by their weights."""
    vx, vy, vz, total = 0.0, 0.0, 0.0, 0.0
    for j in range(head.shape[0]):
        part = weight[head[j]] * share[j]
        vx, vy, vz = vx + part * carried[j, 0], vy + part * carried[j, 1], vz + part * carried[j, 2]
        total += part
    if total > 0.0:
        vx, vy, vz = vx / total, vy / total, vz / total
    return vx, vy, vz

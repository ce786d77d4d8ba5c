"""Level functions of obstacles: distance measures of modulated velocities.

They are numba kernels. A level function Gamma is 1 on the surface of an obstacle with its safety margin, greater
outside, smaller inside, and grows on every ray from a point inside (Khansari-Zadeh & Billard, 2012, eq. 5). All
those used here are convex functions of the position. With u the point in the obstacle's axes and d its signed
distance from the bare obstacle [m],

    ellipsoid     sum (u_i / a_i)^2           a_i: semi-axes of an ellipsoid that contains obstacle and margin
    superquadric  sum |u_i / a_i|^(2 p_i)     a_i: semi-axes, stretched by one factor to contain the margin
    all others    ((l + d) / (l + margin))^2  l: least half width of the obstacle

which for a sphere is (|u| / (radius + margin))^2. Where d has a kink outside, at an edge, its gradient still is
continuous off the surface; with a margin also on it.

Obstacles are rows of one table that begins as those of `comove.geometry.distances`. Further columns are `LEVEL` (3:
a_i; or l and l + margin), `EXPONENT` (3: p_i), `REFERENCE` (3: a point inside, in the world), `VELOCITY` (3: of the
centre), `TURN` (3: angular velocity) and `GROUP`; `REACH` is the radius about the centre that contains the obstacle
with its margin. Everything is spatial: a planar obstacle is the slice z = 0 of one that is endless along z.
"""

from __future__ import annotations

from math import exp, log, sqrt

import numpy as np

from comove.arrays import Array, Integers
from comove.compiled import kernel
from comove.geometry.distances import CENTER, ELLIPSOID, KIND, N_COLUMNS, REACH, TINY, distance_and_gradient

LEVEL, EXPONENT, REFERENCE, VELOCITY, TURN = range(N_COLUMNS, N_COLUMNS + 15, 3)
GROUP, N_LEVEL_COLUMNS = N_COLUMNS + 15, N_COLUMNS + 16
SUPERQUADRIC = ELLIPSOID + 1
HUGE = 1e150  # beyond it a level says no more than "far", and its square still is a number


@kernel
def level_at(table: Array, j: int, x: float, y: float, z: float) -> tuple[float, float, float, float, float]:
    """Return the level of obstacle `j` at a point, and its gradient. The gradient is given by its length [1/m] and
    its direction (3). At the very centre, where there is no gradient, the length is 0 and the direction along x."""
    if table[j, KIND] >= ELLIPSOID:
        level, slope, nx, ny, nz = _algebraic(table, j, x, y, z)
    else:
        distance, nx, ny, nz = distance_and_gradient(table, j, x, y, z)
        width = table[j, LEVEL + 1]
        share = max(table[j, LEVEL] + distance, 0.0) / width
        level, slope = share * share, 2.0 * share / width
        if nx * nx + ny * ny + nz * nz < 0.25:  # where the distance has no gradient
            slope = 0.0
    if not slope > 0.0:
        return level, 0.0, 1.0, 0.0, 0.0
    return min(level, HUGE), min(slope, HUGE), nx, ny, nz


@kernel
def _algebraic(
    table: Array, j: int, x: float, y: float, z: float
) -> tuple[float, float, float, float, float]:
    """Return `level_at` for ellipsoids and superquadrics. A level far outside may overflow."""
    x, y, z = x - table[j, CENTER], y - table[j, CENTER + 1], z - table[j, CENTER + 2]
    u = table[j, 4] * x + table[j, 7] * y + table[j, 10] * z
    v = table[j, 5] * x + table[j, 8] * y + table[j, 11] * z
    w = table[j, 6] * x + table[j, 9] * y + table[j, 12] * z
    a, b, c = table[j, LEVEL], table[j, LEVEL + 1], table[j, LEVEL + 2]
    if table[j, KIND] == ELLIPSOID:
        level, scale = (u / a) ** 2 + (v / b) ** 2 + (w / c) ** 2, 2.0
        gu, gv, gw = u / a / a, v / b / b, w / c / c
    else:
        p, q, r = table[j, EXPONENT], table[j, EXPONENT + 1], table[j, EXPONENT + 2]
        level = abs(u / a) ** (2 * p) + abs(v / b) ** (2 * q) + abs(w / c) ** (2 * r)
        # Powers of far points overflow: the gradient is built relative to its largest part.
        lu, lv, lw = _log_slope(u, a, p), _log_slope(v, b, q), _log_slope(w, c, r)
        most = max(lu, lv, lw)
        if most == -np.inf:
            return level, 0.0, 1.0, 0.0, 0.0
        scale = exp(min(most, 700.0))
        gu, gv, gw = (
            np.copysign(exp(lu - most), u),
            np.copysign(exp(lv - most), v),
            np.copysign(exp(lw - most), w),
        )
    length = sqrt(gu * gu + gv * gv + gw * gw)
    if length < 1e-300:
        return level, 0.0, 1.0, 0.0, 0.0
    gu, gv, gw = gu / length, gv / length, gw / length
    return (
        level,
        scale * length,
        table[j, 4] * gu + table[j, 5] * gv + table[j, 6] * gw,
        table[j, 7] * gu + table[j, 8] * gv + table[j, 9] * gw,
        table[j, 10] * gu + table[j, 11] * gv + table[j, 12] * gw,
    )


@kernel
def _log_slope(u: float, a: float, p: float) -> float:
    """Return log |d/du |u / a|^(2p)|. It is minus infinity at 0 and along an endless axis."""
    share = abs(u) / a
    return log(2.0 * p / a) + (2.0 * p - 1.0) * log(share) if share > 0.0 else -np.inf


@kernel
def levels_at(table: Array, points: Array) -> tuple[Array, Array]:
    """Return levels and gradients [1/m] of every obstacle at every point.

    Parameters
    ----------
    table : array, shape (n_obstacles, N_LEVEL_COLUMNS)
    points : array, shape (n_points, 3), [m]

    Returns
    -------
    levels : array, shape (n_points, n_obstacles)
    gradients : array, shape (n_points, n_obstacles, 3)
    """
    levels = np.empty((points.shape[0], table.shape[0]))
    gradients = np.empty((points.shape[0], table.shape[0], 3))
    for i in range(points.shape[0]):
        for j in range(table.shape[0]):
            level, slope, nx, ny, nz = level_at(table, j, points[i, 0], points[i, 1], points[i, 2])
            levels[i, j] = level
            gradients[i, j, 0], gradients[i, j, 1], gradients[i, j, 2] = slope * nx, slope * ny, slope * nz
    return levels, gradients


@kernel
def common_point(table: Array, members: Integers, x: Array) -> float:
    """Find a point deep inside all `members`; return their largest level.

    The point is written in `x` (3). The greatest of convex functions is convex. The ellipsoid method (Yudin &
    Nemirovski, 1976) converges to its least value from a ball that contains the smallest obstacle, and ends with 1
    or more as soon as it is certain that the obstacles have no point in common.
    """
    smallest = members[0]
    for j in members:
        if table[j, REACH] < table[smallest, REACH]:
            smallest = j
    here = table[smallest, CENTER : CENTER + 3].copy()
    shape = np.eye(3) * table[smallest, REACH] ** 2
    best = np.inf
    for _ in range(300):
        greatest, slope, gx, gy, gz = -1.0, 0.0, 0.0, 0.0, 0.0
        for j in members:
            level, steep, nx, ny, nz = level_at(table, j, here[0], here[1], here[2])
            if level > greatest:
                greatest, slope, gx, gy, gz = level, steep, nx, ny, nz
        if greatest < best:
            best = greatest
            x[:] = here
        across = shape @ np.array([gx, gy, gz])
        width = sqrt(max(across[0] * gx + across[1] * gy + across[2] * gz, 0.0))
        # The tangent bounds the least value from below.
        least = greatest - slope * width
        if least >= 1.0 or best - least < 1e-3 or width < TINY:
            break
        across /= width
        here -= across / 4.0
        shape = 9.0 / 8.0 * (shape - 0.5 * np.outer(across, across))
    return best

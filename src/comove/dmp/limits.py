"""Via-points and limits of a primitive, by quadratic programmes in its weights.

Position, velocity and acceleration are linear in the shape weights, so via-points are linear equations and limits of
every coordinate are linear inequalities. Of all movements that satisfy them, the programme selects the one nearest to
the given movement, in the metric in which the weights are orthonormal (the velocity's). Between two knots the
acceleration is ``(P + Q t) exp(-omega t)``, so the largest velocity and acceleration over continuous time are known
exactly; where they exceed a limit between the knots, the limit at the knots is lowered and the programme solved
again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.arguments import is_number, numbers, vector
from comove.dmp.basis import MotionBasis
from comove.dmp.dmp import DMP, require_positions
from comove.dmp.system import INTERVAL, OMEGA
from comove.errors import OptionError


@dataclass(frozen=True)
class ViaPoint:
    """A point that a movement passes at a given time.

    Attributes
    ----------
    time : [s], between start and end
    position : array, shape (n_dims,), [m]
    velocity : array, shape (n_dims,), [m/s]; free if not given
    """

    time: float
    position: ArrayLike
    velocity: ArrayLike | None = None


def largest(dmp: DMP) -> tuple[Array, Array]:
    """Compute every coordinate's largest velocity and acceleration in continuous time.

    Returns
    -------
    velocity, acceleration : arrays, shape (n_dims,), [m/s] and [m/s^2]

    Raises
    ------
    OptionError
        For rhythmic movements.
    """
    ending_basis(dmp)
    velocity, acceleration = _largest(dmp.curve.knots)
    return velocity / dmp.duration, acceleration / dmp.duration**2


def constrained(
    dmp: DMP,
    *,
    via: Sequence[ViaPoint] = (),
    velocity: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
) -> DMP:
    """Return the nearest movement that passes via-points and keeps limits. Ends and duration are those of `dmp`.

    Parameters
    ----------
    via
        Points that the movement passes exactly.
    velocity, acceleration
        Limits of every coordinate at every instant; a number or an array of shape (n_dims,), [m/s], [m/s^2].

    Raises
    ------
    OptionError
        If no weights satisfy all conditions, or an argument is out of range.
    """
    basis, values, weights = ending_basis(dmp), dmp.boundary_values(), dmp.shape_weights
    of_velocity = limits_of("velocity", velocity, dmp) * dmp.duration
    of_acceleration = limits_of("acceleration", acceleration, dmp) * dmp.duration**2
    limits = np.stack([of_velocity, of_acceleration], axis=1)
    rows, targets = _via_rows(dmp, via)
    new = np.stack(
        [
            _solved(basis, values[:, d], weights[d], (rows, targets[:, d]), limits[d], d)
            for d in range(dmp.n_dims)
        ]
    )
    scaling = dmp.scaling()
    learned = np.linalg.pinv(scaling) @ new
    if np.abs(scaling @ learned - new).max() > 1e-9 * (1.0 + np.abs(new).max()):
        raise OptionError(
            f"the variant {dmp.variant} learns nothing where the goal is the start",
            way_out="use the closed form",
        )
    return replace(dmp, weights=learned)


def _solved(
    basis: MotionBasis,
    boundary: Array,
    weights: Array,
    via: tuple[Array, Array],
    limits: Array,
    dimension: int,
) -> Array:
    """Compute one coordinate's shape weights nearest to `weights`; shape (n_basis,).

    `limits` holds the limits of velocity and acceleration in unit duration, infinite where there is none.
    """
    equalities, targets = via[0][:, 4:], via[1] - via[0][:, :4] @ boundary
    lowered = limits
    slack = 1e-9  # share of a limit by which it is undercut: rounding
    lost = 1e-12  # share of a limit that is lost when weights are written for another system and read again
    for _ in range(8):
        rows, lower, upper = [equalities], [targets], [targets]
        for order, limit in enumerate(lowered, start=1):
            if limit < np.inf:
                coast = basis.boundary[order] @ boundary
                rows.append(basis.shape[order])
                lower.append(-limit - coast)
                upper.append(limit - coast)
        solution = _nearest(
            weights, np.concatenate(rows), np.concatenate(lower), np.concatenate(upper), len(targets)
        )
        if solution is None:
            wanted = ["the via-points"] if len(targets) else []
            names = ("velocity", "acceleration")
            wanted += [name for name, limit in zip(names, limits, strict=True) if limit < np.inf]
            raise OptionError(
                f"no movement of {len(weights)} weights keeps {' and '.join(wanted)} in dimension {dimension}",
                way_out="give it more time or more weights, or ask for less",
            )
        knots = basis.boundary @ boundary + basis.shape @ solution
        excess = np.concatenate(_largest(knots[:, :, None])) / limits - 1
        if excess.max() <= -lost:
            return solution
        lowered = lowered * (1 - 2 * np.maximum(excess, 0.0) - slack)
    raise OptionError(
        f"the limits in dimension {dimension} cannot be kept between the knots", way_out="give it more time"
    )


def _nearest(weights: Array, rows: Array, lower: Array, upper: Array, n_equal: int) -> Array | None:
    """Return the z nearest to `weights`: ``lower <= rows z <= upper``, the first `n_equal` rows with equality."""
    import daqp

    # Equations are met by elimination, exactly; the programme is left with the inequalities.
    particular, free = weights, np.eye(len(weights))
    if n_equal:
        equal = rows[:n_equal]
        _, singular, right = np.linalg.svd(equal)
        rank = int((singular > 1e-10 * max(singular.max(initial=0.0), 1e-300)).sum())
        particular = weights + np.linalg.lstsq(equal, lower[:n_equal] - equal @ weights, rcond=1e-10)[0]
        missed, size = np.abs(equal @ particular - lower[:n_equal]).max(), np.abs(lower[:n_equal]).max()
        if missed > 1e-9 * (1.0 + size):  # more than rounding
            return None
        free = right[rank:].T
    rows, lower, upper = rows[n_equal:], lower[n_equal:], upper[n_equal:]
    value = rows @ particular
    if not ((value < lower) | (value > upper)).any():
        return particular
    if not free.shape[1]:
        return None
    scale = np.maximum(np.abs(upper - lower) / 2, 1e-300)  # rows in units of their limits
    matrix = np.ascontiguousarray((rows @ free) / scale[:, None])
    solution, _, flag, _ = daqp.solve(
        np.eye(free.shape[1]),
        np.zeros(free.shape[1]),
        matrix,
        (upper - value) / scale,
        (lower - value) / scale,
        np.zeros(len(rows), dtype=np.int32),
    )
    return particular + free @ solution if flag > 0 else None


def _largest(knots: Array) -> tuple[Array, Array]:
    """Compute the largest |y'| and |y''| in unit duration; knots (3, n_knots, n_dims)."""
    _, velocity, acceleration = knots
    p = acceleration[:-1]
    q = (acceleration[1:] * np.exp(OMEGA * INTERVAL) - p) / INTERVAL
    with np.errstate(divide="ignore", invalid="ignore"):
        turning, bending = -p / q, 1 / OMEGA - p / q
    fastest = np.abs(velocity).max(axis=0)
    hardest = np.abs(acceleration).max(axis=0)
    for t, order in ((turning, 1), (bending, 2)):
        t = np.where((t > 0) & (t < INTERVAL), t, 0.0)  # elsewhere: the knot itself
        decay = np.exp(-OMEGA * t)
        if order == 2:
            hardest = np.maximum(hardest, np.abs((p + q * t) * decay).max(axis=0))
        else:
            gained = -(p / OMEGA + q / OMEGA**2) * np.expm1(-OMEGA * t) - q * t * decay / OMEGA
            fastest = np.maximum(fastest, np.abs(velocity[:-1] + gained).max(axis=0))
    return fastest, hardest


def _via_rows(dmp: DMP, via: Sequence[ViaPoint]) -> tuple[Array, Array]:
    """Return rows of [B Phi] and their target values. Shapes are (n_rows, 4 + n_basis) and (n_rows, n_dims)."""
    rows, targets = [np.zeros((0, 4 + dmp.weights.shape[1]))], [np.zeros((0, dmp.n_dims))]
    if not isinstance(via, (list, tuple)) or not all(isinstance(point, ViaPoint) for point in via):
        raise OptionError(f"via = {via!r}", way_out="give a list of ViaPoint(time, position)")
    for point in via:
        if not is_number(point.time) or not 0 < point.time < dmp.duration:
            raise OptionError(
                f"a via-point at {point.time!r} s of a movement of {dmp.duration:g} s",
                way_out="give a time between start and end",
            )
        boundary, shape = dmp.basis.at([point.time / dmp.duration])
        for order, value in enumerate((point.position, point.velocity)):
            if value is None:
                continue
            passed = vector("a via-point", value, dmp.n_dims)
            rows.append(np.concatenate([boundary[order], shape[order]], axis=1))
            targets.append(passed[None] * dmp.duration**order)
    return np.concatenate(rows), np.concatenate(targets)


def limits_of(name: str, value: ArrayLike | None, dmp: DMP) -> Array:
    """Return every coordinate's limit, infinite if none; array, shape (n_dims,)."""
    limit = numbers(np.inf if value is None else value)
    if limit.shape not in ((), dmp.start.shape) or not (limit > 0).all():
        raise OptionError(f"{name} = {value!r}", way_out=f"give a positive number, or {dmp.n_dims} of them")
    return np.broadcast_to(limit, dmp.start.shape)


def ending_basis(dmp: DMP) -> MotionBasis:
    """Return the basis of a movement that ends; raise for others."""
    require_positions(dmp)
    if not isinstance(dmp.basis, MotionBasis):
        raise OptionError("a rhythmic movement has no end", way_out="give a movement that ends")
    return dmp.basis

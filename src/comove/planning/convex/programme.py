"""A sequence of quadratic programmes that makes a motion cheap and keeps it clear.

The cost is a sum of squares in the shape weights, taken to first order inside (Gauss-Newton), and distances are taken
to first order. A step is as good as its trial: what it comes too near to is added to the programme, linearised there,
before the step is shortened. Steps end in a trust region, in configurations at even times.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import daqp
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from comove.coordination.coordinates import QUATERNION, Coordinates
from comove.coordination.motion import CoordinatedMotion
from comove.planning.convex.contacts import (
    N_FIELDS,
    OWNER,
    find_contacts,
    linearised,
    surroundings_of,
)
from comove.primitives.basis import MotionBasis
from comove.primitives.forcing import N_INTERVALS
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

FREE = 1e30  # what bounds nothing, as DAQP takes it


class Cost(Protocol):
    """A sum of squares over even samples of a motion."""

    def value(self, q: Array) -> float:
        """The sum; q has the shape (n_samples, n_columns)."""

    def model(self, q: Array, shape: Array) -> tuple[float, Array, Array]:
        """The sum, half its gradient, and half its Gauss-Newton matrix, by the shape weights."""


@dataclass(frozen=True)
class Settings:
    """How steps are taken.

    Attributes
    ----------
    margin : asked of distances beyond what the scene asks for [m]
    border_margin : the same of the border and of hands that stay apart [m]
    tolerance : share of the margin that may be lost without a word
    radius, most : of the trust region, at first and at most [m]; angles by three times as much
    least : of the trust region, below which the search ends [m]
    iterations : at most
    gain : relative gain of the cost that counts as one
    patience : steps without gain after which the search ends
    corrections : times that a step is improved before it is shortened
    slack_cost : of a metre that the linearised distances miss
    """

    margin: float = 1.5e-3
    border_margin: float = 1e-4
    tolerance: float = 0.6
    radius: float = 0.12
    most: float = 0.15
    least: float = 1e-4
    iterations: int = 40
    gain: float = 1e-3
    patience: float = 2.0
    corrections: int = 3
    slack_cost: float = 1e6


class Grid(NamedTuple):
    """Even samples of all motions with given ends.

    Attributes
    ----------
    shape : array, shape (n_samples, n_basis), configurations by unit shape weights
    base : array, shape (n_samples, n_columns), the configurations without weights
    """

    shape: Array
    base: Array

    def q(self, z: Array) -> Array:
        """Configurations, array of shape (n_samples, n_columns); `z` has the shape (n_columns * n_basis,)."""
        return self.base + self.shape @ z.reshape(self.base.shape[1], -1).T


def grid(basis: MotionBasis, boundary: Array, n_samples: int) -> Grid:
    """Return samples at every so many knots; `n_samples` - 1 divides the number of intervals."""
    step = N_INTERVALS // (n_samples - 1)
    return Grid(np.ascontiguousarray(basis.shape[0][::step]), basis.boundary[0][::step] @ boundary)


class Seen(NamedTuple):
    """A movement where clearances were looked at.

    Attributes
    ----------
    q, nodes : arrays, shapes (n_samples, n_columns) and (n_samples, n_nodes, 3)
    contacts : array, shape (n, N_FIELDS)
    depth : by how much margins are missed, worst of every owner, array, shape (n_owners + 2,) [m]
    """

    q: Array
    nodes: Array
    contacts: Array
    depth: Array


@dataclass
class Outcome:
    """What the search found.

    Attributes
    ----------
    z : array, shape (n_columns * n_basis,)
    value : of the cost
    missed : how far margins are missed beyond the tolerance, summed [m]
    iterations, programmes : steps tried, and quadratic programmes solved
    """

    z: Array
    value: float
    missed: float
    iterations: int = 0
    programmes: int = 0


class Programme:
    """A scene in one basis, with given ends.

    Parameters
    ----------
    boundary : array, shape (4, n_columns), as `CoordinatedMotion` has it
    n_fine, n_coarse : samples at which clearances are looked at, and the cost
    """

    def __init__(
        self,
        scene: Scene,
        coordinates: Coordinates,
        basis: MotionBasis,
        boundary: Array,
        n_fine: int = 401,
        n_coarse: int = 101,
    ):
        self.scene, self.coordinates, self.basis, self.boundary = scene, coordinates, basis, boundary
        self.around = surroundings_of(scene, coordinates)
        self.fine, self.coarse = grid(basis, boundary, n_fine), grid(basis, boundary, n_coarse)
        self.offsets = scene.offsets_along(n_fine)
        self.n = self.fine.base.shape[1] * basis.n_basis
        at = np.linspace(0, n_fine - 1, max(24, int(1.2 * basis.n_basis)) + 2).astype(int)[1:-1]
        self.watched = at
        self.scale = np.tile(_scale(coordinates), len(at))
        moves = np.zeros((len(at), len(self.fine.base[0]), len(self.fine.base[0]), basis.n_basis))
        for column in range(moves.shape[1]):
            moves[:, column, column] = self.fine.shape[at]
        self.moves = moves.reshape(-1, self.n)
        self._found = np.empty((4000, N_FIELDS))

    def motion(self, z: Array) -> CoordinatedMotion:
        """The motion with these weights."""
        weights = z.reshape(-1, self.basis.n_basis)
        return CoordinatedMotion(self.scene, self.coordinates, self.basis, self.boundary, weights)

    def fit(self, q: Array, ridge: float) -> Array:
        """Weights of least jerk among those near to configurations, array of shape (n_fine, n_columns)."""
        shape, base = self.fine
        square = shape.T @ shape / len(shape) + ridge * np.eye(shape.shape[1])
        return np.linalg.solve(square, shape.T @ (q - base) / len(shape)).T.ravel()

    def need(self, settings: Settings) -> Array:
        """Distances that are asked of every owner; array, shape (n_owners + 2,) [m]."""
        need = np.full(self.around.n_owners + 2, self.scene.clearance + settings.margin)
        need[-2:] = self.scene.clearance + settings.border_margin, settings.border_margin
        return need

    def look(self, q: Array, cutoff: float, need: Array, *, contacts: bool = True) -> Seen:
        """Look at clearances below `cutoff` [m] along configurations, array of shape (n_fine, n_columns)."""
        nodes = self.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
        least = np.empty(self.around.n_owners + 2)
        found = self._found if contacts else self._found[:0]
        n = find_contacts(self.around, nodes, self.offsets, cutoff, found, least)
        if n == len(found) > 0:  # more room, and once more
            self._found = np.empty((2 * n, N_FIELDS))
            return self.look(q, cutoff, need)
        return Seen(q, nodes, found[:n].copy(), need - least)

    def linear(self, seen: Seen, off: Array, need: Array) -> tuple[Array, Array]:
        """Rows A and bounds b of the linearised clearances, ``A dz >= b``."""
        rows, distance = np.empty((len(seen.contacts), self.n)), np.empty(len(seen.contacts))
        linearised(self.coordinates.blocks, seen.contacts, seen.q, off, self.fine.shape, rows, distance)
        return rows, need[seen.contacts[:, OWNER].astype(int)] - distance


def _scale(coordinates: Coordinates) -> Array:
    """By how much columns may change where a centre may change by a metre; array, shape (n_columns,)."""
    scale, reach = np.ones(coordinates.n_columns), float(np.linalg.norm(coordinates.blocks.point, axis=1).max())
    for part in coordinates.parts:
        turn = np.arange(len(scale))[part.columns][coordinates.n_dims :]
        scale[turn] = min(1.0 / max(reach, 1e-3), 3.0) * (0.5 if part.kind == QUATERNION else 1.0)
    return scale


def optimise(
    programme: Programme, cost: Cost, z: Array, settings: Settings, reference: Array | None = None
) -> Outcome:
    """Improve shape weights until nothing is gained.

    Parameters
    ----------
    z : array, shape (n_columns * n_basis,), where to begin
    reference : array, shape (n_fine, n_columns), a movement that touches nothing, about which the first clearances
        are linearised; that of `z` unless given
    """
    p, need = programme, programme.need(settings)
    zone = settings.tolerance * np.append(np.full(p.around.n_owners, settings.margin), [settings.border_margin] * 2)
    radius, mu = settings.radius, settings.slack_cost

    def cutoff() -> float:
        return settings.margin + p.scene.clearance + 1.8 * radius + 0.005

    def missed(seen: Seen) -> float:
        return float(np.maximum(seen.depth - zone, 0.0).sum())

    begun = reference is None
    seen = p.look(p.fine.q(z) if begun else reference, cutoff(), need)
    off = seen.q - p.fine.q(z)
    violation = missed(seen) if begun else np.inf
    outcome, best, stall = Outcome(z, np.inf, violation), np.inf, 0.0
    value, gradient, factor = _model(p, cost, z)
    for _ in range(settings.iterations):
        outcome.iterations += 1
        step = _step(p, cost, z, value, violation, gradient, factor, seen, off, need, radius, mu, settings, outcome, missed)
        if step is None:
            radius *= 0.3
            if radius < settings.least:
                break
            continue
        dz, after, then, there, predicted, slack = step
        size = float(np.abs((p.moves @ dz - off[p.watched].ravel()) / p.scale).max())
        actual = value - after + mu * (violation - then)
        restoring = predicted <= 0 and then <= violation and after < 1.01 * value
        first = not np.isfinite(violation)
        if (
            first
            or actual > max(0.05 * predicted, 0.0)
            or (abs(actual) < settings.gain * value and then <= violation)
            or restoring
        ):
            if not first:
                if actual > 0.5 * predicted and size > 0.9 * radius:
                    radius = min(2 * radius, settings.most)
                elif actual < 0.25 * predicted and not restoring:
                    radius = max(0.5 * size, 2 * settings.least)
            z, violation = z + dz, then
            seen, off = p.look(there.q, cutoff(), need), np.zeros_like(off)
            value, gradient, factor = _model(p, cost, z)
            accepted = True
        else:
            radius = 0.4 * min(radius, size)
            accepted = False
        gained = violation < 1e-9 and value < best * (1 - settings.gain)
        if violation < 1e-9 and value < best:
            best, outcome.z, outcome.value, outcome.missed = value, z, value, 0.0
        if gained:
            stall = 0.0
        else:
            stall += 1.0 if accepted and violation < 1e-9 else 0.4
        if stall >= settings.patience or radius < settings.least:
            break
        if slack > 1e-6 and (seen.depth > need).any():
            mu = min(5 * mu, 1e8)
    if not np.isfinite(outcome.value):
        outcome.z, outcome.value, outcome.missed = z, value, violation
    return outcome


def _model(p: Programme, cost: Cost, z: Array) -> tuple[float, Array, Array]:
    """The cost, and its model in the variables ``L' dz`` in which its matrix is the identity: gradient and L."""
    value, gradient, square = cost.model(p.coarse.q(z), p.coarse.shape)
    square[np.diag_indices_from(square)] += 1e-9 * np.trace(square) / p.n
    factor = cholesky(square, lower=True, check_finite=False)
    return value, solve_triangular(factor, gradient, lower=True, check_finite=False), factor


UNIT = 1e-3  # m, of the slack in the programme


def _step(p, cost, z, value, violation, gradient, factor, seen, off, need, radius, mu, settings, outcome, missed):
    """One step, corrected where its trial comes too near; None where a programme has no solution.

    Returns
    -------
    dz, cost after it, what it misses, what was seen there, the predicted gain of merit, slack
    """

    def whitened(rows: Array) -> Array:
        return solve_triangular(factor, rows.T, lower=True, check_finite=False).T

    rows, bound = p.linear(seen, off, need)
    rows, moves, center = whitened(rows), whitened(p.moves), off[p.watched].ravel()
    known, lenient = np.isfinite(violation), False
    deepest = float(seen.depth.max())
    correction = 0
    while True:
        found = _solve(rows, bound, moves, center - radius * p.scale, center + radius * p.scale, gradient, mu)
        outcome.programmes += 1
        if found is None:
            return None
        w, slack = found
        dz = solve_triangular(factor, w, lower=True, trans="T", check_finite=False)
        gain = float(-(2 * gradient @ w + w @ w))
        trial = z + dz
        after = cost.value(p.coarse.q(trial))
        there = p.look(p.fine.q(trial), settings.margin + p.scene.clearance + 1e-3, need)
        then, deepest = missed(there), float(there.depth.max())
        near_enough = deepest < settings.tolerance * settings.margin
        predicted = gain + mu * (violation - min(violation, slack)) if known else np.inf
        if known:
            if (
                correction == 0
                and not lenient
                and predicted < -settings.gain * value
                and violation < 1e-9
            ):
                lenient, bound = True, np.minimum(bound, 0.0)
                continue
            actual = value - after + mu * (violation - then)
            if actual > 0.5 * predicted or (near_enough and actual > 0.1 * predicted):
                break
            if near_enough and value - after < 0.5 * abs(gain):
                break  # the cost's model is what fails
            if correction and slack > settings.margin:
                break
        if correction == settings.corrections or near_enough:
            break
        correction += 1
        more, least = p.linear(there, np.zeros_like(off), need)
        rows = np.concatenate([rows, whitened(more)])
        bound = np.concatenate([bound, least + more @ dz])
    return dz, after, then, there, predicted, slack


def _solve(rows, bound, moves, lower, upper, gradient, mu):
    """Minimise ``|w|^2 / 2 + gradient w`` and the cost of the slack; None where that fails.

    Returns
    -------
    w : array, shape (n,)
    slack : by which ``rows w >= bound`` is missed at most [m]
    """
    n, k = len(gradient), len(rows)
    matrix = np.zeros((k + len(moves), n + 1))
    matrix[:k, :n], matrix[k:, :n], matrix[:k, n] = rows, moves, UNIT
    square = np.eye(n + 1)
    square[n, n] = 1e-3
    above = np.concatenate([np.full(n + 1 + k, FREE), upper])
    below = np.concatenate([np.full(n, -FREE), [0.0], bound, lower])
    w, _, flag, _ = daqp.solve(
        square,
        np.append(gradient, 0.5 * mu * UNIT),
        matrix,
        above,
        below,
        np.zeros(len(above), dtype=np.int32),
        primal_tol=1e-7,
        iter_limit=2000,
    )
    return (w[:n], w[n] * UNIT) if flag >= 1 else None

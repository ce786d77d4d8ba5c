"""A sequence of quadratic programmes that makes a motion cheap and keeps it clear.

The cost is a sum of squares in the shape weights, taken to first order inside (Gauss-Newton), and distances are taken
to first order. A step is as good as its trial: what it comes too near to is added to the programme, linearised there,
before the step is shortened. Steps end in a trust region, in configurations at even times.
"""

from __future__ import annotations

from collections.abc import Callable
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
UNIT = 1e-3  # m, of the slack in a programme
SOUND = 1e-9  # m, by which margins may be missed
MOST_SLACK_COST = 1e8  # of a metre


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

    def missed(self, seen: Seen, settings: Settings) -> float:
        """How far margins are missed beyond the tolerance, the worst of every owner summed [m]."""
        zone = np.full(len(seen.depth), settings.margin)
        zone[-2:] = settings.border_margin
        return float(np.maximum(seen.depth - settings.tolerance * zone, 0.0).sum())

    def linear(self, seen: Seen, off: Array, need: Array) -> tuple[Array, Array]:
        """Rows A and bounds b of the linearised clearances, ``A dz >= b``."""
        rows, distance = np.empty((len(seen.contacts), self.n)), np.empty(len(seen.contacts))
        linearised(self.coordinates.blocks, seen.contacts, seen.q, off, self.fine.shape, rows, distance)
        return rows, need[seen.contacts[:, OWNER].astype(int)] - distance


def _scale(coordinates: Coordinates) -> Array:
    """By how much columns may change where a centre may change by a metre; array, shape (n_columns,)."""
    scale, reach = (
        np.ones(coordinates.n_columns),
        float(np.linalg.norm(coordinates.blocks.point, axis=1).max()),
    )
    for part in coordinates.parts:
        turn = np.arange(len(scale))[part.columns][coordinates.n_dims :]
        scale[turn] = min(1.0 / max(reach, 1e-3), 3.0) * (0.5 if part.kind == QUATERNION else 1.0)
    return scale


class Stand(NamedTuple):
    """Where a search stands.

    Attributes
    ----------
    z : array, shape (n_columns * n_basis,)
    value : of the cost
    gradient, factor : its model in the variables ``L' dz`` in which its matrix is the identity: gradient and L
    seen : the clearances that are linearised
    off : array, shape (n_samples, n_columns), how far they are from those of `z`
    missed : how far margins are missed beyond the tolerance, summed [m]; inf where nobody has looked
    """

    z: Array
    value: float
    gradient: Array
    factor: Array
    seen: Seen
    off: Array
    missed: float


class Step(NamedTuple):
    """What a step leads to.

    Attributes
    ----------
    dz : array, shape (n_columns * n_basis,)
    value, missed : of the cost and the margins after it
    seen : clearances there
    predicted : gain of the merit
    slack : by how much its programme misses the margins [m]
    programmes : quadratic programmes that were solved for it
    """

    dz: Array
    value: float
    missed: float
    seen: Seen
    predicted: float
    slack: float
    programmes: int


def optimise(
    programme: Programme,
    cost: Cost,
    z: Array,
    settings: Settings,
    reference: Array | None = None,
    over: Callable[[], bool] = lambda: False,
) -> Outcome:
    """Improve shape weights until nothing is gained.

    Parameters
    ----------
    z : array, shape (n_columns * n_basis,), where to begin
    reference : array, shape (n_fine, n_columns), a movement that touches nothing, about which the first clearances
        are linearised; that of `z` unless given
    over : asked before every step whether it is time to end
    """
    radius, mu = settings.radius, settings.slack_cost
    here = _stand(programme, cost, z, settings, radius, reference)
    outcome, stall = Outcome(z, np.inf, here.missed), 0.0
    for _ in range(settings.iterations):
        if over():
            break
        step = _step(programme, cost, here, settings, radius, mu)
        outcome.iterations += 1
        if step is None:
            radius *= 0.3
            if radius < settings.least:
                break
            continue
        outcome.programmes += step.programmes
        ahead = programme.moves @ step.dz - here.off[programme.watched].ravel()
        size = float(np.abs(ahead / programme.scale).max())
        first = not np.isfinite(here.missed)
        actual = here.value - step.value + mu * (here.missed - step.missed)
        restoring = step.predicted <= 0 and step.missed <= here.missed and step.value < 1.01 * here.value
        even = abs(actual) < settings.gain * here.value and step.missed <= here.missed
        taken = first or actual > max(0.05 * step.predicted, 0.0) or even or restoring
        if not taken:
            radius = 0.4 * min(radius, size)
        elif not first and actual > 0.5 * step.predicted and size > 0.9 * radius:
            radius = min(2 * radius, settings.most)
        elif not first and actual < 0.25 * step.predicted and not restoring:
            radius = max(0.5 * size, 2 * settings.least)
        if taken:
            here = _stand(programme, cost, here.z + step.dz, settings, radius)
        gained = here.missed < SOUND and here.value < outcome.value * (1 - settings.gain)
        if here.missed < SOUND and here.value < outcome.value:
            outcome.z, outcome.value, outcome.missed = here.z, here.value, 0.0
        stall = 0.0 if gained else stall + (1.0 if taken and here.missed < SOUND else 0.4)
        if stall >= settings.patience or radius < settings.least:
            break
        if step.slack > 1e-6 and (here.seen.depth > programme.need(settings)).any():
            mu = min(5 * mu, MOST_SLACK_COST)
    if not np.isfinite(outcome.value):
        outcome.z, outcome.value, outcome.missed = here.z, here.value, here.missed
    return outcome


def _stand(
    p: Programme, cost: Cost, z: Array, settings: Settings, radius: float, reference: Array | None = None
) -> Stand:
    """Look around at weights `z`, or at a `reference` near to them."""
    value, gradient, square = cost.model(p.coarse.q(z), p.coarse.shape)
    square[np.diag_indices_from(square)] += 1e-9 * np.trace(square) / p.n
    factor = cholesky(square, lower=True, check_finite=False)
    gradient = solve_triangular(factor, gradient, lower=True, check_finite=False)
    own = p.fine.q(z)
    cutoff = settings.margin + p.scene.clearance + 1.8 * radius + 0.005
    seen = p.look(own if reference is None else reference, cutoff, p.need(settings))
    missed = p.missed(seen, settings) if reference is None else np.inf
    return Stand(z, value, gradient, factor, seen, seen.q - own, missed)


def _step(p: Programme, cost: Cost, here: Stand, settings: Settings, radius: float, mu: float) -> Step | None:
    """One step, corrected where its trial comes too near; None where a programme has no solution."""

    def whitened(rows: Array) -> Array:
        return solve_triangular(here.factor, rows.T, lower=True, check_finite=False).T

    need, center = p.need(settings), here.off[p.watched].ravel()
    rows, bound = p.linear(here.seen, here.off, need)
    rows, moves = whitened(rows), whitened(p.moves)
    known, lenient, corrections, programmes = np.isfinite(here.missed), False, 0, 0
    while True:
        found = _solve(rows, bound, moves, center, radius * p.scale, here.gradient, mu)
        programmes += 1
        if found is None:
            return None
        w, slack = found
        dz = solve_triangular(here.factor, w, lower=True, trans="T", check_finite=False)
        gain = -float(2 * here.gradient @ w + w @ w)
        value = cost.value(p.coarse.q(here.z + dz))
        there = p.look(p.fine.q(here.z + dz), settings.margin + p.scene.clearance + 1e-3, need)
        missed, near_enough = (
            p.missed(there, settings),
            there.depth.max() < settings.tolerance * settings.margin,
        )
        predicted = gain + mu * (here.missed - min(here.missed, slack)) if known else np.inf
        step = Step(dz, value, missed, there, predicted, slack, programmes)
        if known:
            if (
                corrections == 0
                and not lenient
                and predicted < -settings.gain * here.value
                and here.missed < SOUND
            ):
                lenient, bound = (
                    True,
                    np.minimum(bound, 0.0),
                )  # what is too near may stay so, but not come nearer
                continue
            actual = here.value - value + mu * (here.missed - missed)
            if actual > 0.5 * predicted or (near_enough and actual > 0.1 * predicted):
                return step
            if near_enough and here.value - value < 0.5 * abs(gain):
                return step  # the cost's model is what fails
            if corrections and slack > settings.margin:
                return step
        if corrections == settings.corrections or near_enough:
            return step
        corrections += 1
        more, least = p.linear(there, np.zeros_like(here.off), need)
        rows, bound = np.concatenate([rows, whitened(more)]), np.concatenate([bound, least + more @ dz])


def _solve(
    rows: Array, bound: Array, moves: Array, center: Array, radius: Array, gradient: Array, mu: float
) -> tuple[Array, float] | None:
    """Minimise ``|w|^2 / 2 + gradient w`` and the cost `mu` of the slack; None where that fails.

    Parameters
    ----------
    rows, bound : clearances, ``rows w >= bound``
    moves, center, radius : trust region, ``|moves w - center| <= radius``

    Returns
    -------
    w : array, shape (n,)
    slack : by how much clearances are missed at most [m]
    """
    n, k = len(gradient), len(rows)
    matrix = np.zeros((k + len(moves), n + 1))
    matrix[:k, :n], matrix[k:, :n], matrix[:k, n] = rows, moves, UNIT
    square = np.eye(n + 1)
    square[n, n] = 1e-3
    above = np.concatenate([np.full(n + 1 + k, FREE), center + radius])
    below = np.concatenate([np.full(n, -FREE), [0.0], bound, center - radius])
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

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

from comove.coordination.coordinates import DIRECTION, QUATERNION, Coordinates
from comove.coordination.motion import CoordinatedMotion
from comove.planning.convex.contacts import (
    N_FIELDS,
    OWNER,
    find_contacts,
    hand_slopes,
    linearised,
    surroundings_of,
)
from comove.planning.convex.limits import ACTIVE, Limits, LinearLimits
from comove.primitives.basis import MotionBasis
from comove.primitives.forcing import N_INTERVALS
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

FREE = 1e30  # what bounds nothing, as DAQP takes it
GAUGE_EVERY = 4  # samples, at which lengths are looked at
LIMIT = 0.1  # m, that missing a limit by its whole self counts as
LIMIT_TOLERANCE = 1e-3  # of a limit, up to which it is linearised
UNNOTICED = 1e-2  # of a limit, less than what is kept back from it
UNIT = 1e-3  # m, of the slack in a programme
SOUND = 1e-9  # m, by which margins may be missed
MOST_SLACK_COST = 1e8  # of a metre
ROUNDS = 8  # of cuts by which limits are approached from outside
HASTIER = 0.5  # of the pace, that a step may save
CURVED = 1e-2  # of the cost of a pace, by which its model is bent, so that the programme has one solution


class Cost(Protocol):
    """A sum of squares of the hands at even samples of a motion, and what each duration costs that it needs.

    Attributes
    ----------
    haste : cost of a pace of 1, as `Limits.pace` counts; 0 where limits are to be kept in the duration given
    """

    haste: float

    def residuals(self, hands: Array) -> Array:
        """What is squared and summed, of hands of shape (n_samples, n_hands * n_dims)."""

    def slopes(self, moves: Array) -> Array:
        """How the residuals change, of how hands change with n variables, (n_samples, n_hands * n_dims, n)."""


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
    wish : clearance that is wished for besides, where it costs little [m]; 0 for none
    worth : share of the cost by which an obstacle that is touched makes it dearer; less, the nearer to the wish
    gauge : weight of what holds directions and quaternions near unit length, which no motion shows
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
    wish: float = 0.01
    worth: float = 0.15
    gauge: float = 3.0


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
    value : of the cost, more where obstacles are nearer than wished for
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
    limits : of the hands; those of the scene unless given
    """

    def __init__(
        self,
        scene: Scene,
        coordinates: Coordinates,
        basis: MotionBasis,
        boundary: Array,
        n_fine: int = 401,
        n_coarse: int = 101,
        limits: Limits | None = None,
    ):
        self.scene, self.coordinates, self.basis, self.boundary = scene, coordinates, basis, boundary
        self.around = surroundings_of(scene, coordinates)
        self.fine, self.coarse = grid(basis, boundary, n_fine), grid(basis, boundary, n_coarse)
        self.offsets = scene.offsets_along(n_fine)
        self.limits = limits or Limits.of(scene, scene.duration)
        self.normed = [
            (
                np.arange(coordinates.n_columns)[part.columns][scene.n_dims :],
                np.linalg.norm(part.points, axis=1).max(),
            )
            for part in coordinates.parts
            if part.kind in (DIRECTION, QUATERNION)
        ]
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

    def look(self, q: Array, cutoff: float, need: Array) -> Seen:
        """Look at clearances below `cutoff` [m] along configurations, array of shape (n_fine, n_columns)."""
        nodes = self.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
        least = np.empty(self.around.n_owners + 2)
        n = find_contacts(self.around, nodes, self.offsets, cutoff, self._found, least)
        if n == len(self._found):  # more room, and once more
            self._found = np.empty((2 * n, N_FIELDS))
            return self.look(q, cutoff, need)
        return Seen(q, nodes, self._found[:n].copy(), need - least)

    def hands(self, q: Array) -> tuple[Array, Array]:
        """All nodes along configurations (n_samples, n_columns), and the hands, (n_samples, n_hands * n_dims) [m]."""
        nodes = self.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
        return nodes, nodes[:, : len(self.scene.manipulators), : self.scene.n_dims].reshape(len(q), -1)

    def moves_of_hands(self, q: Array, nodes: Array) -> Array:
        """How hands at the coarse samples change with the shape weights; (n_samples, n_hands * n_dims, n)."""
        n_hands = len(self.scene.manipulators)
        slopes = hand_slopes(self.coordinates.blocks, self.around.block, nodes, q, n_hands)
        slopes = slopes.reshape(len(q), -1, q.shape[1])
        return (slopes[:, :, :, None] * self.coarse.shape[:, None, None, :]).reshape(*slopes.shape[:2], -1)

    def gauge(self, q: Array, weight: float) -> Array:
        """By how much directions and quaternions differ from unit length at some samples."""
        lengths = [
            weight * reach * (np.linalg.norm(q[::GAUGE_EVERY, turn], axis=1) - 1.0)
            for turn, reach in self.normed
        ]
        return np.concatenate([np.zeros(0), *lengths])

    def moves_of_gauge(self, q: Array, weight: float) -> Array:
        """How that changes with the shape weights; array, shape (n, n_columns * n_basis)."""
        rows = [np.zeros((0, self.n))]
        for turn, reach in self.normed:
            p = q[::GAUGE_EVERY, turn]
            unit = p / np.linalg.norm(p, axis=1, keepdims=True)
            row = np.zeros((len(p), q.shape[1], self.basis.n_basis))
            row[:, turn] = weight * reach * unit[:, :, None] * self.coarse.shape[::GAUGE_EVERY, None, :]
            rows.append(row.reshape(len(p), -1))
        return np.concatenate(rows)

    def missed(self, seen: Seen, hands: Array, settings: Settings, cost: Cost) -> float:
        """How far margins and limits are missed beyond the tolerance, the worst of every owner summed [m].

        A limit that is exceeded by a tenth counts as a centimetre, where the pace is given.
        """
        zone = np.full(len(seen.depth), settings.margin)
        zone[-2:] = settings.border_margin
        missed = np.maximum(seen.depth - settings.tolerance * zone, 0.0).sum()
        if cost.haste > 0:
            return float(missed)
        return float(missed) + LIMIT * max(self.limits.excess(hands) - UNNOTICED, 0.0)

    def linear(self, seen: Seen, off: Array, need: Array) -> tuple[Array, Array, NDArray[np.int64]]:
        """Rows A and bounds b of the linearised clearances, ``A dz >= b``, and whom they keep away from."""
        rows, distance = np.empty((len(seen.contacts), self.n)), np.empty(len(seen.contacts))
        linearised(self.coordinates.blocks, seen.contacts, seen.q, off, self.fine.shape, rows, distance)
        owner = seen.contacts[:, OWNER].astype(np.int64)
        return rows, need[owner] - distance, owner


def _scale(coordinates: Coordinates) -> Array:
    """By how much columns may change where a centre may change by a metre; array, shape (n_columns,)."""
    scale = np.ones(coordinates.n_columns)
    reach = float(np.linalg.norm(coordinates.blocks.point, axis=1).max())
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
    wish : how much of the wish for clearance is not met
    gradient : of its model in the variables w, ``dz = whiten' w``, in which its matrix is the identity
    whiten : array, shape (n_columns * n_basis, n_columns * n_basis)
    seen : the clearances that are linearised
    off : array, shape (n_samples, n_columns), how far they are from those of `z`
    limits : those of the hands, linearised
    pace : in how many durations they are kept; 1 where the duration is given
    missed : how far margins are missed beyond the tolerance, summed [m]; inf where nobody has looked
    """

    z: Array
    value: float
    wish: float
    gradient: Array
    whiten: Array
    seen: Seen
    off: Array
    limits: LinearLimits
    pace: float
    missed: float


class Step(NamedTuple):
    """What a step leads to.

    Attributes
    ----------
    dz : array, shape (n_columns * n_basis,)
    value, missed : of the cost after it, with what it gains of the wish, and of the margins
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
        worth = here.value * (1 + settings.worth * here.wish)
        gained = here.missed < SOUND and worth < outcome.value * (1 - settings.gain)
        if here.missed < SOUND and worth < outcome.value:
            outcome.z, outcome.value, outcome.missed = here.z, worth, 0.0
        stall = 0.0 if gained else stall + (1.0 if taken and here.missed < SOUND else 0.4)
        if stall >= settings.patience or radius < settings.least:
            break
        if step.slack > 1e-6 and (here.seen.depth > programme.need(settings)).any():
            mu = min(5 * mu, MOST_SLACK_COST)
    if not np.isfinite(outcome.value):
        outcome.z, outcome.value, outcome.missed = here.z, here.value, here.missed
    return outcome


def _value(p: Programme, cost: Cost, z: Array, settings: Settings) -> tuple[float, Array]:
    """Return the cost at weights `z`, with the gauge, and the hands at the coarse samples."""
    q = p.coarse.q(z)
    _, hands = p.hands(q)
    residuals, gauge = cost.residuals(hands), p.gauge(q, settings.gauge)
    hasty = cost.haste * p.limits.pace(hands) if cost.haste > 0 else 0.0
    return float(residuals @ residuals + gauge @ gauge) + hasty, hands


def _stand(
    p: Programme, cost: Cost, z: Array, settings: Settings, radius: float, reference: Array | None = None
) -> Stand:
    """Look around at weights `z`, or at a `reference` near to them."""
    q = p.coarse.q(z)
    nodes, hands = p.hands(q)
    moves = p.moves_of_hands(q, nodes)
    residuals = np.concatenate([cost.residuals(hands), p.gauge(q, settings.gauge)])
    slopes = np.concatenate([cost.slopes(moves), p.moves_of_gauge(q, settings.gauge)])
    square = slopes.T @ slopes
    square[np.diag_indices_from(square)] += 1e-9 * np.trace(square) / p.n
    # All by numpy: its threads and those of scipy stand in each other's way for longer than the work takes.
    whiten = np.linalg.inv(np.linalg.cholesky(square))
    gradient = whiten @ (slopes.T @ residuals)
    own = p.fine.q(z)
    cutoff = max(settings.margin + 0.005, settings.wish) + p.scene.clearance + 1.8 * radius
    seen = p.look(own if reference is None else reference, cutoff, p.need(settings))
    missed = p.missed(seen, hands, settings, cost) if reference is None else np.inf
    pace = p.limits.pace(hands) if cost.haste > 0 else 1.0
    value = float(residuals @ residuals) + cost.haste * pace
    wish = _wish(p, seen, settings)
    limits = p.limits.linear(hands, moves, pace)
    return Stand(z, value, wish, gradient, whiten, seen, seen.q - own, limits, pace, missed)


def _wish(p: Programme, seen: Seen, settings: Settings) -> float:
    """How much of the wish for clearance is not met: the squared share of every obstacle, summed."""
    if settings.wish <= 0:
        return 0.0
    n = p.around.n_owners
    least = p.need(settings)[:n] - p.scene.clearance - seen.depth[:n]
    return float((np.clip(1.0 - least / settings.wish, 0.0, 1.0) ** 2).sum())


def _further(
    p: Programme, owner: NDArray[np.int64], bound: Array, settings: Settings, radius: float
) -> Array:
    """By how much more than the margin is wished for [m], -inf where nothing is; array of the shape of `owner`.

    Nothing is wished of obstacles that are as far as no step is likely to come.
    """
    near = bound > -settings.wish - 0.5 * radius
    wished = near & (owner < p.around.n_owners) & (settings.wish > settings.margin)
    return np.where(wished, settings.wish - settings.margin, -np.inf)


def _step(p: Programme, cost: Cost, here: Stand, settings: Settings, radius: float, mu: float) -> Step | None:
    """One step, corrected where its trial comes too near; None where a programme has no solution."""

    def whitened(rows: Array) -> Array:
        return rows @ here.whiten.T

    def limits(w: Array, slower: float, share: float) -> tuple[Array, Array]:
        cut, least = here.limits.cuts(w @ here.whiten, slower, share)
        return whitened(cut), least

    need, center = p.need(settings), here.off[p.watched].ravel()
    rows, bound, owner = p.linear(here.seen, here.off, need)
    rows, moves = whitened(rows), whitened(p.moves)
    hasty = cost.haste > 0
    haste = Haste(cost.haste if hasty else mu * LIMIT, here.pace, HASTIER if hasty else 0.0)
    worth, wished = settings.worth * here.value, max(settings.wish, UNIT) ** 2
    further = _further(p, owner, bound, settings, radius)
    known, lenient, corrections, programmes = np.isfinite(here.missed), False, 0, 0
    while True:
        found = _solve(
            Rows(rows, bound, owner, further),
            limits,
            moves,
            center,
            radius * p.scale,
            here.gradient,
            mu,
            worth / wished,
            haste,
        )
        programmes += 1
        if found is None:
            return None
        w, slack, short, slower = found
        dz = w @ here.whiten
        if not hasty:
            slack += LIMIT * slower
        gain = -float(2 * here.gradient @ w + w @ w) + worth * (here.wish - short / wished)
        gain -= cost.haste * slower
        value, hands = _value(p, cost, here.z + dz, settings)
        near = max(settings.margin + 1e-3, settings.wish) + p.scene.clearance
        there = p.look(p.fine.q(here.z + dz), near, need)
        wish = _wish(p, there, settings)
        missed = p.missed(there, hands, settings, cost)
        near_enough = missed == 0.0
        predicted = gain + mu * (here.missed - min(here.missed, slack)) if known else np.inf
        step = Step(dz, value + worth * (wish - here.wish), missed, there, predicted, slack, programmes)
        if known:
            if (
                corrections == 0
                and not lenient
                and predicted < -settings.gain * here.value
                and here.missed < SOUND
            ):
                lenient = True
                bound = np.minimum(bound, 0.0)  # what is too near may stay so, but not come nearer
                continue
            actual = here.value - step.value + mu * (here.missed - missed)
            if actual > 0.5 * predicted or (near_enough and actual > 0.1 * predicted):
                return step
            if near_enough and here.value - step.value < 0.5 * abs(gain):
                return step  # the cost's model is what fails
            if corrections and slack > settings.margin:
                return step
        if corrections == settings.corrections or near_enough:
            return step
        corrections += 1
        more, least, whose = p.linear(there, np.zeros_like(here.off), need)
        rows, bound = np.concatenate([rows, whitened(more)]), np.concatenate([bound, least + more @ dz])
        owner = np.concatenate([owner, whose])
        further = np.append(further, _further(p, whose, least, settings, radius))


class Rows(NamedTuple):
    """Linearised clearances of a programme.

    Attributes
    ----------
    rows, bound : ``rows w >= bound`` [m]
    owner : array of int, shape (n,), whom they keep away from
    further : array, shape (n,), by how much more is wished for [m]; -inf where nothing is
    """

    rows: Array
    bound: Array
    owner: NDArray[np.int64]
    further: Array


class Haste(NamedTuple):
    """How the pace may change, one more variable of a programme: slower where limits cannot be kept else.

    Attributes
    ----------
    cost : of a duration
    pace : so far, in durations
    faster : share of it that may be saved
    """

    cost: float
    pace: float
    faster: float


def _solve(
    clearances: Rows,
    limits: Callable[[Array, float, float], tuple[Array, Array]],
    moves: Array,
    center: Array,
    radius: Array,
    gradient: Array,
    mu: float,
    wishes: float,
    haste: Haste,
) -> tuple[Array, float, float, float] | None:
    """Minimise ``|w|^2 / 2 + gradient w``, the cost `mu` of the slack, `wishes` and `haste`; None where that fails.

    Parameters
    ----------
    limits : half-spaces for the limits that w and a slower pace exceed a share of, as rows and bounds
    moves, center, radius : trust region, ``|moves w - center| <= radius``
    wishes : cost of the squared distance by which an owner is nearer than wished for

    Returns
    -------
    w : array, shape (n,)
    slack : by how much clearances are missed at most [m]
    short : squared distances by which owners are nearer than wished for, summed [m^2]
    slower : by how much the pace grows, in durations
    """
    n = len(gradient)
    rows, bound, owner, further = clearances
    wished = np.flatnonzero(np.isfinite(further) & (bound + further > -np.inf))
    owners, mine = np.unique(owner[wished], return_inverse=True)
    # Variables: the weights, the slack, what is missed of each owner's wish, and the change of the pace.
    k, m, more = len(rows), len(wished), len(owners)
    matrix = np.zeros((k + m + len(moves), n + 2 + more))
    matrix[:k, :n], matrix[:k, n] = rows, UNIT
    matrix[k : k + m, :n], matrix[k + np.arange(m), n + 1 + mine] = rows[wished], UNIT
    matrix[k + m :, :n] = moves
    dear = haste.cost * haste.pace
    square = np.concatenate(
        [np.ones(n), [1e-3], np.full(more, max(wishes * UNIT**2, 1e-6)), [CURVED * dear or 1.0]]
    )
    linear = np.concatenate([gradient, [0.5 * mu * UNIT], np.zeros(more), [0.5 * dear]])
    below = np.concatenate(
        [
            np.full(n, -FREE),
            np.zeros(1 + more),
            [-haste.faster],
            bound,
            bound[wished] + further[wished],
            center - radius,
        ]
    )
    above = np.full(len(below), FREE)
    above[len(above) - len(moves) :] = center + radius
    cut, least = limits(np.zeros(n), 0.0, ACTIVE)
    known = np.zeros(len(below))
    for _ in range(ROUNDS):
        matrix = np.concatenate([matrix, np.zeros((len(cut), matrix.shape[1]))])
        matrix[len(matrix) - len(cut) :, :n], matrix[len(matrix) - len(cut) :, -1] = cut, haste.pace
        below, above = np.append(below, least), np.append(above, np.full(len(cut), FREE))
        known = np.append(known, np.zeros(len(cut)))
        for guess in (known, None) if known.any() else (None,):  # from a guess it may go round in circles
            w, _, flag, told = daqp.solve(
                np.diag(square),
                linear,
                matrix,
                above,
                below,
                np.zeros(len(above), dtype=np.int32),
                dual_start=guess,
                primal_tol=1e-7,
                iter_limit=2000,
            )
            if flag >= 1:
                break
        else:
            return None
        known = told["lam"]
        slower = haste.pace * float(w[-1])
        cut, least = limits(w[:n], slower, 1.0 + LIMIT_TOLERANCE)
        if not len(cut):
            break
    short = float(((w[n + 1 : n + 1 + more] * UNIT) ** 2).sum())
    return w[:n], w[n] * UNIT, short, slower

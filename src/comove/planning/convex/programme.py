"""A scene as what programmes are made of: a cost that is a sum of squares, clearances and limits, to first order."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

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
from comove.planning.convex.limits import Limits
from comove.primitives.basis import MotionBasis
from comove.primitives.forcing import N_INTERVALS
from comove.scenes.scene import Scene

Array = NDArray[np.float64]

GAUGE_EVERY = 4  # samples, at which lengths are looked at
LIMIT = 0.1  # m, that missing a limit by its whole self counts as
UNNOTICED = 1e-2  # of a limit, less than what is kept back from it


class QuadraticCost(Protocol):
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
class ConvexSettings:
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
    patience: float = 1.0
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


class ConvexProgramme:
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
        n_fine: int = 201,
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

    def need(self, settings: ConvexSettings) -> Array:
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

    def value(self, cost: QuadraticCost, z: Array, gauge: float) -> tuple[float, Array]:
        """The cost at weights `z`, with the gauge of that weight, and the hands at the coarse samples."""
        q = self.coarse.q(z)
        _, hands = self.hands(q)
        residuals, lengths = cost.residuals(hands), self.gauge(q, gauge)
        hasty = cost.haste * self.limits.pace(hands) if cost.haste > 0 else 0.0
        return float(residuals @ residuals + lengths @ lengths) + hasty, hands

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

    def missed(self, seen: Seen, hands: Array, settings: ConvexSettings, cost: QuadraticCost) -> float:
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

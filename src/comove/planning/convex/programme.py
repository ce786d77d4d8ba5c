"""The parts of a scene's quadratic programmes: cost, clearances and limits."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple, Protocol

import numpy as np

from comove.arrays import Array, Integers
from comove.dmp.basis import MotionBasis
from comove.dmp.system import N_INTERVALS
from comove.model.blocks import Blocks
from comove.model.coordinates import DIRECTION, QUATERNION, Coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.resting import recessions
from comove.model.scene import Scene
from comove.planning.convex.contacts import (
    N_FIELDS,
    OWNER,
    find_contacts,
    hand_slopes,
    linearised,
    moved_load,
)
from comove.planning.convex.costs import Moves, SumOfSquares
from comove.planning.convex.leaning import Leaning
from comove.planning.convex.limits import Limits
from comove.planning.convex.quadratic import SETTINGS as QUADRATIC
from comove.planning.convex.quadratic import QuadraticSettings

FOLLOWED = 2  # samples of which one is looked at by what follows
GAUGE_EVERY = 4  # samples between those at which the lengths of directions and quaternions are evaluated


@dataclass(frozen=True)
class WarpSettings:
    """Settings of the warps of time, see `warp`.

    Attributes
    ----------
    n_waves : waves whose sum a warp is
    smooth : weight of their squared slopes, relative to the mean curvature of the cost
    steepest : largest relative change of the time scaling
    shares : shares of a warp that are tried in turn
    ridge : of the fit of the warped movement
    """

    n_waves: int = 12
    smooth: float = 1e-8
    steepest: float = 0.5
    shares: tuple[float, ...] = (1.0, 0.5, 0.25)
    ridge: float = 1e-12


@dataclass(frozen=True)
class ConvexSettings:
    """Settings of the sequence of quadratic programmes.

    Attributes
    ----------
    margin : distance from obstacles beyond the scene's clearance [m]
    border_margin : likewise for the border, and for end effectors beyond their separation [m]
    tolerance : share of the margins that may be missed without consequence
    radius, most : radius of the trust region, at first and at most [m]; for angles multiplied by at most 3 rad/m
    least : radius of the trust region below which the search ends [m]
    iterations : largest number of steps
    gain : least relative decrease of the cost that counts as a gain
    patience : number of steps without gain after which the search ends
    outlook, behind : extrapolated gains like the last one, and the ratio of the value then to that of a known motion
        above which the search ends
    corrections : number of times that a step is corrected before the trust region shrinks
    slack_cost, most_slack_cost : cost of a metre by which linearised distances are missed, at first and at most
    limit : length as which a limit exceeded by 100 % counts [m]
    unnoticed : relative excess over the limits that is tolerated, within the share that is held back
        (`Limits.shares`)
    hastier : share of the pace that a step may save
    wish : soft clearance beyond the scene's [m]; 0 for none
    worth : share of the cost added for an obstacle in contact, less with more of the soft clearance
    gauge : weight of the penalty that keeps directions and quaternions near unit length; motions do not depend on it
    quadratic, warp : settings of each programme, and of the warps of time between them
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
    outlook: float = 2.0
    behind: float = 1.2
    corrections: int = 3
    slack_cost: float = 1e6
    most_slack_cost: float = 1e8
    limit: float = 0.1
    unnoticed: float = 1e-2
    hastier: float = 0.5
    wish: float = 0.01
    worth: float = 0.15
    gauge: float = 3.0
    quadratic: QuadraticSettings = QUADRATIC
    warp: WarpSettings = field(default_factory=WarpSettings)


SETTINGS = ConvexSettings()


class Follower(Protocol):
    """A follower of motions, such as arms, with distances of several kinds.

    Some of these are required. Its samples are every `FOLLOWED`-th of the fine ones.
    """

    def required(self, margin: float) -> Array:
        """Return the required distances with a margin [m]; array, shape (n_kinds,) [m]."""

    def follow(self, nodes: Array) -> tuple[Array, Array]:
        """Return the postures that follow keypoints, and their distances.

        Arrays, shapes (n_samples, n) and (n_samples, n_kinds) [m].

        Parameters
        ----------
        nodes : array, shape (n_samples, n_nodes, 3) [m]
        """

    def slopes(self, blocks: Blocks, q: Array, postures: Array, distances: Array) -> Array:
        """Return the derivatives of distances by configurations. They are 0 for distances too large to count.

        Array, shape (n_samples, n_kinds, n_columns).

        Parameters
        ----------
        q : array, shape (n_samples, n_columns)
        postures, distances : arrays, as of `follow`
        """

    def stricter(self) -> Follower:
        """Return a stricter follower, after the rejection of a followed motion."""


class Grid(NamedTuple):
    """The linear map from shape weights to even samples of motions.

    Attributes
    ----------
    shape : array, shape (n_samples, n_basis), values of the basis functions
    base : array, shape (n_samples, n_columns), configurations for zero shape weights
    free : array, shape (n_columns, n_free), directions in which configurations may change; None for all columns
    """

    shape: Array
    base: Array
    free: Array | None = None

    def q(self, z: Array) -> Array:
        """Return configurations, array of shape (n_samples, n_columns); `z` has the shape (n_free * n_basis,)."""
        weights = z.reshape(-1, self.shape.shape[1])
        return self.base + self.shape @ (weights if self.free is None else self.free @ weights).T


def grid(
    basis: MotionBasis, boundary: Array, n_samples: int, order: int = 0, free: Array | None = None
) -> Grid:
    """Return the map to even samples, or to their derivatives. These are by normalised time.

    `n_samples` - 1 must divide `N_INTERVALS`.

    Parameters
    ----------
    boundary : array, shape (4, n_columns), as in `CoordinatedMotion`
    free : as in `Grid`
    """
    step = N_INTERVALS // (n_samples - 1)
    shape, base = np.ascontiguousarray(basis.shape[order][::step]), basis.boundary[order][::step] @ boundary
    return Grid(shape, base, free)


class Seen(NamedTuple):
    """A movement and its contacts.

    Attributes
    ----------
    q, nodes : arrays, shapes (n_samples, n_columns) and (n_samples, n_nodes, 3), configurations and nodes [m]
    contacts : array, shape (n, N_FIELDS)
    depth : array, shape (n_owners + 2 + n_leaning + n_kinds,), largest amount by which a required distance is missed:
        from every owner, from the border, between end effectors that stay apart, from leaning too far, of the
        follower [m]
    postures, distances : those of the follower at its samples, as in `Follower`
    """

    q: Array
    nodes: Array
    contacts: Array
    depth: Array
    postures: Array
    distances: Array


class ConvexProgramme:
    """The optimisation problem of a scene, for motions with given ends.

    Parameters
    ----------
    boundary : array, shape (4, n_columns), as in `CoordinatedMotion`
    n_fine, n_coarse : numbers of samples for the clearances, and for cost and limits
    limits : limits of the end effectors; those of the scene unless given

    Attributes
    ----------
    follower : follower of the motion; None unless set
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
        self.follower: Follower | None = None
        self.scene, self.coordinates, self.basis, self.boundary = scene, coordinates, basis, boundary
        self.load = moved_load(scene, coordinates)
        self.free, self.leaning = coordinates.free, Leaning.of(coordinates, boundary)
        self.fine, self.coarse = (grid(basis, boundary, n, free=self.free) for n in (n_fine, n_coarse))
        self.fine_rate = grid(basis, boundary, n_fine, order=1, free=self.free)
        self.moved = scene.displacements_along(n_fine)
        self.limits = limits or Limits.of(scene, scene.duration)
        self.normed = [
            (
                np.arange(coordinates.n_columns)[part.columns][scene.n_dims :],
                np.linalg.norm(part.points, axis=1).max(),
            )
            for part in coordinates.parts
            if part.kind in (DIRECTION, QUATERNION)
        ]
        n_free = coordinates.n_columns if self.free is None else self.free.shape[1]
        self.n = n_free * basis.n_basis
        is_center = np.isin(np.arange(coordinates.n_columns), coordinates.blocks.center[:, : scene.n_dims])
        self.even = is_center if self.free is None else np.logical_not(self.free[~is_center].any(axis=0))
        at = np.linspace(0, n_fine - 1, max(24, int(1.2 * basis.n_basis)) + 2).astype(int)[1:-1]
        self.watched = at
        self.scale = np.tile(_scale(coordinates), len(at))
        moves = np.zeros((len(at), coordinates.n_columns, coordinates.n_columns, basis.n_basis))
        for column in range(moves.shape[1]):
            moves[:, column, column] = self.fine.shape[at]
        self.moves = self.of_free(moves).reshape(-1, self.n)
        self._found = np.empty((4000, N_FIELDS))

    def motion(self, z: Array) -> CoordinatedMotion:
        """Return the motion with the shape weights `z`."""
        weights = z.reshape(-1, self.basis.n_basis)
        weights = weights if self.free is None else self.free @ weights
        return CoordinatedMotion(self.scene, self.coordinates, self.basis, self.boundary, weights)

    def of_free(self, slopes: Array) -> Array:
        """Return derivatives by free directions; (..., n_columns, n_basis) -> (..., n_free, n_basis)."""
        return slopes if self.free is None else self.free.T @ slopes

    def fit(self, q: Array, ridge: float) -> Array:
        """Fit shape weights to configurations, shape (n_fine, n_columns), by ridge regression."""
        shape, base = self.fine.shape, self.fine.base
        square = shape.T @ shape / len(shape) + ridge * np.eye(shape.shape[1])
        found = np.asarray(np.linalg.solve(square, shape.T @ (q - base) / len(shape)).T, dtype=np.float64)
        return self.of_free(found).ravel()

    def need(self, settings: ConvexSettings) -> Array:
        """Return the required distances; array, shape (n_owners + 2 + n_leaning + n_kinds,) [m].

        They are in the order of `Seen.depth`.
        """
        need = np.full(self.load.n_owners + 2, self.scene.clearance + settings.margin)
        need[-2:] = self.scene.clearance + settings.border_margin, settings.border_margin
        need = np.append(need, self.leaning.required(settings.margin))
        return need if self.follower is None else np.append(need, self.follower.required(settings.margin))

    def look(self, q: Array, cutoff: float, need: Array) -> Seen:
        """Find contacts nearer than `cutoff` [m] along configurations.

        Parameters
        ----------
        q : array, shape (n_fine, n_columns)
        need : array, as of `need`
        """
        nodes = self.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
        least = np.empty(self.load.n_owners + 2)
        moved = self.moved
        if self.scene.rests:
            receded = recessions(self.scene, nodes, float(need[0]) - self.scene.clearance)
            moved = moved.shifted(receded[:, self.scene.owners])
        n = find_contacts(self.load, nodes, moved, cutoff, self._found, least)
        if n == len(self._found):  # the array may have been too small: once more with a larger one
            self._found = np.empty((2 * n, N_FIELDS))
            return self.look(q, cutoff, need)
        contacts, postures, distances = self._found[:n].copy(), np.zeros((0, 0)), np.zeros((0, 0))
        least = np.append(least, self.leaning.spare(q[::FOLLOWED]).min(axis=0))
        if self.follower is not None:
            postures, distances = self.follower.follow(nodes[::FOLLOWED])
            least = np.append(least, distances.min(axis=0))
        return Seen(q, nodes, contacts, need - least, postures, distances)

    def hands(self, q: Array) -> tuple[Array, Array]:
        """Return keypoints, and end effectors (n_samples, n_hands * n_dims), along configurations [m]."""
        nodes = self.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]
        return nodes, nodes[:, : len(self.scene.manipulators), : self.scene.n_dims].reshape(len(q), -1)

    def moves_of_hands(self, q: Array, nodes: Array) -> Moves:
        """Return end effectors' derivatives at coarse samples by the shape weights.

        Parameters
        ----------
        q, nodes : arrays, shapes (n_samples, n_columns) and (n_samples, n_nodes, 3) [m]
        """
        n_hands = len(self.scene.manipulators)
        slopes = hand_slopes(self.coordinates.blocks, self.load.block, nodes, q, n_hands)
        slopes = slopes.reshape(len(q), -1, q.shape[1])
        return Moves(slopes if self.free is None else slopes @ self.free, self.coarse.shape, self.even)

    def value(self, cost: SumOfSquares, z: Array, gauge: float) -> tuple[float, Array]:
        """Return the cost at weights `z`, plus the gauge, and end effectors."""
        q = self.coarse.q(z)
        _, hands = self.hands(q)
        lengths = self.gauge(q, gauge)
        hasty = cost.haste * self.limits.pace(hands) if cost.haste > 0 else 0.0
        return cost.value(hands) + float(lengths @ lengths) + hasty, hands

    def gauge(self, q: Array, weight: float) -> Array:
        """Return weighted deviations of directions and quaternions from unit length."""
        lengths = [
            weight * reach * (np.linalg.norm(q[::GAUGE_EVERY, turn], axis=1) - 1.0)
            for turn, reach in self.normed
        ]
        return np.concatenate([np.zeros(0), *lengths])

    def moves_of_gauge(self, q: Array, weight: float) -> Array:
        """Return the derivatives of `gauge` by the shape weights; array, shape (n, n_free * n_basis)."""
        rows = [np.zeros((0, self.n))]
        for turn, reach in self.normed:
            p = q[::GAUGE_EVERY, turn]
            unit = p / np.linalg.norm(p, axis=1, keepdims=True)
            row = np.zeros((len(p), q.shape[1], self.basis.n_basis))
            row[:, turn] = weight * reach * unit[:, :, None] * self.coarse.shape[::GAUGE_EVERY, None, :]
            rows.append(self.of_free(row).reshape(len(p), -1))
        return np.concatenate(rows)

    def missed(self, seen: Seen, hands: Array, settings: ConvexSettings, cost: SumOfSquares) -> float:
        """Return the summed violation of margins and limits beyond the tolerance [m].

        If the duration is given, an excess over limits counts by `ConvexSettings.limit`; else limits do not count.
        """
        zone = np.full(len(seen.depth), settings.margin)
        zone[self.load.n_owners : self.load.n_owners + 2] = settings.border_margin
        missed = np.maximum(seen.depth - settings.tolerance * zone, 0.0).sum()
        if cost.haste > 0:
            return float(missed)
        return float(missed) + settings.limit * max(self.limits.excess(hands) - settings.unnoticed, 0.0)

    def is_followed(self, z: Array) -> bool:
        """Return whether the follower can follow the motion of weights `z`."""
        if self.follower is None:
            return True
        _, distances = self.follower.follow(self.hands(self.fine.q(z))[0][::FOLLOWED])
        return bool((distances.min(axis=0) >= self.follower.required(0.0)).all())

    def linear(self, seen: Seen, off: Array, need: Array) -> tuple[Array, Array, Integers]:
        """Return the linearised distances, ``A dz >= b``, and each row's owner.

        Arrays, shapes (n_rows, n_free * n_basis), (n_rows,) and (n_rows,) of int; owners count as in `Seen.depth`.

        Parameters
        ----------
        off : array, shape (n_fine, n_columns), difference of `seen.q` from the configurations of dz = 0
        need : array, as of `need`
        """
        n_contacts, n_columns = len(seen.contacts), self.coordinates.n_columns
        rows, distance = np.empty((n_contacts, n_columns * self.basis.n_basis)), np.empty(n_contacts)
        linearised(self.coordinates.blocks, seen.contacts, seen.q, off, self.fine.shape, rows, distance)
        rows = self.of_free(rows.reshape(n_contacts, n_columns, self.basis.n_basis)).reshape(-1, self.n)
        owner = seen.contacts[:, OWNER].astype(np.int64)
        bound, first = need[owner] - distance, self.load.n_owners + 2
        q, away = seen.q[::FOLLOWED], off[::FOLLOWED]
        further = []
        if len(self.leaning.blocks):
            further.append((first, *self.leaning.linear(q)))
        if self.follower is not None:
            slopes = self.follower.slopes(self.coordinates.blocks, q, seen.postures, seen.distances)
            further.append((first + len(self.leaning.blocks), seen.distances, slopes))
        for base, distances, slopes in further:
            t, kind = np.nonzero(slopes.any(axis=2))
            slope, also = slopes[t, kind], base + kind
            more = slope[:, :, None] * self.fine.shape[::FOLLOWED][t][:, None, :]
            least = need[also] - distances[t, kind] + (slope * away[t]).sum(axis=1)
            rows = np.concatenate([rows, self.of_free(more).reshape(-1, self.n)])
            bound, owner = np.append(bound, least), np.append(owner, also)
        return rows, bound, owner


def _scale(coordinates: Coordinates) -> Array:
    """Return each column's trust-region size, relative to a centre's [1/m]; shape (n_columns,)."""
    scale = np.ones(coordinates.n_columns)
    reach = float(np.linalg.norm(coordinates.blocks.point, axis=1).max())
    for part in coordinates.parts:
        turn = np.arange(len(scale))[part.columns][coordinates.n_dims :]
        scale[turn] = min(1.0 / max(reach, 1e-3), 3.0) * (0.5 if part.kind == QUATERNION else 1.0)
    return scale

"""The motions of a convex programme, linear in their shape weights."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from comove.arrays import Array, Integers
from comove.dmp.basis import MotionBasis
from comove.dmp.system import N_INTERVALS
from comove.model.coordinates import DIRECTION, QUATERNION, Coordinates
from comove.model.motion import CoordinatedMotion
from comove.model.scene import Scene

GAUGE_EVERY = 4  # samples between those at which the lengths of directions and quaternions are evaluated


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
    """Return the map to even samples, or to their derivatives.

    They are of an order, by normalised time; `n_samples` - 1 must divide `N_INTERVALS`.

    Parameters
    ----------
    boundary : array, shape (4, n_columns), as in `CoordinatedMotion`
    free : as in `Grid`
    """
    step = N_INTERVALS // (n_samples - 1)
    shape, base = np.ascontiguousarray(basis.shape[order][::step]), basis.boundary[order][::step] @ boundary
    return Grid(shape, base, free)


@dataclass(frozen=True, eq=False)
class Curves:
    """The motions of a scene in one basis with given ends.

    Shape weights are z, array of shape (n_free * n_basis,).

    Attributes
    ----------
    boundary : array, shape (4, n_columns), as in `CoordinatedMotion`
    fine, coarse : maps to the samples for the clearances, and for cost and limits
    """

    scene: Scene
    coordinates: Coordinates
    basis: MotionBasis
    boundary: Array
    fine: Grid
    coarse: Grid

    @classmethod
    def of(
        cls,
        scene: Scene,
        coordinates: Coordinates,
        basis: MotionBasis,
        boundary: Array,
        n_fine: int,
        n_coarse: int,
    ) -> Curves:
        """Return the motions, sampled at `n_fine` and at `n_coarse` even times."""
        grids = (grid(basis, boundary, n, free=coordinates.free) for n in (n_fine, n_coarse))
        return cls(scene, coordinates, basis, boundary, *grids)

    @cached_property
    def fine_rate(self) -> Grid:
        """Return the map to the derivatives by normalised time at fine samples."""
        return grid(self.basis, self.boundary, len(self.fine.base), order=1, free=self.free)

    @property
    def free(self) -> Array | None:
        """Return the directions in which configurations may change, as in `Grid`."""
        return self.coordinates.free

    @property
    def n(self) -> int:
        """Return the number of shape weights."""
        n_free = self.coordinates.n_columns if self.free is None else self.free.shape[1]
        return n_free * self.basis.n_basis

    @cached_property
    def even(self) -> NDArray[np.bool_]:
        """Return which free directions move the hands alike at all samples; array, shape (n_free,)."""
        centers = self.coordinates.blocks.center[:, : self.scene.n_dims]
        is_center = np.isin(np.arange(self.coordinates.n_columns), centers)
        return is_center if self.free is None else np.logical_not(self.free[~is_center].any(axis=0))

    def motion(self, z: Array) -> CoordinatedMotion:
        """Return the motion with the shape weights `z`."""
        weights = z.reshape(-1, self.basis.n_basis)
        weights = weights if self.free is None else self.free @ weights
        return CoordinatedMotion(self.scene, self.coordinates, self.basis, self.boundary, weights)

    def of_free(self, slopes: Array) -> Array:
        """Return derivatives by free directions; (..., n_columns, n_basis) -> (..., n_free, n_basis)."""
        return slopes if self.free is None else self.free.T @ slopes

    def fit(self, q: Array, ridge: float) -> Array:
        """Return shape weights fitted to configurations by ridge regression.

        The array `q` has the shape (n_fine, n_columns).
        """
        shape, base = self.fine.shape, self.fine.base
        square = shape.T @ shape / len(shape) + ridge * np.eye(shape.shape[1])
        found = np.asarray(np.linalg.solve(square, shape.T @ (q - base) / len(shape)).T, dtype=np.float64)
        return self.of_free(found).ravel()

    def nodes(self, q: Array) -> Array:
        """Return nodes along configurations; (n_samples, n_columns) -> (n_samples, n_nodes, 3) [m]."""
        return self.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0]

    def hands(self, q: Array) -> tuple[Array, Array]:
        """Return nodes and end effectors along configurations [m].

        Shapes: (n_samples, n_columns) -> (n_samples, n_nodes, 3), (n_samples, n_hands * n_dims).
        """
        nodes = self.nodes(q)
        return nodes, nodes[:, : len(self.scene.manipulators), : self.scene.n_dims].reshape(len(q), -1)


class Gauge(NamedTuple):
    """The penalty that keeps directions and quaternions near unit length.

    Attributes
    ----------
    turns : the columns of each, and its reach [m]
    """

    turns: tuple[tuple[Integers, float], ...]

    @classmethod
    def of(cls, coordinates: Coordinates) -> Gauge:
        """Return that of the directions and quaternions among coordinates."""
        columns = np.arange(coordinates.n_columns)
        return cls(
            tuple(
                (columns[part.columns][coordinates.n_dims :], np.linalg.norm(part.points, axis=1).max())
                for part in coordinates.parts
                if part.kind in (DIRECTION, QUATERNION)
            )
        )

    def lengths(self, q: Array, weight: float) -> Array:
        """Return the weighted differences from unit length, at some of the samples."""
        lengths = [
            weight * reach * (np.linalg.norm(q[::GAUGE_EVERY, turn], axis=1) - 1.0)
            for turn, reach in self.turns
        ]
        return np.concatenate([np.zeros(0), *lengths])

    def moves(self, curves: Curves, q: Array, weight: float) -> Array:
        """Return the derivatives of `lengths` at coarse samples by the shape weights; array, shape (n, curves.n)."""
        rows = [np.zeros((0, curves.n))]
        for turn, reach in self.turns:
            p = q[::GAUGE_EVERY, turn]
            unit = p / np.linalg.norm(p, axis=1, keepdims=True)
            row = np.zeros((len(p), q.shape[1], curves.basis.n_basis))
            row[:, turn] = weight * reach * unit[:, :, None] * curves.coarse.shape[::GAUGE_EVERY, None, :]
            rows.append(curves.of_free(row).reshape(len(p), -1))
        return np.concatenate(rows)


class Watched(NamedTuple):
    """The samples whose configurations the trust region bounds.

    Attributes
    ----------
    at : array, shape (n,), their numbers among the fine ones
    moves : array, shape (n * n_columns, n_free * n_basis), derivatives of their configurations by the shape weights
    scale : array, shape (n * n_columns,), size of the region, relative to that of a centre [1/m]
    """

    at: Integers
    moves: Array
    scale: Array

    @classmethod
    def of(cls, curves: Curves) -> Watched:
        """Return enough samples for a basis."""
        basis, n_columns = curves.basis, curves.coordinates.n_columns
        n = max(24, int(1.2 * basis.n_basis)) + 2
        at = np.linspace(0, len(curves.fine.base) - 1, n).astype(int)[1:-1]
        moves = np.zeros((len(at), n_columns, n_columns, basis.n_basis))
        for column in range(n_columns):
            moves[:, column, column] = curves.fine.shape[at]
        scale = np.tile(_scale(curves.coordinates), len(at))
        return cls(at, curves.of_free(moves).reshape(-1, curves.n), scale)


def _scale(coordinates: Coordinates) -> Array:
    """Return relative sizes of the trust region; array, shape (n_columns,) [1/m]."""
    scale = np.ones(coordinates.n_columns)
    reach = float(np.linalg.norm(coordinates.blocks.point, axis=1).max())
    for part in coordinates.parts:
        turn = np.arange(len(scale))[part.columns][coordinates.n_dims :]
        scale[turn] = min(1.0 / max(reach, 1e-3), 3.0) * (0.5 if part.kind == QUATERNION else 1.0)
    return scale

"""The candidate: a coordinated movement as an exact curve, not as samples."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from comove.coordination.coordinates import Coordinates
from comove.primitives.basis import MotionBasis
from comove.primitives.dmp import DMP
from comove.scenes.groups import rotation_between
from comove.scenes.scene import Scene
from comove.trajectory import Trajectory

Array = NDArray[np.float64]

SAMPLE_RATE = 100.0  # Hz, of what is handed out


@dataclass(frozen=True, eq=False)
class CoordinatedMotion:
    """A movement of all manipulators of a scene on one phase, in unit duration.

    Attributes
    ----------
    scene : what it is meant for
    coordinates : how its configurations are written
    basis : its transformed system
    boundary : array, shape (4, n_columns): start, start velocity, goal, goal velocity of q
    weights : array, shape (n_columns, n_basis), shape weights
    """

    scene: Scene
    coordinates: Coordinates
    basis: MotionBasis
    boundary: Array
    weights: Array

    def __post_init__(self) -> None:
        for name in ("boundary", "weights"):  # own copies that nobody can change behind the judge's back
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @cached_property
    def knots(self) -> Array:
        """q and its first two derivatives at the knots; array, shape (3, n_knots, n_columns)."""
        knots = self.basis.boundary @ self.boundary + self.basis.shape @ self.weights.T
        knots.setflags(write=False)
        return knots

    def at(self, s: ArrayLike) -> Array:
        """The same at normalised times `s`; array, shape (3, n_steps, n_columns)."""
        boundary, shape = self.basis.at(s)
        return boundary @ self.boundary + shape @ self.weights.T

    def hands(self, s: ArrayLike) -> Array:
        """Hands and their derivatives by normalised time; array, shape (3, n_steps, n_manipulators, n_dims)."""
        nodes = self.coordinates.motion(self.at(s))
        return nodes[:, :, : len(self.scene.manipulators), : self.scene.n_dims]

    def trajectory(self, n_steps: int | None = None) -> Trajectory:
        """Sample the movement; at `SAMPLE_RATE` or finer unless `n_steps` is given."""
        duration = self.scene.duration
        n_steps = n_steps or max(201, int(np.ceil(duration * SAMPLE_RATE - 1e-9)) + 1)
        s = np.linspace(0.0, 1.0, n_steps)
        position, velocity, _ = self.hands(s)
        return Trajectory(s * duration, position, velocity / duration, self.scene.manipulators)


@dataclass(frozen=True, eq=False)
class CoordinatedDMP:
    """Several manipulators on one canonical system (what the paper calls a joint DMP).

    Attributes
    ----------
    scene, coordinates, basis, boundary : as in `CoordinatedMotion`
    weights : array, shape (n_columns, n_basis), those of the demonstration
    """

    scene: Scene
    coordinates: Coordinates
    basis: MotionBasis
    boundary: Array
    weights: Array

    @classmethod
    def from_demonstration(
        cls, dmp: DMP, scene: Scene, coordinates: Coordinates, basis: MotionBasis
    ) -> CoordinatedDMP:
        """Modulate one single-manipulator movement to every manipulator's start and goal (paper, III-B).

        Parameters
        ----------
        dmp
            The demonstrated movement, of the scene's dimension.
        """
        s = np.linspace(0.0, 1.0, 201)
        hands = np.stack(
            [
                modulate(dmp, start, goal).at(s * dmp.duration).position
                for start, goal in zip(scene.start, scene.goal, strict=True)
            ],
            axis=1,
        )
        return cls(scene, coordinates, basis, coordinates.boundary(), np.zeros(0)).fitted(
            s, coordinates.from_hands(hands)
        )

    def fitted(self, s: Array, q: Array) -> CoordinatedDMP:
        """The primitive whose rollout is nearest to given configurations.

        Parameters
        ----------
        s : array, shape (n_steps,), normalised times
        q : array, shape (n_steps, n_columns); whole turns by which it differs at the goal are kept
        """
        boundary = self.boundary.copy()
        for group, column in zip(self.coordinates.groups, self.coordinates.blocks.column, strict=True):
            if group.orientation == "plane" and self.coordinates.kind == "load":
                turn = slice(column + 2, column + 3)
                boundary[2, turn] += (
                    2
                    * np.pi
                    * np.round(
                        (q[-1, turn] - q[0, turn] - boundary[2, turn] + boundary[0, turn]) / (2 * np.pi)
                    )
                )
                q = q.copy()
                q[:, turn] += boundary[0, turn] - q[0, turn]
            elif group.orientation == "space":
                turn = slice(column + 3, column + 7)
                q = q.copy()
                q[:, turn] *= np.sign(q[0, turn] @ boundary[0, turn]) or 1.0
                boundary[2, turn] *= np.sign(q[-1, turn] @ boundary[2, turn]) or 1.0
        of_boundary, of_shape = self.basis.at(s)
        weights = np.linalg.lstsq(of_shape[0], q - of_boundary[0] @ boundary, rcond=None)[0].T
        return replace(self, boundary=boundary, weights=weights)

    def rollout(self, weights: Array | None = None) -> CoordinatedMotion:
        """The movement with these shape weights, array of shape (n_columns, n_basis)."""
        weights = self.weights if weights is None else np.asarray(weights, dtype=float)
        return CoordinatedMotion(self.scene, self.coordinates, self.basis, self.boundary, weights)

    def rollouts(self, weights: Array, n_steps: int = 201) -> Array:
        """Configurations of a whole population by one matrix product.

        Parameters
        ----------
        weights : array, shape (n_rollouts, n_columns, n_basis)

        Returns
        -------
        array, shape (n_rollouts, n_columns, n_steps)
        """
        return rollouts(self.basis, self.boundary, weights, n_steps)


def rollouts(basis: MotionBasis, boundary: Array, weights: Array, n_steps: int = 201) -> Array:
    """Positions of many rollouts as one matrix product of weights and boundary values with the basis.

    Parameters
    ----------
    boundary : array, shape (4, n_columns)
    weights : array, shape (n_rollouts, n_columns, n_basis)

    Returns
    -------
    array, shape (n_rollouts, n_columns, n_steps)
    """
    n_rollouts, n_columns, n_basis = weights.shape
    inputs = np.empty((n_rollouts, n_columns, n_basis + 4))
    inputs[:, :, :n_basis] = weights
    inputs[:, :, n_basis:] = boundary.T
    product = inputs.reshape(-1, n_basis + 4) @ basis.sampled(n_steps)
    return product.reshape(n_rollouts, n_columns, n_steps)


def modulate(dmp: DMP, start: Array, goal: Array) -> DMP:
    """Carry a movement to other ends by the similarity (rotation and scale) that maps its ends to theirs.

    Where its own ends coincide there is no such map: then it is only shifted. The result starts at rest.

    Parameters
    ----------
    start, goal : arrays, shape (n_dims,), [m]
    """
    own, wanted = dmp.goal - dmp.start, goal - start
    own_length, length = np.linalg.norm(own), np.linalg.norm(wanted)
    turn = np.eye(len(start))
    if own_length > 1e-9 * np.abs(dmp.weights).max(initial=1e-300):
        if length > 0:
            turn = _rotation(own / own_length, wanted / length)
        turn = turn * (length / own_length)
    still = np.zeros_like(start)
    return replace(
        dmp, weights=turn @ dmp.weights, start=start, goal=goal, start_velocity=still, goal_velocity=still
    )


def _rotation(a: Array, b: Array) -> Array:
    """The least rotation that turns the unit vector `a` into `b`, in the plane or in space."""
    if len(a) == 3:
        return rotation_between(a, b)
    c, s = a @ b, a[0] * b[1] - a[1] * b[0]
    return np.array([[c, -s], [s, c]])

"""Coordinated movements as exact curves, not as samples."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import comove
from comove.arrays import Array
from comove.brief import brief
from comove.dmp.arguments import require_steps
from comove.dmp.basis import MotionBasis, motion_basis, positions_at_even_times
from comove.model.coordinates import (
    Coordinates,
    coordinates_for,
    load_coordinates,
)
from comove.model.scene import Scene
from comove.trajectory import Trajectory

SAMPLE_RATE = 100.0  # Hz, of sampled trajectories


@dataclass(frozen=True, eq=False)
class CoordinatedMotion:
    """A movement of a scene's manipulators on one phase, in unit duration.

    Attributes
    ----------
    scene : the scene of the movement
    coordinates : coordinates that describe its configurations
    basis : basis functions of its transformed system
    boundary : array, shape (4, n_columns): start, start velocity, goal, goal velocity of q
    weights : array, shape (n_columns, n_basis), shape weights; masked motions of bodies are left out
    """

    __repr__ = brief

    scene: Scene
    coordinates: Coordinates
    basis: MotionBasis
    boundary: Array
    weights: Array

    def __post_init__(self) -> None:
        for name in ("boundary", "weights"):  # own read-only copies, so that checks stay valid
            array = np.array(getattr(self, name), dtype=float)
            if name == "weights" and self.coordinates.free is not None:
                array = self.coordinates.blocks.mask @ array
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __reduce__(self) -> tuple[type[CoordinatedMotion], tuple[Any, ...]]:
        """Pickle the motion's fields, not the cached results."""
        return CoordinatedMotion, (self.scene, self.coordinates, self.basis, self.boundary, self.weights)

    @classmethod
    def straight(cls, scene: Scene, coordinates: Coordinates | None = None) -> CoordinatedMotion:
        """Return the minimum-jerk motion from start to goal, which ignores obstacles.

        It is in payload coordinates by default.
        """
        coordinates, basis = coordinates or load_coordinates(scene), motion_basis(20, "jerk")
        weights = np.zeros((coordinates.n_columns, basis.n_basis))
        return cls(scene, coordinates, basis, coordinates.boundary(), weights)

    def on(self, scene: Scene) -> CoordinatedMotion:
        """Return the movement on another version of its scene.

        Duration, limits or size may differ. Centres are scaled by the ratio of the largest sides of the workspaces
        (`Scene.scaled`).
        """
        coordinates = coordinates_for(scene, self.coordinates.kind)
        factor, blocks = np.ones(self.coordinates.n_columns), self.coordinates.blocks
        sides = [float((own.upper - own.lower).max()) for own in (scene, self.scene)]
        factor[blocks.center[:, : blocks.n_dims]] = sides[0] / sides[1]
        return CoordinatedMotion(
            scene, coordinates, self.basis, self.boundary * factor, self.weights * factor[:, None]
        )

    def show(self) -> None:
        """Show the verified motion in a notebook or browser. See `comove.show`."""
        comove.show(self)

    @cached_property
    def knots(self) -> Array:
        """Return q and two derivatives at knots; array, shape (3, n_knots, n_columns)."""
        knots = self.basis.boundary @ self.boundary + self.basis.shape @ self.weights.T
        knots.setflags(write=False)
        return knots

    def at(self, s: ArrayLike) -> Array:
        """Return q and two derivatives at normalised times; (3, n_steps, n_columns)."""
        boundary, shape = self.basis.at(s)
        return boundary @ self.boundary + shape @ self.weights.T

    def nodes(self, n_steps: int) -> Array:
        """Return the keypoints at even times; array, shape (n_steps, n_nodes, 3) [m]."""
        boundary, shape = positions_at_even_times(self.basis, n_steps)
        q = boundary @ self.boundary + shape @ self.weights.T
        return np.ascontiguousarray(self.coordinates.nodes(np.ascontiguousarray(q.T[None]))[0])

    @cached_property
    def nodes_at_knots(self) -> Array:
        """Return the keypoints at knots and two derivatives; array, shape (3, n_knots, n_nodes, 3) [m]."""
        nodes = self.coordinates.motion(self.knots)
        nodes.setflags(write=False)
        return nodes

    def hands(self, s: ArrayLike) -> Array:
        """Return the end effectors' positions and two derivatives by normalised time.

        Array, shape (3, n_steps, n_manipulators, n_dims).
        """
        nodes = self.coordinates.motion(self.at(s))
        return nodes[:, :, : len(self.scene.manipulators), : self.scene.n_dims]

    def trajectory(self, n_steps: int | None = None) -> Trajectory:
        """Sample the movement, by default at `SAMPLE_RATE` or finer."""
        duration = self.scene.duration
        if n_steps is not None:
            require_steps(n_steps)
        n_steps = n_steps or max(201, int(np.ceil(duration * SAMPLE_RATE - 1e-9)) + 1)
        s = np.linspace(0.0, 1.0, n_steps)
        position, velocity, _ = self.hands(s)
        return Trajectory(s * duration, position, velocity / duration, self.scene.manipulators)

"""Coordinated movements as exact curves, not as samples."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

import comove
from comove.brief import brief
from comove.coordination.coordinates import (
    ANGLE,
    QUATERNION,
    Coordinates,
    coordinates_for,
    load_coordinates,
)
from comove.errors import OptionError
from comove.geometry.rotations import quaternion_of_rotation, quaternion_product, similarity
from comove.primitives.arguments import numbers, require_steps
from comove.primitives.basis import MotionBasis, motion_basis
from comove.primitives.online import Curve, DMPState, advance, begin
from comove.scenes.groups import orientation_of
from comove.scenes.scene import Scene
from comove.trajectory import Trajectory

Array = NDArray[np.float64]

SAMPLE_RATE = 100.0  # Hz, of sampled trajectories
GOAL_MISS = 1e-6  # m, largest violation of constraints by hands at a moved goal


@dataclass(frozen=True, eq=False)
class CoordinatedMotion:
    """A movement of all manipulators of a scene on one phase, in unit duration.

    Attributes
    ----------
    scene : the scene of the movement
    coordinates : coordinates that describe its configurations
    basis : basis functions of its transformed system
    boundary : array, shape (4, n_columns): start, start velocity, goal, goal velocity of q
    weights : array, shape (n_columns, n_basis), shape weights
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
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __reduce__(self) -> tuple[type[CoordinatedMotion], tuple[Any, ...]]:
        """Pickle what the motion is made of, and not what was computed from it."""
        return CoordinatedMotion, (self.scene, self.coordinates, self.basis, self.boundary, self.weights)

    @classmethod
    def straight(cls, scene: Scene, coordinates: Coordinates | None = None) -> CoordinatedMotion:
        """Return the minimum-jerk motion from start to goal, which ignores obstacles.

        It is in load coordinates by default.
        """
        coordinates, basis = coordinates or load_coordinates(scene), motion_basis(20, "jerk")
        weights = np.zeros((coordinates.n_columns, basis.n_basis))
        return cls(scene, coordinates, basis, coordinates.boundary(), weights)

    def on(self, scene: Scene) -> CoordinatedMotion:
        """Return the movement on its scene made larger or smaller (`Scene.scaled`)."""
        coordinates = coordinates_for(scene, self.coordinates.kind)
        factor, blocks = np.ones(self.coordinates.n_columns), self.coordinates.blocks
        sides = [float((own.upper - own.lower).max()) for own in (scene, self.scene)]
        factor[blocks.center[:, : blocks.n_dims]] = sides[0] / sides[1]
        return CoordinatedMotion(
            scene, coordinates, self.basis, self.boundary * factor, self.weights * factor[:, None]
        )

    def show(self) -> None:
        """Show the motion, judged, in a notebook, or else in a browser; see `comove.show`."""
        comove.show(self)

    @cached_property
    def knots(self) -> Array:
        """Return q and its first two derivatives at the knots; array, shape (3, n_knots, n_columns)."""
        knots = self.basis.boundary @ self.boundary + self.basis.shape @ self.weights.T
        knots.setflags(write=False)
        return knots

    def at(self, s: ArrayLike) -> Array:
        """Return q and its first two derivatives at normalised times `s`; array, shape (3, n_steps, n_columns)."""
        boundary, shape = self.basis.at(s)
        return boundary @ self.boundary + shape @ self.weights.T

    def hands(self, s: ArrayLike) -> Array:
        """Return the hands and their first two derivatives by normalised time.

        Array, shape (3, n_steps, n_manipulators, n_dims).
        """
        nodes = self.coordinates.motion(self.at(s))
        return nodes[:, :, : len(self.scene.manipulators), : self.scene.n_dims]

    @cached_property
    def curve(self) -> Curve:
        """Return the curve in configurations that an execution follows."""
        basis = self.basis
        force = basis.boundary_force @ self.boundary + basis.shape_force @ self.weights.T
        return Curve(self.knots, force, self.boundary[2])

    def initial_state(self) -> DMPState:
        """Return the state at time 0, from which `step` continues; its position is a configuration q."""
        return begin(self.curve, self.boundary[0], self.boundary[1], self.scene.duration)

    def step(self, state: DMPState, dt: float, *, rate: float = 1.0) -> DMPState:
        """Advance by `dt` [s] online, exactly as `DMP.step` does.

        Constraints that the coordinates keep by construction hold at any pace, in pauses, after pushes and while the
        goal moves. A redirected movement has not been verified.
        """
        if not np.array_equal(state.goal, state.curve.goal):
            state = self._towards(state, state.goal)
        return advance(state, dt, rate)

    def hands_at(self, state: DMPState) -> tuple[Array, Array]:
        """Return positions [m] and velocities [m/s] of the hands in a state.

        Arrays, shape (n_manipulators, n_dims).
        """
        rate = state.rate / state.duration
        q = np.stack([state.position, state.slope * rate, np.zeros_like(state.position)])[:, None]
        position, velocity, _ = self.coordinates.motion(q)[
            :, 0, : len(self.scene.manipulators), : self.scene.n_dims
        ]
        return position, velocity

    def redirected(self, state: DMPState, goal: ArrayLike) -> DMPState:
        """Return the state with another goal, array of shape (n_manipulators, n_dims), [m].

        Raises
        ------
        OptionError
            If hands at this goal would violate constraints that the coordinates keep by construction.
        """
        q = self._configuration(state.curve.goal, goal)
        miss = np.abs(self._hands_of(q) - np.asarray(goal, dtype=np.float64)).max()
        if miss > GOAL_MISS:
            raise OptionError(
                f"the goal {np.asarray(goal).tolist()} breaks a constraint by {miss:.3g} m",
                way_out="move all hands together",
            )
        return self._towards(state, q)

    def _towards(self, state: DMPState, q: Array) -> DMPState:
        """Return the state on the way to another goal, a configuration."""
        if len(q) != self.coordinates.n_columns:
            raise OptionError("the state is none of this motion", way_out="begin with initial_state()")
        boundary = self.boundary.copy()
        boundary[2] = q
        curve = replace(self, boundary=boundary).curve.after(state.curve, state.progress)
        return replace(state, goal=q, curve=curve)

    def displaced(self, state: DMPState, hands: ArrayLike) -> DMPState:
        """Return the state after a push, with the hands as measured, array of shape (n_manipulators, n_dims), [m].

        The nearest configuration is taken, so that the constraints hold whatever was measured.
        """
        return replace(state, position=self._configuration(state.position, hands))

    def _configuration(self, near: Array, hands: ArrayLike) -> Array:
        """Return the configuration of given hands, with roll, whole turns and sign nearest to the configuration
        `near`.
        """
        if len(near) != self.coordinates.n_columns:
            raise OptionError("the state is none of this motion", way_out="begin with initial_state()")
        hands = numbers(hands)
        now = self._hands_of(near)
        if hands.shape != now.shape or not np.isfinite(hands).all():
            raise OptionError(
                f"hands of shape {hands.shape}",
                way_out=f"give {len(now)} points of {self.scene.n_dims} finite numbers",
            )
        own, q = self.coordinates.from_hands(np.stack([now, hands]))
        for group, (kind, columns, *_) in zip(self.coordinates.groups, self.coordinates.parts, strict=True):
            turn = np.arange(len(q))[columns][self.coordinates.n_dims :]
            if kind == QUATERNION and orientation_of(group.grasps, 3) == "axis":
                # Two hands say nothing of the roll about the line between them: it stays.
                ends = (hand[list(group.members)] for hand in (now, hands))
                first, last = (np.diff(fit_ends, axis=0)[0] for fit_ends in ends)
                least = quaternion_of_rotation(
                    similarity(first / np.linalg.norm(first), last / np.linalg.norm(last))
                )
                q[turn] = quaternion_product(least, near[turn])
            elif kind == ANGLE:
                q[turn] += near[turn] - own[turn]
            elif len(turn):  # its length is free, and a quaternion's sign
                q[turn] *= (own[turn] @ near[turn]) / (own[turn] @ own[turn])
        return q

    def _hands_of(self, q: Array) -> Array:
        hands = self.coordinates.nodes(np.ascontiguousarray(q[None, :, None]))[0, 0]
        return hands[: len(self.scene.manipulators), : self.scene.n_dims]

    def trajectory(self, n_steps: int | None = None) -> Trajectory:
        """Sample the movement; at `SAMPLE_RATE` or finer unless `n_steps` is given."""
        duration = self.scene.duration
        if n_steps is not None:
            require_steps(n_steps)
        n_steps = n_steps or max(201, int(np.ceil(duration * SAMPLE_RATE - 1e-9)) + 1)
        s = np.linspace(0.0, 1.0, n_steps)
        position, velocity, _ = self.hands(s)
        return Trajectory(s * duration, position, velocity / duration, self.scene.manipulators)

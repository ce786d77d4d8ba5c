"""Coordinated movements executed stepwise, exactly as curves."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from comove.arrays import Array
from comove.dmp.arguments import numbers
from comove.dmp.online import Curve, DMPState, advance, begin
from comove.errors import OptionError
from comove.geometry.rotations import quaternion_of_rotation, quaternion_product, similarity
from comove.model.coordinates import ANGLE, QUATERNION
from comove.model.groups import orientation_of
from comove.model.motion import CoordinatedMotion

GOAL_MISS = 1e-6  # m, largest violation of constraints by hands at a moved goal


@dataclass(frozen=True, eq=False)
class OnlineMotion:
    """A coordinated movement that is advanced, slowed, pushed and redirected.

    Attributes
    ----------
    motion : the movement
    """

    motion: CoordinatedMotion

    @cached_property
    def curve(self) -> Curve:
        """Return the followed curve of configurations."""
        motion, basis = self.motion, self.motion.basis
        force = basis.boundary_force @ motion.boundary + basis.shape_force @ motion.weights.T
        return Curve(motion.knots, force, motion.boundary[2])

    def initial_state(self) -> DMPState:
        """Return the state at time 0; its position is a configuration."""
        return begin(self.curve, self.motion.boundary[0], self.motion.boundary[1], self.motion.scene.duration)

    def step(self, state: DMPState, dt: float, *, rate: float = 1.0) -> DMPState:
        """Advance by `dt` [s] online, exactly as `DMP.step` does.

        Constraints that the coordinates keep by construction hold at any pace, in pauses, after pushes and while the
        goal moves. A redirected movement has not been verified.
        """
        if not np.array_equal(state.goal, state.curve.goal):
            state = self._towards(state, state.goal)
        return advance(state, dt, rate)

    def hands_at(self, state: DMPState) -> tuple[Array, Array]:
        """Return the end effectors' positions [m] and velocities [m/s]. Arrays, shape (n_manipulators, n_dims)."""
        rate = state.rate / state.duration
        q = np.stack([state.position, state.slope * rate, np.zeros_like(state.position)])[:, None]
        position, velocity, _ = self.motion.coordinates.motion(q)[
            :, 0, : len(self.motion.scene.manipulators), : self.motion.scene.n_dims
        ]
        return position, velocity

    def redirected(self, state: DMPState, goal: ArrayLike) -> DMPState:
        """Return the state with another goal, (n_manipulators, n_dims), [m].

        Raises
        ------
        OptionError
            If end effectors at this goal would violate constraints that the coordinates keep by construction.
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
        """Return the state towards another goal configuration."""
        if len(q) != self.motion.coordinates.n_columns:
            raise OptionError("the state is none of this motion", way_out="begin with initial_state()")
        boundary = self.motion.boundary.copy()
        boundary[2] = q
        curve = OnlineMotion(replace(self.motion, boundary=boundary)).curve.after(state.curve, state.progress)
        return replace(state, goal=q, curve=curve)

    def displaced(self, state: DMPState, hands: ArrayLike) -> DMPState:
        """Return the state after a push to measured end effectors.

        They have shape (n_manipulators, n_dims), [m]. The nearest configuration is used, so that the constraints hold
        for any measurement.
        """
        return replace(state, position=self._configuration(state.position, hands))

    def _configuration(self, near: Array, hands: ArrayLike) -> Array:
        """Return the end effectors' configuration nearest to `near` in roll, turns, sign."""
        if len(near) != self.motion.coordinates.n_columns:
            raise OptionError("the state is none of this motion", way_out="begin with initial_state()")
        hands = numbers(hands)
        now = self._hands_of(near)
        if hands.shape != now.shape or not np.isfinite(hands).all():
            raise OptionError(
                f"hands of shape {hands.shape}",
                way_out=f"give {len(now)} points of {self.motion.scene.n_dims} finite numbers",
            )
        own, q = self.motion.coordinates.from_hands(np.stack([now, hands]))
        for group, (kind, columns, *_) in zip(
            self.motion.coordinates.groups, self.motion.coordinates.parts, strict=True
        ):
            turn = np.arange(len(q))[columns][self.motion.coordinates.n_dims :]
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
        hands = self.motion.coordinates.nodes(np.ascontiguousarray(q[None, :, None]))[0, 0]
        return hands[: len(self.motion.scene.manipulators), : self.motion.scene.n_dims]

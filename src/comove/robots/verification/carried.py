"""The verified motion of hands and load, with bounds of its derivatives, and the load as shapes of coal.

All of it comes from the verified curve and from the bounds by which it was verified. A rod of the load is a capsule,
a solid a box, placed by the nodes that they span.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import coal
import numpy as np
from numpy.typing import NDArray

from comove.coordination.coordinates import load_coordinates
from comove.coordination.motion import CoordinatedMotion
from comove.geometry.rotations import cross
from comove.primitives.forcing import N_INTERVALS
from comove.robots.motion import Ranges
from comove.scenes.scene import Scene
from comove.verification.bounds import NodeBounds, node_bounds

Array = NDArray[np.float64]


class LoadMotion(Protocol):
    """A load in motion, as the clearance is certified for it: `Carried`, or one that lies still."""

    @property
    def speed(self) -> Ranges:
        """Return upper bounds of the speed of every node [m/s]."""

    def nodes(self, time: Array) -> Array:
        """Compute the positions of the nodes; array, shape (n_steps, n_nodes, 3) [m]."""


@dataclass(frozen=True, eq=False)
class Carried:
    """A verified motion of hands and load in space, by time [s].

    Attributes
    ----------
    motion : CoordinatedMotion on a spatial scene
    """

    motion: CoordinatedMotion

    @classmethod
    def straight(cls, scene: Scene) -> Carried:
        """Return the straight motion on a scene, which has the ends and the load of all."""
        return cls(CoordinatedMotion.straight(scene, load_coordinates(scene)))

    @cached_property
    def time(self) -> Array:
        """Return the times of the knots, between which the bounds hold; array, shape (n_knots,) [s]."""
        return np.linspace(0.0, self.motion.scene.duration, N_INTERVALS + 1)

    def nodes(self, time: Array) -> Array:
        """Compute the positions of the hands and of the load's corners; array, shape (n_steps, n_nodes, 3) [m]."""
        return self.motion.coordinates.motion(self.motion.at(time / self.motion.scene.duration))[0]

    def hands(self, time: Array) -> tuple[Array, Array]:
        """Compute positions [m] and velocities [m/s] of the hands; arrays, shape (n_steps, n_manipulators, 3)."""
        duration = self.motion.scene.duration
        position, velocity, _ = self.motion.hands(time / duration)
        return position, velocity / duration

    def rotations(self, time: Array) -> tuple[Array, Array] | None:
        """Compute orientations and angular velocities of the hands' grasp frames; None where the scene has no grasp.

        Returns
        -------
        rotations : array, shape (n_steps, n_manipulators, 3, 3)
        velocities : array, shape (n_steps, n_manipulators, 3) [rad/s]
        """
        grasp = self.motion.scene.grasp
        if grasp is None:
            return None
        position, velocity = self.hands(time)
        spin = np.zeros_like(position)
        spin[:, grasp.turning, 2] = grasp.heading_rates(position, velocity[..., None])
        return grasp.hand_rotations(position), spin

    @cached_property
    def speed(self) -> Ranges:
        """Return upper bounds of the speed of every node [m/s]."""
        return Ranges(self.time, self._speeds / self.motion.scene.duration)

    @cached_property
    def jerk(self) -> Ranges:
        """Return upper bounds of the third derivative of every hand's position [m/s^3]."""
        n_hands = len(self.motion.scene.manipulators)
        return Ranges(self.time, self._bounds.jerk[:, :n_hands] / self.motion.scene.duration**3)

    @cached_property
    def swing(self) -> Ranges:
        """Return upper bounds of the third derivative of the heading [rad/s^3]; array of width 1.

        The unit vector u along a planar vector r has ``|u'''| <= a3 + 2 sqrt(3) a1 a2 + 3 a1^3``, a_i the bounds of
        the derivatives of r over the least |r| (see `comove.verification.bounds`), and its angle has
        ``|psi'''| <= |u'''| + |u'|^3``.
        """
        scene, time = self.motion.scene, self.time
        if scene.grasp is None or len(scene.grasp.holders) < 2:
            return Ranges(time, np.zeros((N_INTERVALS, 1)))
        pair = list(scene.grasp.holders[:2])
        hands = self.nodes(time)[:, pair, :2]
        apart = np.linalg.norm(hands[:, 0] - hands[:, 1], axis=1)
        change = self._speeds[:, pair].sum(axis=1)
        least = np.minimum(apart[1:], apart[:-1]) - 0.5 / N_INTERVALS * change
        sums = change, *(bound[:, pair].sum(axis=1) for bound in self._bounds)
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second, third = (np.where(least > 0, x / least, np.inf) for x in sums)
        bound = third + 2 * np.sqrt(3.0) * first * second + 4 * first**3
        return Ranges(time, bound[:, None] / scene.duration**3)

    @cached_property
    def _bounds(self) -> NodeBounds:
        return node_bounds(self.motion)

    @cached_property
    def _speeds(self) -> Array:
        """Return upper bounds of the speed of every node between two knots, in unit duration; (n_intervals,
        n_nodes).
        """
        speed = np.linalg.norm(self.motion.coordinates.motion(self.motion.knots)[1], axis=2)
        return np.maximum(speed[1:], speed[:-1]) + 0.5 / N_INTERVALS * self._bounds.acceleration


class LoadShape(NamedTuple):
    """A shape and the nodes that define its pose.

    Attributes
    ----------
    geometry : coal.Capsule or coal.Box
    nodes : numbers of both end nodes of a rod; of the eight corners of a box, numbered in binary by the sides they
        are on
    """

    geometry: Any
    nodes: tuple[int, ...]


def load_shapes(carried: Carried, thin: float = 1e-6) -> list[LoadShape]:
    """Return all shapes of the load, in the largest size that they have at any time; no rod is thinner than `thin`
    [m].
    """
    body, nodes = carried.motion.scene.body, carried.nodes(carried.time)
    shapes = []
    for (a, b), radius in zip(body.edges.tolist(), body.radii.tolist(), strict=True):
        if a != b:
            shapes.append(LoadShape(coal.Capsule(max(radius, thin), _largest(nodes, a, b)), (a, b)))
    for corners in body.solids.tolist():
        size = [_largest(nodes, corners[0], corners[side]) for side in (1, 2, 4)]
        shapes.append(LoadShape(coal.Box(*size), tuple(corners)))
    return shapes


def _largest(nodes: Array, a: int, b: int) -> float:
    return float(np.linalg.norm(nodes[:, a] - nodes[:, b], axis=1).max())


def placements(nodes: Array, spanned: tuple[int, ...]) -> tuple[Array, Array]:
    """Compute orientations and centres of a shape from the positions of the nodes that it spans.

    Parameters
    ----------
    nodes : array, shape (n_steps, n_nodes, 3) [m]
    spanned : nodes as in `LoadShape`

    Returns
    -------
    array, shape (n_steps, 3, 3), rotations, and array, shape (n_steps, 3), centres [m]
    """
    ends = nodes[:, spanned[0]], nodes[:, spanned[-1]]
    if len(spanned) == 2:  # any frame whose z axis is along the rod
        z = _unit(ends[1] - ends[0])
        x = _unit(cross(z, np.eye(3)[np.abs(z).round(9).argmin(axis=1)]))
    else:
        x = _unit(nodes[:, spanned[1]] - ends[0])
        z = _unit(cross(x, nodes[:, spanned[2]] - ends[0]))
    return np.stack([x, cross(z, x), z], axis=2), 0.5 * (ends[0] + ends[1])


def _unit(vectors: Array) -> Array:
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def leverage(carried: Carried) -> float:
    """Return the largest ratio of the error of a corner of the load to the errors of its hands [m and rad].

    Two hands, each with a position error e, turn the load by up to 2e over their distance; about the line between the
    two, the load turns with the hands themselves.
    """
    scene = carried.motion.scene
    nodes = scene.nodes_at("start")
    hands = nodes[list(scene.file.holder_numbers)]
    corners = nodes[len(scene.manipulators) :]
    if not len(hands) or not len(corners):
        return 1.0
    beyond = np.linalg.norm(corners[:, None] - hands[None], axis=2).min(axis=1).max()
    apart = [np.linalg.norm(hands[i] - hands[j]) for i in range(len(hands)) for j in range(i)]
    return float(1.0 + beyond * (1.0 + (2.0 / min(apart) if apart else 0.0)))

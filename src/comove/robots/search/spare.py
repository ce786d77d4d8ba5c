"""What the arms that carry a load have to spare along a motion, and how that changes with it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from comove.compiled import kernel
from comove.coordination.blocks import Blocks, place_one
from comove.planning.trees import copy_to
from comove.robots.search.chains import Chains, jacobian, place_arm, reach_pose, solve_damped
from comove.robots.search.following import MET, SEARCHING, Arms, follow_one, hand_rotation
from comove.robots.search.links import ENOUGH, ROUGH, clearance_around, clearance_between, place_links

Array = NDArray[np.float64]

WITHIN = 2e-3  # m, by which poses must be within reach
MORE = 1e-3  # m, of clearance at first and after every rejection: in between samples, and where joints are redundant
SOON = 0.012  # m, beyond what is required, below which it counts how a distance changes
MOVE = 1e-3  # m, or of a direction or quaternion, by which a configuration is moved to see what changes
LEVER = 0.2  # m, with which distances to the end of reach are about right for most arms
N_INVERSIONS = 4  # iterations to the least eigenvalue
EXACT = SEARCHING._replace(tolerance=1e-8)
"""Iteration for differences, where the end of an arm's reach is seen by how its joints turn."""


@dataclass(frozen=True, eq=False)
class ArmsFollower:
    """Arms that follow motions of a load, as `comove.planning.convex.programme.Follower` describes.

    The distances are of as many kinds as there are arms, and two more: how far the pose of each hand is within the
    arm's reach, negative where it is out of it, the clearance of the links from obstacles and load, and the one from
    each other.

    Attributes
    ----------
    course : array, shape (2, n_joints), joints at start and goal
    at_ends : array, shape (n_kinds,), least distances at start and goal [m]
    more : clearance that is asked for beyond the required one [m]
    """

    arms: Arms
    course: Array
    at_ends: Array
    more: float = MORE

    @classmethod
    def near(cls, arms: Arms, course: Array, nodes: Array) -> ArmsFollower:
        """Return what follows motions near one; what has less to spare at its ends may have so anywhere.

        Parameters
        ----------
        nodes : array, shape (n_steps, n_nodes, 3), hands and nodes of the load [m]
        """
        _, spare = spare_along(arms, np.ascontiguousarray(nodes), course)
        return cls(arms, course, spare[[0, -1]].min(axis=0) - ROUGH)

    def stricter(self) -> ArmsFollower:
        """Return what asks for more clearance."""
        return replace(self, more=self.more + MORE)

    def required(self, margin: float) -> Array:
        """Return the distances that are required; array, shape (n_kinds,) [m]."""
        reach = np.full(len(self.arms.chains.first) - 1, WITHIN)
        clearance = np.full(2, self.arms.around.clearance + self.more + margin)
        return np.minimum(self.at_ends, np.concatenate([reach, clearance]))

    def follow(self, nodes: Array) -> tuple[Array, Array]:
        """Compute the joints along a motion, shape (n_samples, n_joints), and distances, (n_samples, n_kinds) [m]."""
        return spare_along(self.arms, np.ascontiguousarray(nodes), self.course)

    def slopes(self, blocks: Blocks, q: Array, joints: Array, spare: Array) -> Array:
        """Compute the derivatives of distances by the configurations `q`; array, shape (n_samples, n_kinds,
        n_columns), 0 where there is so much to spare that it does not count.
        """
        near = self.required(0.0) + SOON
        return slopes_along(self.arms, blocks, np.array(q), joints, spare, near)


@kernel(nogil=True)
def spare_along(arms: Arms, nodes: Array, course: Array) -> tuple[Array, Array]:
    """Follow one motion; returns joints, shape (n_steps, n_joints), and distances, shape (n_steps, n_kinds) [m]."""
    links, n_steps, n_arms = arms.links, nodes.shape[0], arms.chains.first.shape[0] - 1
    q, left = np.empty((n_steps, course.shape[1])), np.empty((n_steps, n_arms))
    follow_one(arms, nodes, course, q, left)
    spare, start, end = np.empty((n_steps, n_arms + 2)), links.start.copy(), links.end.copy()
    for t in range(n_steps):
        for i in range(n_arms):
            spare[t, i] = _reach(arms.chains, i, q[t], left[t, i])
        _clearances(arms, nodes[t], q[t], start, end, spare[t])
    return q, spare


@kernel
def _reach(chains: Chains, arm: int, q: Array, left: float) -> float:
    """Return how far a hand is within its arm's reach, of which it misses its pose by `left` [m]."""
    return min(ENOUGH, _within_reach(chains, arm, q)) if left <= MET else -left


@kernel
def _within_reach(chains: Chains, arm: int, q: Array) -> float:
    """Return about how far a hand is from where its arm is stretched [m]; `ENOUGH` for fewer than six joints.

    An arm of two parts of length a, whose elbow is bent by a small angle e, reaches a e^2 / 4 further, and a radian
    of its joints moves the hand by s = a e / 2 in that direction: the distance is s^2 / a. Here s^2 is the least
    eigenvalue of J J^T, by inverse iteration. Its direction is one of poses, and turns as well as it moves, which
    makes s smaller: `LEVER` is less than a.
    """
    n = chains.first[arm + 1] - chains.first[arm]
    if n < 6:
        return ENOUGH
    rotations, points, jac = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3)), np.empty((6, n))
    x, y, free, size = np.ones(6), np.empty(6), np.ones(n, dtype=np.bool_), 1.0
    place_arm(chains, arm, q, rotations, points)
    jacobian(chains, arm, rotations, points, jac)
    for _ in range(N_INVERSIONS):
        solve_damped(jac, free, 1e-9, x, y)
        size = 0.0
        for i in range(6):
            size += y[i] * y[i]
        size = sqrt(size)
        for i in range(6):
            x[i] = y[i] / size
    return 1.0 / (size * LEVER)


@kernel
def _clearances(arms: Arms, nodes: Array, q: Array, start: Array, end: Array, out: Array) -> None:
    """Write the clearances of the links at joints q, the last two distances."""
    place_links(arms.chains, arms.links, q, start, end)
    out[-2] = clearance_around(arms.links, arms.around, start, end, nodes, ENOUGH)
    out[-1] = clearance_between(arms.links, start, end, ENOUGH) + arms.around.eased


@kernel(nogil=True)
def slopes_along(arms: Arms, blocks: Blocks, at: Array, joints: Array, spare: Array, near: Array) -> Array:
    """Compute the derivatives of distances nearer than `near`, array of shape (n_kinds,), by differences.

    Arms follow each move of a configuration with the least motion of their joints.

    Parameters
    ----------
    at : array, shape (n_steps, n_columns), configurations of the load

    Returns
    -------
    array, shape (n_steps, n_kinds, n_columns)
    """
    chains, links, (n_steps, n_kinds), n_columns = arms.chains, arms.links, spare.shape, at.shape[1]
    slopes, nodes = np.zeros((n_steps, n_kinds, n_columns)), np.empty((blocks.node.shape[0], 3))
    start, end, moved, q = (
        links.start.copy(),
        links.end.copy(),
        np.empty(n_columns),
        np.empty(joints.shape[1]),
    )
    rotation, value = np.empty((3, 3)), np.empty((2, n_kinds))
    n_arms = n_kinds - 2
    for t in range(n_steps):
        counts = spare[t] < near
        links_count = counts[n_arms] or counts[n_arms + 1]
        for c in range(-1, n_columns if counts.any() else -1):
            copy_to(at[t], moved)
            copy_to(joints[t], q)
            if c >= 0:
                moved[c] += MOVE
            place_one(blocks, moved, 1.0, nodes)
            for i in range(n_arms):
                if counts[i] or links_count:
                    hand_rotation(arms.around, nodes, i, rotation)
                    left = reach_pose(chains, i, rotation, nodes[i], joints[t], EXACT, q)
                    if counts[i]:
                        value[int(c >= 0), i] = _reach(chains, i, q, left)
            if links_count:
                _clearances(arms, nodes, q, start, end, value[int(c >= 0)])
            for k in range(n_kinds):
                if c >= 0 and counts[k] and value[0, k] < near[k]:
                    slopes[t, k, c] = (value[1, k] - value[0, k]) / MOVE
    return slopes
